//! The phases of a run, and the test for standstill that ends the phase in which a robot is held.

use crate::fault::Fault;
use opspace_control::Measurement;

/// The phase that an interface cycle belongs to: the signal `phase`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Before control: the robot holds itself and its force sensors are tared.
    Rest,
    /// The controller commands.
    Control,
    /// After a stop: the robot is in its safe state.
    Stopped,
    /// After a dropout: the robot is held until it stands still.
    Held,
    /// The controller commands again, its torques ramping in.
    Resuming,
}

impl Phase {
    /// Its number in a log.
    #[must_use]
    pub fn code(self) -> f64 {
        match self {
            Self::Rest => 0.0,
            Self::Control => 1.0,
            Self::Stopped => 2.0,
            Self::Held => 3.0,
            Self::Resuming => 4.0,
        }
    }
}

/// Test for standstill of a robot that is held.
#[derive(Clone, Debug)]
pub(crate) struct Standstill {
    period_s: f64,
    max_hold_s: f64,
    held_from_s: f64,
    /// Positions at the beginning of the present test, rad or m (n).
    q: Vec<f64>,
    from_s: f64,
}

/// Time over which a robot must not move, s.
const STANDSTILL_S: f64 = 0.05;

/// Largest motion of a robot at rest, rad (m): a mean speed of 0.02 rad/s, some ten counts of a coarse encoder.
const STANDSTILL_RAD: f64 = 1e-3;

impl Standstill {
    /// A test for n joints read every `period_s` (s); a robot that moves for longer than `max_hold_s` (s) is not held.
    pub(crate) fn new(n: usize, period_s: f64, max_hold_s: f64) -> Self {
        Self { period_s, max_hold_s, held_from_s: 0.0, q: vec![0.0; n], from_s: 0.0 }
    }

    /// Begins with the robot being held.
    pub(crate) fn begin(&mut self, measurement: &Measurement) {
        self.held_from_s = measurement.time_s;
        self.restart(measurement);
    }

    /// Returns true once the robot has not moved for [`STANDSTILL_S`], and for two periods at least.
    ///
    /// # Errors
    /// A joint that still moves after the longest time for which a robot is held.
    pub(crate) fn is_reached(&mut self, measurement: &Measurement) -> Result<bool, Fault> {
        // Half a period: times are multiples of one, rounded.
        let passed_s = measurement.time_s - self.from_s + 0.5 * self.period_s;
        if passed_s < STANDSTILL_S.max(2.0 * self.period_s) {
            return Ok(false);
        }
        let Some(joint) = self.moving_joint(measurement) else {
            return Ok(true);
        };
        let held_s = measurement.time_s - self.held_from_s;
        if held_s > self.max_hold_s {
            return Err(Fault::HoldFailed { joint, held_s });
        }
        self.restart(measurement);
        Ok(false)
    }

    fn restart(&mut self, measurement: &Measurement) {
        self.q.copy_from_slice(measurement.q.as_slice());
        self.from_s = measurement.time_s;
    }

    /// The joint that has moved most, if it moved at all.
    fn moving_joint(&self, measurement: &Measurement) -> Option<usize> {
        let moved = |joint: &usize| (measurement.q[*joint] - self.q[*joint]).abs();
        let joint = (0..self.q.len()).max_by(|a, b| moved(a).total_cmp(&moved(b)))?;
        (moved(&joint) > STANDSTILL_RAD).then_some(joint)
    }
}
