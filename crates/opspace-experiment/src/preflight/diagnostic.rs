//! Diagnostics: predicted failures of a run, with their place and a remedy.

use crate::codes::Code;
pub(super) use crate::evaluate::table::format_short as short;
use crate::files::source::{FileError, Source};
use crate::files::toml_path::dotted;
use crate::run::experiment::Experiment;

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
