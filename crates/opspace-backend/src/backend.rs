//! The contract with a robot.

use crate::capabilities::Capabilities;
use crate::command::Command;
use crate::fault::DeviceFault;
use crate::ground_truth::GroundTruth;
use crate::sample::Sample;

/// A robot, as seen by a control loop: a simulated one, a recorded one, or a real one.
///
/// Arrays are in the order of [`Capabilities::joints`]. Before the first command, and after [`stop`](Self::stop), the
/// robot holds itself, its weight included. It is neither `Send` nor `'static`: a vendor's handle may borrow, or belong
/// to one thread.
pub trait Backend {
    /// The properties of the robot and its interface. They do not change.
    fn capabilities(&self) -> &Capabilities;

    /// Waits for the next cycle and fills the sample. Missed cycles show as a gap in [`Sample::time_s`]. The same
    /// sample is never returned twice.
    ///
    /// # Errors
    /// The fault for which the robot can't be read. The run ends.
    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault>;

    /// Passes a command on. Called at most once per [`read`](Self::read).
    ///
    /// # Errors
    /// The fault for which the robot did not take it. The run ends.
    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault>;

    /// Enters the declared safe state, in which the robot holds itself; a position robot keeps its last setpoint.
    /// Idempotent, callable at any time, also before the first command.
    fn stop(&mut self);

    /// The rows of the true state, which only a simulation has. They are visited after each read, also when it failed.
    fn ground_truth(&self) -> Option<&dyn GroundTruth> {
        None
    }
}
