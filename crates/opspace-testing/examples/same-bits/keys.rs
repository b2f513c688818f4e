//! Keys of a JSON file with their values.

use crate::entries::{Entry, Kind};
use crate::shipped::without_paths;
use serde_json::Value;

/// Keys that are not compared, with the reason.
const LEFT_OUT: [(&str, &str); 3] = [
    ("timing", "wall-clock times"),
    ("opspace_version", "version of the program"),
    ("suite_sha256", "hash of texts that contain paths"),
];

/// Returns an entry for each number, text and empty list of a JSON value; `name` is that of the value itself, and may be
/// empty.
///
/// Numbers are compared by their shortest decimal form, which differs if a bit differs.
#[must_use]
pub fn of(name: &str, value: &Value) -> Vec<Entry> {
    let mut entries = Vec::new();
    add(name, value, &mut entries);
    entries
}

fn add(name: &str, value: &Value, entries: &mut Vec<Entry>) {
    match value {
        Value::Object(keys) if !keys.is_empty() => {
            for (key, value) in keys.iter().filter(|(key, _)| LEFT_OUT.iter().all(|(left, _)| left != key)) {
                let dot = if name.is_empty() { "" } else { "." };
                add(&format!("{name}{dot}{key}"), value, entries);
            }
        }
        Value::Array(list) if !list.is_empty() => {
            for (place, value) in list.iter().enumerate() {
                add(&format!("{name}[{place}]"), value, entries);
            }
        }
        _ => entries.push(Entry::new(Kind::Key, name, &without_paths(&value.to_string()))),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test")]
mod tests {
    use super::of;

    fn entries(json: &str) -> Vec<(String, String)> {
        let entries = of("", &serde_json::from_str(json).unwrap());
        entries.into_iter().map(|entry| (entry.name, entry.value)).collect()
    }

    /// Compared: a file, and its keys and values one by one, without those that are left out.
    #[test]
    fn each_value_is_an_entry() {
        let json = r#"{ "a": 1, "b": { "c": [true, { "d": null }], "timing": { "x": 1 } }, "e": [], "f": {},
                        "opspace_version": "1", "g": "in tasks/x.toml" }"#;
        let expected = [
            ("a", "1"),
            ("b.c[0]", "true"),
            ("b.c[1].d", "null"),
            ("e", "[]"),
            ("f", "{}"),
            ("g", "\"in x.toml\""),
        ];
        assert_eq!(entries(json), expected.map(|(name, value)| (name.to_owned(), value.to_owned())));
    }

    /// Compared: numbers that differ in one bit.
    #[test]
    fn each_bit_of_a_number_changes_its_value() {
        let value = |number: f64| entries(&serde_json::to_string(&[number]).unwrap());
        for number in [0.0_f64, 0.1, 1.0, 1e300, 5e-324, -123.456] {
            for bit in [0, 1, 31, 51, 63] {
                let other = f64::from_bits(number.to_bits() ^ (1 << bit));
                assert_ne!(value(number), value(other), "bit {bit} of {number}");
            }
        }
        assert_ne!(entries("[1]"), entries("[1.0]"), "a count is no measured number");
    }
}
