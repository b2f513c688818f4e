//! Counts of the intervals between the states that arrive: period and jitter.

use std::fmt;

/// Number of classes of intervals; each is a twentieth of a period wide.
const CLASSES: usize = 100;
const CLASSES_PER_PERIOD: f64 = 20.0;

/// Intervals between states. Allocates nothing after it is built.
#[derive(Clone, Debug)]
pub struct Pace {
    period_s: f64,
    count: u64,
    sum_s: f64,
    longest_s: f64,
    /// Number of cycles whose state was overtaken by the next one before it was read.
    pub skipped: u64,
    classes: [u64; CLASSES],
}

impl Pace {
    /// Returns counts for a period, s.
    #[must_use]
    pub fn new(period_s: f64) -> Self {
        Self { period_s, count: 0, sum_s: 0.0, longest_s: 0.0, skipped: 0, classes: [0; CLASSES] }
    }

    /// Counts an interval, s.
    pub fn add(&mut self, interval_s: f64) {
        self.count += 1;
        self.sum_s += interval_s;
        self.longest_s = self.longest_s.max(interval_s);
        let class = (interval_s / self.period_s * CLASSES_PER_PERIOD).max(0.0) as usize;
        self.classes[class.min(CLASSES - 1)] += 1;
    }

    /// Number of intervals.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Mean interval, s; NaN before the first one.
    #[must_use]
    pub fn mean_s(&self) -> f64 {
        self.sum_s / self.count as f64
    }

    /// Longest interval, s.
    #[must_use]
    pub fn longest_s(&self) -> f64 {
        self.longest_s
    }

    /// Interval that this share of the intervals does not exceed, s, rounded up to a twentieth of a period.
    #[must_use]
    pub fn quantile_s(&self, share: f64) -> f64 {
        let wanted = share * self.count as f64;
        let mut below = 0.0;
        for (class, count) in self.classes.iter().enumerate() {
            below += *count as f64;
            if below >= wanted {
                let end_s = (class as f64 + 1.0) / CLASSES_PER_PERIOD * self.period_s;
                return if class + 1 == CLASSES { self.longest_s } else { end_s.min(self.longest_s) };
            }
        }
        self.longest_s
    }
}

impl fmt::Display for Pace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ms = |seconds: f64| 1e3 * seconds;
        write!(
            f,
            "{} states, every {:.2} ms on average ({:.2} ms stated); 99 % of the intervals below {:.2} ms, longest {:.2} ms; \
             {} states skipped",
            self.count,
            ms(self.mean_s()),
            ms(self.period_s),
            ms(self.quantile_s(0.99)),
            ms(self.longest_s),
            self.skipped
        )
    }
}
