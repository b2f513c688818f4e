//! Servo of a simulated joint, with its state.

use opspace_transformer::{ServoLaw, ServoState, SetpointAverage};

/// Servo of a joint: its law, what it remembers, and the average of its setpoints.
#[derive(Clone, Debug)]
pub(crate) struct JointServo {
    law: ServoLaw,
    memory: ServoState,
    average: SetpointAverage,
}

impl JointServo {
    /// Returns a servo at rest at `position` (rad, m) with this torque (Nm, N), and its setpoint.
    pub fn at_rest(law: ServoLaw, position: f64, torque: f64) -> (Self, f64) {
        let mut servo = Self { law, memory: ServoState::default(), average: law.setpoint_average() };
        let setpoint = servo.rest(position, torque);
        (servo, setpoint)
    }

    /// Sets the servo to rest, and returns its setpoint.
    pub fn rest(&mut self, position: f64, torque: f64) -> f64 {
        let (memory, setpoint) = self.law.rest(position, torque);
        self.memory = memory;
        self.average.rest(setpoint);
        setpoint
    }

    /// Runs a servo tick at a measured position (rad, m), and returns the torque (Nm, N).
    pub fn step(&mut self, setpoint: f64, position: f64) -> f64 {
        let setpoint = self.average.step(setpoint);
        self.law.step(&mut self.memory, setpoint, position)
    }
}
