//! Durations of the control cycles.

use crate::metrics::metric_tables::Timing;
use hdrhistogram::Histogram;
use opspace_backend::signal_names::{PHASE, TICK_CHANNEL, TICK_TIME, TIMING_CHANNEL};
use opspace_log::Recording;

/// Largest duration that is distinguished, ns.
const MAX_NS: u64 = 60_000_000_000;

/// Number of significant digits of a duration.
const DIGITS: u8 = 3;

/// Histogram of the durations of the control cycles, to three significant digits.
#[derive(Clone, Debug)]
pub struct CycleTimes {
    times_ns: Option<Histogram<u64>>,
}

impl Default for CycleTimes {
    fn default() -> Self {
        Self { times_ns: Histogram::new_with_max(MAX_NS, DIGITS).ok() }
    }
}

impl CycleTimes {
    /// Adds the cycles of a segment of a log.
    pub fn add(&mut self, segment: &Recording) {
        let (Some(tick), Some(timing)) = (segment.channel(TICK_CHANNEL), segment.channel(TIMING_CHANNEL))
        else {
            return;
        };
        let (Some(phase), Some(time)) = (tick.signal(PHASE), timing.signal(TICK_TIME)) else { return };
        let Some(times_ns) = &mut self.times_ns else { return };
        // Rows belong together that have the same time; a cycle without a computed command has no row in `timing`.
        let mut cycles = tick.time_s.iter().zip(phase.rows()).peekable();
        for (time_s, elapsed) in timing.time_s.iter().zip(time.rows()) {
            while cycles.next_if(|(cycle_s, _)| *cycle_s < time_s).is_some() {}
            if cycles.peek().is_some_and(|(cycle_s, p)| *cycle_s == time_s && p[0] == 1.0) {
                times_ns.saturating_record(elapsed[0] as u64);
            }
        }
    }

    /// Histogram with at least one cycle.
    pub fn histogram(&self) -> Option<&Histogram<u64>> {
        self.times_ns.as_ref().filter(|times_ns| !times_ns.is_empty())
    }

    /// Returns the statistics of the durations.
    pub(crate) fn timing(&self, realtime_factor: Option<f64>) -> Timing {
        let quantile = |share: f64| {
            self.histogram().map_or(f64::NAN, |times_ns| times_ns.value_at_quantile(share) as f64)
        };
        Timing {
            tick_ns_median: quantile(0.5),
            tick_ns_p99: quantile(0.99),
            tick_ns_max: self.histogram().map_or(f64::NAN, |times_ns| times_ns.max() as f64),
            realtime_factor,
        }
    }
}
