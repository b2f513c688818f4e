//! Curves of a log for the figures of the documentation.

use opspace::log::Recording;
use opspace::log::recording::ChannelData;
use std::error::Error;
use std::ops::Range;

/// Samples of an element of a signal in part of a log (s), every `step`th, relative to an origin and scaled; NaN where the signal
/// does not apply.
pub fn curve(
    channel: &ChannelData,
    (shown_s, step): (&Range<f64>, usize),
    (signal, element): (&str, usize),
    (origin, scale): (f64, f64),
) -> Result<Vec<(f64, f64)>, Box<dyn Error>> {
    let column = channel.signal(signal).ok_or(format!("no signal {signal}"))?;
    let shown = channel.time_s.iter().zip(column.rows()).filter(|(t, _)| shown_s.contains(t));
    Ok(shown.step_by(step).map(|(t, row)| (*t, scale * (row[element] - origin))).collect())
}

/// Returns the channel with a row per control cycle.
pub fn tick(recording: &Recording) -> Result<&ChannelData, Box<dyn Error>> {
    Ok(recording.tick()?)
}
