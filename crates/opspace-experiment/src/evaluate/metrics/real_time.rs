//! Period, jitter and late cycles of a run on a real robot, by the computer's clock.

use hdrhistogram::Histogram;
use opspace_backend::signal_names::{RESPONSE_TIME, SAMPLE_INTERVAL, TIMING_CHANNEL};
use opspace_log::Recording;
use opspace_loop::LateCommands;
use serde::{Deserialize, Serialize};

/// Largest duration that is distinguished, ns.
const MAX_NS: u64 = 60_000_000_000;

/// Number of significant digits of a duration.
const DIGITS: u8 = 3;

const MS_PER_NS: f64 = 1e-6;
const S_PER_NS: f64 = 1e-9;
const MS_PER_S: f64 = 1e3;

/// Period, jitter and late cycles of a run on a real robot, by the computer's clock; they are not reproducible.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct RealTimeStatistics {
    /// Scheduling of the control thread, and what the machine does not allow; `None` in logs of earlier versions.
    pub scheduling: Option<String>,
    /// Number of cycles.
    pub cycles: u64,
    /// Number of late cycles: their commands came more than 1.5 periods after those of the cycles before.
    pub late_cycles: u64,
    /// Largest time between two commands beyond the period, ms.
    pub longest_lateness_ms: f64,
    /// Period of the interface that robot.toml states, ms.
    pub stated_period_ms: f64,
    /// Time between the arrivals of two samples, ms.
    pub period_ms: Distribution,
    /// Standard deviation of this time, ms.
    pub jitter_rms_ms: f64,
    /// Time from the arrival of a sample until the command is written, ms.
    pub response_ms: Distribution,
}

/// Distribution of a duration, to three digits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Distribution {
    /// Mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// 99.9th percentile.
    pub p999: f64,
    /// Largest value.
    pub max: f64,
}

impl Distribution {
    fn of(times_ns: &Histogram<u64>) -> Self {
        let quantile = |share: f64| MS_PER_NS * times_ns.value_at_quantile(share) as f64;
        Self {
            mean: MS_PER_NS * times_ns.mean(),
            p50: quantile(0.5),
            p99: quantile(0.99),
            p999: quantile(0.999),
            max: MS_PER_NS * times_ns.max() as f64,
        }
    }
}

impl RealTimeStatistics {
    /// Describes the statistics in two sentences: late cycles with the scheduling, and the distributions.
    #[must_use]
    pub fn sentences(&self) -> [String; 2] {
        let Self { cycles, late_cycles, period_ms, response_ms, .. } = self;
        let share = 100.0 * *late_cycles as f64 / *cycles as f64;
        let scheduling = self.scheduling.as_ref().map_or_else(String::new, |text| format!(" ({text})"));
        let late = match late_cycles {
            0 => format!("no command of {cycles} was late{scheduling}"),
            _ => format!(
                "{late_cycles} of {cycles} commands were late ({share:.2} %), by {:.2} ms at most{scheduling}",
                self.longest_lateness_ms
            ),
        };
        let times = format!(
            "period {:.2} ms ({:.2} stated), jitter {:.3} ms rms, 99 % below {:.2} ms, longest {:.2} ms; \
             from sample to command {:.2} ms, 99 % below {:.2} ms, longest {:.2} ms",
            period_ms.mean,
            self.stated_period_ms,
            self.jitter_rms_ms,
            period_ms.p99,
            period_ms.max,
            response_ms.mean,
            response_ms.p99,
            response_ms.max
        );
        [late, times]
    }
}

/// Histograms of a run while segments of its log arrive.
#[derive(Clone, Debug)]
pub(crate) struct RealTimeCycles {
    period_s: f64,
    intervals_ns: Option<Histogram<u64>>,
    responses_ns: Option<Histogram<u64>>,
    late: LateCommands,
}

impl RealTimeCycles {
    /// Returns empty histograms of cycles with this period, s.
    pub(crate) fn new(period_s: f64) -> Self {
        let empty = || Histogram::new_with_max(MAX_NS, DIGITS).ok();
        Self { period_s, intervals_ns: empty(), responses_ns: empty(), late: LateCommands::new(period_s) }
    }

    /// Adds the cycles of a segment of a log.
    pub(crate) fn add(&mut self, segment: &Recording) {
        let Some(timing) = segment.channel(TIMING_CHANNEL) else { return };
        let (Some(intervals), Some(responses)) =
            (timing.signal(SAMPLE_INTERVAL), timing.signal(RESPONSE_TIME))
        else {
            return;
        };
        for (interval, response) in intervals.rows().zip(responses.rows()) {
            self.count(interval[0], response[0]);
        }
    }

    /// Counts a cycle with the time since the sample before and until its command, ns.
    fn count(&mut self, interval_ns: f64, response_ns: f64) {
        let record = |times_ns: &mut Option<Histogram<u64>>, time_ns: f64| {
            if let Some(times_ns) = times_ns.as_mut().filter(|_| time_ns.is_finite()) {
                times_ns.saturating_record(time_ns as u64);
            }
        };
        record(&mut self.responses_ns, response_ns);
        record(&mut self.intervals_ns, interval_ns);
        self.late.add(S_PER_NS * interval_ns, S_PER_NS * response_ns);
    }

    /// Returns the statistics of a run with this scheduling; `None` without two cycles.
    pub(crate) fn statistics(&self, scheduling: Option<&String>) -> Option<RealTimeStatistics> {
        let intervals_ns = self.intervals_ns.as_ref().filter(|times_ns| !times_ns.is_empty())?;
        let responses_ns = self.responses_ns.as_ref()?;
        Some(RealTimeStatistics {
            scheduling: scheduling.cloned(),
            cycles: responses_ns.len(),
            late_cycles: self.late.count(),
            longest_lateness_ms: MS_PER_S * self.late.longest_s(),
            stated_period_ms: MS_PER_S * self.period_s,
            period_ms: Distribution::of(intervals_ns),
            jitter_rms_ms: MS_PER_NS * intervals_ns.stdev(),
            response_ms: Distribution::of(responses_ns),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::RealTimeCycles;

    /// Compared: the statistics, and those of a list of cycles by hand: one sample comes 12 ms late, one command takes 6 ms more, and
    /// one cycle is a period late and not more than that by rounding.
    #[test]
    fn late_commands_are_counted_with_their_distributions() {
        let mut cycles = RealTimeCycles::new(0.01);
        let list =
            [(f64::NAN, 1e6), (10e6, 1e6), (22e6, 1e6), (8e6, 1e6), (10e6, 7e6), (4e6, 1e6), (10e6, 1e6)];
        list.iter().for_each(|(interval_ns, response_ns)| cycles.count(*interval_ns, *response_ns));
        let found = cycles.statistics(Some(&"as it was".to_owned())).expect("two cycles");
        assert_eq!((found.cycles, found.late_cycles), (7, 2));
        let near = |value: f64, expected: f64| (value - expected).abs() < 0.002 * expected;
        assert!(near(found.longest_lateness_ms, 12.0) && near(found.stated_period_ms, 10.0));
        assert!(near(found.period_ms.mean, 64.0 / 6.0) && near(found.period_ms.p50, 10.0));
        assert!(near(found.period_ms.max, 22.0) && near(found.period_ms.p999, 22.0));
        let mean = 64.0 / 6.0_f64;
        let squares: f64 = list[1..].iter().map(|(ns, _)| (ns * 1e-6 - mean).powi(2)).sum();
        assert!(near(found.jitter_rms_ms, (squares / 6.0).sqrt()), "{}", found.jitter_rms_ms);
        assert!(near(found.response_ms.mean, 13.0 / 7.0) && near(found.response_ms.max, 7.0));
        let [late, _] = found.sentences();
        assert_eq!(late, "2 of 7 commands were late (28.57 %), by 12.00 ms at most (as it was)");
    }

    #[test]
    fn a_log_without_arrivals_has_no_statistics() {
        let mut cycles = RealTimeCycles::new(0.01);
        assert_eq!(cycles.statistics(None), None);
        cycles.count(f64::NAN, 1e6);
        assert_eq!(cycles.statistics(None), None);
    }
}
