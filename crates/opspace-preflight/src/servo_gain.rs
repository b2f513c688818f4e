//! Gain margin of position or velocity loops: the largest excess over the nominal gains at which a run stays bounded.
//!
//! A transformer cancels the stiffness and damping of the servo. If the gain of a position loop is (1 + ε) kp instead
//! of kp, the transformer cancels too little position feedback, and a torque ε kv q̇ remains in the direction of
//! motion. Together with all other damping of the joints, a run stays bounded as long as
//!
//! ```text
//! (1 + ε) Kv Kp t̄ + B − B̂ + D − ε Kv  is positive definite
//! t̄ = (d + (R−1)/2) T_s, or 0 if held setpoints are emulated
//! ```
//!
//! where Kv and Kp are the nominal gains, B is the viscous friction, B̂ its compensated part and D = −∂τ/∂q̇ the
//! damping of the task's control law (n × n; the other matrices are diagonal). For one joint this is
//!
//! ```text
//! 1 + ε < 1 + (1 + ε) kp t̄ + (b − b̂ + d)/kv
//! ```
//!
//! A velocity robot has no position loop. A velocity loop with a gain of (1 + ε) kv produces (1 + ε) times the
//! desired torque. A friction compensation can then exceed the friction and drive the joint; a run stays bounded as
//! long as
//!
//! ```text
//! B + (1 + ε) (D − B̂)  is positive definite
//! ```
//!
//! The reported bound is not computed from these formulas but by [simulation](super::nudge), with the backend and the
//! transformer of the experiment and the same ε for all joints; the bound on ε between decay and growth is found by
//! bisection. The result therefore includes the effect of a disturbance observer on the motor current.
//!
//! Coulomb friction is not included: it only brakes as long as the compensation does not exceed it. However, the
//! slope of a compensation at rest, Fc/v₀, is a negative damping while the joint moves only in presliding.

use super::boundary::boundary;
use super::diagnostic::short;
use super::gain_remedies;
use super::nudge::{Nudge, NudgedArm};
use super::variation::Variation;
use opspace_backend::CommandKind;
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::experiment::Experiment;
use std::fmt;

/// Excess below which the margin is reported: a slightly stiffer gear or a rounded gain would make the run unstable.
const LEAST_EXCESS: f64 = 0.05;

/// Largest excess that is examined: 2, that is, three times the nominal gains.
const MOST_EXCESS: f64 = 2.0;

/// Resolution of the bound.
const RESOLUTION: f64 = 1e-3;

/// Servo loops for which a gain margin is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServoLoop {
    /// The position loops of a position robot.
    Position,
    /// The velocity loops of a velocity robot.
    Velocity,
}

impl ServoLoop {
    /// Loops of a robot with the given command interface; `None` for torques.
    pub(super) fn of(command: CommandKind) -> Option<Self> {
        match command {
            CommandKind::Position => Some(Self::Position),
            CommandKind::Velocity => Some(Self::Velocity),
            CommandKind::Torque => None,
        }
    }

    /// Gain that is varied.
    pub(super) fn varied(self) -> Variation {
        match self {
            Self::Position => Variation::PositionGain,
            Self::Velocity => Variation::VelocityGain,
        }
    }

    /// Name of the loops in messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Position => "position loops",
            Self::Velocity => "velocity loops",
        }
    }
}

/// Largest excess of the position or velocity loop gains over their nominal values at which a task is stable.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct GainMargin {
    /// Loops to which the margin applies.
    pub servo_loop: ServoLoop,
    /// Largest relative increase of all these gains together, 0.05 = 5 %; `None` above three times the nominal gains.
    pub excess: Option<f64>,
    /// Joint that becomes unstable first, if any.
    pub joint: Option<String>,
    /// Name of the transformer.
    pub transformer: String,
}

/// Computes the gain margin in the initial tasks of an experiment: of the position loops of a position robot, or of
/// the velocity loops of a velocity robot. `None` if commands pass without a transformer.
#[must_use]
pub fn gain_margin(experiment: &Experiment) -> Option<GainMargin> {
    let servo_loop = ServoLoop::of(experiment.command_kind())?;
    let transformer = experiment.transformer_name()?;
    let nudged = NudgedArm::new(experiment, &transformer)?;
    let varied = |excess: f64| servo_loop.varied().of(nudged.nominal(), 1.0 + excess);
    let found = boundary(&nudged, MOST_EXCESS, RESOLUTION, 0.0, varied)?;
    let excess = found.as_ref().map(|found| found.last_stable);
    let joint = found.map(|found| experiment.robot().model.joints()[found.joint].name.clone());
    Some(GainMargin { servo_loop, excess, joint, transformer: transformer.to_string() })
}

/// True if an experiment is stable with this excess of its gains; `None` if it cannot be simulated.
fn is_stable(experiment: &Experiment, servo_loop: ServoLoop, least: f64) -> Option<bool> {
    let nudged = NudgedArm::new(experiment, &experiment.transformer_name()?)?;
    let varied = servo_loop.varied().of(nudged.nominal(), 1.0 + least)?;
    Some(matches!(nudged.nudge(&varied)?, Nudge::DiesOut))
}

/// Describes a margin, which may be below the resolution.
fn at_most(excess: f64, word: &str) -> String {
    if excess < RESOLUTION {
        format!("less than {} %", 100.0 * RESOLUTION)
    } else {
        format!("{word} {:.1} %", 100.0 * excess)
    }
}

/// Describes the delay of setpoints, as part of a sentence; empty without one.
fn delay_of_setpoints(experiment: &Experiment) -> String {
    let profile = experiment.profile().1;
    let cycles = f64::from(profile.delay()) / f64::from(profile.servo_ticks_per_cycle.get());
    if cycles == 0.0 {
        return String::new();
    }
    format!(
        " and a delay of {} interface cycles ({} ms)",
        short(cycles),
        short(1e3 * cycles * profile.period_s())
    )
}

impl fmt::Display for GainMargin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let loops = self.servo_loop.name();
        match (self.excess, &self.joint) {
            (Some(excess), Some(joint)) => {
                let most = at_most(excess, "up to");
                write!(
                    f,
                    "{loops} tolerate {most} more gain than nominal (joint '{joint}' becomes unstable first)"
                )?;
            }
            _ => write!(f, "{loops} tolerate at least {} times the nominal gain", 1.0 + MOST_EXCESS)?,
        }
        write!(f, ", with transformer '{}'", self.transformer)
    }
}

impl GainMargin {
    /// Returns a diagnostic if the margin is too small.
    #[must_use]
    pub fn finding(&self, experiment: &Experiment) -> Option<Finding> {
        // Gains with a narrower interval need no larger margin, which the damping that is left provides.
        let left = experiment.servo_damping().ok()?;
        let least = left.map_or(LEAST_EXCESS, |left| left.interval.half_width - RESOLUTION).min(LEAST_EXCESS);
        let excess = self.excess.filter(|excess| *excess < least)?;
        let joint = self.joint.as_ref()?;
        let delay = delay_of_setpoints(experiment);
        let message = if excess == 0.0 {
            format!(
                "the run is unstable with the nominal gains of the {}, with transformer '{}'{delay}: joint '{joint}' oscillates \
                 first",
                self.servo_loop.name(),
                self.transformer,
            )
        } else {
            format!(
                "{} tolerate {} more gain than nominal, with transformer '{}'{delay}: beyond that the run is unstable, joint \
                 '{joint}' first",
                self.servo_loop.name(),
                at_most(excess, "only"),
                self.transformer,
            )
        };
        let profile = experiment.profile().0;
        let helps = |changed: &Experiment| is_stable(changed, self.servo_loop, least).unwrap_or(false);
        let missing = LEAST_EXCESS - excess;
        let help = gain_remedies::help(experiment, &self.transformer, joint, missing, &helps);
        let help = if help.is_empty() {
            "no transformer, and no friction compensation or damping of this file, helps: other nominal gains do not change this \
             margin, but identified ones (`opspace identify`) may be relied on"
                .to_owned()
        } else {
            help
        };
        Some(
            Finding::new(Code::SmallGainMargin, &["profile", profile, "transformer"], message, help)
                .of_robot(),
        )
    }
}
