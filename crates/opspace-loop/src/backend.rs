//! What the control loop drives: any robot, seen as one that takes torques.

use crate::fault::Fault;
use crate::interface::Facts;
use crate::robot::{Trace, Traces};
use crate::sensing::Sensing;
use opspace_backend::Observable;
use opspace_model::{Data, Model};

/// A command for all n joints.
#[derive(Clone, Copy, Debug)]
pub enum Command<'a> {
    /// Joint torques, Nm (N): what the motors are to produce.
    Torque(&'a [f64]),
    /// Joint positions, rad (m): only a position robot takes them.
    Position(&'a [f64]),
}

/// A robot with its estimator and, where it needs one, its transformer. Read, observe, command: once a
/// tick, in that order.
pub trait Backend: Observable + Send {
    /// What the robot declares of itself.
    fn facts(&self) -> &Facts {
        self.sensing().facts()
    }

    /// Waits for the next interface tick and reads the robot.
    ///
    /// # Errors
    /// The fault that keeps the robot from being read.
    fn read(&mut self) -> Result<(), Fault>;

    /// The estimator and its measurement.
    fn sensing(&self) -> &Sensing;

    /// The same, to observe, tare and begin.
    fn sensing_mut(&mut self) -> &mut Sensing;

    /// Turns what was read into a measurement and brings `data` up to date with it. Allocates nothing.
    ///
    /// # Errors
    /// As [`Sensing::observe`].
    fn observe(&mut self, model: &Model, data: &mut Data) -> Result<(), Fault> {
        self.sensing_mut().observe(model, data)
    }

    /// Makes the robot do it. `data` is that of the last observation. Allocates nothing.
    ///
    /// # Errors
    /// A command that is not finite, that this robot doesn't take, or that it can't follow.
    fn command(&mut self, data: &Data, command: Command<'_>) -> Result<(), Fault>;

    /// Keeps the robot where it is while no controller commands it, from tick to tick: a position robot is told its last
    /// set-points again, a torque robot brakes.
    ///
    /// # Errors
    /// The fault for which the robot didn't take it.
    fn hold(&mut self) -> Result<(), Fault>;

    /// Brings the robot into its safe state: a position robot holds where it is, a torque robot brakes.
    fn stop(&mut self, data: &Data);

    /// What the robot knows beyond its interface ([`Robot::traces`](crate::robot::Robot::traces)).
    fn traces(&self) -> Option<Traces>;

    /// Visits the rows that came with the last read ([`Robot::visit_traces`](crate::robot::Robot::visit_traces)).
    fn visit_traces(&self, visit: &mut dyn FnMut(Trace<'_>));
}

/// The first joint whose command is not a finite number.
pub(crate) fn check_finite(command: &[f64]) -> Result<(), Fault> {
    match command.iter().position(|v| !v.is_finite()) {
        Some(joint) => Err(Fault::CommandNotFinite { joint }),
        None => Ok(()),
    }
}
