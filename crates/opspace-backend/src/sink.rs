//! Receivers of the rows that a run produces.

/// Channel number of the control loop: one row per interface cycle.
pub const TICK: usize = 0;
/// Channel number of the wall-clock times of the control loop: one row per computed interface cycle.
pub const TIMING: usize = 1;
/// Channel number of the true state of a simulation: one row per interface cycle.
pub const TRUTH: usize = 2;
/// Channel number of the drives of a simulation: one row per servo tick.
pub const SERVO: usize = 3;
/// Channel number of the external forces in a simulation: one row per interface cycle.
pub const EXTERNAL: usize = 4;

/// A receiver of rows: a log, a live view, or a comparison. It moves to another thread with the run that owns it.
pub trait Sink: Send {
    /// Receives a row of a channel with its time on the robot's clock, s. Must not allocate, lock or format.
    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]);

    /// Called between two cycles. With a simulated robot the receiver may wait here.
    fn between_ticks(&mut self) {}
}

/// Sink that another part owns.
impl<S: Sink + ?Sized> Sink for &mut S {
    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        (**self).row(channel, time_s, row);
    }

    fn between_ticks(&mut self) {
        (**self).between_ticks();
    }
}

/// Sink that discards all rows.
impl Sink for () {
    fn row(&mut self, _channel: usize, _time_s: f64, _row: &[f64]) {}
}
