//! Findings: predicted failures of a run, with their place and a remedy.

use crate::files::source::FileError;
use crate::files::toml_path::dotted;
use crate::run::experiment::Experiment;

/// A predicted failure of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// Key of the value at fault, as a dotted path into its file: `task.hand.cartesian.gains`.
    pub key: String,
    /// Description of the failure, with the numbers.
    pub message: String,
    /// Remedy.
    pub help: String,
    file: File,
}

/// The file in which a finding's key stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum File {
    Task,
    Robot,
}

impl Diagnostic {
    pub(super) fn new<S: AsRef<str>>(key: &[S], message: String, help: String) -> Self {
        let key = dotted(&key.iter().map(|part| part.as_ref().to_owned()).collect::<Vec<_>>());
        Self { key, message, help, file: File::Task }
    }

    pub(super) fn of_robot(self) -> Self {
        Self { file: File::Robot, ..self }
    }

    /// Returns the finding with its place in the files of its experiment.
    #[must_use]
    pub fn placed(&self, experiment: &Experiment) -> FileError {
        let source = match self.file {
            File::Task => &experiment.task().source,
            File::Robot => &experiment.robot().source,
        };
        FileError::at_key(source, self.key.as_str(), &self.message, Some(self.help.clone()))
    }
}

/// Formats a number with three digits and no trailing zeros: `8.35`, `40`, `-0.12`, `1.2e-9`.
pub(super) fn short(number: f64) -> String {
    let text = format!("{number:.2e}");
    let Some((digits, Ok(exponent))) = text.split_once('e').map(|(d, e)| (d, e.parse::<i32>())) else {
        return text;
    };
    if digits.trim_start_matches('-') == "0.00" {
        return "0".to_owned();
    }
    let trimmed = |text: &str| match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text.to_owned(),
    };
    match exponent {
        -4..=4 => trimmed(&format!("{number:.*}", usize::try_from(2 - exponent).unwrap_or(0))),
        _ => format!("{}e{exponent}", trimmed(digits)),
    }
}
