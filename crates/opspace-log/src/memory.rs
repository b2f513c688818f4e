//! Log in memory, for a run that needs no file.

use crate::header::{Channel, Header};
use crate::recording::{ChannelData, Recording};
use opspace_backend::Sink;

/// Largest number of rows for which memory is reserved; a longer run allocates more while it goes on.
const MAX_RESERVED_ROWS: f64 = 1e6;

/// Sink that keeps all rows in memory. Unlike a [`Recorder`](crate::Recorder) it allocates while rows arrive: it is for
/// simulations, not for a control thread.
///
/// ```
/// use opspace_backend::{Layout, Signal, Sink};
/// use opspace_log::{Channel, Header, MemoryRecorder};
///
/// let layout = Layout { channel: "tick".to_owned(), signals: vec![Signal::new("q", "rad", &["shoulder", "elbow"])] };
/// let mut log = MemoryRecorder::new(Header::default(), vec![Channel { layout, rate_hz: 1000.0 }], 1.0);
/// log.row(0, 0.001, &[0.1, 0.2]);
/// let recording = log.finish();
/// assert_eq!(recording.channel("tick").expect("was recorded").row(0), [0.1, 0.2]);
/// ```
#[derive(Clone, Debug)]
pub struct MemoryRecorder {
    recording: Recording,
}

impl MemoryRecorder {
    /// Creates a log with a header, and with memory for the rows of `duration_s` (s).
    #[must_use]
    pub fn new(header: Header, channels: Vec<Channel>, duration_s: f64) -> Self {
        let empty = |channel: Channel| {
            let rows = (channel.rate_hz * duration_s).clamp(0.0, MAX_RESERVED_ROWS) as usize;
            let values = rows * channel.layout.width();
            ChannelData {
                layout: channel.layout,
                time_s: Vec::with_capacity(rows),
                rows: Vec::with_capacity(values),
            }
        };
        let recording = Recording {
            channels: channels.into_iter().map(empty).collect(),
            attachments: header.attachments,
            metadata: header.metadata,
            ..Recording::default()
        };
        Self { recording }
    }

    /// Returns the rows.
    #[must_use]
    pub fn finish(self) -> Recording {
        self.recording
    }
}

impl Sink for MemoryRecorder {
    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        let data = &mut self.recording.channels[channel];
        data.time_s.push(time_s);
        data.rows.extend_from_slice(row);
    }
}
