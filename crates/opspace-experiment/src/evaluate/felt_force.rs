//! Motions and forces of a person who moves a simulated position robot by hand, beside the same run on a torque robot and
//! without friction compensation.

use crate::evaluate::headline::moved_by_hand;
use crate::evaluate::summary::Summary;
use crate::files::controller_kind::ControllerKind;
use crate::run::error::RunError;
use crate::run::execute::Progress;
use crate::run::experiment::{Experiment, RunOptions};
use crate::run::scenario::Scenario;
use opspace_backend::CommandKind;
use opspace_backend::quantity::NonNegative;
use opspace_sim::EnvironmentObjectParameters;
use std::fmt;

/// Motions and forces of a run in which a person moves the arm, in words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FeltForce {
    /// Those of the run.
    pub run: String,
    /// Those on a torque robot, which has the same friction and its compensation.
    pub torque_robot: String,
    /// Those without friction compensation; `None` if the task compensates none.
    pub without_compensation: Option<String>,
}

impl fmt::Display for FeltForce {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "by hand: {}\n    torque robot: {}", self.run, self.torque_robot)?;
        match &self.without_compensation {
            Some(without) => write!(f, "\n    without friction compensation: {without}"),
            None => Ok(()),
        }
    }
}

impl Scenario {
    /// Repeats a simulated run of a position robot with a driver, in which a person moves it, without logs: as torque robot, and
    /// without friction compensation. `None` for other runs.
    ///
    /// # Errors
    /// A robot that cannot be simulated so.
    pub fn felt_force(&self, summary: &Summary, progress: &Progress) -> Result<Option<FeltForce>, RunError> {
        let Some(experiment) = self.single().filter(|experiment| is_felt(experiment, summary)) else {
            return Ok(None);
        };
        let Some(run) = moved_by_hand(summary) else { return Ok(None) };
        let repeated = |experiment: Experiment| -> Result<Option<String>, RunError> {
            let again = Self::from(experiment).run_without_logs(progress)?;
            Ok(again.single().map(|again| match (&again.faulted, moved_by_hand(again)) {
                (Some(fault), _) => format!("stopped: {fault}"),
                (None, moved) => moved.unwrap_or_else(|| "no motion".to_owned()),
            }))
        };
        let options = experiment.options().clone();
        let torque = RunOptions { backend: CommandKind::Torque, transformer: None, ..options.clone() };
        let torque = experiment.with_parts(experiment.robot().clone(), experiment.task().clone(), torque)?;
        let Some(torque_robot) = repeated(torque)? else { return Ok(None) };
        let mut task = experiment.task().clone();
        let gain = std::mem::replace(&mut task.file.friction_compensation.gain, NonNegative::literal(0.0));
        let without_compensation = match gain.get() > 0.0 {
            true => repeated(experiment.with_parts(experiment.robot().clone(), task, options)?)?,
            false => None,
        };
        Ok(Some(FeltForce { run, torque_robot, without_compensation }))
    }
}

/// True for a complete simulation of a real position robot under operational-space control, which a simulated person moves.
fn is_felt(experiment: &Experiment, summary: &Summary) -> bool {
    summary.simulated
        && summary.faulted.is_none()
        && !summary.interrupted
        && experiment.has_driver()
        && !experiment.is_on_log()
        && experiment.command_kind() == CommandKind::Position
        && experiment.options().controller == ControllerKind::Osc
        && experiment.task().file.environment.values().any(is_person)
}

/// True for an operator and for pushes; walls, drawers and loads are no person.
fn is_person(object: &EnvironmentObjectParameters) -> bool {
    matches!(object, EnvironmentObjectParameters::Spring(_) | EnvironmentObjectParameters::Pushes(_))
}
