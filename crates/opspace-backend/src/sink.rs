//! Destinations of the rows that a run produces.

/// Channel number of the rows of the control loop: one per interface cycle.
pub const TICK: usize = 0;
/// Channel number of the true state of a simulation: one per interface cycle.
pub const TRUTH: usize = 1;
/// Channel number of the drives of a simulation: one per servo tick.
pub const SERVO: usize = 2;
/// Channel number of the external forces put into a simulation: one per interface cycle.
pub const EXTERNAL: usize = 3;

/// A receiver of rows: a log, a live view, or a comparison.
pub trait Sink {
    /// Takes a row of a channel at `time_s` (s, the robot's clock). Must not allocate, lock or format.
    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]);

    /// Called between two cycles, when a simulated robot may wait.
    fn between_ticks(&mut self) {}
}

/// Discards the rows.
impl Sink for () {
    fn row(&mut self, _channel: usize, _time_s: f64, _row: &[f64]) {}
}
