//! Objects of the environment that a frame may press on, with their stiffness along a direction.

use super::case::PreflightCase;
use nalgebra::Vector3;
use opspace_model::frame_placement;
use opspace_sim::EnvironmentObjectParameters;

/// Stiffness along a direction below which an object does not count, as a fraction of its stiffness: it is touched
/// sideways.
const SIDEWAYS: f64 = 0.01;

/// Surface of an object: its stiffness and damping along a direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    /// Stiffness, N/m.
    pub(super) stiffness: f64,
    /// Damping, Ns/m.
    pub(super) damping: f64,
}

/// Objects that act on `frame`, with their surfaces along `along` (of unit length, in the world) in the start posture.
pub(super) fn surfaces<'a>(
    case: &PreflightCase<'a>,
    frame: &str,
    along: &Vector3<f64>,
) -> Vec<(&'a str, Surface)> {
    let Ok(id) = case.model.frame_id(frame) else { return Vec::new() };
    let point = frame_placement(case.model, &case.data, id).translation;
    let objects = case.experiment.task().file.environment.iter();
    objects
        .filter(|(_, object)| object.frame() == frame)
        .filter_map(|(name, object)| Some((name.as_str(), surface(object, &point, along)?)))
        .collect()
}

fn surface(
    object: &EnvironmentObjectParameters,
    point: &Vector3<f64>,
    along: &Vector3<f64>,
) -> Option<Surface> {
    let toward = |direction: Vector3<f64>| unit(direction).dot(along).powi(2);
    let (stiffness, damping, share) = match object {
        EnvironmentObjectParameters::Wall(wall) => {
            (wall.stiffness_n_per_m.get(), wall.damping_ns_per_m.get(), toward(wall.normal.into()))
        }
        EnvironmentObjectParameters::Cylinder(cylinder) => {
            let (axis, from_axis) = (unit(cylinder.axis.into()), point - Vector3::from(cylinder.point_m));
            let normal = from_axis - axis * axis.dot(&from_axis);
            (cylinder.stiffness_n_per_m.get(), cylinder.damping_ns_per_m.get(), toward(normal))
        }
        // Its plane and bottom, and its wall across them.
        EnvironmentObjectParameters::Hole(hole) => {
            let share = toward(hole.normal.into());
            (hole.stiffness_n_per_m.get(), hole.damping_ns_per_m.get(), share.max(1.0 - share))
        }
        EnvironmentObjectParameters::Spring(spring) => {
            let gain = Vector3::from(spring.gain.map(|gain| gain.get()));
            (spring.stiffness_n_per_m.get(), spring.damping_ns_per_m.get(), gain.dot(&along.map(|x| x * x)))
        }
        _ => return None,
    };
    (share > SIDEWAYS).then_some(Surface { stiffness: stiffness * share, damping: damping * share })
}

/// Direction of a vector; zero for zero.
fn unit(vector: Vector3<f64>) -> Vector3<f64> {
    let largest = vector.amax();
    if largest > 0.0 { (vector / largest).normalize() } else { vector }
}
