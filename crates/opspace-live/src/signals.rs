//! Signals of a robot as a JSON message: those that a page plots.

use opspace_backend::Layout;
use opspace_backend::signal_names::{EXTERNAL_CHANNEL, TICK_CHANNEL, TRUTH_CHANNEL};
use serde_json::{Map, Value};
use std::collections::BTreeSet;
use std::fmt::Write;

/// Signal of the channel of external forces that is shown: the force that acts.
const ACTING_FORCE: &str = "force";

/// Elements of rows that are shown, and their last values.
#[derive(Clone, Debug, Default)]
pub(crate) struct Signals {
    channels: Vec<ChannelSignals>,
}

/// Elements of a channel's rows that are shown.
#[derive(Clone, Debug)]
struct ChannelSignals {
    /// Index of the channel in the log.
    channel: usize,
    /// Name, unit and column of each element.
    elements: Vec<(String, String, usize)>,
    row: Vec<f64>,
}

impl Signals {
    /// Returns the signals of a log with these layouts.
    pub fn new(layouts: &[&Layout]) -> Self {
        let mut names = BTreeSet::new();
        let mut channels = Vec::new();
        for (channel, layout) in layouts.iter().enumerate() {
            let prefix = match layout.channel.as_str() {
                TICK_CHANNEL => "",
                TRUTH_CHANNEL => "truth.",
                EXTERNAL_CHANNEL => "external.",
                _ => continue,
            };
            let (mut elements, mut column) = (Vec::new(), 0);
            for signal in &layout.signals {
                for (element, unit) in signal.elements.iter().zip(&signal.units) {
                    let plain = match signal.elements.len() {
                        1 => signal.name.clone(),
                        _ => format!("{}.{element}", signal.name),
                    };
                    // A signal of the truth that the loop measures has a name of its own.
                    let is_own = layout.channel == EXTERNAL_CHANNEL || names.contains(&plain);
                    let name = if is_own { format!("{prefix}{plain}") } else { plain };
                    if layout.channel != EXTERNAL_CHANNEL || signal.name == ACTING_FORCE {
                        names.insert(name.clone());
                        elements.push((name, unit.clone(), column));
                    }
                    column += 1;
                }
            }
            channels.push(ChannelSignals { channel, elements, row: vec![f64::NAN; column] });
        }
        Self { channels }
    }

    /// Units of all signals, by name.
    pub fn units(&self) -> Map<String, Value> {
        let elements = self.channels.iter().flat_map(|shown| &shown.elements);
        elements.map(|(name, unit, _)| (name.clone(), Value::from(unit.as_str()))).collect()
    }

    /// Keeps a row of a channel of the log.
    pub fn row(&mut self, channel: usize, row: &[f64]) {
        if let Some(shown) = self.channels.iter_mut().find(|shown| shown.channel == channel)
            && shown.row.len() == row.len()
        {
            shown.row.copy_from_slice(row);
        }
    }

    /// Value of a signal in the last rows.
    pub fn value(&self, name: &str) -> Option<f64> {
        let elements =
            self.channels.iter().flat_map(|shown| shown.elements.iter().map(move |element| (shown, element)));
        elements
            .into_iter()
            .find(|(_, (own, ..))| own == name)
            .map(|(shown, (_, _, column))| shown.row[*column])
    }

    /// Writes all finite values of the last rows, at a time on the robot's clock (s).
    pub fn write(&self, time_s: f64, out: &mut String) {
        out.clear();
        // Writing to a string does not fail.
        let _ = write!(out, "{{\"time_s\":{time_s:.6},\"values\":{{");
        let mut comma = "";
        for shown in &self.channels {
            for (name, _, column) in &shown.elements {
                let value = shown.row[*column];
                if value.is_finite() {
                    let _ = write!(out, "{comma}{}:{value:.6e}", Value::from(name.as_str()));
                    comma = ",";
                }
            }
        }
        out.push_str("}}");
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use opspace_backend::Signal;

    /// Compared: values of rows, and those read from the message.
    #[test]
    fn finite_values_are_written() {
        let layout = |channel: &str, signals| Layout { channel: channel.to_owned(), signals };
        let tick = layout("tick", vec![Signal::new("q", "rad", &["a", "b\""]), Signal::scalar("phase", "1")]);
        let truth = layout("truth", vec![Signal::new("q", "rad", &["a", "b\""])]);
        let timing = layout("timing", vec![Signal::scalar("tick", "ns")]);
        let mut signals = Signals::new(&[&tick, &timing, &truth]);
        signals.row(0, &[0.5, f64::NAN, 2.0]);
        signals.row(1, &[7.0]);
        signals.row(2, &[-1e-9, f64::INFINITY]);
        let mut out = String::new();
        signals.write(1.25, &mut out);
        let read: Value = serde_json::from_str(&out).unwrap();
        assert_eq!(
            read,
            serde_json::json!({"time_s": 1.25, "values": {"q.a": 0.5, "phase": 2.0, "truth.q.a": -1e-9}})
        );
        assert_eq!(signals.units()["truth.q.b\""], "rad");
        assert_eq!(signals.value("phase"), Some(2.0));
    }
}
