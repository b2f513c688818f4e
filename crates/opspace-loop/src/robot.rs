//! The two kinds of robot, as their interfaces are: a position robot and a torque robot.
//!
//! An adapter implements one of them for a simulated robot, a log, or a real arm.

use crate::fault::Fault;
use crate::interface::Facts;
use opspace_backend::Layout;
use opspace_backend::Sample;

/// What both kinds of robot have in common: they say what they are, and are read once every period.
pub trait Robot: Send {
    /// What the robot declares of itself.
    fn facts(&self) -> &Facts;

    /// Waits for the next interface tick and reads the robot into `sample`. A robot of which cycles are missed comes back
    /// later, its clock so much further on, and has meanwhile held what it was given last.
    ///
    /// # Errors
    /// The fault that keeps the robot from being read.
    fn read(&mut self, sample: &mut Sample) -> Result<(), Fault>;

    /// What this robot knows beyond its interface, as a simulation does: the layouts of its
    /// [`Trace::Truth`] and [`Trace::Servo`] rows.
    fn traces(&self) -> Option<Traces> {
        None
    }

    /// Visits the rows that came with the last [`read`](Self::read), those of missed cycles as well, in the order of time.
    fn visit_traces(&self, _visit: &mut dyn FnMut(Trace<'_>)) {}
}

/// The layouts of what a simulated robot tells beyond its interface.
#[derive(Clone, Debug)]
pub struct Traces {
    /// The true state at each interface tick.
    pub truth: Layout,
    /// The drives at each servo tick.
    pub servo: Layout,
}

/// A row of what a simulated robot tells beyond its interface.
#[derive(Clone, Copy, Debug)]
pub enum Trace<'a> {
    /// The true state at an interface tick.
    Truth {
        /// The robot's clock, s.
        time_s: f64,
        /// In the order of [`Traces::truth`].
        row: &'a [f64],
    },
    /// One servo period.
    Servo {
        /// The robot's clock at its beginning, s.
        time_s: f64,
        /// Which command was in force: 0 is the robot's own hold before the first, 1 the first.
        command: u64,
        /// In the order of [`Traces::servo`].
        row: &'a [f64],
    },
}

/// A robot that takes joint positions.
pub trait PositionRobot: Robot {
    /// Gives the set-points (rad, m) that hold until the next call: absolute, never increments.
    ///
    /// # Errors
    /// The fault for which the robot didn't take them.
    fn set_positions(&mut self, q_desired: &[f64]) -> Result<(), Fault>;
}

/// A robot that takes joint torques.
pub trait TorqueRobot: Robot {
    /// Gives the torques (Nm, N) that hold until the next call.
    ///
    /// # Errors
    /// The fault for which the robot didn't take them.
    fn set_torques(&mut self, tau: &[f64]) -> Result<(), Fault>;

    /// Stops the joints and holds them without torque commands: this robot's safe state. May be told again; the next torques
    /// end it.
    fn brake(&mut self);
}
