//! The interface to a robot.

use crate::capabilities::Capabilities;
use crate::command::Command;
use crate::fault::DeviceFault;
use crate::ground_truth::GroundTruth;
use crate::sample::Sample;

/// Stop of a robot that another thread calls while [`Backend::read`] or [`Backend::write`] does not return.
pub type RemoteStop = Box<dyn FnMut() + Send>;

/// Interface to a simulated, recorded or real robot, called by the control loop.
///
/// Arrays are in the order of [`Capabilities::joints`]. Before the first command and after [`stop`](Self::stop), the
/// robot holds its position against gravity. The trait requires neither `Send` nor `'static`: a vendor's handle may
/// borrow data or be bound to one thread.
pub trait Backend {
    /// Properties of the robot and its interface. They are constant.
    fn capabilities(&self) -> &Capabilities;

    /// Waits for the next interface cycle and fills the sample. Missed cycles appear as a gap in [`Sample::time_s`].
    /// Each sample is returned only once. A robot that sends nothing is an error after a timeout of the driver's own, so
    /// that the robot's stop can be called.
    ///
    /// # Errors
    /// The fault because of which the robot cannot be read. The run ends.
    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault>;

    /// Sends a command to the robot. Called at most once per [`read`](Self::read).
    ///
    /// # Errors
    /// The fault because of which the robot did not accept the command. The run ends.
    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault>;

    /// Enters the safe state, in which the robot holds its position; a position-controlled robot keeps its last
    /// setpoint. Idempotent; may be called at any time, also before the first command, after a panic in another method,
    /// and once more after a panic in this one.
    fn stop(&mut self);

    /// Stop that another thread may call while this thread is blocked in a call of the driver; `None` by default. It
    /// brings the robot to rest as [`stop`](Self::stop) does, and makes the blocked call return an error. Called once,
    /// before the first cycle.
    fn remote_stop(&self) -> Option<RemoteStop> {
        None
    }

    /// Rows of the true state; `None` unless the robot is simulated. They are visited after each read, also after a
    /// failed one.
    fn ground_truth(&self) -> Option<&dyn GroundTruth> {
        None
    }
}
