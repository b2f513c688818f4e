//! Errors of a run.

use crate::codes::Code;
use crate::files::source::FileError;
use opspace_backend::DeviceFault;
use opspace_log::{LogError, OutcomeRecord};
use std::io;
use std::path::PathBuf;
use thiserror::Error;

/// Reason why an experiment cannot be run or its log cannot be read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum RunError {
    /// A mistake in a file.
    #[error(transparent)]
    File(#[from] FileError),
    /// The log cannot be read or written.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The log was not written by opspace, or its beginning is incomplete.
    #[error("this log lacks {what}, which is needed to reconstruct its run")]
    Incomplete {
        /// Description of the part that is missing or unreadable.
        what: String,
    },
    /// The log was written by an incompatible version of opspace.
    #[error(
        "this log was written by opspace {written}; read it with opspace {written}, this is opspace {own}"
    )]
    Version {
        /// Version of opspace that wrote the log.
        written: String,
        /// Version of this program.
        own: &'static str,
    },
    /// The joint positions of the real robot cannot be read before the run.
    #[error("the robot cannot be read: {fault}")]
    Unreadable {
        /// Fault reported by the robot.
        fault: DeviceFault,
    },
    /// A real robot that cannot be stopped after an error.
    #[error("the robot cannot be stopped: {fault}; before that: {before}")]
    NotStopped {
        /// Fault of the stop.
        fault: DeviceFault,
        /// Error because of which it was stopped.
        before: Box<RunError>,
    },
    /// A panic outside the control loop, while a real robot was open. The robot was stopped.
    #[error("{place} panicked; the message was printed to standard error, and the robot was stopped")]
    Panicked {
        /// Part of the program or the driver.
        place: &'static str,
    },
    /// A driver that failed after the run. The results of the run are complete.
    #[error("the run is complete, but the driver failed after it: {words}")]
    AfterRun {
        /// Cause, a sentence without a full stop.
        words: String,
    },
    /// A machine that does not allow the real-time scheduling that robot.toml requires.
    #[error(
        "[driver] states real_time = \"required\", but this machine does not allow it: {words}; `opspace doctor` names the commands \
         that mend it"
    )]
    NotRealTime {
        /// Scheduling that the machine allows, and the part that it does not.
        words: String,
    },
    /// The real robot is not at the start position of the task.
    #[error(
        "joint '{joint}' is at {q_rad:.3} rad (m), but the task starts at {start_rad:.3}; use --move-to-start to move the robot there slowly, or change start_rad [{}]",
        Code::AwayFromStart
    )]
    AwayFromStart {
        /// Name of the first joint, counted from the base, that is not at its start position.
        joint: String,
        /// Position of the joint, rad or m.
        q_rad: f64,
        /// `start_rad` of the task, rad or m.
        start_rad: f64,
    },
    /// The real robot is not at the start position of the task, although it was moved there.
    #[error(
        "joint '{joint}' is at {q_rad:.3} rad (m) after the motion to the start, which is at {start_rad:.3}: something holds or pulls \
         it, or the gains or zeros of the servos are wrong [{}]",
        Code::AwayFromStart
    )]
    StartNotReached {
        /// Name of the first joint, counted from the base, that is not at its start position.
        joint: String,
        /// Position of the joint, rad or m.
        q_rad: f64,
        /// `start_rad` of the task, rad or m.
        start_rad: f64,
    },
    /// A folder of results to which another process writes.
    #[error(
        "{}: another opspace is writing its results here; wait for it, or choose another folder with --out",
        path.display()
    )]
    Locked {
        /// Path of the folder.
        path: PathBuf,
    },
    /// A log that could not be written to its end: the run itself went on to its own.
    #[error("{source}")]
    LogCutShort {
        /// Outcome of the run.
        record: Box<OutcomeRecord>,
        /// Number of rows of the run, written or not.
        rows: u64,
        /// The cause.
        source: LogError,
    },
    /// A file that can't be written.
    #[error("{}: cannot be written: {source}", path.display())]
    Write {
        /// Path of the file or its folder.
        path: PathBuf,
        /// Cause of the failure.
        source: io::Error,
    },
}
