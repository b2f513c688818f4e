//! Diagnostics: problems of a task and its robot that are predicted before the robot moves.
//!
//! A task that cannot be built is an error of [`Experiment::new`]. A diagnostic concerns a task that can run but will
//! not behave as intended; it gives the value at fault and a remedy. [`Check`] lists the checks that need no simulation, each in a
//! file of its own; `margins`, `refusal`, `impedances`, `gears` and `servo_gain` simulate nudges, and `couplings` examines several
//! robots.
//!
//! All checks use the nominal robot, which starts in the start posture of the task and follows the references without
//! error.

mod accelerations;
mod admittance;
mod approach;
mod boundary;
mod case;
mod changed;
mod check;
mod collisions;
mod contact;
mod contact_margin;
mod couplings;
mod detectable_force;
mod diagnostic;
mod freedom;
mod gain_remedies;
mod gear_remedies;
mod gear_resonance;
mod gears;
mod goals;
mod half_turns;
mod ignored_compliance;
mod impedances;
mod jumps;
mod limits;
mod loads;
mod margins;
mod motion;
mod nudge;
mod objects;
mod overcompensation;
mod phase_margin;
mod position_limits;
mod ramp;
mod refusal;
mod reserves;
mod sensor_loads;
mod servo_gain;
mod setpoint_filters;
mod speeds;
mod stability;
mod surfaces;
mod times;
mod torque_floor;
mod variation;
mod weak_joints;

use case::PreflightCase;
pub use check::Check;
pub use couplings::coupling_diagnostics;
pub use detectable_force::DetectableForce;
pub use freedom::SingularPostures;
pub use gear_resonance::GearResonance;
pub use gears::{GearMargin, GearScale, gear_margin};
pub use impedances::{JointImpedance, impedances};
pub use margins::{Margins, Quantity, RangeEnd, StableRange, alternatives, margins, margins_with};
use opspace_experiment::extensions::Extensions;
use opspace_experiment::files::controller_kind::ControllerKind;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::experiment::Experiment;
use opspace_transformer::Gears;
pub use refusal::{LEAST_EXCESS, checked_for_real_robot, checked_for_real_robots, refusals};
pub use reserves::{Reserve, ReserveOf};
pub use servo_gain::{GainMargin, ServoLoop, gain_margin};
pub use stability::{LoopMargin, loop_margin};
pub use times::PathDuration;
pub use torque_floor::{JointFloor, TORQUE_HZ, floors};
pub use variation::Variation;
pub use weak_joints::weak_joints;

/// Computes all diagnostics that need no simulation; most tasks have none. [`GainMargin::finding`] gives the
/// diagnostic about the gain margin.
#[must_use]
pub fn diagnostics(experiment: &Experiment) -> Vec<Finding> {
    diagnostics_with(&Extensions::default(), experiment)
}

/// Computes the [`diagnostics`], with the checks of `extensions`.
#[must_use]
pub fn diagnostics_with(extensions: &Extensions, experiment: &Experiment) -> Vec<Finding> {
    check::diagnostics(experiment, extensions.all())
}

/// Computes those of the [`diagnostics`] that do not follow the references: they concern the start posture, gains and
/// contacts, and those of added checks. They take some 20 ms; references out of reach can take five times as long, and long runs
/// more.
#[must_use]
pub fn start_diagnostics(extensions: &Extensions, experiment: &Experiment) -> Vec<Finding> {
    check::start_diagnostics(experiment, extensions.all())
}

/// Computes the diagnostics that `opspace check` lists of a task: [`diagnostics_with`], and those that simulate nudges of the
/// arm.
#[must_use]
pub fn problems(extensions: &Extensions, experiment: &Experiment) -> Vec<Finding> {
    let mut found = diagnostics_with(extensions, experiment);
    found.extend(gain_margin(experiment).and_then(|margin| margin.finding(experiment)));
    // Gears that are declared rigid have none of these problems.
    if experiment.robot().gears() != Gears::Rigid {
        found.extend(gear_margin(experiment).and_then(|margin| margin.finding(experiment)));
        let impedances = impedances(experiment).unwrap_or_default();
        found.extend(JointImpedance::finding(&impedances, experiment));
    }
    let used = experiment.transformer_name().filter(|_| margins::is_varied(experiment));
    let margins = used.and_then(|name| margins_with(experiment, &name));
    found.extend(margins.and_then(|margins| margins.finding(experiment)));
    found
}

/// Counts, for each task of at most six rows, the sampled postures in which it is nearly singular.
#[must_use]
pub fn singular_postures(experiment: &Experiment) -> Vec<SingularPostures> {
    PreflightCase::new(experiment).map_or_else(Vec::new, |case| freedom::singular_postures_of(&case))
}

/// Computes the joints that reach a limit first along the references: with a payload, with the target forces of the tasks, and
/// with speed.
#[must_use]
pub fn reserves(experiment: &Experiment) -> Vec<Reserve> {
    PreflightCase::new(experiment).map_or_else(Vec::new, |case| reserves::reserves_of(&case))
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
        found.extend(contact::unknown_contacts(&case));
        found.extend(stability::not_checked(&case));
    }
    found
}
