//! Companion of a run: gets its messages for viewers, and is called between its cycles.

use opspace_log::ViewerReceiver;
use opspace_loop::Run;

/// Companion of a run, for example a live view that paces it.
pub trait Companion {
    /// Returns receivers of the messages for viewers and of the rows of the robot with that number, which the thread that writes its
    /// log calls.
    fn receivers(&mut self, robot: usize) -> Vec<Box<dyn ViewerReceiver>>;

    /// Called before each cycle, with the number of the robot and the time of the cycle since the first one (s). It may wait, and
    /// write the targets of the cycle; it returns false if there are no further cycles of any robot.
    fn before_cycle(&mut self, robot: usize, time_s: f64, run: &mut Run<'_>) -> bool;
}

/// No companion: the run has no receivers and does not wait.
impl Companion for () {
    fn receivers(&mut self, _robot: usize) -> Vec<Box<dyn ViewerReceiver>> {
        Vec::new()
    }

    fn before_cycle(&mut self, _robot: usize, _time_s: f64, _run: &mut Run<'_>) -> bool {
        true
    }
}

/// Several companions of one run. All are called before each cycle; the run has no further cycles if one says so.
impl Companion for Vec<Box<dyn Companion + '_>> {
    fn receivers(&mut self, robot: usize) -> Vec<Box<dyn ViewerReceiver>> {
        self.iter_mut().flat_map(|companion| companion.receivers(robot)).collect()
    }

    fn before_cycle(&mut self, robot: usize, time_s: f64, run: &mut Run<'_>) -> bool {
        let mut goes_on = true;
        for companion in self {
            goes_on &= companion.before_cycle(robot, time_s, run);
        }
        goes_on
    }
}
