//! Seeds of a suite's run: a list, or a range.

use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;

/// Maximum number of seeds of a range.
const MAX_SEEDS: u64 = 100_000;

/// Reads `[1, 2, 3]` or `{ from = 1, to = 20 }`, which includes both ends.
pub(crate) fn seeds<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<u64>, D::Error> {
    deserializer.deserialize_any(SeedsVisitor)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Range {
    from: u64,
    to: u64,
}

struct SeedsVisitor;

impl<'de> Visitor<'de> for SeedsVisitor {
    type Value = Vec<u64>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of seeds or a range such as { from = 1, to = 20 }")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
        let mut seeds = Vec::new();
        while let Some(seed) = list.next_element()? {
            seeds.push(seed);
        }
        Ok(seeds)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
        let Range { from, to } = Range::deserialize(MapAccessDeserializer::new(map))?;
        if from > to {
            return Err(A::Error::custom(format!("this range is empty: from {from} to {to}")));
        }
        if to - from >= MAX_SEEDS {
            return Err(A::Error::custom(format!("more than {MAX_SEEDS} seeds: from {from} to {to}")));
        }
        Ok((from..=to).collect())
    }
}

#[cfg(feature = "schema")]
pub(crate) fn schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
    let seed = serde_json::json!({ "type": "integer", "minimum": 0 });
    schemars::json_schema!({
        "anyOf": [
            { "type": "array", "items": seed },
            {
                "type": "object",
                "properties": { "from": seed, "to": seed },
                "required": ["from", "to"],
                "additionalProperties": false,
            },
        ]
    })
}
