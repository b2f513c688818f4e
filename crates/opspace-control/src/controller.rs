//! The [`Controller`] trait and its input.

use crate::measurement::Measurement;
use crate::qp::quadratic_program::QpError;
use crate::targets::Targets;
use opspace_backend::{CommandKind, Observable};
use opspace_model::{Data, Model};

/// Input of a controller in one cycle.
#[derive(Clone, Copy, Debug)]
pub struct ControlInput<'a> {
    /// Kinematics and dynamics of the robot, n joints.
    pub model: &'a Model,
    /// Kinematics and dynamics at the measured state, computed by [`opspace_model::update`].
    pub data: &'a Data,
    /// Measured state of the robot.
    pub measurement: &'a Measurement,
    /// Feedforward torques that are added to the command, for example friction compensation (n; Nm or N). The torque
    /// limits apply to the sum.
    pub feedforward_torque: &'a [f64],
    /// Intervals of the torques that the drives add to the commanded ones, because a transformer leaves damping to the joints or
    /// takes too much of it away (n; Nm or N); empty if there are none. The limits hold with any torques within them.
    pub damping_torque: &'a [[f64; 2]],
    /// Streamed targets.
    pub targets: &'a Targets,
    /// Current time on the robot's clock, s. The time stamps of the targets use the same clock.
    pub clock_s: f64,
}

impl<'a> ControlInput<'a> {
    /// Returns the input at a measurement, whose time is that of the clock, for drives that add no torques. `feedforward_torque` is
    /// added to the command (n; Nm or N).
    #[must_use]
    pub fn new(
        model: &'a Model,
        data: &'a Data,
        measurement: &'a Measurement,
        feedforward_torque: &'a [f64],
        targets: &'a Targets,
    ) -> Self {
        let clock_s = measurement.time_s;
        Self { model, data, measurement, feedforward_torque, damping_torque: &[], targets, clock_s }
    }
}

/// A control law that computes commands from measurements, independently of the kind of robot.
pub trait Controller: Observable + Send {
    /// Kind of the commands that [`update`](Self::update) writes.
    fn command_kind(&self) -> CommandKind;

    /// Initialises the controller at the robot's present state: the references start there. May allocate.
    fn start(&mut self, input: &ControlInput<'_>);

    /// Computes the command of this cycle and writes it into `command` (n; unit of
    /// [`command_kind`](Self::command_kind)). Must not allocate, lock, log or format text.
    fn update(&mut self, input: &ControlInput<'_>, command: &mut [f64]);

    /// Writes the joint velocities that the references ask for, as of the last [`update`](Self::update), into `velocity` (n;
    /// rad/s or m/s). Returns false if they are unknown. Must not allocate.
    fn reference_velocity(&mut self, _input: &ControlInput<'_>, _velocity: &mut [f64]) -> bool {
        false
    }

    /// Joint accelerations that the last [`update`](Self::update) commands, if they are known.
    fn commanded_acceleration(&self) -> Option<CommandedAcceleration<'_>> {
        None
    }

    /// Processes a cycle in which the robot is held and the controller commands nothing. Must not allocate.
    fn observe_while_held(&mut self, _input: &ControlInput<'_>) {}

    /// Continues after a hold, with the robot at rest, without a jump in the command. The default implementation calls
    /// [`start`](Self::start); an implementation that overrides it must not allocate.
    fn resume(&mut self, input: &ControlInput<'_>) {
        self.start(input);
    }

    /// Returns the row of this controller's streamed targets, with all values "as configured".
    fn targets(&self) -> Targets {
        Targets::none()
    }

    /// Returns the error of a program of the limits in the last [`update`](Self::update) that no solver could correct:
    /// the command does not keep the limits.
    fn unsolved_limits(&self) -> Option<QpError> {
        None
    }

    /// Returns a stale streamed target whose task requires the robot to stop, if any.
    fn stale_target(&self) -> Option<StaleTarget> {
        None
    }
}

/// Joint accelerations that a command causes without external forces.
#[derive(Clone, Copy, Debug)]
pub struct CommandedAcceleration<'a> {
    /// Accelerations (n; rad/s² or m/s²).
    pub acceleration: &'a [f64],
    /// True if a limit changed the command.
    pub is_limited: bool,
}

/// A streamed target that was not renewed before its timeout.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct StaleTarget {
    /// Index of the task in the priority order, from 0.
    pub task: usize,
    /// Age of the target, s.
    pub age_s: f64,
}
