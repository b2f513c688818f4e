//! Measurement of the time by which a thread that sleeps wakes up late.

use super::finding::MachineFinding;
use opspace_loop::{Pacer, RealTime, RealTimeMode, RealTimeParameters};
use serde::Serialize;
use std::sync::Arc;

/// Period of the measurement, s.
pub const PERIOD_S: f64 = 1e-3;

/// Longest measurement, s.
pub const LONGEST_S: f64 = 600.0;

/// Times by which a thread that sleeps until its next cycle wakes up late.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct WakeUps {
    /// True if real-time scheduling was asked for.
    pub is_real_time: bool,
    /// Scheduling of the thread.
    pub scheduling: String,
    /// True if the thread had the scheduling that it asked for.
    pub is_granted: bool,
    /// Number of cycles.
    pub cycles: usize,
    /// Number of cycles that began more than a period late.
    pub late_cycles: usize,
    /// Median, µs.
    pub p50_us: f64,
    /// 99th percentile, µs.
    pub p99_us: f64,
    /// Largest time, µs.
    pub max_us: f64,
}

/// Measures the wake-ups of a thread with the period [`PERIOD_S`], with real-time scheduling as far as the machine allows it or
/// without. Takes `duration_s` (s), at most [`LONGEST_S`].
#[must_use]
pub fn measure(duration_s: f64, mode: RealTimeMode) -> WakeUps {
    let real_time = RealTime::enter(RealTimeParameters::default().with_mode(mode));
    let cycles = (duration_s.clamp(0.0, LONGEST_S) / PERIOD_S).round().max(1.0) as usize;
    let mut late_us = Vec::with_capacity(cycles);
    let mut pacer = Pacer::new(Arc::default(), PERIOD_S);
    for cycle in 0..cycles {
        pacer.wait(cycle as f64 * PERIOD_S, &mut || false);
        late_us.push(1e6 * pacer.late_s());
    }
    let (scheduling, is_granted) = (real_time.text(), real_time.is_complete());
    drop(real_time);
    late_us.sort_by(f64::total_cmp);
    let quantile = |share: f64| late_us[((share * cycles as f64) as usize).min(cycles - 1)];
    WakeUps {
        is_real_time: mode != RealTimeMode::Off,
        scheduling,
        is_granted,
        cycles,
        late_cycles: late_us.iter().filter(|late_us| **late_us > 1e6 * PERIOD_S).count(),
        p50_us: quantile(0.5),
        p99_us: quantile(0.99),
        max_us: quantile(1.0),
    }
}

impl WakeUps {
    /// Returns what the measurement says about the machine; without real-time scheduling, it is for comparison.
    #[must_use]
    pub fn finding(&self) -> MachineFinding {
        const WAKE_UP: &str = "wake-up";
        let Self { scheduling, cycles, late_cycles, p50_us, p99_us, max_us, .. } = self;
        let text = format!(
            "{scheduling}: cycles of 1 ms began {p50_us:.0} µs late (median), 99 % below {p99_us:.0} µs, at most {max_us:.0} µs; \
             {late_cycles} of {cycles} by more than a period"
        );
        match late_cycles {
            _ if !self.is_real_time => MachineFinding::note(WAKE_UP, text),
            0 => MachineFinding::ok(WAKE_UP, text),
            _ => MachineFinding::missing(WAKE_UP, text),
        }
    }
}
