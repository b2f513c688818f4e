//! Latency of a channel without its jitter.
//!
//! ```text
//! m ← m + T/(0.5 s + T) (age − m)        Δ = age − m, |Δ| ≤ 0.05 s        p̂ ← p̂ + v̂ Δ
//! ```
//!
//! m is the mean age of what was received, T the control period. The law (`teleoperation.rs`) continues the received position p̂
//! by its velocity over Δ.

/// Time of the mean, s.
const MEAN_S: f64 = 0.5;

/// Longest time over which motion is continued, s.
const CONTINUED_AT_MOST_S: f64 = 0.05;

/// Mean of the age of what was received. A position that is older by Δ than in the mean is continued by its velocity over Δ: the
/// receiver then sees a motion that is late by the mean, without steps where packets came late, were lost, or come less often than
/// its cycles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SteadyLatency {
    share: f64,
    mean_s: Option<f64>,
    /// Mean square of the excess, s².
    variance_s2: f64,
}

impl SteadyLatency {
    /// Returns the state before the first packet, for the period (s, above zero).
    #[must_use]
    pub fn new(period_s: f64) -> Self {
        Self { share: period_s / (MEAN_S + period_s), mean_s: None, variance_s2: 0.0 }
    }

    /// Forgets the means.
    pub fn restart(&mut self) {
        (self.mean_s, self.variance_s2) = (None, 0.0);
    }

    /// Returns the time over which to continue a motion, s: its age, minus the mean of all ages, at most 0.05 s in magnitude. The
    /// age (s) is the receiver's time minus the sender's, in each cycle; their clocks need not agree.
    pub fn update(&mut self, age_s: f64) -> f64 {
        if !age_s.is_finite() {
            return 0.0;
        }
        let before_s = self.mean_s.unwrap_or(age_s);
        let mean_s = before_s + self.share * (age_s - before_s);
        self.mean_s = Some(mean_s);
        let excess_s = (age_s - mean_s).clamp(-CONTINUED_AT_MOST_S, CONTINUED_AT_MOST_S);
        self.variance_s2 += self.share * (excess_s * excess_s - self.variance_s2);
        excess_s
    }

    /// Mean of the ages, s; `None` before the first one.
    #[must_use]
    pub fn mean_s(&self) -> Option<f64> {
        self.mean_s
    }

    /// Jitter of the channel, s: the rms of the excess.
    #[must_use]
    pub fn jitter_s(&self) -> f64 {
        self.variance_s2.sqrt()
    }
}
