//! Recording of runs to MCAP files, and reading of these files.
//!
//! The control thread only pushes rows of numbers into a ring buffer; a separate thread writes them ([`record`]). A log
//! can be opened in Foxglove and PlotJuggler. [`Recording`] reads it back bit for bit, or its intact part if it is
//! damaged.
//!
//! ```
//! use opspace_backend::{Layout, Signal};
//! use opspace_log::{Attachment, Channel, Header, Pace, Recording, record};
//! use std::io::Cursor;
//!
//! // Write to memory; a `File` works too.
//! let layout = Layout {
//!     channel: "tick".to_owned(),
//!     signals: vec![Signal::new("q", "rad", &["shoulder", "elbow"]), Signal::scalar("hand.force", "N")],
//! };
//! let header = Header {
//!     attachments: vec![Attachment::new("task.toml", "application/toml", "seed = 1")],
//!     ..Header::default()
//! };
//! let channels = vec![Channel { layout, rate_hz: 1000.0 }];
//! let (mut recorder, writer) = record(Cursor::new(Vec::new()), header, channels, Pace::Simulated)?;
//! for k in 0..100 {
//!     let t = f64::from(k) * 1e-3;
//!     recorder.wait_for_space();
//!     recorder.push(0, t, &[t.sin(), t.cos(), 0.0]);
//! }
//! drop(recorder);
//! let (written, sink) = writer.finish()?;
//! assert_eq!((written.records, written.dropped), (100, 0));
//!
//! // Read.
//! let recording = Recording::from_bytes(sink.get_ref())?;
//! assert!(recording.damage.is_none());
//! assert_eq!(recording.attachments[0].data, b"seed = 1");
//! let tick = recording.channel("tick").expect("was recorded");
//! let q = tick.signal("q").expect("was recorded");
//! assert_eq!(q.elements(), ["shoulder", "elbow"]);
//! assert_eq!(q.row(10), [tick.time_s[10].sin(), tick.time_s[10].cos()]);
//! # Ok::<(), opspace_log::LogError>(())
//! ```

#![forbid(unsafe_code)]

mod bytes;
pub mod compare;
pub mod csv;
pub mod difference;
pub mod error;
mod fields;
mod file;
mod foxglove;
pub mod header;
pub mod inputs;
pub mod log_file;
pub mod outcome;
pub mod parts;
pub mod recorder;
pub mod recording;
mod records;
pub mod recover;
pub mod replay_backend;
mod schema;
pub mod segments;
mod viewer;
mod viewer_messages;
pub mod viewer_receiver;
mod walk;

pub use compare::{Comparer, Difference};
pub use csv::CsvWriter;
pub use difference::{ChannelComparison, LogComparison, MessageDifference, compare_logs};
pub use error::{Corruption, LogError};
pub use header::{
    Attachment, Channel, ForceArrow, GAPS, Header, LOG, ObjectShape, Scene, SceneCapsule, SceneObject,
    TIME_ZERO_NS, Wall,
};
pub use inputs::{LoggedInput, LoggedInputs};
pub use log_file::{ChannelContents, LogFile};
pub use mcap::MAGIC;
pub use outcome::{OutcomeRecord, ReplayedCommands};
pub use parts::PartDifference;
pub use recorder::{Pace, Recorder, WriteStats, Writer, record, record_with};
pub use recording::{ChannelData, Column, Recording};
pub use recover::{RECOVERED, Recovery, recover};
pub use replay_backend::{LoggedTargets, ReplayBackend};
pub use segments::SegmentRecorder;
pub use viewer_receiver::{ViewerReceiver, ViewerTopic};

/// Code examples of the README, compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
