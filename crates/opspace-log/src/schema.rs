//! Protobuf form of a layout: message definition, and encoding and decoding of rows.
//!
//! A row of the channel `tick` is a message `opspace.Tick`: field 1 is `double t` (s), followed by one field per signal, in
//! the layout's order. A signal with named elements is a message with one number per element, so that a viewer shows
//! `torque_desired.shoulder`; a scalar signal is a number. NaN, which means that a signal does not apply, is absent.
//! Values are stored bit for bit. Signal names that protobuf doesn't allow, units and element names are stored as JSON
//! in the channel's metadata.

use opspace_backend::{Layout, Signal};
use prost::Message;
use prost::encoding::{WireType, decode_key, decode_varint, double, encode_key, encode_varint, key_len};
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, OneofDescriptorProto,
};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};

/// Key of the layout in a channel's metadata.
const LAYOUT: &str = "opspace.layout";

/// Form of a signal in a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shape {
    /// Number.
    Scalar,
    /// Message with one number for each of that many elements.
    Named(usize),
    /// Packed list of that many numbers: the form of logs before version 0.2.
    Packed(usize),
}

impl Shape {
    fn of(signal: &Signal) -> Self {
        match signal.elements.as_slice() {
            // A label with spaces explains the number, and names no element.
            [only] if only == "value" || only.contains(' ') => Self::Scalar,
            elements => Self::Named(elements.len()),
        }
    }

    fn len(self) -> usize {
        match self {
            Self::Scalar => 1,
            Self::Named(len) | Self::Packed(len) => len,
        }
    }
}

/// Forms of the signals of a layout, in a log that is written.
pub(crate) fn shapes(layout: &Layout) -> Vec<Shape> {
    layout.signals.iter().map(Shape::of).collect()
}

/// Returns the name of a channel's message, and the serialized `FileDescriptorSet` that defines it.
pub(crate) fn definition(layout: &Layout) -> (String, Vec<u8>) {
    let name = pascal_case(&layout.channel);
    let mut message = DescriptorProto { name: Some(name.clone()), ..DescriptorProto::default() };
    message
        .field
        .push(FieldDescriptorProto { label: Some(Label::Optional as i32), ..field("t", 1, Type::Double) });
    for (i, (signal, plain)) in layout.signals.iter().zip(field_names(layout)).enumerate() {
        match Shape::of(signal) {
            Shape::Scalar => push_optional(&mut message, &plain, number(i)),
            Shape::Named(_) | Shape::Packed(_) => {
                let of_elements = format!("{}Values", pascal_case(&plain));
                let mut values =
                    DescriptorProto { name: Some(of_elements.clone()), ..DescriptorProto::default() };
                for (k, element) in element_names(signal).iter().enumerate() {
                    push_optional(&mut values, element, element_number(k));
                }
                message.nested_type.push(values);
                message.field.push(FieldDescriptorProto {
                    label: Some(Label::Optional as i32),
                    type_name: Some(format!(".opspace.{name}.{of_elements}")),
                    ..field(&plain, number(i), Type::Message)
                });
            }
        }
    }
    let file = FileDescriptorProto {
        name: Some(format!("opspace/{name}.proto")),
        package: Some("opspace".to_owned()),
        message_type: vec![message],
        syntax: Some("proto3".to_owned()),
        ..FileDescriptorProto::default()
    };
    (format!("opspace.{name}"), FileDescriptorSet { file: vec![file] }.encode_to_vec())
}

fn field(name: &str, number: u32, kind: Type) -> FieldDescriptorProto {
    FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number as i32),
        r#type: Some(kind as i32),
        ..FieldDescriptorProto::default()
    }
}

/// Adds an `optional double`. Proto3 represents that it can be absent by a `oneof` with this field alone.
fn push_optional(message: &mut DescriptorProto, name: &str, number: u32) {
    message.field.push(FieldDescriptorProto {
        label: Some(Label::Optional as i32),
        oneof_index: Some(message.oneof_decl.len() as i32),
        proto3_optional: Some(true),
        ..field(name, number, Type::Double)
    });
    let alone = OneofDescriptorProto { name: Some(format!("_{name}")), ..OneofDescriptorProto::default() };
    message.oneof_decl.push(alone);
}

/// Field number of a signal; protobuf reserves 19000 to 19999.
fn number(signal: usize) -> u32 {
    unreserved(signal as u32 + 2)
}

/// Field number of an element within its signal.
fn element_number(element: usize) -> u32 {
    unreserved(element as u32 + 1)
}

fn unreserved(n: u32) -> u32 {
    if n < 19_000 { n } else { n + 1_000 }
}

/// Field names: `hand.position` becomes `hand_position`. They are unique, also in lowerCamelCase (protobuf's JSON
/// names).
fn field_names(layout: &Layout) -> Vec<String> {
    unique_identifiers(layout.signals.iter().map(|signal| signal.name.as_str()), &["t"])
}

/// Field names of the elements of a signal.
fn element_names(signal: &Signal) -> Vec<String> {
    unique_identifiers(signal.elements.iter().map(String::as_str), &[])
}

fn unique_identifiers<'n>(names: impl Iterator<Item = &'n str>, taken: &[&str]) -> Vec<String> {
    let mut taken: BTreeSet<String> = taken.iter().map(|&name| name.to_owned()).collect();
    let unique = |name: &str| {
        let plain = identifier(name);
        let mut name = plain.clone();
        let mut copy = 2;
        while !taken.insert(name.replace('_', "").to_lowercase()) {
            name = format!("{plain}_x{copy}");
            copy += 1;
        }
        name
    };
    names.map(unique).collect()
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

/// Metadata of a channel: its layout, so that it can be restored exactly, and the fields of its signals and elements.
pub(crate) fn channel_metadata(layout: &Layout) -> BTreeMap<String, String> {
    let fields = field_names(layout);
    let signal = |(s, field): (&Signal, String)| {
        let mut value = json!({ "name": s.name, "unit": s.unit(), "field": field, "elements": s.elements });
        value["fields"] = match Shape::of(s) {
            Shape::Scalar => Value::Null,
            Shape::Named(_) | Shape::Packed(_) => json!(element_names(s)),
        };
        value
    };
    let signals: Vec<Value> = layout.signals.iter().zip(fields).map(signal).collect();
    let text = json!({ "channel": layout.channel, "signals": signals }).to_string();
    BTreeMap::from([(LAYOUT.to_owned(), text)])
}

/// Returns the layout of a channel with that metadata and the form of its signals; `None` if opspace didn't write the
/// channel.
pub(crate) fn layout(metadata: &BTreeMap<String, String>) -> Option<Result<(Layout, Vec<Shape>), String>> {
    let text = metadata.get(LAYOUT)?;
    let read = || {
        let value: Value = serde_json::from_str(text).ok()?;
        let read: Vec<(Signal, Shape)> =
            value["signals"].as_array()?.iter().map(signal).collect::<Option<_>>()?;
        let (signals, shapes) = read.into_iter().unzip();
        Some((Layout { channel: value["channel"].as_str()?.to_owned(), signals }, shapes))
    };
    Some(read().ok_or_else(|| format!("the layout of a channel cannot be parsed: {text}")))
}

fn signal(value: &Value) -> Option<(Signal, Shape)> {
    let elements = value["elements"].as_array()?.iter().map(Value::as_str).collect::<Option<Vec<_>>>()?;
    let signal = Signal::new(value["name"].as_str()?, value["unit"].as_str()?, &elements);
    let shape = match value.get("fields") {
        None => Shape::Packed(elements.len()),
        Some(Value::Null) if elements.len() == 1 => Shape::Scalar,
        Some(_) => Shape::Named(elements.len()),
    };
    Some((signal, shape))
}

/// True if a number is absent from messages: NaN as it is written in code. A NaN with other bits, the result of a
/// computation, is recorded.
fn is_absent(value: f64) -> bool {
    value.to_bits() == f64::NAN.to_bits()
}

/// Appends the message of a row to `out`. NaN is absent.
pub(crate) fn encode(shapes: &[Shape], time_s: f64, mut row: &[f64], out: &mut Vec<u8>) {
    double::encode(1, &time_s, out);
    for (i, &shape) in shapes.iter().enumerate() {
        let (values, rest) = row.split_at(shape.len());
        row = rest;
        match shape {
            Shape::Scalar => present(values).for_each(|(_, value)| double::encode(number(i), &value, out)),
            Shape::Packed(_) => double::encode_packed(number(i), values, out),
            Shape::Named(_) => {
                let length: usize =
                    present(values).map(|(k, _)| key_len(element_number(k)) + size_of::<f64>()).sum();
                if length > 0 {
                    encode_key(number(i), WireType::LengthDelimited, out);
                    encode_varint(length as u64, out);
                    present(values).for_each(|(k, value)| double::encode(element_number(k), &value, out));
                }
            }
        }
    }
}

/// Numbers that are not absent, with their indices.
fn present(values: &[f64]) -> impl Iterator<Item = (usize, f64)> {
    values.iter().copied().enumerate().filter(|(_, value)| !is_absent(*value))
}

/// Appends the row of a message to `rows` and returns its time (s). Returns `None` and appends nothing if the message
/// differs from the form that [`encode`] writes.
pub(crate) fn decode(shapes: &[Shape], message: &[u8], rows: &mut Vec<f64>) -> Option<f64> {
    let before = rows.len();
    let time_s = decode_into(shapes, message, rows);
    if time_s.is_none() {
        rows.truncate(before);
    }
    time_s
}

fn decode_into(shapes: &[Shape], mut message: &[u8], rows: &mut Vec<f64>) -> Option<f64> {
    let at = &mut message;
    let time = number_at(1, at)?;
    for (i, &shape) in shapes.iter().enumerate() {
        match shape {
            Shape::Scalar => rows.push(number_at(number(i), at).unwrap_or(f64::NAN)),
            // Empty packed fields are not written.
            Shape::Packed(0) => {}
            Shape::Packed(width) => {
                let values =
                    block_at(number(i), at).filter(|values| values.len() == width * size_of::<f64>())?;
                rows.extend(values.as_chunks().0.iter().map(|&b| f64::from_le_bytes(b)));
            }
            Shape::Named(width) => {
                let mut values = block_at(number(i), at).unwrap_or_default();
                for k in 0..width {
                    rows.push(number_at(element_number(k), &mut values).unwrap_or(f64::NAN));
                }
                if !values.is_empty() {
                    return None;
                }
            }
        }
    }
    at.is_empty().then_some(time)
}

/// Takes the number of a field from the beginning of `at`; `None`, and nothing is taken, if there is another field.
fn number_at(tag: u32, at: &mut &[u8]) -> Option<f64> {
    let mut rest = *at;
    if decode_key(&mut rest).ok()? != (tag, WireType::SixtyFourBit) {
        return None;
    }
    let (value, rest) = rest.split_first_chunk()?;
    *at = rest;
    Some(f64::from_le_bytes(*value))
}

/// Takes the bytes of a field from the beginning of `at`; `None`, and nothing is taken, if there is another field.
fn block_at<'m>(tag: u32, at: &mut &'m [u8]) -> Option<&'m [u8]> {
    let mut rest = *at;
    if decode_key(&mut rest).ok()? != (tag, WireType::LengthDelimited) {
        return None;
    }
    let length = usize::try_from(decode_varint(&mut rest).ok()?).ok()?;
    let (values, rest) = rest.split_at_checked(length)?;
    *at = rest;
    Some(values)
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]
    use super::*;

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

    /// Checks the definition against the rules of proto3: field numbers in order, and each optional number alone in its
    /// `oneof`; signals with elements are messages with a field per element.
    #[test]
    fn the_definition_names_each_element() {
        let set = FileDescriptorSet::decode(definition(&awkward()).1.as_slice()).unwrap();
        let message = &set.file[0].message_type[0];
        assert_eq!(
            (set.file[0].syntax(), set.file[0].package(), message.name()),
            ("proto3", "opspace", "ServoLeftArm")
        );
        assert!(message.field.iter().enumerate().all(|(i, field)| field.number() == i as i32 + 1));
        let position = &message.field[1];
        assert_eq!(position.type_name(), ".opspace.ServoLeftArm.HandPositionValues");
        let values = message.nested_type.iter().find(|nested| nested.name() == "HandPositionValues").unwrap();
        assert_eq!(values.field.iter().map(FieldDescriptorProto::name).collect::<Vec<_>>(), ["x", "y"]);
        for (i, field) in values.field.iter().enumerate() {
            assert!(field.proto3_optional() && field.oneof_index() == i as i32);
            assert_eq!(values.oneof_decl[i].name(), format!("_{}", field.name()));
        }
        let scalars = Layout {
            channel: "tick".to_owned(),
            signals: vec![Signal::scalar("phase", "1"), Signal::new("pull", "1", &["0 none, 1 spring"])],
        };
        let set = FileDescriptorSet::decode(definition(&scalars).1.as_slice()).unwrap();
        assert!(set.file[0].message_type[0].field.iter().all(|field| field.r#type() == Type::Double));
    }

    /// Compares a layout before and after conversion to metadata.
    #[test]
    fn layout_round_trips_through_metadata() {
        let (read, forms) = layout(&channel_metadata(&awkward())).unwrap().unwrap();
        assert_eq!((read, forms), (awkward(), shapes(&awkward())));
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
        assert_eq!(layout(&metadata).unwrap().unwrap().0, arm);
    }

    /// Checks that a message with additional data or of another layout is rejected and appends nothing, and that the
    /// packed form of older logs is read.
    #[test]
    fn message_of_another_layout_is_refused() {
        use Shape::{Named, Packed, Scalar};
        let mut message = Vec::new();
        encode(&[Named(2), Named(0), Scalar], 0.5, &[1.0, 2.0, 3.0], &mut message);
        let mut rows = vec![9.0];
        assert_eq!(decode(&[Named(2), Named(0), Scalar], &message, &mut rows), Some(0.5));
        assert_eq!(rows, [9.0, 1.0, 2.0, 3.0]);
        for shapes in [
            &[Named(2), Named(0)][..],
            &[Named(1), Named(0), Scalar],
            &[Packed(2), Packed(0), Packed(1)],
            &[Scalar],
        ] {
            assert_eq!(decode(shapes, &message, &mut rows), None, "{shapes:?}");
        }
        assert_eq!(rows.len(), 4);
        message.clear();
        encode(&[Packed(2), Packed(0), Packed(1)], 0.5, &[1.0, 2.0, 3.0], &mut message);
        assert_eq!(decode(&[Packed(2), Packed(0), Packed(1)], &message, &mut rows), Some(0.5));
        assert_eq!(rows, [9.0, 1.0, 2.0, 3.0, 1.0, 2.0, 3.0]);
        for cut in 0..message.len() {
            assert_eq!(
                decode(&[Packed(2), Packed(0), Packed(1)], &message[..cut], &mut rows),
                None,
                "{cut} bytes"
            );
        }
    }

    /// Checks that NaN takes no space in a message and is read again, and that a NaN with other bits keeps them.
    #[test]
    fn signal_that_does_not_apply_is_absent() {
        let shapes = [Shape::Named(2), Shape::Scalar, Shape::Named(2)];
        let (mut message, mut empty, mut read) = (Vec::new(), Vec::new(), Vec::new());
        encode(&shapes, 0.5, &[f64::NAN; 5], &mut empty);
        assert_eq!(empty.len(), 9, "the time alone");
        let row = [f64::NAN, f64::NAN, f64::from_bits(0x7ff4_0000_0000_1234), f64::NAN, -0.0];
        encode(&shapes, 0.5, &row, &mut message);
        assert_eq!(decode(&shapes, &message, &mut read), Some(0.5));
        assert_eq!(read.map_bits(), row.to_vec().map_bits());
    }

    trait Bits {
        fn map_bits(&self) -> Vec<u64>;
    }

    impl Bits for Vec<f64> {
        fn map_bits(&self) -> Vec<u64> {
            self.iter().map(|value| value.to_bits()).collect()
        }
    }
}
