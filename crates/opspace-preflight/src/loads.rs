//! Loads of the environment that are too heavy for a joint: with their weight, the references need more torque than is allowed.

use super::case::PreflightCase;
use super::diagnostic::{at_most, short};
use nalgebra::Matrix6xX;
use opspace_backend::GravityCompensation;
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::rollout::{Instant, Rollout};
use opspace_model::{FrameId, frame_jacobian, update};
use opspace_sim::EnvironmentObjectParameters;
use opspace_sim::environment::MassParameters;

/// Largest number of instants that are examined for a load.
const INSTANTS: usize = 200;

/// Joint that a load overloads the most.
struct Overloaded {
    time_s: f64,
    joint: usize,
    /// Torque of the weight of arm and load, and the allowed one, Nm (N).
    needed: f64,
    allowed: f64,
    /// Mass that the joint can hold, kg.
    at_most_kg: f64,
}

/// Reports each load whose weight a joint cannot hold.
pub(crate) fn too_heavy(case: &PreflightCase<'_>, followed: &Rollout) -> Vec<Finding> {
    let environment = &case.experiment.task().file.environment;
    let masses = environment.iter().filter_map(|(name, object)| match object {
        EnvironmentObjectParameters::Mass(mass) => Some((name, mass, case.model.frame_id(&mass.frame).ok()?)),
        _ => None,
    });
    masses
        .filter_map(|(name, mass, frame)| {
            Some(finding(case, name, mass, &worst(case, followed, mass, frame)?))
        })
        .collect()
}

/// Joint that the load overloads the most along the references; `None` if none is overloaded by it.
fn worst(
    case: &PreflightCase<'_>,
    followed: &Rollout,
    mass: &MassParameters,
    frame: FrameId,
) -> Option<Overloaded> {
    let limits = case.experiment.task().file.limits;
    let share = if limits.enforce { limits.torque_fraction.get().min(1.0) } else { 1.0 };
    let by_robot =
        case.experiment.robot().file.interface.gravity_compensated_by == GravityCompensation::Robot;
    let torque_limits = case.experiment.robot().torque_limits();
    let (from_s, until_s) = (
        mass.put_on_s.map_or(0.0, |time| time.get()),
        mass.taken_off_s.map_or(f64::INFINITY, |time| time.get()),
    );
    let hanging: Vec<&Instant> = followed
        .instants
        .iter()
        .filter(|instant| instant.time_s >= from_s && instant.time_s <= until_s)
        .collect();
    let every = hanging.len().div_ceil(INSTANTS).max(1);
    let (mut data, rest) = (case.data.clone(), vec![0.0; case.model.n()]);
    let mut jacobian = Matrix6xX::zeros(case.model.n());
    let mut worst: Option<Overloaded> = None;
    for instant in hanging.into_iter().step_by(every) {
        if !update(case.model, &mut data, &instant.q, &rest) {
            continue;
        }
        frame_jacobian(case.model, &data, frame, &mut jacobian);
        for (joint, limit) in torque_limits.iter().enumerate() {
            let own = if by_robot { 0.0 } else { data.gravity[joint] };
            // Torque per kilogram: the drives bear the load against its weight.
            let of_load = -jacobian.column(joint).fixed_rows::<3>(0).dot(&case.model.gravity());
            let (needed, allowed) = (own + mass.mass_kg.get() * of_load, share * limit);
            // The weight of the arm alone is a diagnostic of its own.
            if needed.abs() <= allowed || own.abs() > allowed {
                continue;
            }
            let at_most_kg = (allowed - own * needed.signum()) / of_load.abs();
            if worst.as_ref().is_none_or(|worst| at_most_kg < worst.at_most_kg) {
                worst = Some(Overloaded {
                    time_s: instant.time_s,
                    joint,
                    needed: needed.abs(),
                    allowed,
                    at_most_kg,
                });
            }
        }
    }
    worst
}

fn finding(case: &PreflightCase<'_>, name: &str, mass: &MassParameters, worst: &Overloaded) -> Finding {
    let message = format!(
        "at {} s joint '{}' needs {} Nm (N) to hold the arm with '{name}' of {} kg, but only {} Nm (N) is allowed",
        short(worst.time_s),
        case.joint(worst.joint),
        short(worst.needed),
        short(mass.mass_kg.get()),
        short(worst.allowed),
    );
    let help = format!(
        "mass_kg = {} can be held there; for more, choose a posture with less weight on this joint",
        at_most(worst.at_most_kg)
    );
    Finding::new(Code::WeightAboveLimit, &["environment", name, "mass", "mass_kg"], message, help)
}
