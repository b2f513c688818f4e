//! Settings from the command line: `--set task.hand.gains.damping_ratio=0.7`.
//!
//! A setting edits the text of a file, so its value is parsed and checked exactly as if it were in the file. The name
//! of a kind can be omitted: if a key is missing in a table that contains one inner table and nothing else, the
//! search continues in the inner table (`[task.hand.cartesian]` in the example).

use std::ops::Range;

use toml_edit::{Array, ArrayOfTables, DocumentMut, InlineTable, Item, Key, TableLike, Value};

use crate::files::numbers::with_digits;
use crate::files::source::{FileError, Setting, Source, check_syntax};
use crate::files::toml_path::{Part, dotted};
use crate::suggest::nearest;

/// Maximum depth of a key. Files are flat, so a deeper key is a mistake.
const MAX_DEPTH: usize = 32;

/// Applies `key=value` settings, in order; a later one wins.
///
/// A value is TOML; a bare word is read as text. Missing keys are added: [`crate::files::source::parse`] checks later
/// if they are allowed.
///
/// # Errors
/// A file that is not TOML; a setting without `=`; a key that passes through a value that is not a table or an array.
/// The error names the setting.
pub fn apply(source: &Source, settings: &[String]) -> Result<Source, FileError> {
    edit(source, settings, None)
}

/// Applies settings that all begin with `root.`, like [`apply`]: the rest of the key is the key in this file. Errors
/// show the setting as the user wrote it.
///
/// # Errors
/// As [`apply`], and if a setting does not begin with `root.`.
pub fn apply_below(source: &Source, root: &str, settings: &[String]) -> Result<Source, FileError> {
    edit(source, settings, Some(root))
}

/// Separates the settings that begin with `root.` from the others, keeping their order.
#[must_use]
pub fn split(settings: &[String], root: &str) -> (Vec<String>, Vec<String>) {
    settings.iter().cloned().partition(|setting| {
        let key = setting.split('=').next().unwrap_or_default();
        key.split_once('.').is_some_and(|(first, _)| first.trim() == root)
    })
}

fn edit(source: &Source, settings: &[String], root: Option<&str>) -> Result<Source, FileError> {
    check_syntax(source)?;
    let mut source = source.clone();
    for spelling in settings {
        let (mut keys, at) = key_of(spelling)?;
        let mut setting = Setting { spelling: spelling.clone(), key: at, path: Vec::new() };
        let refuse =
            |setting: &Setting, part, (message, help)| FileError::of_setting(setting, part, message, help);
        if let Some(root) = root {
            if keys.len() < 2 || keys[0] != root {
                let message = format!("this setting must begin with `{root}.`");
                return Err(refuse(&setting, Part::Key, (message, None)));
            }
            keys.remove(0);
        }
        if keys.len() > MAX_DEPTH {
            let message = format!("a key of {} parts is nested too deeply", keys.len());
            return Err(refuse(&setting, Part::Key, (message, None)));
        }
        let value =
            value_of(&spelling[setting.key.end + 1..]).map_err(|e| refuse(&setting, Part::Value, e))?;
        // This cannot fail: `check_syntax` has parsed the same text with the same grammar.
        let mut document: DocumentMut = source
            .text()
            .parse()
            .map_err(|error| FileError::of_file(source.name(), format!("not TOML: {error}"), None))?;
        let mut path = Vec::new();
        put(Node::Table(document.as_table_mut()), &keys, &value, &mut path)
            .map_err(|error| refuse(&setting, Part::Key, error))?;
        setting.path = path;
        source = source.with_setting(document.to_string(), setting);
    }
    Ok(source)
}

/// Message and help of an error.
type OverrideError = (String, Option<String>);

/// Returns the key of a setting and its byte range; a quoted key may contain `=`.
fn key_of(spelling: &str) -> Result<(Vec<String>, Range<usize>), FileError> {
    let equals = spelling.match_indices('=').map(|(index, _)| index);
    for end in equals.clone() {
        if let Ok(keys) = Key::parse(spelling[..end].trim()) {
            return Ok((keys.iter().map(|key| key.get().to_owned()).collect(), 0..end));
        }
    }
    let help = Some("a setting is `key=value`: `--set task.hand.gains.damping_ratio=0.7`".to_owned());
    let message = match equals.min() {
        None => "a setting needs an `=`".to_owned(),
        Some(end) => format!("`{}` is not a key", spelling[..end].trim()),
    };
    let setting = Setting { spelling: spelling.to_owned(), key: 0..spelling.len(), path: Vec::new() };
    Err(FileError::of_setting(&setting, Part::Key, message, help))
}

fn value_of(text: &str) -> Result<Value, OverrideError> {
    let text = text.trim();
    if text.is_empty() {
        return Err((
            "a value is missing after `=`".to_owned(),
            Some("for an empty text, write `\"\"`".to_owned()),
        ));
    }
    if let Ok(value) = text.parse::<Value>() {
        return Ok(value);
    }
    // `+.5e400` and `1e400` are too large for TOML: the reader says so.
    if let Ok(number) = text.parse::<f64>() {
        return Ok(number.into());
    }
    // `.7` and `1.` are not TOML, but their meaning is clear, also in an array.
    let corrected = with_digits(text).and_then(|(corrected, _)| corrected.parse::<Value>().ok());
    if let Some(value) = corrected {
        return Ok(value);
    }
    let starts = text.starts_with(|c: char| c.is_alphabetic() || "_/~".contains(c));
    if (starts || text.starts_with("./") || text.starts_with("../"))
        && text.chars().all(|c| c.is_alphanumeric() || "_-./~:+".contains(c))
    {
        return Ok(text.into());
    }
    let help = "write a number without a unit (the unit is part of the key's name), or text in quotes";
    Err((format!("`{text}` is neither a TOML value nor a single word"), Some(help.to_owned())))
}

/// Node of a document, by the way in which a key path continues below it.
enum Node<'a> {
    Table(&'a mut dyn TableLike),
    Array(&'a mut Array),
    Tables(&'a mut ArrayOfTables),
    Leaf(&'static str),
}

fn node_of(item: &mut Item) -> Node<'_> {
    match item {
        Item::Table(table) => Node::Table(table),
        Item::ArrayOfTables(tables) => Node::Tables(tables),
        Item::Value(value) => within_value(value),
        Item::None => Node::Leaf("nothing"),
    }
}

fn within_value(value: &mut Value) -> Node<'_> {
    match value {
        Value::InlineTable(table) => Node::Table(table),
        Value::Array(array) => Node::Array(array),
        other => Node::Leaf(other.type_name()),
    }
}

/// Writes `value` at `keys` below `node`. Adds the keys on the way to `path`, including omitted names of kinds.
fn put(node: Node<'_>, keys: &[String], value: &Value, path: &mut Vec<String>) -> Result<(), OverrideError> {
    let Some((key, rest)) = keys.split_first() else { return Ok(()) };
    let mut table = match node {
        Node::Table(table) => table,
        Node::Array(array) => {
            let element = element(key, array.len(), path).map(|index| array.get_mut(index))?;
            path.push(key.clone());
            return match element {
                Some(element) if rest.is_empty() => {
                    replace(element, value);
                    Ok(())
                }
                Some(element) => put(within_value(element), rest, value, path),
                None => Ok(()),
            };
        }
        Node::Tables(tables) => {
            let table = element(key, tables.len(), path).map(|index| tables.get_mut(index))?;
            path.push(key.clone());
            return match table {
                Some(_) if rest.is_empty() => {
                    Err((format!("`{}` is one of several tables: set its keys", dotted(path)), None))
                }
                Some(table) => put(Node::Table(table), rest, value, path),
                None => Ok(()),
            };
        }
        Node::Leaf(kind) => {
            return Err((format!("`{}` is of type {kind}: it has no key `{key}`", dotted(path)), None));
        }
    };
    if let Some(error) = second_kind(table, key, path) {
        return Err(error);
    }
    for tag in tags_left_out(table, key, rest.is_empty(), path) {
        match table.get_mut(&tag).and_then(Item::as_table_like_mut) {
            Some(inner) => table = inner,
            None => return Ok(()),
        }
        path.push(tag);
    }
    path.push(key.clone());
    if rest.is_empty() {
        match table.get_mut(key) {
            Some(Item::Value(old)) => replace(old, value),
            Some(item) => *item = Item::Value(value.clone()),
            None => {
                table.insert(key, Item::Value(value.clone()));
            }
        }
        return Ok(());
    }
    if !table.contains_key(key) {
        table.insert(key, Item::Value(InlineTable::new().into()));
    }
    match table.get_mut(key) {
        Some(item) => put(node_of(item), rest, value, path),
        None => Ok(()),
    }
}

/// Error of a setting that names another kind of reference or servo than the table has.
fn second_kind(table: &dyn TableLike, key: &str, path: &[String]) -> Option<OverrideError> {
    let is_servo = path.len() == 4 && path[0] == "profile" && path[2] == "servo";
    let has_one_kind = is_servo || path.last().is_some_and(|last| last == "reference");
    let (kind, _) = sole_table(table).filter(|_| has_one_kind)?;
    let is_other = kind != key && KINDS.contains(&kind) && KINDS.contains(&key);
    is_other.then(|| {
        let table = dotted(path);
        let message = format!("`{table}` is of kind `{kind}`, not `{key}`");
        (
            message,
            Some(format!("for another kind, set all its values at once: `{table}={{ {key} = {{ ... }} }}`")),
        )
    })
}

/// Names of kinds between this table and `key` that a setting omitted.
fn tags_left_out(table: &dyn TableLike, key: &str, last: bool, path: &[String]) -> Vec<String> {
    // There are no kinds at the root.
    if path.is_empty() || table.contains_key(key) {
        return Vec::new();
    }
    let mut tags = Vec::new();
    let mut inner = table;
    while let Some((tag, next)) = sole_table(inner) {
        tags.push(tag.to_owned());
        inner = next;
        if inner.contains_key(key) {
            return tags;
        }
    }
    // The key does not exist. If it is the last one of the setting, the value is added to this table. Otherwise a new
    // table is added inside the kind, unless the key is a misspelling of the kind's name. A table that is no kind may
    // have others beside it, and be the only one by chance.
    tags.truncate(1);
    tags.retain(|tag| !last && is_kind(path, tag) && nearest(key, [tag.as_str()]).is_none());
    tags
}

/// Names of kinds: what a file may have in one table, of which it has exactly one.
pub const KINDS: [&str; 52] = [
    "absolute_m",
    "absolute_rad",
    "absolute_rpy_rad",
    "arc",
    "bounded",
    "capsule",
    "cartesian",
    "cascaded",
    "center-of-mass",
    "circle",
    "coupled",
    "cylinder",
    "drawer",
    "first-order",
    "frame",
    "goal",
    "half-space",
    "hole",
    "joint-damping",
    "joint-posture",
    "joint-tracking",
    "line",
    "mass",
    "moving-average",
    "offset_m",
    "offset_rad",
    "offset_rpy_rad",
    "on",
    "path",
    "pid",
    "point-to-point",
    "pushes",
    "random",
    "recorded",
    "retract",
    "rpy_rad",
    "scripted",
    "second-order",
    "sinusoid",
    "sphere",
    "spline",
    "spring",
    "staircase",
    "still",
    "streamed",
    "surface",
    "swivel",
    "transfer-function",
    "velocity",
    "wall",
    "waves",
    "waypoints",
];

/// True if the table `tag` in the table at `path` is a kind. Programs may add kinds of tasks.
fn is_kind(path: &[String], tag: &str) -> bool {
    (path.len() == 2 && path[0] == "task") || KINDS.contains(&tag)
}

/// Returns the only entry of a table, if this entry is a table.
fn sole_table(table: &dyn TableLike) -> Option<(&str, &dyn TableLike)> {
    let mut entries = table.iter().filter(|(_, item)| !item.is_none());
    match (entries.next(), entries.next()) {
        (Some((key, item)), None) => item.as_table_like().map(|inner| (key, inner)),
        _ => None,
    }
}

/// Replaces a value and keeps the comment after it.
fn replace(old: &mut Value, new: &Value) {
    let decor = old.decor().clone();
    *old = new.clone();
    *old.decor_mut() = decor;
}

fn element(key: &str, length: usize, path: &[String]) -> Result<usize, OverrideError> {
    match key.parse::<usize>() {
        Ok(index) if index < length => Ok(index),
        _ => Err((
            format!("`{}` has elements 0 to {}, but no element `{key}`", dotted(path), length.max(1) - 1),
            None,
        )),
    }
}
