//! Behaviour of a task whose desired acceleration the limits do not allow: what its axes are worth, and if it is scaled.

use crate::error::{ControlError, Reason};
use crate::per_joint::{PerJoint, indices};
use crate::tasks::axes::PerAxis;
use nalgebra::Vector6;
use opspace_backend::quantity::Positive;
use opspace_model::Model;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Largest ratio of the weights of a task. The deviation of the axis with the smallest weight then still counts much
/// more than the accuracy with which the program of a level is solved.
pub const WEIGHT_RATIO: f64 = 100.0;

/// Change of a task's desired acceleration that limits do not allow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum WhenLimited {
    /// The acceleration deviates as little as possible. Deviations perpendicular to the direction of motion have
    /// `limits.lateral_weight` times the weight of those along it.
    #[default]
    LeastSquares,
    /// The velocity after the horizon of the limits keeps its direction, and is reduced by one factor from 0 to 1. The
    /// task stops at a limit at which least squares would slide along it. It leaves its direction only as far as the
    /// limits force it to. Compliant and force axes are not scaled.
    Scaled,
}

/// Returns the weights of the rows of a task, one per axis in `axes`; `None` if they are equal.
///
/// # Errors
/// A ratio of the weights above [`WEIGHT_RATIO`].
pub(crate) fn axis_weights(
    weight: &PerAxis<Positive>,
    axes: &[usize],
    key: &str,
) -> Result<Option<Vector6<f64>>, ControlError> {
    let weights = axes.iter().map(|&axis| weight.get(axis).map_or(1.0, Positive::get));
    let mut rows = Vector6::repeat(1.0);
    rows.iter_mut().zip(weights).for_each(|(row, weight)| *row = weight);
    Ok(are_different(&rows.as_slice()[..axes.len()], key)?.then_some(rows))
}

/// Returns the weights of `joints`; `None` if they are equal. Joints that are not named have the weight 1.
///
/// # Errors
/// A name that is not the name of one of `joints`; a ratio of the weights above [`WEIGHT_RATIO`].
pub(crate) fn joint_weights(
    weight: &PerJoint<Positive>,
    joints: &[usize],
    model: &Model,
    key: &str,
) -> Result<Option<Vec<f64>>, ControlError> {
    let mut weights = vec![1.0; joints.len()];
    if let PerJoint::Each(map) = weight {
        for (joint, value) in indices(model, key, map)? {
            let Some(place) = joints.iter().position(|&other| other == joint) else {
                let name = &model.joints()[joint].name;
                let message = format!("joint '{name}' is not in the task: only its joints have a weight");
                return Err(ControlError::new(format!("{key}.{name}"), Reason::Value { message }));
            };
            weights[place] = value.get();
        }
    }
    Ok(are_different(&weights, key)?.then_some(weights))
}

/// Returns true if weights are not equal.
fn are_different(weights: &[f64], key: &str) -> Result<bool, ControlError> {
    let range = |(least, most): (f64, f64), &weight: &f64| (least.min(weight), most.max(weight));
    let (least, most) = weights.iter().fold((f64::INFINITY, 0.0), range);
    if most > WEIGHT_RATIO * least {
        let message = format!(
            "weights from {least} to {most}: the largest may be at most {WEIGHT_RATIO} times the smallest, whose axis \
             would otherwise be lost in the accuracy of the solver; put the more important axes into a task of \
             higher priority"
        );
        return Err(ControlError::new(key, Reason::Value { message }));
    }
    Ok(most > least)
}
