//! First differences between two logs of the same run.

use crate::accepted::{Fate, Table};
use crate::entries::Kind;
use crate::hashes::{TIME, bits, signals};
use opspace_log::{ChannelData, Recording};

/// First difference of a signal.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Index of the row, from 0.
    pub row: usize,
    /// Time of the row, s.
    pub time_s: f64,
    /// Channel and signal with their names in the old build, and the element.
    pub name: String,
    /// Value in the old log.
    pub old: f64,
    /// Value in the new log.
    pub new: f64,
}

/// Returns the first difference of each signal that both logs contain, in order of time.
#[must_use]
pub fn differences(old: &Recording, new: &Recording, table: &Table) -> Vec<Difference> {
    let mut differences: Vec<Difference> =
        old.channels.iter().flat_map(|channel| channel_differences(channel, new, table)).collect();
    differences.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    differences
}

fn channel_differences(old: &ChannelData, new: &Recording, table: &Table) -> Vec<Difference> {
    let names = std::iter::once(TIME).chain(signals(old));
    names.filter_map(|name| signal_difference(old, name, new, table)).collect()
}

fn signal_difference(old: &ChannelData, signal: &str, new: &Recording, table: &Table) -> Option<Difference> {
    let name = format!("{}/{signal}", old.layout.channel);
    let Fate::Called(called) = table.fate(Kind::Signal, &name) else { return None };
    let (channel, new_signal) = called.split_once('/')?;
    let new = new.channel(channel)?;
    let (old_rows, new_rows) = (rows(old, signal)?, rows(new, new_signal)?);
    let differ = |(old, new): (&f64, &f64)| bits(*old) != bits(*new);
    for (row, (old_row, new_row)) in old_rows.iter().zip(&new_rows).enumerate() {
        if let Some(element) = old_row.iter().zip(*new_row).position(differ) {
            let (time_s, old_value) = (old.time_s[row], old_row[element]);
            let element_name = old.signal(signal).and_then(|s| s.elements().get(element));
            let name = element_name.map_or_else(|| name.clone(), |element| format!("{name}[{element}]"));
            return Some(Difference { row, time_s, name, old: old_value, new: new_row[element] });
        }
    }
    None
}

/// Rows of a signal; for the name [`TIME`], the time stamps.
fn rows<'a>(channel: &'a ChannelData, signal: &str) -> Option<Vec<&'a [f64]>> {
    if signal == TIME {
        return Some(channel.time_s.chunks_exact(1).collect());
    }
    Some(channel.signal(signal)?.rows().collect())
}

#[cfg(test)]
mod tests {
    use super::{Difference, differences};
    use crate::accepted::Table;
    use opspace_backend::{Layout, Signal};
    use opspace_log::{ChannelData, Recording};

    fn recording(name: &str, rows: [f64; 6]) -> Recording {
        let signals = vec![Signal::new(name, "rad", &["a", "b"])];
        let layout = Layout { channel: "tick".to_owned(), signals };
        let data = ChannelData { layout, time_s: vec![0.0, 0.1, 0.2], rows: rows.to_vec() };
        Recording { channels: vec![data], ..Recording::default() }
    }

    #[test]
    fn first_differing_row_and_element_are_located() {
        let old = recording("q", [1.0, 2.0, 3.0, 0.0, 5.0, 6.0]);
        let new = recording("p", [1.0, 2.0, 3.0, -0.0, 5.5, 6.0]);
        let table = Table::parse("signal tick/q -> tick/p # another name").unwrap_or_default();
        let name = "tick/q[b]".to_owned();
        let first = Difference { row: 1, time_s: 0.1, name, old: 0.0, new: -0.0 };
        assert_eq!(differences(&old, &new, &table), [first]);
        assert_eq!(differences(&old, &old, &Table::default()), []);
    }
}
