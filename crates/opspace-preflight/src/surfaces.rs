//! Objects of the environment that a frame may press on, with their stiffness along a direction.

use super::case::PreflightCase;
use nalgebra::Vector3;
use opspace_model::frame_placement;
use opspace_sim::EnvironmentObjectParameters;

/// Stiffness along a direction below which an object does not count, as a fraction of its stiffness: it is touched
/// sideways.
const SIDEWAYS: f64 = 0.01;

/// Bounds of the examined stiffness of unknown objects, N/m, and number of values per decade.
const STIFFNESSES_N_PER_M: [f64; 2] = [1.0, 1e7];
const PER_DECADE: i32 = 4;

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

/// Largest stiffness of an undamped object for which a contact is stable, N/m; `None` if it is for all.
pub(super) fn largest_stable_stiffness(is_stable: impl Fn(Surface) -> bool) -> Option<f64> {
    let [low, high] = STIFFNESSES_N_PER_M;
    let stable = |stiffness| is_stable(Surface { stiffness, damping: 0.0 });
    // The margin need not fall with the stiffness: very stiff objects leave the compliance of the servos.
    let steps = (high / low).log10() as i32 * PER_DECADE;
    let at = |step: i32| low * 10.0_f64.powf(f64::from(step) / f64::from(PER_DECADE));
    let unstable = (1..=steps).find(|&step| !stable(at(step)))?;
    largest_true(at(unstable - 1), at(unstable), stable)
}

/// Largest value from `low` to `high` for which `is_true`, on a logarithmic scale; `None` if it is false for `low`.
pub(super) fn largest_true(mut low: f64, mut high: f64, is_true: impl Fn(f64) -> bool) -> Option<f64> {
    if !is_true(low) {
        return None;
    }
    for _ in 0..20 {
        let middle = (low * high).sqrt();
        if is_true(middle) { low = middle } else { high = middle }
    }
    Some(low)
}
