//! Setpoints that act in the drives, from one interface cycle to the next.

use crate::drive_timing::DriveTiming;
use nalgebra::DVector;

/// Setpoints of the drives at the start of an interface cycle (n; rad, m or rad/s, m/s).
#[derive(Clone, Debug)]
pub(crate) struct ActiveSetpoints {
    before: DVector<f64>,
    last: DVector<f64>,
    /// Servo ticks since the last setpoint took effect.
    age: u32,
}

impl ActiveSetpoints {
    /// Returns setpoints of zero for n joints.
    pub(crate) fn new(n: usize, ticks: DriveTiming) -> Self {
        Self { before: DVector::zeros(n), last: DVector::zeros(n), age: ticks.servo_ticks_per_cycle }
    }

    /// Setpoint of a joint's drive at servo tick `tick`, counted from the interface cycle, if no new one is sent.
    pub(crate) fn at(&self, ticks: DriveTiming, joint: usize, tick: u32) -> f64 {
        ticks.setpoints.at(
            self.before[joint],
            self.last[joint],
            self.age.saturating_add(tick),
            ticks.servo_ticks_per_cycle,
        )
    }

    /// Setpoint of a joint's drive at servo tick `tick` if `new` setpoints (n) are sent at the interface cycle.
    pub(crate) fn during(&self, ticks: DriveTiming, joint: usize, tick: u32, new: Option<&[f64]>) -> f64 {
        match new {
            Some(new) if tick >= ticks.delay => ticks.setpoints.at(
                self.left(ticks, joint),
                new[joint],
                tick - ticks.delay,
                ticks.servo_ticks_per_cycle,
            ),
            _ => self.at(ticks, joint, tick),
        }
    }

    /// Setpoint from which a drive interpolates to a new one, which takes effect `delay` servo ticks after the
    /// interface cycle.
    pub(crate) fn left(&self, ticks: DriveTiming, joint: usize) -> f64 {
        match (self.age.saturating_add(ticks.delay)).checked_sub(1) {
            Some(age) => {
                ticks.setpoints.at(self.before[joint], self.last[joint], age, ticks.servo_ticks_per_cycle)
            }
            None => self.before[joint],
        }
    }

    /// Advances to the next interface cycle, after `new` setpoints (n) or none were sent at this one.
    pub(crate) fn advance(&mut self, ticks: DriveTiming, new: Option<&[f64]>) {
        match new {
            Some(new) => {
                for i in 0..new.len() {
                    self.before[i] = self.left(ticks, i);
                }
                self.last.copy_from_slice(new);
                self.age = ticks.servo_ticks_per_cycle - ticks.delay;
            }
            None => self.age = self.age.saturating_add(ticks.servo_ticks_per_cycle),
        }
    }

    /// Sets the setpoint of a joint that a drive holds.
    pub(crate) fn hold(&mut self, joint: usize, setpoint: f64) {
        self.before[joint] = setpoint;
        self.last[joint] = setpoint;
    }

    /// Ends all interpolation.
    pub(crate) fn settle(&mut self, ticks: DriveTiming) {
        self.age = ticks.servo_ticks_per_cycle;
    }
}
