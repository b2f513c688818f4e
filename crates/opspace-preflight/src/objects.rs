//! Objects of the simulated environment in which the hand starts, or which it cannot reach.

use super::case::PreflightCase;
use super::diagnostic::{at_least, short};
use nalgebra::Vector3;
use opspace_control::reach;
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_model::frame_placement;
use opspace_sim::EnvironmentObjectParameters;

/// Depth up to which a start in an object is contact, m.
const CONTACT_M: f64 = 1e-3;

/// Diagnostics of all objects.
pub(crate) fn misplaced(case: &PreflightCase<'_>) -> Vec<Finding> {
    let objects = case.experiment.task().file.environment.iter();
    objects.filter_map(|(name, object)| misplaced_object(case, name, object)).collect()
}

fn misplaced_object(
    case: &PreflightCase<'_>,
    name: &str,
    object: &EnvironmentObjectParameters,
) -> Option<Finding> {
    let frame = case.model.frame_id(object.frame()).ok()?;
    let at = frame_placement(case.model, &case.data, frame).translation;
    let first = &case.model.bodies()[case.model.ancestors(frame).last()?];
    let base = case.model.base().act_point(&first.origin.translation);
    let (depth_m, stiffness) = depth(object, &at)?;
    let key = ["environment", name, object.kind()];
    if depth_m > CONTACT_M {
        let message = format!(
            "'{}' starts {} m deep in '{name}', which pushes it out with {} N",
            object.frame(),
            short(depth_m),
            short(stiffness * depth_m),
        );
        let help = format!("move '{name}' by {} m or more, or start elsewhere", at_least(depth_m));
        return Some(Finding::new(Code::StartInObject, &key, message, help));
    }
    let reach_m = reach(case.model, frame);
    let away_m = -depth(object, &base)?.0;
    if away_m > reach_m {
        let message = format!(
            "'{name}' is {} m from the first joint, but '{}' reaches only {} m from there: they never touch",
            short(away_m),
            object.frame(),
            short(reach_m),
        );
        let help = format!("move '{name}' {} m closer", at_least(away_m - reach_m));
        return Some(Finding::new(Code::ObjectOutOfReach, &key, message, help));
    }
    None
}

/// Depth of a point behind the surface of an object, m, and the object's stiffness, N/m. The depth is negative outside; it
/// is zero in a hole and below an edge. `None` for an object without a surface.
pub(super) fn depth(object: &EnvironmentObjectParameters, at: &Vector3<f64>) -> Option<(f64, f64)> {
    let unit = |vector: [f64; 3]| Vector3::from(vector).try_normalize(0.0);
    match object {
        EnvironmentObjectParameters::Wall(wall) => {
            let depth_m = unit(wall.normal)?.dot(&(Vector3::from(wall.point_m) - at));
            let beyond = wall
                .edge
                .as_ref()
                .is_some_and(|edge| unit(edge.toward).is_some_and(|toward| toward.dot(at) >= edge.at_m));
            Some((if beyond { depth_m.min(0.0) } else { depth_m }, wall.stiffness_n_per_m.get()))
        }
        EnvironmentObjectParameters::Cylinder(cylinder) => {
            let (axis, from_axis) = (unit(cylinder.axis)?, at - Vector3::from(cylinder.point_m));
            let distance_m = (from_axis - axis * axis.dot(&from_axis)).norm();
            Some((cylinder.radius_m.get() - distance_m, cylinder.stiffness_n_per_m.get()))
        }
        EnvironmentObjectParameters::Hole(hole) => {
            let (normal, from_hole) = (unit(hole.normal)?, at - Vector3::from(hole.point_m));
            let depth_m = -normal.dot(&from_hole);
            let is_in_hole = (from_hole + normal * depth_m).norm() < hole.radius_m.get();
            Some((if is_in_hole { depth_m.min(0.0) } else { depth_m }, hole.stiffness_n_per_m.get()))
        }
        _ => None,
    }
}
