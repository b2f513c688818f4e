//! Numbers in the texts of diagnostics.

pub(super) use opspace_experiment::text::format_short as short;
use opspace_experiment::text::format_trimmed as trimmed;

/// Formats a proposed value that must be at least `number`: three significant digits, rounded up.
pub(super) fn at_least(number: f64) -> String {
    rounded(number, f64::ceil, -1.0)
}

/// Formats a proposed value that must be at most `number`: three significant digits, rounded down.
pub(super) fn at_most(number: f64) -> String {
    rounded(number, f64::floor, 1.0)
}

/// Rounds a number to three significant digits. `tolerated` is the sign of the rounding error that makes no difference.
fn rounded(number: f64, round: fn(f64) -> f64, tolerated: f64) -> String {
    const ROUNDING: f64 = 1e-9;
    if number == 0.0 || !number.is_finite() {
        return short(number);
    }
    let unit = 10f64.powi(number.abs().log10().floor() as i32 - 2);
    short(round(number / unit + tolerated * ROUNDING) * unit)
}

/// Formats numbers with as many significant digits, from three on, as the first two need to differ.
pub(super) fn distinct<const N: usize>(numbers: [f64; N]) -> [String; N] {
    const MOST_DIGITS: usize = 8;
    let texts = |digits: usize| numbers.map(|number| trimmed(number, digits));
    (3..MOST_DIGITS).map(texts).find(|texts| texts[0] != texts[1]).unwrap_or_else(|| texts(MOST_DIGITS))
}

#[cfg(test)]
mod tests {
    use super::{at_least, at_most, distinct};

    /// Checks that a proposed value is never on the wrong side of the bound, and that a round bound is proposed itself.
    #[test]
    fn proposed_values_are_on_the_safe_side() {
        for (number, least, most) in [
            (4.9312, "4.94", "4.93"),
            (5.749_58, "5.75", "5.74"),
            (1.0012, "1.01", "1"),
            (-2.0004, "-2", "-2.01"),
            (0.2, "0.2", "0.2"),
            (0.3, "0.3", "0.3"),
            (0.1 + 0.2, "0.3", "0.3"),
            (9.996, "10", "9.99"),
            (1234.0, "1240", "1230"),
            (0.0, "0", "0"),
        ] {
            assert_eq!((at_least(number), at_most(number)), (least.to_owned(), most.to_owned()), "{number}");
        }
    }

    /// Checks numbers that are equal with three digits, and numbers that are not.
    #[test]
    fn different_numbers_get_different_texts() {
        assert_eq!(distinct([4.9312, 4.93]), ["4.931", "4.93"]);
        assert_eq!(distinct([5.75, 5.749_58, 5.759_58]), ["5.75", "5.7496", "5.7596"]);
        assert_eq!(distinct([2.0, 1.0]), ["2", "1"]);
    }
}
