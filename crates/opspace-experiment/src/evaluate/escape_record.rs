//! Escapes of tasks from singular poses, as recorded in a log.

use serde::{Deserialize, Serialize};
use std::fmt;

/// An interval of a run in which a task escaped from a singular pose.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct EscapeRecord {
    /// Name of the task.
    pub task: String,
    /// Begin of the interval, s after the start of control.
    pub begin_s: f64,
    /// Duration, s.
    pub duration_s: f64,
}

impl fmt::Display for EscapeRecord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { task, begin_s, duration_s } = self;
        write!(
            f,
            "task '{task}': escaped from a singular pose, from {begin_s:.2} s on, for {duration_s:.2} s"
        )
    }
}
