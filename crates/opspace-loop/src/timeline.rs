//! Order of the cycles of several robots, on one integer clock.

use thiserror::Error;

/// Timeline that orders the interface cycles of several robots. Its clock counts ticks at the least common multiple of
/// their rates, so that rounding never affects the order. Of cycles at the same time, that of the robot with the lower
/// number comes first.
#[derive(Clone, Debug)]
pub struct Timeline {
    ticks_per_s: u64,
    robots: Vec<Cycles>,
}

#[derive(Clone, Copy, Debug)]
struct Cycles {
    period: u64,
    next: u64,
}

/// Interface cycle of one of the robots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cycle {
    /// Number of the robot.
    pub robot: usize,
    /// Time, in ticks.
    pub tick: u64,
}

/// Reason why a timeline can't be created.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum TimelineError {
    /// No robot, or a rate of zero.
    #[error("a timeline needs at least one robot, and a rate of at least 1 Hz for each")]
    Rate,
    /// Common clock of 2³² Hz or more.
    #[error("the rates have no common multiple below 2^32 Hz")]
    TooFine,
}

impl Timeline {
    /// Returns a timeline for robots with these interface rates (Hz); the first cycle of each is at tick 0.
    ///
    /// # Errors
    /// If there is no robot, a rate is zero, or the rates have no common clock below 2³² Hz.
    pub fn new(rates_hz: &[u32]) -> Result<Self, TimelineError> {
        if rates_hz.is_empty() || rates_hz.contains(&0) {
            return Err(TimelineError::Rate);
        }
        let common = |clock: u64, &rate: &u32| {
            let rate = u64::from(rate);
            let multiple = clock / greatest_common_divisor(clock, rate) * rate;
            if multiple > u64::from(u32::MAX) { Err(TimelineError::TooFine) } else { Ok(multiple) }
        };
        let ticks_per_s = rates_hz.iter().try_fold(1, common)?;
        let robots = rates_hz.iter().map(|&rate| Cycles { period: ticks_per_s / u64::from(rate), next: 0 });
        Ok(Self { ticks_per_s, robots: robots.collect() })
    }

    /// Ticks of the clock per second.
    #[must_use]
    pub fn ticks_per_s(&self) -> u64 {
        self.ticks_per_s
    }

    /// Converts a duration (s) to ticks, rounded.
    #[must_use]
    pub fn ticks(&self, duration_s: f64) -> u64 {
        (duration_s * self.ticks_per_s as f64).round() as u64
    }

    /// Number of a cycle of its robot; the first cycle is 0.
    ///
    /// # Panics
    /// If the timeline has no such robot.
    #[must_use]
    pub fn number(&self, cycle: Cycle) -> u64 {
        cycle.tick / self.robots[cycle.robot].period
    }

    /// Returns the next cycle and advances past it.
    pub fn next_cycle(&mut self) -> Cycle {
        let mut first = 0;
        for (robot, cycles) in self.robots.iter().enumerate() {
            if cycles.next < self.robots[first].next {
                first = robot;
            }
        }
        let cycles = &mut self.robots[first];
        let tick = cycles.next;
        cycles.next += cycles.period;
        Cycle { robot: first, tick }
    }
}

fn greatest_common_divisor(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compared: the order of two seconds of cycles at 1000, 500 and 300 Hz, and their times sorted as fractions.
    #[test]
    fn cycles_are_ordered_by_time_then_number() {
        let rates = [1000, 500, 300];
        let mut timeline = Timeline::new(&rates).expect("a good clock");
        assert_eq!(timeline.ticks_per_s(), 3000);
        let mut expected: Vec<(u64, usize)> = Vec::new();
        for (robot, &rate) in rates.iter().enumerate() {
            // k/rate < 2 s, over the common denominator 3000.
            expected.extend((0..2 * u64::from(rate)).map(|k| (k * 3000 / u64::from(rate), robot)));
        }
        expected.sort_unstable();
        let mut counted = [0; 3];
        for (tick, robot) in expected {
            let cycle = timeline.next_cycle();
            assert_eq!(cycle, Cycle { robot, tick });
            assert_eq!(timeline.number(cycle), counted[robot]);
            counted[robot] += 1;
        }
    }

    #[test]
    fn rates_without_common_clock_are_refused() {
        assert_eq!(Timeline::new(&[]).expect_err("refused"), TimelineError::Rate);
        assert_eq!(Timeline::new(&[1000, 0]).expect_err("refused"), TimelineError::Rate);
        assert_eq!(Timeline::new(&[65_521, 65_519, 65_497]).expect_err("refused"), TimelineError::TooFine);
    }
}
