//! Start positions of joints that a file states, compared with the limits.

use opspace_model::{JointKind, Limits, Model};
use std::collections::BTreeMap;

/// Remedy for angles that are probably degrees.
pub(crate) const IN_DEGREES: &str = "positions are in rad: if the file means degrees, multiply them by π/180";

/// Size of an angle from which on it is probably one in degrees.
const LEAST_DEGREES: f64 = 7.0;

/// Largest distance of a start position from 0, rad or m: far beyond it, the dynamics of a joint without position limits
/// are rounding errors.
const LARGEST_START: f64 = 1e4;

/// Checks a start position of a joint, rad or m. The error is a message and a help.
pub fn check_start(limits: &Limits, value: f64) -> Result<(), (String, String)> {
    let (lower, upper) = (limits.lower.max(-LARGEST_START), limits.upper.min(LARGEST_START));
    if value >= lower && value <= upper {
        return Ok(());
    }
    let message = if value.abs() > LARGEST_START {
        format!("{value:e} is too far from 0")
    } else {
        format!("{value} is outside the joint's limits")
    };
    Err((message, format!("give a value from {lower} to {upper}")))
}

/// Names the other joints whose positions (rad, m) are outside their limits.
pub(crate) fn others_outside(model: &Model, given: &BTreeMap<String, f64>, first: &str) -> String {
    let is_outside = |(name, value): (&String, &f64)| {
        let joint = model.joint(name).ok()?;
        let is_other = name.as_str() != first;
        (is_other && check_start(&model.joints()[joint].limits, *value).is_err())
            .then(|| format!("'{name}' at {value}"))
    };
    let others: Vec<String> = given.iter().filter_map(is_outside).collect();
    if others.is_empty() { String::new() } else { format!("; so are {}", others.join(", ")) }
}

/// True if the angles are probably in degrees: one is large, and as degrees all are within their limits.
pub(crate) fn are_degrees(model: &Model, given: &BTreeMap<String, f64>) -> bool {
    let angles = given.iter().filter_map(|(name, &value)| {
        let joint = &model.joints()[model.joint(name).ok()?];
        matches!(joint.kind, JointKind::Revolute | JointKind::Continuous).then_some((joint, value))
    });
    let angles: Vec<_> = angles.collect();
    angles.iter().any(|(_, value)| value.abs() > LEAST_DEGREES)
        && angles.iter().all(|(joint, value)| check_start(&joint.limits, value.to_radians()).is_ok())
}
