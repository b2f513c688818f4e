//! Segments of a log, so that a long one needs no more memory than a short one.

use crate::recording::{ChannelData, Recording};
use opspace_backend::signal_names::TICK_CHANNEL;
use opspace_backend::{Layout, Sink};

/// Number of values at which a segment ends, unless another one is chosen: 32 MiB.
pub(crate) const SEGMENT_VALUES: usize = 4 << 20;

/// Number of rows at the end of a segment that are left for the next one: rows of the same time, of other channels, may
/// still follow.
const LEFT_ROWS: usize = 16;

/// True if a segment has `values` values, and enough control cycles to be cut between two of them.
pub(crate) fn is_full(segment: &Recording, values: usize) -> bool {
    let held = segment.channels.iter().map(|channel| channel.rows.len()).sum::<usize>();
    // A log without control cycles is cut all the same.
    held >= values && (held >= 4 * values.max(SEGMENT_VALUES) || ticks_to_cut(segment).is_some())
}

fn ticks_to_cut(segment: &Recording) -> Option<&ChannelData> {
    segment.channel(TICK_CHANNEL).filter(|tick| tick.len() > 2 * LEFT_ROWS)
}

/// Passes a full segment to `receive`, except for its last rows, which remain. The cut lies between two cycles of
/// control, so that rows of one cycle stay together.
pub(crate) fn cut(segment: &mut Recording, receive: &mut dyn FnMut(&Recording, bool)) {
    let at_s = cut_time_s(segment);
    let rest: Vec<ChannelData> = segment.channels.iter_mut().map(|channel| split(channel, at_s)).collect();
    receive(segment, false);
    for (channel, rest) in segment.channels.iter_mut().zip(rest) {
        channel.time_s.clear();
        channel.rows.clear();
        channel.time_s.extend(rest.time_s);
        channel.rows.extend(rest.rows);
    }
}

/// Time at which a segment is cut, s. Without control cycles the channel with the most rows decides.
fn cut_time_s(segment: &Recording) -> f64 {
    let channel =
        ticks_to_cut(segment).or_else(|| segment.channels.iter().max_by_key(|channel| channel.len()));
    let times = channel.map_or(&[][..], |channel| &channel.time_s);
    let place = times.len().saturating_sub(LEFT_ROWS);
    match times.get(place.wrapping_sub(1)).zip(times.get(place)) {
        Some((before, after)) if before < after => 0.5 * (before + after),
        // Times that do not increase: nothing remains.
        _ => f64::INFINITY,
    }
}

/// Removes the rows of a channel from a time on, and returns them.
fn split(channel: &mut ChannelData, at_s: f64) -> ChannelData {
    let place = channel.time_s.partition_point(|time_s| *time_s < at_s);
    let width = channel.layout.width();
    ChannelData {
        layout: channel.layout.clone(),
        time_s: channel.time_s.split_off(place),
        rows: channel.rows.split_off(place * width),
    }
}

/// Sink that passes the rows of a run on in segments, for a simulation that needs no log. Unlike a
/// [`Recorder`](crate::Recorder) it allocates while rows arrive: it is not for a control thread.
///
/// ```
/// use opspace_backend::{Layout, Signal, Sink};
/// use opspace_log::SegmentRecorder;
///
/// let layout = Layout { channel: "tick".to_owned(), signals: vec![Signal::new("q", "rad", &["shoulder", "elbow"])] };
/// let mut rows = 0;
/// let mut log = SegmentRecorder::new(vec![layout], |segment, _last| rows += segment.channels[0].len());
/// log.row(0, 0.001, &[0.1, 0.2]);
/// log.finish();
/// assert_eq!(rows, 1);
/// ```
#[derive(Clone, Debug)]
pub struct SegmentRecorder<F> {
    segment: Recording,
    values: usize,
    receive: F,
}

impl<F: FnMut(&Recording, bool)> SegmentRecorder<F> {
    /// Creates a sink of rows with these layouts. `receive` gets the segments in order, with true for the last one.
    pub fn new(layouts: Vec<Layout>, receive: F) -> Self {
        let empty = |layout| ChannelData { layout, time_s: Vec::new(), rows: Vec::new() };
        let segment =
            Recording { channels: layouts.into_iter().map(empty).collect(), ..Recording::default() };
        Self { segment, values: SEGMENT_VALUES, receive }
    }

    /// Sets the number of values (8 bytes each) after which a segment ends.
    #[must_use]
    pub fn segment_values(self, values: usize) -> Self {
        Self { values, ..self }
    }

    /// Passes the last segment on.
    pub fn finish(mut self) {
        (self.receive)(&self.segment, true);
    }
}

impl<F: FnMut(&Recording, bool) + Send> Sink for SegmentRecorder<F> {
    fn row(&mut self, channel: usize, time_s: f64, row: &[f64]) {
        if is_full(&self.segment, self.values) {
            cut(&mut self.segment, &mut self.receive);
        }
        let data = &mut self.segment.channels[channel];
        data.time_s.push(time_s);
        data.rows.extend_from_slice(row);
    }
}
