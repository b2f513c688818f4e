//! Diagnostics: problems of a task and its robot that are predicted before the robot moves.
//!
//! A task that cannot be built is an error of [`Experiment::new`]. A diagnostic concerns a task that can run but will
//! not behave as intended; it gives the value at fault and a remedy. There is one file per kind:
//!
//! | file | finds |
//! |---|---|
//! | `goals` | references that are out of reach, or reachable only beyond the joint position limits |
//! | `speeds` | references faster than the joints or the speed limit of the task |
//! | `accelerations` | references that need more acceleration or torque of a joint than its limits |
//! | `ramp` | references that move fast while the torque ramps in |
//! | `stability` | gains too high for the rate, the delay and the servo |
//! | `admittance` | force axes of inverse kinematics that oscillate on the objects of the environment |
//! | `limits` | limits that contradict each other, the start posture or the arm's weight |
//! | `position_limits` | references that the position limits keep the task from, on the way from the start |
//! | `freedom` | a start at a singularity; degrees of freedom without a task; compliant axes that nothing brings back |
//! | `servo_gain` | position or velocity loops with a small gain margin |
//! | `ignored_compliance` | impedances and compliant axes that inverse kinematics ignores, or the default transformer damps |
//! | `margins` | ranges of true over nominal values in which the arm is stable |
//! | `refusal` | margins too small for a real robot |
//! | `impedances` | real part of the impedance of drives with their transformer |
//! | `gears` | oscillation on elastic gears |
//! | `torque_floor` | velocity feed-forward with held setpoints |
//! | `contact` | force axes whose contact would oscillate, or whose impact exceeds torque limits |
//! | `objects` | a start inside an object of the environment; objects out of reach |
//! | `collisions` | a start or references in collision with an obstacle or the arm itself |
//! | `couplings` | couplings of several robots without passivity control |
//! | `times` | events and references that end after the run |
//!
//! All checks use the nominal robot, which starts in the start posture of the task and follows the references without
//! error.

mod accelerations;
mod admittance;
mod boundary;
mod case;
mod collisions;
mod contact;
mod couplings;
mod detectable_force;
mod diagnostic;
mod freedom;
mod gear_resonance;
mod gears;
mod goals;
mod ignored_compliance;
mod impedances;
mod limits;
mod margins;
mod motion;
mod nudge;
mod objects;
mod phase_margin;
mod position_limits;
mod ramp;
mod refusal;
mod servo_gain;
mod speeds;
mod stability;
mod surfaces;
mod times;
mod torque_floor;
mod variation;

use crate::codes::Code;
use crate::files::controller_kind::ControllerKind;
pub use crate::finding::Finding;
use crate::run::experiment::Experiment;
use crate::run::rollout::Rollout;
use case::PreflightCase;
pub use couplings::coupling_diagnostics;
pub use detectable_force::DetectableForce;
pub use freedom::SingularPostures;
pub use gear_resonance::GearResonance;
pub use gears::{GearMargin, GearScale, gear_margin};
pub use impedances::{JointImpedance, impedances};
pub use margins::{Margins, Quantity, RangeEnd, StableRange, margins, margins_with};
pub use refusal::{LEAST_EXCESS, checked_for_real_robot, refusals};
pub use servo_gain::{GainMargin, ServoLoop, gain_margin};
pub use times::PathDuration;
pub use torque_floor::{JointFloor, TORQUE_HZ, floors};
pub use variation::Variation;

/// Computes all diagnostics that need no simulation; most tasks have none. [`GainMargin::finding`] gives the
/// diagnostic about the gain margin.
#[must_use]
pub fn diagnostics(experiment: &Experiment) -> Vec<Finding> {
    let Some(case) = PreflightCase::new(experiment) else {
        return Vec::new();
    };
    let followed = Rollout::new(&case.rollout());
    let mut found = of_start(&case);
    found.extend(limits::of_postures(&case, &followed));
    let out_of_reach = goals::out_of_reach(&case, &followed);
    // References that are out of reach would require arbitrary speeds and torques.
    if out_of_reach.is_empty() {
        found.extend(speeds::of_joints(&case, &followed));
        if experiment.options().controller == ControllerKind::Osc {
            found.extend(accelerations::of_joints(&case, &followed));
            found.extend(ramp::of_references(&case, &followed));
        }
        found.extend(limits::on_the_way(&case, &followed));
        // Targets beyond the limits explain themselves.
        if found.iter().all(|diagnostic| diagnostic.code != Code::TargetBeyondLimits) {
            found.extend(position_limits::beyond_on_the_way(&case, &followed));
        }
    }
    found.extend(out_of_reach);
    if experiment.options().controller == ControllerKind::Osc {
        found.extend(collisions::on_the_way(&case, &followed));
    }
    found.extend(speeds::of_tasks(&case, &followed));
    found.extend(times::too_short(&case, &followed));
    found
}

/// Computes those of the [`diagnostics`] that do not follow the references: they concern the start posture, gains and
/// contacts. They take some 20 ms; references out of reach can take five times as long, and long runs more.
#[must_use]
pub fn start_diagnostics(experiment: &Experiment) -> Vec<Finding> {
    PreflightCase::new(experiment).map_or_else(Vec::new, |case| of_start(&case))
}

fn of_start(case: &PreflightCase<'_>) -> Vec<Finding> {
    let mut found = limits::of_start(case);
    found.extend(objects::misplaced(case));
    found.extend(freedom::singular_start(case));
    if case.experiment.options().controller == ControllerKind::Osc {
        found.extend(collisions::at_start(case));
        found.extend(freedom::uncontrolled(case));
        found.extend(freedom::drifting(case));
        found.extend(stability::stiff_gains(case));
        found.extend(contact::contacts(case));
    }
    found.extend(ignored_compliance::ignored(case));
    found.extend(admittance::unstable_contacts(case));
    found.extend(torque_floor::feed_forward_impulses(case.experiment));
    found
}

/// Counts, for each task of at most six rows, the sampled postures in which it is nearly singular.
#[must_use]
pub fn singular_postures(experiment: &Experiment) -> Vec<SingularPostures> {
    PreflightCase::new(experiment).map_or_else(Vec::new, |case| freedom::singular_postures_of(&case))
}

/// Computes the durations of the paths that tasks follow.
#[must_use]
pub fn path_durations(experiment: &Experiment) -> Vec<PathDuration> {
    times::path_durations_of(experiment)
}

/// Computes the frequencies of the joints whose gear stiffness is declared, at the start.
#[must_use]
pub fn gear_resonances(experiment: &Experiment) -> Vec<GearResonance> {
    let case = PreflightCase::new(experiment);
    case.map_or_else(Vec::new, |case| gear_resonance::gear_resonances_of(&case))
}

/// Computes the smallest forces that the robot's estimated force sensors can show, at the start.
#[must_use]
pub fn detectable_forces(experiment: &Experiment) -> Vec<DetectableForce> {
    let case = PreflightCase::new(experiment);
    case.map_or_else(Vec::new, |case| detectable_force::detectable_forces_of(&case))
}

/// Thresholds of the collision detection at rest at the start, with the names of the joints (Nm, N); empty without one.
#[must_use]
pub fn collision_thresholds(experiment: &Experiment) -> Vec<(String, f64)> {
    let Some((detector, case)) = experiment.collision_detector().zip(PreflightCase::new(experiment)) else {
        return Vec::new();
    };
    let thresholds =
        detector.thresholds_at_rest(case.data.gravity.as_slice(), experiment.capabilities().period_s);
    case.model.joints().iter().map(|joint| joint.name.clone()).zip(thresholds).collect()
}

/// Lists the tasks that lack information for [`diagnostics`]; their diagnostics are incomplete.
#[must_use]
pub fn not_checked(experiment: &Experiment) -> Vec<Finding> {
    let Some(case) = PreflightCase::new(experiment) else { return Vec::new() };
    let mut found = admittance::unknown_contacts(&case);
    if experiment.options().controller == ControllerKind::Osc {
        found.extend(stability::not_checked(&case));
    }
    found
}
