//! Protobuf form of a layout: message definition, and encoding and decoding of rows.
//!
//! A row of the channel `tick` is a message `opspace.Tick`: field 1 is `double t` (s), followed by one packed
//! `repeated double` per signal, in the layout's order. Values are stored bit for bit. Signal names that protobuf
//! doesn't allow, units and element names are stored as JSON in the channel's metadata.

use crate::foxglove::nested;
use opspace_backend::{Layout, Signal};
use prost::encoding::{WireType, decode_key, decode_varint, double, int32, string};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};

/// Key of the layout in a channel's metadata.
const LAYOUT: &str = "opspace.layout";

/// Number of elements of each signal of a layout.
pub(crate) fn widths(layout: &Layout) -> Vec<usize> {
    layout.signals.iter().map(Signal::len).collect()
}

/// Returns the name of a channel's message, and the serialized `FileDescriptorSet` that defines it.
pub(crate) fn definition(layout: &Layout) -> (String, Vec<u8>) {
    let message = pascal_case(&layout.channel);
    let mut set = Vec::new();
    nested(1, &mut set, |file| {
        string::encode(1, &format!("opspace/{message}.proto"), file);
        string::encode(2, &"opspace".to_owned(), file);
        nested(4, file, |definition| {
            string::encode(1, &message, definition);
            nested(2, definition, |field| define("t".to_owned(), 1, OPTIONAL, field));
            for (i, name) in field_names(layout).into_iter().enumerate() {
                nested(2, definition, |field| define(name, number(i), REPEATED, field));
            }
        });
        string::encode(12, &"proto3".to_owned(), file);
    });
    (format!("opspace.{message}"), set)
}

/// Label of a field with one value, in a `FieldDescriptorProto`.
const OPTIONAL: i32 = 1;

/// Label of a field with any number of values.
const REPEATED: i32 = 3;

/// Appends the `FieldDescriptorProto` of a field of doubles.
fn define(name: String, number: u32, label: i32, field: &mut Vec<u8>) {
    const DOUBLE: i32 = 1;
    string::encode(1, &name, field);
    int32::encode(3, &(number as i32), field);
    int32::encode(4, &label, field);
    int32::encode(5, &DOUBLE, field);
}

/// Field number of a signal; protobuf reserves 19000 to 19999.
fn number(signal: usize) -> u32 {
    let n = signal as u32 + 2;
    if n < 19_000 { n } else { n + 1_000 }
}

/// Field names: `hand.position` becomes `hand_position`. They are unique, also in lowerCamelCase (protobuf's JSON
/// names).
fn field_names(layout: &Layout) -> Vec<String> {
    let mut taken = BTreeSet::from(["t".to_owned()]);
    let unique = |signal: &Signal| {
        let plain = identifier(&signal.name);
        let mut name = plain.clone();
        let mut copy = 2;
        while !taken.insert(name.replace('_', "").to_lowercase()) {
            name = format!("{plain}_x{copy}");
            copy += 1;
        }
        name
    };
    layout.signals.iter().map(unique).collect()
}

fn identifier(name: &str) -> String {
    let plain: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if plain.starts_with(|c: char| c.is_ascii_alphabetic()) { plain } else { format!("s_{plain}") }
}

fn pascal_case(name: &str) -> String {
    let capital = |word: &str| {
        let (first, rest) = word.split_at(word.len().min(1));
        first.to_uppercase() + rest
    };
    identifier(name).split('_').map(capital).collect()
}

/// Metadata of a channel: its layout, so that it can be restored exactly.
pub(crate) fn channel_metadata(layout: &Layout) -> BTreeMap<String, String> {
    let fields = field_names(layout);
    let signal = |(s, field): (&Signal, String)| json!({ "name": s.name, "unit": s.unit(), "field": field, "elements": s.elements });
    let signals: Vec<Value> = layout.signals.iter().zip(fields).map(signal).collect();
    let text = json!({ "channel": layout.channel, "signals": signals }).to_string();
    BTreeMap::from([(LAYOUT.to_owned(), text)])
}

/// Returns the layout of a channel with that metadata; `None` if opspace didn't write the channel.
pub(crate) fn layout(metadata: &BTreeMap<String, String>) -> Option<Result<Layout, String>> {
    let text = metadata.get(LAYOUT)?;
    let read = || {
        let value: Value = serde_json::from_str(text).ok()?;
        let signals = value["signals"].as_array()?.iter().map(signal).collect::<Option<_>>()?;
        Some(Layout { channel: value["channel"].as_str()?.to_owned(), signals })
    };
    Some(read().ok_or_else(|| format!("the layout of a channel cannot be parsed: {text}")))
}

fn signal(value: &Value) -> Option<Signal> {
    let elements = value["elements"].as_array()?.iter().map(Value::as_str).collect::<Option<Vec<_>>>()?;
    Some(Signal::new(value["name"].as_str()?, value["unit"].as_str()?, &elements))
}

/// Appends the message of a row to `out`.
pub(crate) fn encode(widths: &[usize], time_s: f64, mut row: &[f64], out: &mut Vec<u8>) {
    double::encode(1, &time_s, out);
    for (i, &width) in widths.iter().enumerate() {
        let (values, rest) = row.split_at(width);
        double::encode_packed(number(i), values, out);
        row = rest;
    }
}

/// Appends the row of a message to `rows` and returns its time (s). Returns `None` and appends nothing if the message
/// differs from the form that [`encode`] writes.
pub(crate) fn decode(widths: &[usize], message: &[u8], rows: &mut Vec<f64>) -> Option<f64> {
    let before = rows.len();
    let time_s = decode_into(widths, message, rows);
    if time_s.is_none() {
        rows.truncate(before);
    }
    time_s
}

fn decode_into(widths: &[usize], mut message: &[u8], rows: &mut Vec<f64>) -> Option<f64> {
    let at = &mut message;
    if decode_key(at).ok()? != (1, WireType::SixtyFourBit) {
        return None;
    }
    let (time, rest) = at.split_first_chunk()?;
    *at = rest;
    // Empty packed fields are not written.
    for (i, &width) in widths.iter().enumerate().filter(|&(_, &width)| width > 0) {
        if decode_key(at).ok()? != (number(i), WireType::LengthDelimited) {
            return None;
        }
        let bytes = width * size_of::<f64>();
        if decode_varint(at).ok()? != bytes as u64 {
            return None;
        }
        let (values, rest) = at.split_at_checked(bytes)?;
        rows.extend(values.as_chunks().0.iter().map(|&b| f64::from_le_bytes(b)));
        *at = rest;
    }
    at.is_empty().then(|| f64::from_le_bytes(*time))
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use prost::Message;
    use prost_types::field_descriptor_proto::{Label, Type};
    use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet};

    fn awkward() -> Layout {
        let names = ["hand.position", "hand_position", "handPosition", "t", "τ", "2nd", ""];
        Layout {
            channel: "servo.left-arm".to_owned(),
            signals: names.iter().map(|&n| Signal::new(n, "m,rad", &["x", "y"])).collect(),
        }
    }

    /// Checks the field names against protobuf's rules: identifiers, unique also as lowerCamelCase.
    #[test]
    fn signals_get_legal_unique_field_names() {
        let (message, bytes) = definition(&awkward());
        assert_eq!(message, "opspace.ServoLeftArm");
        let set = FileDescriptorSet::decode(bytes.as_slice()).unwrap();
        let fields = &set.file[0].message_type[0].field;
        assert_eq!(fields.len(), 1 + awkward().signals.len());
        let mut json = BTreeSet::new();
        for field in fields {
            let name = field.name();
            assert!(name.starts_with(|c: char| c.is_ascii_alphabetic()), "{name}");
            assert!(name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_'), "{name}");
            assert!(json.insert(name.replace('_', "").to_lowercase()), "{name} twice");
        }
        assert_eq!(fields[1].name(), "hand_position");
    }

    /// Compares the definition with one made by prost's descriptor types from the same names, byte for byte.
    #[test]
    fn the_definition_is_a_file_descriptor_set() {
        let field = |(i, name): (usize, String)| FieldDescriptorProto {
            name: Some(name),
            number: Some(i as i32 + 1),
            label: Some(if i == 0 { Label::Optional } else { Label::Repeated } as i32),
            r#type: Some(Type::Double as i32),
            ..FieldDescriptorProto::default()
        };
        let names = std::iter::once("t".to_owned()).chain(field_names(&awkward()));
        let message = DescriptorProto {
            name: Some("ServoLeftArm".to_owned()),
            field: names.enumerate().map(field).collect(),
            ..DescriptorProto::default()
        };
        let file = FileDescriptorProto {
            name: Some("opspace/ServoLeftArm.proto".to_owned()),
            package: Some("opspace".to_owned()),
            message_type: vec![message],
            syntax: Some("proto3".to_owned()),
            ..FileDescriptorProto::default()
        };
        let set = FileDescriptorSet { file: vec![file] };
        assert_eq!(definition(&awkward()).1, set.encode_to_vec());
    }

    /// Compares a layout before and after conversion to metadata.
    #[test]
    fn layout_round_trips_through_metadata() {
        assert_eq!(layout(&channel_metadata(&awkward())).unwrap().unwrap(), awkward());
        assert!(layout(&BTreeMap::new()).is_none());
        let broken = BTreeMap::from([(LAYOUT.to_owned(), "{\"channel\": 1}".to_owned())]);
        assert!(layout(&broken).unwrap().is_err());
    }

    /// Compares the units in the metadata with expected texts: one unit if all elements share it, otherwise one per
    /// element; and the layout before and after.
    #[test]
    fn metadata_has_the_unit_of_each_element() {
        let arm = Layout {
            channel: "tick".to_owned(),
            signals: vec![
                Signal::new("q", &["rad"; 3], &["a", "b", "c"]),
                Signal::new("dq", &["rad/s", "m/s", "rad/s"], &["a", "b", "c"]),
                Signal::new("hand.force", "N,Nm", &["fx", "fy", "fz", "mx", "my", "mz"]),
            ],
        };
        let metadata = channel_metadata(&arm);
        let value: Value = serde_json::from_str(&metadata[LAYOUT]).unwrap();
        let units = [0, 1, 2].map(|i| value["signals"][i]["unit"].as_str().unwrap().to_owned());
        assert_eq!(units, ["rad", "rad/s,m/s,rad/s", "N,Nm"]);
        assert_eq!(layout(&metadata).unwrap().unwrap(), arm);
    }

    /// Checks that a message with missing or additional data, or of another layout, is rejected and appends nothing.
    #[test]
    fn message_of_another_layout_is_refused() {
        let mut message = Vec::new();
        encode(&[2, 0, 1], 0.5, &[1.0, 2.0, 3.0], &mut message);
        let mut rows = vec![9.0];
        assert_eq!(decode(&[2, 0, 1], &message, &mut rows), Some(0.5));
        assert_eq!(rows, [9.0, 1.0, 2.0, 3.0]);
        for widths in [&[2_usize, 0][..], &[1, 0, 2], &[2, 1, 1], &[2, 0, 1, 1], &[2, 0, 2]] {
            assert_eq!(decode(widths, &message, &mut rows), None, "{widths:?}");
        }
        for cut in 0..message.len() {
            assert_eq!(decode(&[2, 0, 1], &message[..cut], &mut rows), None, "{cut} bytes");
        }
        assert_eq!(rows.len(), 4);
    }
}
