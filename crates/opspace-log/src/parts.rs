//! Comparison of the attachments and metadata of two logs.

use crate::recording::Recording;
use std::collections::BTreeMap;

/// Number of characters of a value that are shown.
const SHOWN: usize = 80;

/// First difference between the attachments of that name, or an entry of a metadata record that differs.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct PartDifference {
    /// Name of the part: `attachment 'task.toml'` or `metadata 'opspace.run'`.
    pub part: String,
    /// Place in it: `line 7`, `byte 12`, or the key of an entry; `None` if only one of the logs has the part.
    pub place: Option<String>,
    /// Value in each log, shortened; `None` where the part or the place is absent.
    pub values: [Option<String>; 2],
}

/// Compares attachments and metadata of two logs. What only one log has is no difference if the other one is damaged.
pub(crate) fn compare_parts(logs: [&Recording; 2]) -> Vec<PartDifference> {
    let mut found = Vec::new();
    let contents = logs.map(|log| {
        log.attachments
            .iter()
            .map(|part| (part.name.as_str(), part.data.as_slice()))
            .collect::<BTreeMap<_, _>>()
    });
    for (name, values) in pairs(&contents) {
        let part = format!("attachment '{name}'");
        match values {
            [Some(one), Some(other)] => found.extend(content(part, one, other)),
            only => found.extend(missing(part, only.map(|value| value.is_some()), logs)),
        }
    }
    let tables = logs.map(|log| {
        log.metadata.iter().map(|(name, entries)| (name.as_str(), entries)).collect::<BTreeMap<_, _>>()
    });
    for (name, values) in pairs(&tables) {
        let part = format!("metadata '{name}'");
        match values {
            [Some(one), Some(other)] => found.extend(entries(&part, one, other)),
            only => found.extend(missing(part, only.map(|value| value.is_some()), logs)),
        }
    }
    found
}

/// Values of each key in two maps.
fn pairs<'m, K: Ord + Copy, V: Copy>(
    maps: &'m [BTreeMap<K, V>; 2],
) -> impl Iterator<Item = (K, [Option<V>; 2])> + 'm {
    let [one, other] = maps;
    let keys = one.keys().chain(other.keys().filter(|key| !one.contains_key(key)));
    keys.map(|key| (*key, maps.each_ref().map(|map| map.get(key).copied())))
}

/// Part that only one log has.
fn missing(part: String, present: [bool; 2], logs: [&Recording; 2]) -> Option<PartDifference> {
    let is_lost = (0..2).any(|which| !present[which] && logs[which].damage.is_some());
    let values = present.map(|is_present| is_present.then(|| "present".to_owned()));
    (!is_lost).then_some(PartDifference { part, place: None, values })
}

fn entries(
    part: &str,
    one: &BTreeMap<String, String>,
    other: &BTreeMap<String, String>,
) -> Vec<PartDifference> {
    let maps = [one, other].map(|entries| {
        entries.iter().map(|(key, value)| (key.as_str(), value.as_str())).collect::<BTreeMap<_, _>>()
    });
    let differing = pairs(&maps).filter(|(_, [one, other])| one != other);
    differing
        .map(|(key, values)| PartDifference {
            part: part.to_owned(),
            place: Some(key.to_owned()),
            values: values.map(|value| value.map(shown)),
        })
        .collect()
}

/// First difference between two contents: a line of texts, otherwise a byte.
fn content(part: String, one: &[u8], other: &[u8]) -> Option<PartDifference> {
    if one == other {
        return None;
    }
    let same = one.iter().zip(other).take_while(|(a, b)| a == b).count();
    let (place, values) = match [one, other].map(str::from_utf8) {
        [Ok(a), Ok(b)] if !a.lines().eq(b.lines()) => {
            let line = a.lines().zip(b.lines()).take_while(|(a, b)| a == b).count();
            (format!("line {}", line + 1), [a, b].map(|text| text.lines().nth(line).map(shown)))
        }
        _ => {
            let value = |bytes: &[u8]| bytes.get(same).map(|byte| format!("{byte:#04x}"));
            (format!("byte {same}"), [value(one), value(other)])
        }
    };
    Some(PartDifference { part, place: Some(place), values })
}

fn shown(value: &str) -> String {
    let mut text: String = value.chars().take(SHOWN).collect();
    if text.len() < value.len() {
        text.push('…');
    }
    text
}
