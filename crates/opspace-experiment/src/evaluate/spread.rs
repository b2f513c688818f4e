//! Spread of a number over runs that differ only in the seed: median and interval.

use serde::Serialize;

/// Least probability that the interval contains the median of all seeds.
const CONFIDENCE: f64 = 0.95;

/// Median of a number over runs, with an interval.
///
/// With six runs or more the interval lies between two order statistics and contains the median over all seeds with a
/// probability of at least 95 %, whatever the distribution (W. J. Conover, *Practical Nonparametric Statistics*, §3.2).
/// Fewer runs allow no such interval: it is the range of all runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Spread {
    /// Median.
    pub median: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
    /// Number of runs that have the number.
    pub runs: usize,
}

impl Spread {
    /// Computes the spread of numbers; `None` if there are none.
    #[must_use]
    pub fn of(numbers: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = numbers.into_iter().collect();
        sorted.sort_by(f64::total_cmp);
        let runs = sorted.len();
        let middle = runs / 2;
        let median = match runs {
            0 => return None,
            odd if odd % 2 == 1 => sorted[middle],
            _ => 0.5 * (sorted[middle - 1] + sorted[middle]),
        };
        let outside = rank(runs);
        Some(Self { median, low: sorted[outside], high: sorted[runs - 1 - outside], runs })
    }
}

/// Number of runs outside the interval at each end: the largest k for which P(Binomial(n, ½) ≤ k) is at most half of
/// 1 − [`CONFIDENCE`]; 0 if there is none.
fn rank(runs: usize) -> usize {
    let mut outside = 0;
    let mut below = 0.0;
    // P(Binomial(n, ½) = k)
    let mut probability = 0.5_f64.powf(runs as f64);
    for k in 0..runs {
        below += probability;
        if below > 0.5 * (1.0 - CONFIDENCE) {
            break;
        }
        outside = k;
        probability *= (runs - k) as f64 / (k + 1) as f64;
    }
    outside
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compared: numbers of runs outside the interval at each end, and those of tables of the sign test.
    #[test]
    fn interval_contains_the_median_with_the_stated_probability() {
        for (runs, outside) in
            [(1, 0), (3, 0), (5, 0), (6, 0), (8, 0), (9, 1), (10, 1), (12, 2), (20, 5), (25, 7)]
        {
            assert_eq!(rank(runs), outside, "{runs} runs");
        }
    }

    /// Compared: the spread of ten numbers, and their median and second extremes, written out.
    #[test]
    fn spread_is_median_and_order_statistics() {
        let numbers = [9.0, 1.0, 3.0, 2.0, 8.0, 5.0, 4.0, 7.0, 6.0, 100.0];
        assert_eq!(Spread::of(numbers), Some(Spread { median: 5.5, low: 2.0, high: 9.0, runs: 10 }));
        assert_eq!(Spread::of([2.0, 1.0, 4.0]), Some(Spread { median: 2.0, low: 1.0, high: 4.0, runs: 3 }));
        assert_eq!(Spread::of([]), None);
    }
}
