//! Rows of a channel as text with comma-separated values.

use crate::recording::ChannelData;
use opspace_backend::Layout;
use std::io::{self, Write};

/// Text of a channel. The first line has the names of the columns: `time_s`, then a column for each element of each signal
/// with its unit at the end, as in keys of files: `torque_desired.elbow_nm`. Numbers are those of the log to the last
/// bit; NaN, of a signal that does not apply, is an empty field.
#[derive(Debug)]
pub struct CsvWriter<W: Write> {
    writer: csv::Writer<W>,
}

impl<W: Write> CsvWriter<W> {
    /// Writes the names of the columns.
    ///
    /// # Errors
    /// If the sink fails.
    pub fn new(layout: &Layout, sink: W) -> io::Result<Self> {
        let mut writer = csv::Writer::from_writer(sink);
        writer.write_record(columns(layout)).map_err(cause)?;
        Ok(Self { writer })
    }

    /// Writes rows of the channel.
    ///
    /// # Errors
    /// If the sink fails.
    pub fn write_rows(&mut self, channel: &ChannelData) -> io::Result<()> {
        for (k, time_s) in channel.time_s.iter().enumerate() {
            let text = |value: &f64| if value.is_nan() { String::new() } else { format!("{value:?}") };
            self.writer
                .write_record(std::iter::once(time_s).chain(channel.row(k)).map(text))
                .map_err(cause)?;
        }
        Ok(())
    }

    /// Passes everything to the sink.
    ///
    /// # Errors
    /// If the sink fails.
    pub fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }
}

/// Error of the sink, whose kind a caller needs to know a full disk.
fn cause(error: csv::Error) -> io::Error {
    match error.into_kind() {
        csv::ErrorKind::Io(error) => error,
        other => io::Error::other(format!("{other:?}")),
    }
}

/// Names of the columns.
fn columns(layout: &Layout) -> Vec<String> {
    let mut columns = vec!["time_s".to_owned()];
    for signal in &layout.signals {
        for (element, unit) in signal.elements.iter().zip(&signal.units) {
            let name = match signal.elements.as_slice() {
                [only] if only == "value" || only.contains(' ') => signal.name.clone(),
                _ => format!("{}.{element}", signal.name),
            };
            columns.push(name + &suffix(unit));
        }
    }
    columns
}

/// Unit at the end of a name: `_rad_per_s` for rad/s.
fn suffix(unit: &str) -> String {
    if unit == "1" {
        return String::new();
    }
    let plain = unit.to_lowercase().replace('²', "2").replace('/', "_per_");
    format!("_{}", plain.replace(|c: char| !c.is_ascii_alphanumeric() && c != '_', "_"))
}
