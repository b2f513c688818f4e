//! One joint of an arm with its drive and its transformer, cycle by cycle: the loop that stability analyses run.

use crate::active_setpoints::ActiveSetpoints;
use crate::drive_timing::DriveTiming;
use crate::estimator::VelocityEstimator;
use crate::servo_law::{ServoLaw, ServoState};
use crate::setpoint_average::SetpointAverage;
use crate::transformer::Transformer;
use opspace_backend::Sample;
use opspace_model::Data;

/// Drive of one joint that accepts setpoints at the interface.
#[derive(Clone, Debug)]
pub struct SampledDrive {
    law: ServoLaw,
    memory: ServoState,
    average: SetpointAverage,
    timing: DriveTiming,
    active: ActiveSetpoints,
    tick: u32,
    torques: f64,
}

impl SampledDrive {
    /// Returns a drive at rest at `position` (rad, m) with this torque (Nm, N).
    #[must_use]
    pub fn new(law: ServoLaw, timing: DriveTiming, position: f64, torque: f64) -> Self {
        let mut active = ActiveSetpoints::new(1, timing);
        let (memory, setpoint) = law.rest(position, torque);
        active.hold(0, setpoint);
        let mut average = law.setpoint_average();
        average.rest(setpoint);
        Self { law, memory, average, timing, active, tick: 0, torques: 0.0 }
    }

    /// Returns the torque (Nm, N) of the next servo tick at `position` (rad, m); `setpoint` is the one sent at the present
    /// interface cycle.
    pub fn step(&mut self, setpoint: f64, position: f64) -> f64 {
        let now = self.active.during(self.timing, 0, self.tick, Some(&[setpoint]));
        let torque = self.law.step(&mut self.memory, self.average.step(now), position);
        self.tick += 1;
        self.torques += torque;
        torque
    }

    /// Ends the interface cycle, and returns the mean torque during it, Nm (N).
    pub fn end_cycle(&mut self, setpoint: f64) -> f64 {
        self.active.advance(self.timing, Some(&[setpoint]));
        self.tick = 0;
        std::mem::take(&mut self.torques) / f64::from(self.timing.servo_ticks_per_cycle)
    }
}

/// Transformer of an arm of which one joint moves, with the velocities that the controller would give it.
pub struct MovingJoint<'a> {
    transformer: &'a mut dyn Transformer,
    velocity: VelocityEstimator,
    data: Data,
    sample: Sample,
    joint: usize,
    torque: Vec<f64>,
    command: Vec<f64>,
}

impl<'a> MovingJoint<'a> {
    /// Returns the arm at rest in the posture of `data`, with the desired torques that hold it. `sample` contains what the
    /// robot measures.
    #[must_use]
    pub fn new(
        transformer: &'a mut dyn Transformer,
        data: &Data,
        joint: usize,
        velocity: VelocityEstimator,
        mut sample: Sample,
    ) -> Self {
        transformer.reset();
        let n = data.q.len();
        let holding = data.gravity.as_slice().to_vec();
        sample.q.copy_from_slice(data.q.as_slice());
        if let Some(measured) = &mut sample.motor_torque {
            measured.copy_from_slice(&holding);
        }
        let mut data = data.clone();
        data.dq.fill(0.0);
        Self { transformer, velocity, data, sample, joint, command: vec![0.0; n], torque: holding }
    }

    /// Runs one interface cycle with the joint at `position` (rad, m), after an interval with this mean motor torque (Nm,
    /// N). `desired` computes the desired torque of the joint, without the one that holds it, from its estimated velocity.
    /// Returns the setpoint.
    pub fn cycle(&mut self, position: f64, mean_torque: f64, desired: impl Fn(f64) -> f64) -> f64 {
        let i = self.joint;
        self.sample.q[i] = position;
        if let Some(measured) = &mut self.sample.motor_torque {
            measured[i] = mean_torque;
        }
        self.data.q[i] = position;
        let filtered = self.velocity.update(&self.sample.q);
        let dq = self.transformer.observe(&self.sample).unwrap_or(filtered);
        self.data.dq.copy_from_slice(dq);
        let velocity = self.data.dq[i];
        let mut torque = std::mem::take(&mut self.torque);
        torque[i] += desired(velocity);
        self.transformer.transform(&self.data, &torque, &mut self.command);
        self.transformer.sent(&self.data, &self.command);
        torque[i] = self.data.gravity[i];
        self.torque = torque;
        self.command[i]
    }

    /// Position of the joint, rad (m).
    #[must_use]
    pub fn position(&self) -> f64 {
        self.data.q[self.joint]
    }

    /// Desired torque that holds the joint, Nm (N).
    #[must_use]
    pub fn holding_torque(&self) -> f64 {
        self.data.gravity[self.joint]
    }
}
