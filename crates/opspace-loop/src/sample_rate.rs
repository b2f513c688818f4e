//! Watch on the rate of the samples: their mean spacing on the robot's clock, and how often cycles are lost.
//!
//! The model is the rate of successful commands of libfranka, `control_command_success_rate`.

use crate::fault::Fault;

/// Number of spacings in a mean: with 5 % of lost cycles, chance leaves it within [`TOLERANCE`].
const SPACINGS: u32 = 100;
/// Largest deviation of the mean from the period, as a share of the period.
const TOLERANCE: f64 = 0.2;

/// Number of samples in which gaps are counted: in fewer samples, 5 % of lost cycles may be 10 % by chance.
const WINDOW: u32 = 1000;
/// Largest number of samples in [`WINDOW`] before which cycles were lost: 10 %. A dropout counts as one.
const GAPS: u32 = 100;

/// Watch on the rate of the samples of a robot. Allocates nothing.
#[derive(Clone, Debug)]
pub(crate) struct SampleRate {
    period_s: f64,
    /// Time of the last sample, s; NaN before the first one.
    last_s: f64,
    spacings: u32,
    sum_s: f64,
    samples: u32,
    gaps: u32,
}

impl SampleRate {
    /// Returns the watch of a robot that is read every `period_s` (s).
    pub(crate) fn new(period_s: f64) -> Self {
        Self { period_s, last_s: f64::NAN, spacings: 0, sum_s: 0.0, samples: 0, gaps: 0 }
    }

    /// Checks the rate with a sample at `time_s` (s) on the robot's clock, which came after a gap of `missed` cycles. The robot
    /// is held after a gap that is too long to be `bridged`: the gap has a limit of its own, and is not in the mean.
    pub(crate) fn check(&mut self, time_s: f64, missed: u64, bridged: bool) -> Result<(), Fault> {
        let spacing_s = time_s - self.last_s;
        self.last_s = time_s;
        if spacing_s.is_nan() {
            return Ok(());
        }
        self.check_gaps(missed > 0)?;
        if bridged { self.check_mean(spacing_s) } else { Ok(()) }
    }

    fn check_gaps(&mut self, is_gap: bool) -> Result<(), Fault> {
        self.samples += 1;
        self.gaps += u32::from(is_gap);
        let Self { gaps, samples, .. } = *self;
        if gaps > GAPS {
            return Err(Fault::LostCycles { gaps, samples, limit: GAPS, window: WINDOW });
        }
        if samples == WINDOW {
            (self.samples, self.gaps) = (0, 0);
        }
        Ok(())
    }

    fn check_mean(&mut self, spacing_s: f64) -> Result<(), Fault> {
        self.spacings += 1;
        self.sum_s += spacing_s;
        if self.spacings < SPACINGS {
            return Ok(());
        }
        let mean_s = self.sum_s / f64::from(SPACINGS);
        (self.spacings, self.sum_s) = (0, 0.0);
        if (mean_s - self.period_s).abs() <= TOLERANCE * self.period_s {
            return Ok(());
        }
        Err(Fault::SampleRate { spacing_s: mean_s, period_s: self.period_s })
    }
}
