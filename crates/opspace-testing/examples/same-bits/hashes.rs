//! Hashes of all signals of a run.

use crate::entries::{Entry, Kind};
use opspace_log::{ChannelData, Recording};

/// Signals that contain wall-clock times, which are not results.
const WALL_CLOCK: [&str; 3] = ["tick_time", "sample_interval", "response_time"];

/// Name under which the time stamps of a channel are listed as a signal.
pub const TIME: &str = "(time)";

/// Returns an entry for each signal of a log: the number of rows and of elements, and the first 64 bits of the SHA-256 of all
/// numbers, row by row.
#[must_use]
pub fn of(recording: &Recording) -> Vec<Entry> {
    recording.channels.iter().flat_map(channel).collect()
}

fn channel(data: &ChannelData) -> Vec<Entry> {
    let entry = |signal: &str, elements: usize, hash: &str| {
        let (name, rows) = (format!("{}/{signal}", data.layout.channel), data.len());
        Entry::new(Kind::Signal, &name, &format!("{rows}x{elements} {hash}"))
    };
    let mut entries = vec![entry(TIME, 1, &of_numbers(&data.time_s))];
    for name in signals(data) {
        if let Some(column) = data.signal(name) {
            entries.push(entry(name, column.elements().len(), &of_numbers(column.rows().flatten())));
        }
    }
    entries
}

/// Names of the signals of a channel that are results.
pub fn signals(data: &ChannelData) -> impl Iterator<Item = &str> {
    data.layout.signals.iter().map(|signal| signal.name.as_str()).filter(|name| !WALL_CLOCK.contains(name))
}

/// Bits of a number; every NaN gives the same bits.
#[must_use]
pub fn bits(number: f64) -> u64 {
    if number.is_nan() { f64::NAN.to_bits() } else { number.to_bits() }
}

fn of_numbers<'a>(numbers: impl IntoIterator<Item = &'a f64>) -> String {
    let mut hasher = hmac_sha256::Hash::new();
    for number in numbers {
        hasher.update(bits(*number).to_le_bytes());
    }
    hasher.finalize().iter().take(8).map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::{TIME, of};
    use opspace_backend::{Layout, Signal};
    use opspace_log::{ChannelData, Recording};

    fn recording(rows: Vec<f64>) -> Recording {
        let signals = vec![Signal::new("q", "rad", &["a", "b"]), Signal::scalar("tick_time", "ns")];
        let layout = Layout { channel: "tick".to_owned(), signals };
        let data = ChannelData { layout, time_s: vec![0.0, 0.1], rows };
        Recording { channels: vec![data], ..Recording::default() }
    }

    fn flipped(number: f64, bit: u32) -> f64 {
        f64::from_bits(number.to_bits() ^ (1 << bit))
    }

    #[test]
    fn each_bit_changes_the_hash() {
        let rows = vec![0.5, -0.0, 7.0, 1.5, 2.5, 8.0];
        let whole = of(&recording(rows.clone()));
        let shapes: Vec<_> = whole.iter().map(|entry| entry.value.split(' ').next()).collect();
        assert_eq!(shapes, [Some("2x1"), Some("2x2")]);
        for place in [0, 1, 3, 4] {
            for bit in [0, 31, 51, 63] {
                let mut rows = rows.clone();
                rows[place] = flipped(rows[place], bit);
                let changed = of(&recording(rows));
                assert_eq!(changed[0], whole[0], "the times");
                assert_ne!(changed[1], whole[1], "bit {bit} of number {place}");
            }
        }
    }

    #[test]
    fn order_and_time_are_hashed_but_not_wall_clock() {
        let hash = |rows: [f64; 6]| of(&recording(rows.to_vec()));
        let first = hash([1.0, 2.0, 7.0, 3.0, 4.0, 8.0]);
        assert_ne!(first, hash([2.0, 1.0, 7.0, 3.0, 4.0, 8.0]));
        assert_eq!(first, hash([1.0, 2.0, 70.0, 3.0, 4.0, 80.0]));
        let mut later = recording(vec![1.0, 2.0, 7.0, 3.0, 4.0, 8.0]);
        later.channels[0].time_s[1] = flipped(0.1, 0);
        let later = of(&later);
        assert_eq!(
            (later[0].name == format!("tick/{TIME}"), later[0] == first[0], later[1] == first[1]),
            (true, false, true)
        );
    }

    #[test]
    fn all_nans_have_one_hash() {
        let other = f64::from_bits(f64::NAN.to_bits() ^ (1 << 63) ^ 5);
        let hash = |x: f64| of(&recording(vec![x, 2.0, 7.0, 3.0, 4.0, 8.0]));
        assert!(other.is_nan() && hash(other) == hash(f64::NAN) && hash(f64::NAN) != hash(0.0));
    }
}
