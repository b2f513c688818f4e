//! Changes of a TOML file that keep it a TOML file: keys and values are removed, renamed, exchanged and replaced.

use opspace_testing::random::Random;
use toml::{Table, Value};

/// Largest number of changes of a file.
const MOST_CHANGES: usize = 3;

/// Number of copies of an element of a list, at most.
const MOST_COPIES: usize = 400;

/// Values in place of others.
fn edge(random: &mut Random) -> Value {
    let numbers = [
        0.0,
        -0.0,
        -1.0,
        1.0,
        0.5,
        1e-3,
        1e-12,
        1e-300,
        5e-324,
        1e3,
        1e6,
        1e9,
        1e12,
        1e150,
        1e300,
        -1e300,
        f64::MAX,
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
    ];
    let whole = [0, 1, -1, 2, 7, 100, 1000, 65_536, 1 << 32, i64::MAX, i64::MIN];
    let words = [
        "",
        " ",
        "x",
        "motion",
        "force",
        "tip",
        "hand",
        "flange",
        "../..",
        "/dev/null",
        "é\u{202e}",
        "a.b",
        "<b>&",
    ];
    match random.below(8) {
        0..4 => Value::Float(numbers[random.below(numbers.len())]),
        4 => Value::Integer(whole[random.below(whole.len())]),
        5 => Value::String(words[random.below(words.len())].to_owned()),
        6 => Value::Boolean(random.is(0.5)),
        _ if random.is(0.5) => Value::Array(Vec::new()),
        _ => Value::Table(Table::new()),
    }
}

/// Way to a value: keys of tables and indices of lists.
type Way = Vec<Step>;

#[derive(Clone)]
enum Step {
    Key(String),
    Index(usize),
}

/// Ways to all values below a value.
fn ways(value: &Value, before: &Way, found: &mut Vec<Way>) {
    let mut go_on = |step: Step, below: &Value| {
        let way = [before.as_slice(), &[step]].concat();
        found.push(way.clone());
        ways(below, &way, found);
    };
    match value {
        Value::Table(table) => {
            for (key, below) in table {
                go_on(Step::Key(key.clone()), below);
            }
        }
        Value::Array(list) => {
            for (index, below) in list.iter().enumerate() {
                go_on(Step::Index(index), below);
            }
        }
        _ => {}
    }
}

fn drawn_way(value: &Value, random: &mut Random) -> Option<Way> {
    let mut found = Vec::new();
    ways(value, &Vec::new(), &mut found);
    (!found.is_empty()).then(|| found.swap_remove(random.below(found.len())))
}

fn at<'a>(mut value: &'a mut Value, way: &[Step]) -> Option<&'a mut Value> {
    for step in way {
        value = match step {
            Step::Key(key) => value.get_mut(key.as_str())?,
            Step::Index(index) => value.get_mut(*index)?,
        };
    }
    Some(value)
}

fn remove(root: &mut Value, way: &[Step]) -> Option<Value> {
    let (last, before) = way.split_last()?;
    match (at(root, before)?, last) {
        (Value::Table(table), Step::Key(key)) => table.remove(key),
        (Value::Array(list), Step::Index(index)) => Some(list.remove(*index)),
        _ => None,
    }
}

/// Puts a value under a key of the table that a way leads to.
fn put(root: &mut Value, way: &[Step], key: String, value: Value) {
    match at(root, way) {
        Some(Value::Table(table)) => drop(table.insert(key, value)),
        Some(Value::Array(list)) => list.push(value),
        _ => {}
    }
}

fn key_of(way: &[Step]) -> String {
    let key = way.iter().rev().find_map(|step| match step {
        Step::Key(key) => Some(key.clone()),
        Step::Index(_) => None,
    });
    key.unwrap_or_default()
}

/// Value of another type that looks the same.
fn other_type(value: &Value, random: &mut Random) -> Value {
    match value {
        Value::Float(number) if random.is(0.5) => Value::Integer(*number as i64),
        Value::Float(number) => Value::String(number.to_string()),
        Value::Integer(number) => Value::Float(*number as f64),
        Value::String(text) => text.parse().map_or(Value::Boolean(true), Value::Float),
        Value::Boolean(is) => Value::String(is.to_string()),
        Value::Array(list) => list.first().cloned().unwrap_or(Value::Integer(0)),
        other => Value::Array(vec![other.clone()]),
    }
}

fn scaled(value: &Value, random: &mut Random) -> Value {
    let factor = [-1.0, 0.0, 0.1, 0.5, 0.9, 1.1, 2.0, 10.0, 1e-6, 1e-3, 1e3, 1e6][random.below(12)];
    match value {
        Value::Float(number) => Value::Float(number * factor),
        Value::Integer(number) => Value::Integer((*number as f64 * factor) as i64),
        Value::Array(list) => Value::Array(list.iter().map(|value| scaled_by(value, factor)).collect()),
        other => other.clone(),
    }
}

fn scaled_by(value: &Value, factor: f64) -> Value {
    value.as_float().map_or_else(|| value.clone(), |number| Value::Float(number * factor))
}

/// Returns a file after one to three changes; `donor` is another file from which values are taken.
pub fn changed(table: Table, donor: &Table, random: &mut Random) -> String {
    let mut root = Value::Table(table);
    let mut donor = Value::Table(donor.clone());
    // Often only one: most files with several changes are refused.
    let most = 1 + random.below(MOST_CHANGES);
    for _ in 0..=random.below(most) {
        change(&mut root, &mut donor, random);
    }
    toml::to_string(&root).unwrap_or_default()
}

fn change(root: &mut Value, donor: &mut Value, random: &mut Random) {
    let (Some(way), Some(other)) = (drawn_way(root, random), drawn_way(root, random)) else { return };
    let above = &way[..way.len() - 1];
    match random.below(18) {
        0 => drop(remove(root, &way)),
        1 => {
            if let Some(value) = remove(root, &way) {
                let key = if random.is(0.3) { key_of(&way) + "s" } else { key_of(&other) };
                put(root, above, key, value);
            }
        }
        // To another place of the file.
        2 => {
            let value = if random.is(0.5) { remove(root, &way) } else { at(root, &way).cloned() };
            if let Some(value) = value {
                put(root, &other[..other.len() - 1], key_of(&way), value);
            }
        }
        // From another file.
        3 | 4 => {
            let Some(from) = drawn_way(donor, random) else { return };
            if let Some(value) = at(donor, &from).cloned() {
                put(root, if random.is(0.5) { above } else { &[] }, key_of(&from), value);
            }
        }
        5 => {
            if let (Some(one), Some(two)) = (at(root, &way).cloned(), at(root, &other).cloned()) {
                if let Some(place) = at(root, &way) {
                    *place = two;
                }
                if let Some(place) = at(root, &other) {
                    *place = one;
                }
            }
        }
        6 => change_value(root, &way, |value| other_type(value, random)),
        7 => change_list(root, &way, random),
        8..12 => change_value(root, &way, |_| edge(random)),
        _ => change_value(root, &way, |value| scaled(value, random)),
    }
}

fn change_value(root: &mut Value, way: &[Step], new: impl FnOnce(&Value) -> Value) {
    if let Some(value) = at(root, way) {
        *value = new(value);
    }
}

/// Copies elements of a list, or turns it round.
fn change_list(root: &mut Value, way: &[Step], random: &mut Random) {
    let Some(value) = at(root, way) else { return };
    match value {
        Value::Array(list) if !list.is_empty() => {
            let element = list[random.below(list.len())].clone();
            let copies = if random.is(0.1) { 1 + random.below(MOST_COPIES) } else { 1 };
            if random.is(0.3) {
                list.reverse();
            } else {
                list.extend(std::iter::repeat_n(element, copies));
            }
        }
        other => *other = Value::Array(vec![other.clone(), other.clone()]),
    }
}
