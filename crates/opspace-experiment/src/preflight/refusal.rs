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
//! Velocity feed-forward with held setpoints is refused if its impulses exceed a torque limit.

use super::diagnostic::Diagnostic;
use super::gears::first_oscillation;
use super::nudge::{Nudge, NudgedArm};
use super::servo_gain::{ServoLoop, gain_margin};
use super::torque_floor::feed_forward_impulses;
use crate::run::experiment::Experiment;
use opspace_transformer::Gears;

/// Excess of the servos' gains over their nominal values at which a real robot must be stable.
pub const LEAST_EXCESS: f64 = 0.01;

/// Returns the reason why an experiment should not run on a real robot: a margin that is too small; `None` if there is
/// none, or if commands pass without a transformer.
#[must_use]
pub fn refusal(experiment: &Experiment) -> Option<Diagnostic> {
    if let Some(found) = feed_forward_impulses(experiment) {
        return Some(found);
    }
    let nudged = NudgedArm::new(experiment, experiment.transformer_kind()?)?;
    let servo_loop = ServoLoop::of(experiment.command_kind())?;
    let varied = servo_loop.varied().of(nudged.nominal(), 1.0 + LEAST_EXCESS)?;
    if let Nudge::Grows(_) = nudged.nudge(&varied)? {
        let mut found = gain_margin(experiment)?.finding(experiment)?;
        found.message += &format!("; a real robot must tolerate {} %", 100.0 * LEAST_EXCESS);
        return Some(found);
    }
    if experiment.robot().gears() == Gears::Rigid {
        return None;
    }
    first_oscillation(&nudged)?.finding(experiment)
}
