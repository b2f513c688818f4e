//! Runs in simulation whose rows are passed on in segments, without a log.

use crate::run::error::RunError;
use crate::run::execute::Progress;
use crate::run::scenario::Scenario;
use opspace_backend::Sink;
use opspace_log::{OutcomeRecord, Recording, SegmentRecorder};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// Sink that counts the cycles.
struct Counted<S> {
    log: S,
    ticks: u64,
    began: Instant,
}

impl<S: Sink> Sink for Counted<S> {
    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        self.log.row(channel, time_s, row);
    }

    fn between_ticks(&mut self) {
        self.ticks += 1;
    }
}

impl Scenario {
    /// Runs the scenario in simulation and passes the rows of each robot to `receive` in segments, in order, with the number
    /// of the robot, and with true for its last segment. They are those that [`Experiment::run`](crate::Experiment::run) writes
    /// to the log of a robot, bit for bit, except for computing times. Returns of each robot the outcome, and the ratio of
    /// robot time to wall-clock time.
    ///
    /// # Errors
    /// A robot that cannot be simulated.
    pub fn run_in_segments(
        &self,
        progress: &Progress,
        receive: impl FnMut(usize, &Recording, bool) + Send,
    ) -> Result<Vec<(OutcomeRecord, f64)>, RunError> {
        let receive = Mutex::new(receive);
        let driven = self.drive(progress, |number, capabilities, truth| {
            let (control, layouts) = self.members[number].experiment.loop_and_layouts(capabilities, truth)?;
            let receive = &receive;
            let pass = move |segment: &Recording, is_last| {
                (receive.lock().unwrap_or_else(PoisonError::into_inner))(number, segment, is_last);
            };
            let log = SegmentRecorder::new(layouts, pass);
            Ok((control, Counted { log, ticks: 0, began: Instant::now() }))
        })?;
        let results = self.experiments().zip(driven).map(|(experiment, (sink, outcome))| {
            let robot_s = sink.ticks as f64 * experiment.profile().1.period_s();
            sink.log.finish();
            (experiment.outcome_record(&outcome), robot_s / sink.began.elapsed().as_secs_f64())
        });
        Ok(results.collect())
    }
}
