//! Goal poses, absolute or relative to the start of the run.
//!
//! ```text
//! offset_m        x = x₀ + A Δ
//! offset_rpy_rad  R = A R(rpy) Aᵀ R₀
//! ```
//!
//! x₀, R₀ are the pose at the start, A the axes of the task.

use crate::orientation;
use nalgebra::{Matrix3, Vector3};
use opspace_backend::quantity::exactly;
use opspace_model::Placement;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Goal position.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
pub enum PositionGoal {
    /// Position in the world, m.
    #[serde(rename = "absolute_m")]
    Absolute(#[serde(deserialize_with = "exactly")] [f64; 3]),
    /// Offset from the position at the start of the run, along the task's axes, m.
    #[serde(rename = "offset_m")]
    Offset(#[serde(deserialize_with = "exactly")] [f64; 3]),
}

/// Goal orientation: roll, pitch and yaw about fixed axes, in this order.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
pub enum OrientationGoal {
    /// Orientation in the world, rad.
    #[serde(rename = "absolute_rpy_rad")]
    Absolute(#[serde(deserialize_with = "exactly")] [f64; 3]),
    /// Rotation from the orientation at the start of the run, about the task's axes, rad.
    #[serde(rename = "offset_rpy_rad")]
    Offset(#[serde(deserialize_with = "exactly")] [f64; 3]),
}

/// Position of a goal in the world, m; the position of `before` if there is no goal.
pub(crate) fn position(
    goal: Option<&PositionGoal>,
    axes: &Matrix3<f64>,
    home: &Placement,
    before: &Placement,
) -> Vector3<f64> {
    match goal {
        None => before.translation,
        Some(PositionGoal::Absolute(p)) => Vector3::from(*p),
        Some(PositionGoal::Offset(p)) => home.translation + axes * Vector3::from(*p),
    }
}

/// Orientation of a goal in the world; the orientation of `before` if there is no goal.
pub(crate) fn rotation(
    goal: Option<&OrientationGoal>,
    axes: &Matrix3<f64>,
    home: &Placement,
    before: &Placement,
) -> Matrix3<f64> {
    match goal {
        None => before.rotation,
        Some(OrientationGoal::Absolute(rpy)) => orientation::from_rpy(*rpy),
        Some(OrientationGoal::Offset(rpy)) => {
            axes * orientation::from_rpy(*rpy) * axes.transpose() * home.rotation
        }
    }
}
