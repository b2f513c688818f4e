//! The trait of everything that commands a robot, and its input.

use crate::measurement::Measurement;
use crate::targets::Targets;
use opspace_backend::{CommandKind, Observable};
use opspace_model::{Data, Model};

/// Input of a controller in one cycle.
#[derive(Clone, Copy, Debug)]
pub struct ControlInput<'a> {
    /// Kinematics and dynamics of the robot, n joints.
    pub model: &'a Model,
    /// Up to date with the measurement ([`opspace_model::update`]).
    pub data: &'a Data,
    /// State of the robot.
    pub measurement: &'a Measurement,
    /// Torques that will be added to the command, Nm or N (n): friction compensation. Torque limits hold for the sum.
    pub feedforward_torque: &'a [f64],
    /// Streamed targets.
    pub targets: &'a Targets,
    /// The robot's clock, s: the clock of the targets' time stamps.
    pub clock_s: f64,
}

/// Measurements in, commands out. Never knows which robot it drives.
pub trait Controller: Observable + Send {
    /// Kind of the commands that [`update`](Self::update) writes.
    fn command_kind(&self) -> CommandKind;

    /// Takes the robot's present state as the start: references begin here. May allocate.
    fn start(&mut self, input: &ControlInput<'_>);

    /// Computes the command of this cycle, into `command` (n). Allocates, locks, logs and formats nothing.
    fn update(&mut self, input: &ControlInput<'_>, command: &mut [f64]);

    /// Takes in a cycle in which it commands nothing, since the robot is held. Allocates nothing.
    fn observe_while_held(&mut self, _input: &ControlInput<'_>) {}

    /// Continues after the robot was held, at rest at its present position, without a jump and back to its tasks.
    /// Starts anew unless it is overridden; allocates nothing where it is.
    fn resume(&mut self, input: &ControlInput<'_>) {
        self.start(input);
    }

    /// Targets for this controller, all "as configured".
    fn targets(&self) -> Targets {
        Targets::none()
    }

    /// A streamed target that is stale and whose task asks for a stop.
    fn stale_target(&self) -> Option<StaleTarget> {
        None
    }
}

/// A streamed target that has not been renewed in time.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct StaleTarget {
    /// Place of the task in the priority, from 0.
    pub task: usize,
    /// Age of the target, s.
    pub age_s: f64,
}
