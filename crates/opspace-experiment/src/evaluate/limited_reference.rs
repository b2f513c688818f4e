//! Moving references that a task did not follow because of limits or the reach of the arm.

use serde::{Deserialize, Serialize};
use std::fmt;

/// A task that limits of joints, or the reach of the arm, kept from its moving reference.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct LimitedReference {
    /// Name of the task.
    pub task: String,
    /// Time at which limits first held the task back, s after the start of control.
    pub begin_s: f64,
    /// Fraction of the time of control in which the task was held back, from 0 to 1.
    pub share: f64,
    /// Largest error over displacements while the task was held back, m; `None` if the task has none.
    pub position_m: Option<f64>,
    /// Largest error over angles while the task was held back, rad; `None` if the task has none.
    pub orientation_rad: Option<f64>,
    /// Time of the largest error, s after the start of control.
    pub largest_s: f64,
    /// Joints whose position limits hold the task back.
    pub position_limits: Vec<String>,
    /// Joints whose speed or acceleration limits hold the task back.
    pub speed_limits: Vec<String>,
    /// Joints whose limits of torque or torque rate hold the task back.
    pub torque_limits: Vec<String>,
    /// Pairs of links or obstacles whose kept distances (`[collision]`) hold the task back.
    #[serde(default)]
    pub kept_distances: Vec<[String; 2]>,
    /// Time over which the torque ramps in at the start, s, if the largest error is within it.
    pub torque_ramp_s: Option<f64>,
    /// Begin of the statistics, s after the start of control, if the largest error is before it.
    pub settle_s: Option<f64>,
    /// Direction of the error, if the arm is nearly singular along it: `z`, or `0.71 x - 0.71 rz`.
    pub singular_along: Option<String>,
}

impl LimitedReference {
    /// Returns true if a cause is known.
    pub(crate) fn has_cause(&self) -> bool {
        let lists = [&self.position_limits, &self.speed_limits, &self.torque_limits];
        self.singular_along.is_some()
            || !self.kept_distances.is_empty()
            || lists.iter().any(|list| !list.is_empty())
    }
}

impl fmt::Display for LimitedReference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let errors = [(self.position_m, "mm"), (self.orientation_rad, "mrad")];
        let errors: Vec<String> = errors
            .iter()
            .filter_map(|(error, unit)| Some(format!("{:.1} {unit}", 1e3 * (*error)?)))
            .collect();
        write!(
            f,
            "task '{}': moving reference not followed within limits, from {:.2} s on in {:.0} % of the time, up to {} away (at \
             {:.2} s{}): ",
            self.task,
            self.begin_s,
            100.0 * self.share,
            errors.join(" and "),
            self.largest_s,
            self.settle_s.map_or_else(String::new, |settle_s| {
                format!(", before the tables below begin: settle_s = {settle_s}")
            })
        )?;
        let ramp = self
            .torque_ramp_s
            .map(|ramp_s| format!("the torque ramps in over the first {ramp_s} s (safety.torque_ramp_s)"));
        let mut causes: Vec<String> = ramp.into_iter().collect();
        causes.extend(joint_limits(&self.position_limits, &self.speed_limits, &self.torque_limits));
        causes.extend(distances(&self.kept_distances));
        causes.extend(self.singular_along.iter().map(|along| out_of_reach(along)));
        write!(f, "{}", causes.join("; "))
    }
}

/// Names the direction along which an arm is nearly singular as a cause.
pub(crate) fn out_of_reach(along: &str) -> String {
    format!("out of reach: the arm is nearly singular along {along}")
}

/// Names the pairs whose kept distances act on a task.
pub(crate) fn distances(pairs: &[[String; 2]]) -> Option<String> {
    let names: Vec<String> = pairs.iter().map(|[a, b]| format!("{a} and {b}")).collect();
    (!names.is_empty()).then(|| format!("distance kept between {} (collision.margin_m)", names.join(", ")))
}

/// Names the limits of joints that act on a task, one text for each kind.
pub(crate) fn joint_limits(position: &[String], speed: &[String], torque: &[String]) -> Vec<String> {
    let kinds =
        [("position limits", position), ("speed or acceleration limits", speed), ("torque limits", torque)];
    let text = |(kind, joints): (&str, &[String])| {
        (!joints.is_empty()).then(|| format!("{kind} of {}", joints.join(", ")))
    };
    kinds.into_iter().filter_map(text).collect()
}
