//! Byte ranges of keys in a TOML document, and keys at a position.

use std::ops::Range;

use toml::de::{DeTable, DeValue};

/// Formats a path as a TOML key.
pub fn dotted(path: &[String]) -> String {
    let bare =
        |key: &str| !key.is_empty() && key.chars().all(|c| c.is_ascii_alphanumeric() || "_-".contains(c));
    let quoted = |key: &String| if bare(key) { key.clone() } else { format!("{key:?}") };
    path.iter().map(quoted).collect::<Vec<_>>().join(".")
}

/// Part of `key = value` to which an error refers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    Key,
    Value,
}

/// Key span and value of a child.
pub(crate) fn child<'a, 'i>(
    value: &'a DeValue<'i>,
    segment: &str,
) -> Option<(Range<usize>, &'a toml::Spanned<DeValue<'i>>)> {
    match value {
        DeValue::Table(table) => entry(table, segment),
        DeValue::Array(array) => {
            let element = array.get(segment.parse::<usize>().ok()?)?;
            Some((element.span(), element))
        }
        _ => None,
    }
}

pub(crate) fn entry<'a, 'i>(
    table: &'a DeTable<'i>,
    key: &str,
) -> Option<(Range<usize>, &'a toml::Spanned<DeValue<'i>>)> {
    table.iter().find(|(name, _)| name.get_ref() == key).map(|(name, value)| (name.span(), value))
}

/// Key spans and values along `path`, as far as the path exists.
pub(crate) fn along<'a, 'i>(
    document: &'a DeTable<'i>,
    path: &[String],
) -> Vec<(Range<usize>, &'a toml::Spanned<DeValue<'i>>)> {
    let mut steps = Vec::new();
    for segment in path {
        let next = match steps.last() {
            None => entry(document, segment),
            Some(&(_, value)) => child(toml::Spanned::get_ref(value), segment),
        };
        match next {
            Some(step) => steps.push(step),
            None => break,
        }
    }
    steps
}

pub(crate) fn depth_of(document: &DeTable<'_>, path: &[String]) -> usize {
    along(document, path).len()
}

pub(crate) fn value_at<'a, 'i>(document: &'a DeTable<'i>, path: &[String]) -> Option<&'a DeValue<'i>> {
    let steps = along(document, path);
    if steps.len() < path.len() { None } else { steps.last().map(|(_, value)| value.get_ref()) }
}

/// Span of a key or its value, or of the nearest enclosing table; `None` at the root.
pub(crate) fn span_of(document: &DeTable<'_>, path: &[String], part: Part) -> Option<Range<usize>> {
    let steps = along(document, path);
    let whole = steps.len() == path.len();
    let (key, value) = steps.last()?;
    match value.get_ref() {
        DeValue::Table(_) => Some(key.clone()),
        _ if part == Part::Key || !whole => Some(key.clone()),
        _ => Some(value.span()),
    }
}

/// Path of the smallest key or value that contains the start of a span.
pub(crate) fn path_at(document: &DeTable<'_>, span: &Range<usize>) -> Vec<String> {
    let mut best = (usize::MAX, Vec::new());
    if !span.is_empty() {
        let root = document.iter().map(|(key, value)| (key.get_ref().to_string(), key.span(), value));
        for (key, at, value) in root {
            narrow(value, at, span.start, &mut vec![key], &mut best);
        }
    }
    best.1
}

fn narrow(
    value: &toml::Spanned<DeValue<'_>>,
    key: Range<usize>,
    offset: usize,
    path: &mut Vec<String>,
    best: &mut (usize, Vec<String>),
) {
    // The span of a table covers only its header, so all children are searched.
    for around in [key, value.span()] {
        if around.contains(&offset) && around.len() <= best.0 {
            *best = (around.len(), path.clone());
        }
    }
    let children: Vec<_> = match value.get_ref() {
        DeValue::Table(table) => {
            table.iter().map(|(key, v)| (key.get_ref().to_string(), key.span(), v)).collect()
        }
        DeValue::Array(array) => {
            array.iter().enumerate().map(|(i, v)| (i.to_string(), v.span(), v)).collect()
        }
        _ => Vec::new(),
    };
    for (name, at, inner) in children {
        path.push(name);
        narrow(inner, at, offset, path, best);
        path.pop();
    }
}

/// Keys of the table at `path`; of the root for an empty path.
pub(crate) fn keys_at(document: &DeTable<'_>, path: &[String]) -> Vec<String> {
    let table = match value_at(document, path) {
        Some(DeValue::Table(table)) => table,
        None if path.is_empty() => document,
        _ => return Vec::new(),
    };
    table.iter().map(|(key, _)| key.get_ref().to_string()).collect()
}
