//! Logs of several robots, from which their scenario can be rebuilt.

use crate::extensions::Extensions;
use crate::files::experiment_file::ExperimentFile;
use crate::files::source::{FileError, parse};
use crate::run::couplings::couplings;
use crate::run::error::RunError;
use crate::run::experiment::Experiment;
use crate::run::member::Member;
use crate::run::membership::Membership;
use crate::run::result_files::LOG;
use crate::run::scenario::Scenario;
use opspace_log::{LogFile, Recording};
use std::fs;
use std::path::{Path, PathBuf};

/// Paths of the logs of robots in the folder of an experiment, in order: the log of each folder in it that names its
/// experiment. Empty for another folder.
#[must_use]
pub fn robot_logs(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let logs = entries.map(|entry| entry.path().join(LOG));
    let mut logs: Vec<PathBuf> = logs.filter(|log| log.is_file() && is_of_experiment(log)).collect();
    logs.sort();
    logs
}

fn is_of_experiment(log: &Path) -> bool {
    let log = LogFile::open(log);
    log.is_ok_and(|log| !matches!(Membership::of_log(log.recording()), Ok(None)))
}

impl Scenario {
    /// Rebuilds an experiment from the logs of its robots, in any order; the recordings need no rows.
    ///
    /// # Errors
    /// Logs of different experiments or of tasks, several logs of a robot or none, and files that this version of the
    /// program rejects.
    pub fn of_logs(extensions: &Extensions, logs: &[&Recording]) -> Result<Self, RunError> {
        let mut found: Vec<(Membership, &Recording)> = Vec::new();
        for &log in logs {
            let what = "the experiment with several robots to which it belongs";
            let membership = Membership::of_log(log)?;
            let membership = membership.ok_or_else(|| RunError::Incomplete { what: what.to_owned() })?;
            found.push((membership, log));
        }
        let Some((Membership { experiment: source, settings, .. }, _)) = found.first().cloned() else {
            return Err(RunError::Incomplete { what: "the logs of its robots".to_owned() });
        };
        if let Some((other, _)) = found.iter().find(|(m, _)| m.experiment.text() != source.text()) {
            let message = format!("the log of robot '{}' belongs to another experiment", other.robot);
            return Err(FileError::of_file(source.name(), message, None).into());
        }
        let file: ExperimentFile = parse(&source)?;
        let mut members = Vec::new();
        for name in file.robots.keys() {
            let of_robot: Vec<_> = found.iter().filter(|(membership, _)| membership.robot == *name).collect();
            let [(_, log)] = of_robot.as_slice() else {
                let message = format!("{} logs of robot '{name}' are given, instead of one", of_robot.len());
                return Err(FileError::of_file(source.name(), message, None).into());
            };
            let experiment = Experiment::of_log_with(extensions, log)?;
            members.push(Member::new(name, experiment, &source)?);
        }
        let couplings = couplings(&file, &source)?;
        Ok(Self::of_robots(source, file, members, couplings, settings))
    }
}
