//! Fields of a message as text, by the definition of its type in the file: for messages of any program.

use prost::Message;
use prost::encoding::{WireType, decode_key, decode_varint};
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FileDescriptorSet};
use std::collections::{BTreeMap, HashMap};

/// Deepest nesting of messages.
const MAX_DEPTH: usize = 32;

/// Definition of a message type and of all types in it.
pub(crate) struct Definition {
    messages: HashMap<String, HashMap<u32, Field>>,
    root: String,
}

struct Field {
    name: String,
    kind: Type,
    /// Full name of the type, of a field that is a message.
    message: String,
    repeated: bool,
}

/// Fields of a message in their order: path and value.
pub(crate) type Fields = Vec<(String, String)>;

impl Definition {
    /// Reads a serialized `FileDescriptorSet`; `None` if it is none, or does not define the type `root`.
    pub fn protobuf(root: &str, data: &[u8]) -> Option<Self> {
        let set = FileDescriptorSet::decode(data).ok()?;
        let mut messages = HashMap::new();
        for file in &set.file {
            let package =
                if file.package().is_empty() { String::new() } else { format!(".{}", file.package()) };
            file.message_type.iter().for_each(|message| add(message, &package, 0, &mut messages));
        }
        let root = format!(".{root}");
        messages.contains_key(&root).then_some(Self { messages, root })
    }

    /// Returns the fields of a message; `None` if it does not fit the definition.
    pub fn fields(&self, message: &[u8]) -> Option<Fields> {
        let mut out = Vec::new();
        self.read(&self.root, message, "", 0, &mut out)?;
        Some(out)
    }

    fn read(
        &self,
        message: &str,
        mut bytes: &[u8],
        prefix: &str,
        depth: usize,
        out: &mut Fields,
    ) -> Option<()> {
        let definition = self.messages.get(message).filter(|_| depth < MAX_DEPTH)?;
        let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
        let at = &mut bytes;
        while !at.is_empty() {
            let (number, wire) = decode_key(at).ok()?;
            let field = definition.get(&number);
            let name = field.map_or_else(|| format!("field {number}"), |field| field.name.clone());
            let count = counts.entry(number).or_default();
            let repeated = field.is_some_and(|field| field.repeated);
            let path = |k: usize| match repeated {
                true => format!("{prefix}{name}[{k}]"),
                false => format!("{prefix}{name}"),
            };
            if wire != WireType::LengthDelimited {
                out.push((path(*count), value(field.map(|field| field.kind), wire, at)?));
                *count += 1;
                continue;
            }
            let length = usize::try_from(decode_varint(at).ok()?).ok()?;
            let (block, rest) = at.split_at_checked(length)?;
            *at = rest;
            match field.map(|field| (field.kind, &field.message)) {
                Some((Type::Message, message)) => {
                    self.read(message, block, &format!("{}.", path(*count)), depth + 1, out)?;
                    *count += 1;
                }
                Some((Type::String, _)) => {
                    out.push((path(*count), format!("{:?}", String::from_utf8_lossy(block))));
                    *count += 1;
                }
                Some((kind, _)) if repeated && wire_of(kind).is_some() => {
                    let (wire, mut packed) = (wire_of(kind)?, block);
                    while !packed.is_empty() {
                        out.push((path(*count), value(Some(kind), wire, &mut packed)?));
                        *count += 1;
                    }
                }
                _ => {
                    let crc = crc32fast::hash(block);
                    out.push((path(*count), format!("{} bytes with checksum {crc:08x}", block.len())));
                    *count += 1;
                }
            }
        }
        Some(())
    }
}

fn add(
    message: &DescriptorProto,
    scope: &str,
    depth: usize,
    messages: &mut HashMap<String, HashMap<u32, Field>>,
) {
    if depth >= MAX_DEPTH {
        return;
    }
    let name = format!("{scope}.{}", message.name());
    let field = |field: &prost_types::FieldDescriptorProto| {
        let described = Field {
            name: field.name().to_owned(),
            kind: field.r#type(),
            message: field.type_name().to_owned(),
            repeated: field.label() == Label::Repeated,
        };
        (u32::try_from(field.number()).unwrap_or(0), described)
    };
    message.nested_type.iter().for_each(|nested| add(nested, &name, depth + 1, messages));
    messages.insert(name, message.field.iter().map(field).collect());
}

/// Form in a message of a kind of number; `None` for other kinds.
fn wire_of(kind: Type) -> Option<WireType> {
    Some(match kind {
        Type::Double | Type::Fixed64 | Type::Sfixed64 => WireType::SixtyFourBit,
        Type::Float | Type::Fixed32 | Type::Sfixed32 => WireType::ThirtyTwoBit,
        Type::String | Type::Bytes | Type::Message | Type::Group => return None,
        _ => WireType::Varint,
    })
}

/// Takes a number from the beginning of `at`. Different bits give different texts.
fn value(kind: Option<Type>, wire: WireType, at: &mut &[u8]) -> Option<String> {
    Some(match wire {
        WireType::SixtyFourBit => {
            let (bytes, rest) = at.split_first_chunk()?;
            *at = rest;
            match kind {
                Some(Type::Double) => real(f64::from_le_bytes(*bytes)),
                Some(Type::Sfixed64) => i64::from_le_bytes(*bytes).to_string(),
                _ => u64::from_le_bytes(*bytes).to_string(),
            }
        }
        WireType::ThirtyTwoBit => {
            let (bytes, rest) = at.split_first_chunk()?;
            *at = rest;
            match kind {
                Some(Type::Float) => format!("{:?}", f32::from_le_bytes(*bytes)),
                Some(Type::Sfixed32) => i32::from_le_bytes(*bytes).to_string(),
                _ => u32::from_le_bytes(*bytes).to_string(),
            }
        }
        WireType::Varint => {
            let number = decode_varint(at).ok()?;
            match kind {
                Some(Type::Int32 | Type::Int64 | Type::Enum) => number.cast_signed().to_string(),
                Some(Type::Bool) => (number != 0).to_string(),
                Some(Type::Sint32 | Type::Sint64) => {
                    ((number >> 1).cast_signed() ^ -((number & 1).cast_signed())).to_string()
                }
                _ => number.to_string(),
            }
        }
        _ => return None,
    })
}

fn real(value: f64) -> String {
    if value.is_nan() && value.to_bits() != f64::NAN.to_bits() {
        return format!("NaN with bits {:016x}", value.to_bits());
    }
    format!("{value:?}")
}
