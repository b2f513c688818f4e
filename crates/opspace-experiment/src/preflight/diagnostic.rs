//! Diagnostics: predicted failures of a run, with their place and a remedy.

use crate::codes::Code;
use crate::files::source::{FileError, Source};
use crate::files::toml_path::dotted;
use crate::run::experiment::Experiment;
pub(super) use crate::text::format_short as short;
use crate::text::format_trimmed as trimmed;

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

/// A predicted failure of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Diagnostic {
    /// Kind of the failure.
    pub code: Code,
    /// Key of the value at fault, as a dotted path into its file: `task.hand.cartesian.gains`.
    pub key: String,
    /// Description of the failure, with the numbers.
    pub message: String,
    /// Remedy.
    pub help: String,
    file: File,
}

/// File that contains the key of a diagnostic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum File {
    Task,
    Robot,
}

impl Diagnostic {
    pub(super) fn new<S: AsRef<str>>(code: Code, key: &[S], message: String, help: String) -> Self {
        let key = dotted(&key.iter().map(|part| part.as_ref().to_owned()).collect::<Vec<_>>());
        Self { code, key, message, help, file: File::Task }
    }

    pub(super) fn of_robot(self) -> Self {
        Self { file: File::Robot, ..self }
    }

    /// Returns the diagnostic with its place in the files of the experiment.
    #[must_use]
    pub fn placed(&self, experiment: &Experiment) -> FileError {
        let source = match self.file {
            File::Task => &experiment.task().source,
            File::Robot => &experiment.robot().source,
        };
        self.placed_in(source)
    }

    /// Returns the diagnostic with its place in a file that has its key.
    #[must_use]
    pub fn placed_in(&self, source: &Source) -> FileError {
        FileError::at_key(source, self.key.as_str(), &self.message, Some(self.help.clone())).coded(self.code)
    }
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
