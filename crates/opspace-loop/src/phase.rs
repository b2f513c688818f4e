//! Phases of a run, and the standstill test that ends a hold.

use crate::fault::Fault;
use opspace_control::Measurement;

/// Phase of a run, recorded as the signal `phase`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Before control: the robot holds itself and its force sensors are tared.
    Rest,
    /// The controller commands.
    Control,
    /// After a stop: setpoints come to rest within their limits.
    Stopping,
    /// After a stop: the robot is in its safe state.
    Stopped,
    /// After a dropout or on request: the robot is held until it stands still.
    Held,
    /// The controller commands again; its torques ramp in.
    Resuming,
}

impl Phase {
    /// Number of the phase in a log.
    #[must_use]
    pub fn code(self) -> f64 {
        match self {
            Self::Rest => 0.0,
            Self::Control => 1.0,
            Self::Stopped => 2.0,
            Self::Held => 3.0,
            Self::Resuming => 4.0,
            Self::Stopping => 5.0,
        }
    }

    /// True if `code` is the number of a phase after a stop.
    #[must_use]
    pub fn is_after_stop(code: f64) -> bool {
        [Self::Stopping, Self::Stopped].map(Self::code).contains(&code)
    }

    /// True if `code` is the number of a phase in which the robot is held, or its torques ramp in after a hold.
    #[must_use]
    pub fn is_interrupted(code: f64) -> bool {
        [Self::Held, Self::Resuming].map(Self::code).contains(&code)
    }
}

/// Standstill test of a robot that is held.
#[derive(Clone, Debug)]
pub(crate) struct Standstill {
    period_s: f64,
    max_hold_s: f64,
    held_from_s: f64,
    /// Positions at the beginning of the present test interval (n; rad, m).
    q: Vec<f64>,
    from_s: f64,
}

/// Duration over which a robot must not move, s.
const STANDSTILL_S: f64 = 0.05;

/// Largest motion within [`STANDSTILL_S`] that counts as standstill, rad (m): a mean speed of 0.02 rad/s, some ten
/// counts of a coarse encoder.
const STANDSTILL_RAD: f64 = 1e-3;

impl Standstill {
    /// Returns a test for n joints that are read every `period_s` (s). It fails if the robot still moves after
    /// `max_hold_s` (s).
    pub(crate) fn new(n: usize, period_s: f64, max_hold_s: f64) -> Self {
        Self { period_s, max_hold_s, held_from_s: 0.0, q: vec![0.0; n], from_s: 0.0 }
    }

    /// Begins the test at the start of a hold.
    pub(crate) fn begin(&mut self, measurement: &Measurement) {
        self.held_from_s = measurement.time_s;
        self.restart(measurement);
    }

    /// Returns true once the robot has not moved for [`STANDSTILL_S`] and at least two periods.
    ///
    /// # Errors
    /// [`Fault::HoldFailed`] if a joint still moves after the longest allowed hold.
    pub(crate) fn is_reached(&mut self, measurement: &Measurement) -> Result<bool, Fault> {
        // Half a period is added because times are multiples of a period with rounding errors.
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

    /// Returns the joint that moved farthest, if it moved more than [`STANDSTILL_RAD`].
    fn moving_joint(&self, measurement: &Measurement) -> Option<usize> {
        let moved = |joint: &usize| (measurement.q[*joint] - self.q[*joint]).abs();
        let joint = (0..self.q.len()).max_by(|a, b| moved(a).total_cmp(&moved(b)))?;
        (moved(&joint) > STANDSTILL_RAD).then_some(joint)
    }
}
