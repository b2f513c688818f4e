//! Joints whose torque limit does not fit their friction, their rotor or the arm's weight: values in wrong units.
//!
//! Each bound is far from the values of real arms, so that it finds factors of a thousand, and accuses no arm that is only weak.

use super::diagnostic::short;
use opspace_backend::GravityCompensation;
use opspace_experiment::codes::Code;
use opspace_experiment::files::robot::RobotDefinition;
use opspace_experiment::finding::Finding;
use opspace_model::{Data, JointKind, Postures, update};

/// Longest time in which a drive brings its rotor alone to the velocity limit, s. The arms of the repository need 0.01 to 0.05 s.
const SLOWEST_S: f64 = 1.0;

/// Least torque limit as a share of the largest gravity torque within the position limits. Arms that carry nothing but themselves need 1.
const WEAKEST: f64 = 0.05;

/// Number of postures in which the gravity torque is computed.
const POSTURES: usize = 50;

/// Reasons, each with its remedy, in the order in which they are examined: one is named for each joint.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Reason {
    Friction,
    Rotor,
    Weight,
}

/// Returns a diagnostic for each reason, which names the first joint with its numbers, and the others.
#[must_use]
pub fn weak_joints(robot: &RobotDefinition) -> Vec<Finding> {
    let weights = largest_weights(robot);
    let limits = robot.joint_limits();
    let mut found: Vec<(Reason, Finding, Vec<&str>)> = Vec::new();
    for (j, (joint, parameters)) in robot.model.joints().iter().zip(robot.joints()).enumerate() {
        let (torque, velocity) = (limits.torque[j], limits.velocity[j]);
        let friction = parameters.friction.coulomb_nm.get();
        let rotor = parameters.rotor.reflected_inertia();
        let time_s = rotor * velocity / torque;
        let (nm, rad, inertia) = match joint.kind {
            JointKind::Prismatic => ("N", "m", "kg"),
            _ => ("Nm", "rad", "kg m²"),
        };
        let (reason, what, help) = if friction >= torque {
            (
                Reason::Friction,
                format!(
                    "cannot overcome its own Coulomb friction of {} {nm}: its torque limit is {} {nm}",
                    short(friction),
                    short(torque)
                ),
                "check `torque_limit_nm` and `friction.coulomb_nm`: both are at the joint, behind the gear, in Nm (N)",
            )
        } else if velocity.is_finite() && time_s > SLOWEST_S {
            (
                Reason::Rotor,
                format!(
                    "needs {} s to bring its rotor alone to the velocity limit of {} {rad}/s: the rotor has {} {inertia} at the joint, and the \
                     torque limit is {} {nm}; real drives need less than 0.1 s",
                    short(time_s),
                    short(velocity),
                    short(rotor),
                    short(torque)
                ),
                "check `rotor.inertia_kg_m2`, which is that of the motor in kg m² and counts with the square of `gear_ratio`, \
                 `torque_limit_nm`, and the velocity limit of the URDF",
            )
        } else if weights.as_ref().is_some_and(|weights| torque < WEAKEST * weights[j]) {
            let weight = weights.as_ref().map_or(0.0, |weights| weights[j]);
            (
                Reason::Weight,
                format!(
                    "bears up to {} {nm} of the arm's weight, but its torque limit is {} {nm}",
                    short(weight),
                    short(torque)
                ),
                "check `torque_limit_nm`, which is at the joint, behind the gear, in Nm (N), and the masses in the URDF, which are in kg",
            )
        } else {
            continue;
        };
        match found.iter_mut().find(|(known, ..)| *known == reason) {
            Some((.., others)) => others.push(&joint.name),
            None => {
                let message = format!("joint '{}' {what}", joint.name);
                let value: &[&str] = match reason {
                    Reason::Rotor => &["rotor", "inertia_kg_m2"],
                    Reason::Friction | Reason::Weight => &["torque_limit_nm"],
                };
                let key = [&["joint", joint.name.as_str()], value].concat();
                let finding = Finding::new(Code::WeakJoint, &key, message, help.to_owned()).of_robot();
                found.push((reason, finding, Vec::new()));
            }
        }
    }
    let named = found.into_iter().map(|(_, finding, others)| match others.as_slice() {
        [] => finding,
        others => {
            let mut finding = finding;
            finding.message += &format!("; so it is with {}", others.join(", "));
            finding
        }
    });
    named.collect()
}

/// Largest gravity torque of each joint in some postures within its limits, Nm (N); `None` where the robot bears its weight without the
/// torque limits, or if a posture has no dynamics.
fn largest_weights(robot: &RobotDefinition) -> Option<Vec<f64>> {
    if robot.file.interface.gravity_compensated_by == GravityCompensation::Robot {
        return None;
    }
    let (model, n) = (&robot.model, robot.model.n());
    let (mut data, rest, mut largest) = (Data::new(model), vec![0.0; n], vec![0.0; n]);
    let postures = Postures::new(model, 1.0);
    for number in 0..POSTURES {
        update(model, &mut data, &postures.posture(number), &rest).then_some(())?;
        for (largest, weight) in largest.iter_mut().zip(data.gravity.iter()) {
            *largest = f64::max(*largest, weight.abs());
        }
    }
    Some(largest)
}
