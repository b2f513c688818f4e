//! A simulated arm as the joints behind simulated servos.

use crate::simulated::joints::JointModel;
use opspace_backend::{Backend, Command, DeviceFault, Sample};

/// Joints of a simulated arm that accepts torques of its motors in each of its periods, and measures positions and velocities.
pub struct ArmJoints {
    arm: Box<dyn Backend + Send>,
    sample: Sample,
    failure: Option<String>,
}

impl ArmJoints {
    /// Returns the joints of an arm, after its first sample.
    ///
    /// # Errors
    /// If the arm cannot be read.
    pub fn new(mut arm: Box<dyn Backend + Send>) -> Result<Self, DeviceFault> {
        let mut sample = Sample::new(arm.capabilities());
        arm.read(&mut sample)?;
        Ok(Self { arm, sample, failure: None })
    }
}

impl JointModel for ArmJoints {
    fn joints(&self) -> usize {
        self.sample.q.len()
    }

    /// Advances the arm by one of its periods. An arm that fails stays where it is.
    fn advance(&mut self, motor_torque_nm: &[f64], _duration_s: f64) {
        if self.failure.is_some() {
            return;
        }
        let Self { arm, sample, .. } = self;
        let advanced = arm.write(Command::Torque(motor_torque_nm)).and_then(|()| arm.read(sample));
        self.failure = advanced.err().map(|fault| fault.to_string());
    }

    fn q(&self) -> &[f64] {
        &self.sample.q
    }

    fn dq(&self) -> &[f64] {
        self.sample.dq.as_deref().unwrap_or_default()
    }

    fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }
}
