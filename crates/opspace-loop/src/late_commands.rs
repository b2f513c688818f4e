//! Count of late commands, from the times in the channel `timing`.

/// Time between two commands, in periods, from which on the second one is late.
const LATE: f64 = 1.5;

/// Count of commands that came more than 1.5 periods after the ones before, whatever delayed them: the sample, the computation or the
/// driver.
#[derive(Clone, Copy, Debug)]
pub struct LateCommands {
    period_s: f64,
    response_before_s: Option<f64>,
    count: u64,
    longest_s: f64,
}

impl LateCommands {
    /// Returns counts for a period, s.
    #[must_use]
    pub fn new(period_s: f64) -> Self {
        Self { period_s, response_before_s: None, count: 0, longest_s: 0.0 }
    }

    /// Adds a cycle: the time since the sample before, and from its sample until its command, s.
    pub fn add(&mut self, interval_s: f64, response_s: f64) {
        let Some(before_s) = self.response_before_s.replace(response_s) else { return };
        let between_s = interval_s + response_s - before_s;
        self.count += u64::from(between_s > LATE * self.period_s);
        self.longest_s = self.longest_s.max(between_s - self.period_s);
    }

    /// Number of late commands.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Longest time between two commands beyond the period, s.
    #[must_use]
    pub fn longest_s(&self) -> f64 {
        self.longest_s
    }
}

#[cfg(test)]
mod tests {
    use super::LateCommands;

    /// Checks a sample that is late, a command that takes long, both at once, and a constant delay, which is not late.
    #[test]
    fn commands_are_late_whatever_delays_them() {
        let mut commands = LateCommands::new(0.01);
        let mut count = |interval_s, response_s| {
            commands.add(interval_s, response_s);
            commands.count()
        };
        assert_eq!(count(f64::NAN, 0.001), 0);
        assert_eq!(count(0.01, 0.001), 0);
        assert_eq!(count(0.0151, 0.001), 1);
        assert_eq!(count(0.01, 0.0061), 2);
        assert_eq!([count(0.01, 0.0061), count(0.01, 0.0061)], [2, 2]);
        assert_eq!(count(0.013, 0.0091), 3);
        assert!((commands.longest_s() - 0.006).abs() < 1e-12);
    }
}
