//! Refusal of a run on a real robot whose margins are too small.
//!
//! A simulation is never refused: nothing can break, and it shows what happens beyond a margin. On a real robot two
//! margins are required, each examined with a few simulated nudges, which take a few tenths of a second in all; the
//! whole table of [`margins`](super::margins) takes some seconds:
//!
//! * The gains of all position (or velocity) loops may be 1 % higher than nominal: servos are seldom known better.
//! * The arm does not oscillate on elastic gears, unless they are declared rigid: of half and twice the declared
//!   stiffness, or, where none is declared, of antiresonances from 20 to 120 Hz.
//!
//! A task whose gains are unstable at the rate, the delay and the servo of the robot is refused too, by the phase margin of its
//! loop; so is a force axis that is unstable on the surface that the task states, because commands act late.
//!
//! Velocity feed-forward with held setpoints is refused if its impulses exceed a torque limit.

use super::case::PreflightCase;
use super::contact::unstable_contacts;
use super::gears::first_oscillation;
use super::nudge::{Nudge, NudgedArm};
use super::servo_gain::{ServoLoop, gain_margin};
use super::stability::unstable_gains;
use super::torque_floor::feed_forward_impulses;
use opspace_experiment::files::controller_kind::ControllerKind;
use opspace_experiment::files::source::FileError;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::experiment::Experiment;
use opspace_experiment::run::scenario::Scenario;
use opspace_transformer::Gears;

/// Excess of the servos' gains over their nominal values at which a real robot must be stable.
pub const LEAST_EXCESS: f64 = 0.01;

/// Returns the reasons why an experiment should not run on a real robot: margins that are too small. Empty if there is none.
#[must_use]
pub fn refusals(experiment: &Experiment) -> Vec<Finding> {
    let found = [feed_forward_impulses(experiment), small_gain_margin(experiment), oscillation(experiment)];
    unstable_tasks(experiment).into_iter().chain(found.into_iter().flatten()).collect()
}

fn unstable_tasks(experiment: &Experiment) -> Vec<Finding> {
    let has_tasks = experiment.options().controller == ControllerKind::Osc;
    let case = has_tasks.then(|| PreflightCase::new(experiment)).flatten();
    case.map_or_else(Vec::new, |case| [unstable_gains(&case), unstable_contacts(&case)].concat())
}

/// Returns an experiment that may run on a real robot.
///
/// # Errors
/// The first refusal that the user has not allowed; those that are allowed are recorded.
pub fn checked_for_real_robot(mut experiment: Experiment) -> Result<Experiment, FileError> {
    for refusal in refusals(&experiment) {
        let placed = refusal.placed(&experiment).refused(refusal.code);
        experiment.refuse(placed)?;
    }
    Ok(experiment)
}

/// Refuses real robots of a scenario whose margins are too small, unless that is allowed.
///
/// # Errors
/// The refusals of [`checked_for_real_robot`].
pub fn checked_for_real_robots(mut scenario: Scenario) -> Result<Scenario, FileError> {
    for member in scenario.members.iter_mut().filter(|member| member.experiment.has_driver()) {
        member.experiment = checked_for_real_robot(member.experiment.clone())?;
    }
    Ok(scenario)
}

fn nudged(experiment: &Experiment) -> Option<NudgedArm> {
    NudgedArm::new(experiment, &experiment.transformer_name()?)
}

fn small_gain_margin(experiment: &Experiment) -> Option<Finding> {
    let (nudged, servo_loop) = (nudged(experiment)?, ServoLoop::of(experiment.command_kind())?);
    let varied = servo_loop.varied().of(nudged.nominal(), 1.0 + LEAST_EXCESS)?;
    let Nudge::Grows(_) = nudged.nudge(&varied)? else { return None };
    let mut found = gain_margin(experiment)?.finding(experiment)?;
    found.message += &format!("; a real robot must tolerate {} %", 100.0 * LEAST_EXCESS);
    Some(found)
}

fn oscillation(experiment: &Experiment) -> Option<Finding> {
    if experiment.robot().gears() == Gears::Rigid {
        return None;
    }
    first_oscillation(&nudged(experiment)?)?.finding(experiment)
}
