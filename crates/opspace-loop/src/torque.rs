//! The backend of torque robots: torques pass as they are.

use crate::backend::{Backend, Command, check_finite};
use crate::fault::Fault;
use crate::robot::{TorqueRobot, Trace, Traces};
use crate::sensing::Sensing;
use opspace_backend::{Observable, Row, Signal};
use opspace_model::Data;

/// A torque robot.
pub struct TorqueBackend<R> {
    robot: R,
    sensing: Sensing,
}

impl<R: TorqueRobot> TorqueBackend<R> {
    /// For a robot and its estimator.
    #[must_use]
    pub fn new(robot: R, sensing: Sensing) -> Self {
        Self { robot, sensing }
    }

    /// The robot itself.
    pub fn robot(&self) -> &R {
        &self.robot
    }
}

impl<R: TorqueRobot> Backend for TorqueBackend<R> {
    fn read(&mut self) -> Result<(), Fault> {
        self.robot.read(self.sensing.sample_mut())
    }

    fn sensing(&self) -> &Sensing {
        &self.sensing
    }

    fn sensing_mut(&mut self) -> &mut Sensing {
        &mut self.sensing
    }

    fn command(&mut self, _data: &Data, command: Command<'_>) -> Result<(), Fault> {
        match command {
            Command::Torque(tau) => {
                check_finite(tau)?;
                self.robot.set_torques(tau)
            }
            Command::Position(_) => Err(Fault::WrongCommand),
        }
    }

    fn hold(&mut self) -> Result<(), Fault> {
        self.robot.brake();
        Ok(())
    }

    fn stop(&mut self, _data: &Data) {
        self.robot.brake();
    }

    fn traces(&self) -> Option<Traces> {
        self.robot.traces()
    }

    fn visit_traces(&self, visit: &mut dyn FnMut(Trace<'_>)) {
        self.robot.visit_traces(visit);
    }
}

impl<R: TorqueRobot> Observable for TorqueBackend<R> {
    fn signals(&self) -> Vec<Signal> {
        Vec::new()
    }

    fn sample(&self, _row: &mut Row<'_>) {}
}
