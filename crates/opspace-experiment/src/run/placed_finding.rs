//! Place of a finding in the files of an experiment.

use crate::files::source::FileError;
use crate::finding::{Finding, Place};
use crate::run::experiment::Experiment;

impl Finding {
    /// Returns the finding with its place in the files of the experiment.
    #[must_use]
    pub fn placed(&self, experiment: &Experiment) -> FileError {
        self.placed_in(match self.place {
            Place::RobotFile(_) => &experiment.robot().source,
            _ => &experiment.task().source,
        })
    }
}
