//! Goals that a task did not reach, with what kept it from them.

use crate::evaluate::limited_reference::{distances, joint_limits, out_of_reach};
use serde::{Deserialize, Serialize};
use std::fmt;

/// An interval of a run in which a task rests away from its reference, because the controller cannot bring it closer.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct UnreachedGoal {
    /// Name of the task.
    pub task: String,
    /// Begin of the interval, s after the start of control.
    pub begin_s: f64,
    /// End of the interval, s after the start of control; `None` if it lasts until the end of the run.
    pub end_s: Option<f64>,
    /// Largest error in the interval over displacements, m; `None` if the task has none.
    pub position_m: Option<f64>,
    /// Largest error in the interval over angles, rad; `None` if the task has none.
    pub orientation_rad: Option<f64>,
    /// Joints whose position limits hold the task.
    pub position_limits: Vec<String>,
    /// Joints whose speed or acceleration limits hold the task.
    pub speed_limits: Vec<String>,
    /// Joints whose limits of torque or torque rate hold the task.
    pub torque_limits: Vec<String>,
    /// Pairs of links or obstacles whose kept distances (`[collision]`) hold the task.
    #[serde(default)]
    pub kept_distances: Vec<[String; 2]>,
    /// Direction of the error, if the arm is nearly singular along it: `z`, or `0.71 x - 0.71 rz`.
    pub singular_along: Option<String>,
    /// Tasks of higher priority that hold the task.
    pub overridden_by: Vec<String>,
}

impl UnreachedGoal {
    /// Returns true if the cause is known.
    pub(crate) fn has_cause(&self) -> bool {
        let lists = [&self.position_limits, &self.speed_limits, &self.torque_limits, &self.overridden_by];
        self.singular_along.is_some()
            || !self.kept_distances.is_empty()
            || lists.iter().any(|list| !list.is_empty())
    }

    /// Returns true if the tasks of higher priority are the only cause.
    fn is_only_overridden(&self) -> bool {
        let others = Self { overridden_by: Vec::new(), ..self.clone() };
        !others.has_cause()
    }
}

impl fmt::Display for UnreachedGoal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let missed = if self.is_only_overridden() { "not reached" } else { "not reachable within limits" };
        write!(f, "task '{}': goal {missed}, ", self.task)?;
        match self.end_s {
            Some(end_s) => write!(f, "from {:.2} s to {end_s:.2} s", self.begin_s)?,
            None => write!(f, "from {:.2} s on", self.begin_s)?,
        }
        let errors = [(self.position_m, "mm"), (self.orientation_rad, "mrad")];
        let errors: Vec<String> = errors
            .iter()
            .filter_map(|(error, unit)| Some(format!("{:.1} {unit}", 1e3 * (*error)?)))
            .collect();
        write!(f, ", {} away: ", errors.join(" and "))?;
        let mut causes = joint_limits(&self.position_limits, &self.speed_limits, &self.torque_limits);
        causes.extend(distances(&self.kept_distances));
        causes.extend(self.singular_along.iter().map(|along| out_of_reach(along)));
        let above: Vec<String> = self.overridden_by.iter().map(|name| format!("task '{name}'")).collect();
        causes.extend((!above.is_empty()).then(|| format!("overridden by {}", above.join(", "))));
        write!(f, "{}", causes.join("; "))
    }
}
