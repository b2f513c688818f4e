//! Another transformer for a run whose torques were far from the desired ones, and what the run gives with it.

use crate::evaluate::summary::Summary;
use crate::run::error::RunError;
use crate::run::execute::Progress;
use crate::run::scenario::Scenario;
use opspace_backend::CommandKind;
use opspace_transformer::TransformerName;
use std::fmt;

/// Torque error of interval means from which another transformer is looked for.
const LARGE_ERROR: f64 = 0.2;

/// Torque error of a run, and of the same run with another transformer.
#[derive(Clone, Debug, PartialEq)]
pub struct OtherTransformer {
    /// Torque error of the run.
    pub torque_error: f64,
    /// Transformer of the run.
    pub used: TransformerName,
    /// Transformer to try; `None` if the one in use suits the declared properties of the robot best.
    pub other: Option<TransformerName>,
    /// Outcome of the run with the other transformer; `None` for a real robot, which is not moved again.
    pub repeated: Option<Repeated>,
}

/// Outcome of a repeated run.
#[derive(Clone, Debug, PartialEq)]
pub enum Repeated {
    /// Its torque error.
    Completed(f64),
    /// The fault that stopped it.
    Stopped(String),
}

impl fmt::Display for OtherTransformer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |share: f64| (100.0 * share).round();
        write!(f, "the torque error is {} % with transformer '{}'", percent(self.torque_error), self.used)?;
        let Some(other) = &self.other else {
            return f.write_str(
                ", which suits the declared properties of the robot: `opspace check -v` lists what its gains, delay and encoders leave",
            );
        };
        match &self.repeated {
            None => write!(f, ": try --transformer {other}"),
            Some(Repeated::Completed(error)) if *error < self.torque_error => {
                write!(f, ": --transformer {other} gives {} % in the same run", percent(*error))
            }
            Some(Repeated::Completed(error)) => {
                write!(
                    f,
                    "; '{other}', the only other candidate, gives {} % in the same run",
                    percent(*error)
                )
            }
            Some(Repeated::Stopped(fault)) => {
                write!(f, "; '{other}', the only other candidate, is stopped in the same run: {fault}")
            }
        }
    }
}

impl Scenario {
    /// Looks for another transformer after a run of one robot with this summary, if the torque error is large, and repeats a
    /// simulated run with it, without a log. `None` if the error is not large.
    ///
    /// # Errors
    /// A robot that cannot be simulated with the other transformer.
    pub fn other_transformer(
        &self,
        summary: &Summary,
        progress: &Progress,
    ) -> Result<Option<OtherTransformer>, RunError> {
        let Some(experiment) = self.single() else { return Ok(None) };
        let error = summary.metrics.torque_error_interval.filter(|error| *error > LARGE_ERROR);
        let is_converted = experiment.command_kind() == CommandKind::Position;
        let (Some(torque_error), Some(used), true) = (error, experiment.transformer_name(), is_converted)
        else {
            return Ok(None);
        };
        let other = experiment.other_transformer();
        let repeated = match &other {
            Some(name) if summary.simulated && !experiment.is_on_log() => {
                let scenario = Self::from(experiment.with_transformer(name)?);
                let again = scenario.run_without_logs(progress)?;
                again.single().and_then(|again| match (&again.faulted, again.metrics.torque_error_interval) {
                    (Some(fault), _) => Some(Repeated::Stopped(fault.clone())),
                    (None, error) => error.map(Repeated::Completed),
                })
            }
            _ => None,
        };
        Ok(Some(OtherTransformer { torque_error, used, other, repeated }))
    }
}
