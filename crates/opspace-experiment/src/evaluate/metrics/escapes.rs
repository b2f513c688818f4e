//! Intervals in which tasks escape from singular poses, over a whole log.

use super::run_log::Run;
use crate::codes::Code;
use crate::finding::{Finding, Place};
use opspace_backend::signal_names::{self, ESCAPE};
use std::cmp::Ordering;
use std::collections::BTreeMap;

/// Longest interruption of an interval, s.
const MAX_GAP_S: f64 = 0.1;

/// Escapes of a run, while segments of its log arrive.
#[derive(Default)]
pub(super) struct Escapes {
    /// Begin and end of the present interval of each task, s on the robot's clock.
    open: BTreeMap<String, (f64, f64)>,
    start_s: f64,
    found: Vec<Finding>,
}

impl Escapes {
    pub(super) fn add(&mut self, run: &Run<'_>) {
        self.start_s = run.start_s;
        let tasks = run.experiment.task().tasks_of_the_run().into_iter();
        for (name, _) in tasks {
            let Some(signal) = run.tick.signal(&signal_names::of(name, ESCAPE)) else { continue };
            for (k, &time_s) in run.tick.time_s.iter().enumerate() {
                let acceleration = signal.row(k)[0];
                if acceleration.is_nan() || acceleration == 0.0 {
                    continue;
                }
                match self.open.get_mut(name) {
                    Some((_, end_s)) if time_s <= *end_s + MAX_GAP_S => *end_s = time_s,
                    _ => {
                        let before = self.open.insert(name.to_owned(), (time_s, time_s));
                        self.close(name, before);
                    }
                }
            }
        }
    }

    fn close(&mut self, task: &str, interval: Option<(f64, f64)>) {
        let Some((begin_s, end_s)) = interval else { return };
        let (begin_s, duration_s) = (begin_s - self.start_s, end_s - begin_s);
        let message = format!(
            "task '{task}': escaped from a singular pose, from {begin_s:.2} s on, for {duration_s:.2} s"
        );
        let escape = Finding::of(Code::EscapedSingularity, Place::Task(task.to_owned()), message);
        self.found.push(escape.with("begin_s", Some(begin_s)).with("duration_s", Some(duration_s)));
    }

    /// Returns the escapes in order of time.
    pub(super) fn finish(mut self) -> Vec<Finding> {
        for (task, interval) in std::mem::take(&mut self.open) {
            self.close(&task, Some(interval));
        }
        self.found
            .sort_by(|a, b| a.number("begin_s").partial_cmp(&b.number("begin_s")).unwrap_or(Ordering::Equal));
        self.found
    }
}
