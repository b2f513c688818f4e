//! The text of a file, and errors that point into it.
//!
//! [`parse`] reads TOML strictly: finite numbers only, unknown keys refused. What is wrong in a way that
//! only a later step sees (a frame that the robot does not have) is reported by [`FileError::at_key`] at
//! the line of its key. Settings from the command line ([`crate::overrides`]) err in the same words.

use std::fmt;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use miette::{Diagnostic, LabeledSpan, NamedSource, SourceCode};
use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};

/// Files are written by hand; a larger one is a log or a mesh given by mistake.
const MAX_BYTES: u64 = 4 << 20;

/// A file's text and where it came from.
#[derive(Clone, Debug)]
pub struct Source {
    name: String,
    text: Arc<str>,
    /// As read, before settings: an error outside them is shown where the user finds it.
    base: Arc<str>,
    settings: Vec<Setting>,
}

/// A `--set` that went into a [`Source`].
#[derive(Clone, Debug)]
pub(crate) struct Setting {
    /// As the user wrote it.
    pub(crate) spelling: String,
    /// The bytes of `spelling` left of `=`.
    pub(crate) key: Range<usize>,
    /// The keys in the file that it set, tags included.
    pub(crate) path: Vec<String>,
}

impl Source {
    /// A text under a name: a path as the user wrote it, or what else the user knows it by.
    pub fn new(name: impl Into<String>, text: impl Into<Arc<str>>) -> Self {
        let text = text.into();
        Self { name: name.into(), base: Arc::clone(&text), text, settings: Vec::new() }
    }

    /// Reads a text file.
    ///
    /// # Errors
    /// If it is missing (near names in its folder are suggested), a folder, unreadable, not UTF-8 or larger
    /// than 4 MiB.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, FileError> {
        let path = path.as_ref();
        let name = path.display().to_string();
        if path.is_dir() {
            return Err(FileError::of_file(name, "is a folder; a file is meant here", files_in(path)));
        }
        let mut bytes = Vec::new();
        let read =
            std::fs::File::open(path).and_then(|file| file.take(MAX_BYTES + 1).read_to_end(&mut bytes));
        match read {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Err(missing_file(path, name));
            }
            Err(error) => return Err(FileError::of_file(name, format!("cannot be read: {error}"), None)),
            Ok(_) if bytes.len() as u64 > MAX_BYTES => {
                return Err(FileError::of_file(
                    name,
                    "is larger than 4 MiB: is it the file you meant?",
                    None,
                ));
            }
            Ok(_) => {}
        }
        match String::from_utf8(bytes) {
            Ok(text) => Ok(Self::new(name, text)),
            Err(error) => {
                let at = error.utf8_error().valid_up_to();
                let line = 1 + error.as_bytes()[..at].iter().filter(|&&byte| byte == b'\n').count();
                let help = Some("save the file as UTF-8".to_owned());
                Err(FileError::of_file(name, format!("is not UTF-8 (line {line})"), help))
            }
        }
    }

    /// What the user knows the text by: a path.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The text, settings applied.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }

    pub(crate) fn with_setting(&self, text: String, setting: Setting) -> Self {
        let mut settings = self.settings.clone();
        settings.push(setting);
        Self { name: self.name.clone(), text: text.into(), base: Arc::clone(&self.base), settings }
    }
}

/// What is wrong in a file or a setting: the place, what stands there, and the remedy.
///
/// Displays as one line, `tasks/reach.toml:7: unknown key ...`; as a [`Diagnostic`] it carries the line
/// itself, underlined, and the help.
pub struct FileError(Box<Inner>);

struct Inner {
    path: String,
    source: NamedSource<Arc<str>>,
    span: Option<Range<usize>>,
    line: Option<usize>,
    message: String,
    help: Option<String>,
}

impl FileError {
    /// An error of a file as a whole.
    pub fn of_file(path: impl Into<String>, message: impl Into<String>, help: Option<String>) -> Self {
        let path = path.into();
        let source = NamedSource::new(&path, Arc::from(""));
        Self(Box::new(Inner { path, source, span: None, line: None, message: message.into(), help }))
    }

    /// An error at a line of a text (from 1) that is not TOML, or of the text as a whole.
    #[must_use]
    pub fn at_line(
        source: &Source,
        line: Option<usize>,
        message: impl Into<String>,
        help: Option<String>,
    ) -> Self {
        let span = line.and_then(|line| {
            let begin: usize =
                source.text.split_inclusive('\n').take(line.saturating_sub(1)).map(str::len).sum();
            let text = source.text.get(begin..)?.lines().next()?;
            let indent = text.len() - text.trim_start().len();
            Some(begin + indent..begin + text.trim_end().len())
        });
        let path = source.name.clone();
        let named = NamedSource::new(&path, Arc::clone(&source.text));
        Self(Box::new(Inner { path, source: named, span, line, message: message.into(), help }))
    }

    /// An error found after parsing, at a key: `"task.hand.cartesian.frame"`, or its segments where a key
    /// may hold dots: `["joint", "arm.1"]`. An array's element is its index, from 0. If the key is not there,
    /// the error points at the nearest table around it; if a setting wrote it, at the setting.
    pub fn at_key(
        source: &Source,
        key: impl KeyPath,
        message: impl Into<String>,
        help: Option<String>,
    ) -> Self {
        let path = key.segments();
        let message = message.into();
        if let Some(setting) = setting_at(source, &path) {
            return Self::of_setting(setting, Part::Value, message, help);
        }
        let inside = source.settings.iter().rfind(|setting| setting.path.starts_with(&path));
        let note = inside.map(|setting| format!("`--set {}` changed it", setting.spelling));
        Self::in_base(source, &path, Part::Value, message, join(help, note))
    }

    /// At `span` of `text`.
    fn at_span(
        name: &str,
        text: &Arc<str>,
        span: Range<usize>,
        message: String,
        help: Option<String>,
    ) -> Self {
        let start = span.start.min(text.len());
        let line = 1 + text.as_bytes()[..start].iter().filter(|&&byte| byte == b'\n').count();
        let inner = Inner {
            path: name.to_owned(),
            source: NamedSource::new(name, Arc::clone(text)),
            span: Some(start..span.end.clamp(start, text.len())),
            line: Some(line),
            message,
            help,
        };
        Self(Box::new(inner))
    }

    /// At a key of the file as it was read; settings may have shifted the lines of what was parsed.
    fn in_base(source: &Source, path: &[String], part: Part, message: String, help: Option<String>) -> Self {
        let span = DeTable::parse(&source.base).ok().map(|document| span_of(document.get_ref(), path, part));
        match span.flatten() {
            Some(span) => Self::at_span(&source.name, &source.base, span, message, help),
            None => Self::of_file(source.name.clone(), message, help),
        }
    }

    pub(crate) fn of_setting(setting: &Setting, part: Part, message: String, help: Option<String>) -> Self {
        let span = match part {
            Part::Key => setting.key.clone(),
            Part::Value => (setting.key.end + 1).min(setting.spelling.len())..setting.spelling.len(),
        };
        let inner = Inner {
            path: "--set".to_owned(),
            source: NamedSource::new("--set", Arc::from(setting.spelling.as_str())),
            span: Some(span),
            line: None,
            message,
            help,
        };
        Self(Box::new(inner))
    }

    /// The file, as the user named it; `--set` for a setting.
    #[must_use]
    pub fn path(&self) -> &str {
        &self.0.path
    }

    /// The line, from 1; `None` for a setting and for a file as a whole.
    #[must_use]
    pub fn line(&self) -> Option<usize> {
        self.0.line
    }

    /// What is wrong, without the place.
    #[must_use]
    pub fn message(&self) -> &str {
        &self.0.message
    }

    /// What to do about it.
    #[must_use]
    pub fn help(&self) -> Option<&str> {
        self.0.help.as_deref()
    }
}

impl fmt::Display for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Inner { path, line, message, span, source, .. } = &*self.0;
        match (line, span) {
            (Some(line), _) => write!(f, "{path}:{line}: {message}"),
            (None, Some(_)) => write!(f, "{path} {}: {message}", source.inner()),
            (None, None) => write!(f, "{path}: {message}"),
        }
    }
}

impl fmt::Debug for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "FileError({self}; help: {:?})", self.0.help)
    }
}

impl std::error::Error for FileError {}

impl Diagnostic for FileError {
    fn help(&self) -> Option<Box<dyn fmt::Display + '_>> {
        self.0.help.as_ref().map(|help| Box::new(help) as Box<dyn fmt::Display>)
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.0.span.as_ref().map(|_| &self.0.source as &dyn SourceCode)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let span = self.0.span.clone()?;
        Some(Box::new(std::iter::once(LabeledSpan::new_primary_with_span(None, span))))
    }
}

/// Names a key within nested tables.
pub trait KeyPath {
    /// The keys from the file's root inwards.
    fn segments(&self) -> Vec<String>;
}

/// A dotted key as TOML writes it; a segment that holds dots is quoted: `joint."arm.1"`.
impl KeyPath for str {
    fn segments(&self) -> Vec<String> {
        match toml_edit::Key::parse(self) {
            Ok(keys) => keys.iter().map(|key| key.get().to_owned()).collect(),
            Err(_) => self.split('.').map(str::to_owned).collect(),
        }
    }
}

impl KeyPath for String {
    fn segments(&self) -> Vec<String> {
        self.as_str().segments()
    }
}

impl<S: AsRef<str>> KeyPath for [S] {
    fn segments(&self) -> Vec<String> {
        self.iter().map(|segment| segment.as_ref().to_owned()).collect()
    }
}

impl<S: AsRef<str>, const N: usize> KeyPath for [S; N] {
    fn segments(&self) -> Vec<String> {
        self.as_slice().segments()
    }
}

impl<S: AsRef<str>> KeyPath for Vec<S> {
    fn segments(&self) -> Vec<String> {
        self.as_slice().segments()
    }
}

impl<K: KeyPath + ?Sized> KeyPath for &K {
    fn segments(&self) -> Vec<String> {
        (**self).segments()
    }
}

/// Reads a TOML text into `T`.
///
/// `T` decides on unknown keys (`#[serde(deny_unknown_fields)]`); enums must be tagged externally, or the
/// line of an error is lost.
///
/// # Errors
/// Text that is not TOML, a number that is not finite, and what `T` refuses, each at its place.
pub fn parse<T: DeserializeOwned>(source: &Source) -> Result<T, FileError> {
    let document = check_syntax(source)?;
    check_finite(document.get_ref(), &mut Vec::new()).map_err(|(path, number)| {
        FileError::at_key(source, path, format!("expected a finite number, got {number}"), None)
    })?;
    T::deserialize(toml::de::Deserializer::from(document.clone()))
        .map_err(|error| explain::<T>(source, document.get_ref(), &error))
}

type Document<'a> = toml::Spanned<DeTable<'a>>;

/// The document, or where it is not TOML.
pub(crate) fn check_syntax(source: &Source) -> Result<Document<'_>, FileError> {
    DeTable::parse(&source.text).map_err(|error| {
        let span = error.span().unwrap_or(0..0);
        let (message, help) = syntax_words(error.message(), &source.text, &span);
        FileError::at_span(&source.name, &source.text, span, message, help)
    })
}

/// The key path and text of the first number that is not finite.
fn check_finite(table: &DeTable<'_>, path: &mut Vec<String>) -> Result<(), (Vec<String>, String)> {
    for (key, value) in table {
        path.push(key.get_ref().to_string());
        check_finite_value(value.get_ref(), path)?;
        path.pop();
    }
    Ok(())
}

fn check_finite_value(value: &DeValue<'_>, path: &mut Vec<String>) -> Result<(), (Vec<String>, String)> {
    match value {
        // 1e400 is TOML, and parses to infinity.
        DeValue::Float(number) if !number.as_str().parse().is_ok_and(f64::is_finite) => {
            Err((path.clone(), number.as_str().to_owned()))
        }
        DeValue::Array(array) => {
            for (index, element) in array.iter().enumerate() {
                path.push(index.to_string());
                check_finite_value(element.get_ref(), path)?;
                path.pop();
            }
            Ok(())
        }
        DeValue::Table(table) => check_finite(table, path),
        _ => Ok(()),
    }
}

/// Which half of `key = value` an error is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    Key,
    Value,
}

/// A deserialiser's error, placed and in the user's words.
fn explain<T: DeserializeOwned>(
    source: &Source,
    document: &DeTable<'_>,
    error: &toml::de::Error,
) -> FileError {
    let span = error.span().unwrap_or(0..0);
    let path = path_at(document, &span);
    let words = words(error.message(), source, document, &path);
    let (message, help, part) = (words.message, words.help, words.part);
    if source.settings.is_empty() {
        // An empty span is the root's: the file as a whole.
        if span.is_empty() {
            return FileError::of_file(source.name.clone(), message, help);
        }
        return FileError::at_span(&source.name, &source.text, span, message, help);
    }
    if let Some(setting) = setting_at(source, &path) {
        return FileError::of_setting(setting, part, message, join(help, made_here(source, setting)));
    }
    // A key too many spoils the table around it, which stands in the file.
    let inside = source.settings.iter().rfind(|setting| setting.path.starts_with(&path));
    if let Some(setting) = inside
        && parse::<T>(&Source::new(source.name.clone(), Arc::clone(&source.base))).is_ok()
    {
        return FileError::of_setting(setting, Part::Key, message, join(help, made_here(source, setting)));
    }
    FileError::in_base(source, &path, part, message, help)
}

/// The last setting that wrote what stands at `path`.
fn setting_at<'a>(source: &'a Source, path: &[String]) -> Option<&'a Setting> {
    let wrote = source.settings.iter().rfind(|setting| path.starts_with(&setting.path));
    wrote.or_else(|| {
        let base = DeTable::parse(&source.base).ok()?;
        let depth = depth_of(base.get_ref(), path);
        if depth == path.len() {
            return None;
        }
        source.settings.iter().rfind(|setting| setting.path.len() > depth && setting.path.starts_with(path))
    })
}

/// Where a setting made a table that the file does not have: likely a slip in its name.
fn made_here(source: &Source, setting: &Setting) -> Option<String> {
    let base = DeTable::parse(&source.base).ok()?;
    let depth = depth_of(base.get_ref(), &setting.path);
    let made = setting.path.get(depth).filter(|_| depth + 1 < setting.path.len())?;
    let siblings = keys_at(base.get_ref(), &setting.path[..depth]);
    let within =
        if depth == 0 { "the file".to_owned() } else { format!("`{}`", dotted(&setting.path[..depth])) };
    let mut note = format!("{within} has no `{made}` yet");
    if !siblings.is_empty() {
        note += &format!("; it has {}", list(&siblings));
    }
    if let Some(near) = nearest(made, &siblings) {
        note += &format!(": did you mean `{near}`?");
    }
    Some(note)
}

/// The keys of the table at `path`, the root's for an empty path.
fn keys_at(document: &DeTable<'_>, path: &[String]) -> Vec<String> {
    let table = match value_at(document, path) {
        Some(DeValue::Table(table)) => table,
        None if path.is_empty() => document,
        _ => return Vec::new(),
    };
    table.iter().map(|(key, _)| key.get_ref().to_string()).collect()
}

fn join(first: Option<String>, second: Option<String>) -> Option<String> {
    match (first, second) {
        (Some(first), Some(second)) => Some(format!("{first}\n{second}")),
        (first, second) => first.or(second),
    }
}

/// A path as TOML writes it.
pub(crate) fn dotted(path: &[String]) -> String {
    let bare =
        |key: &str| !key.is_empty() && key.chars().all(|c| c.is_ascii_alphanumeric() || "_-".contains(c));
    let quoted = |key: &String| if bare(key) { key.clone() } else { format!("{key:?}") };
    path.iter().map(quoted).collect::<Vec<_>>().join(".")
}

// ---- places in a document ----

/// Key and value of one child.
fn child<'a, 'i>(
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

fn entry<'a, 'i>(
    table: &'a DeTable<'i>,
    key: &str,
) -> Option<(Range<usize>, &'a toml::Spanned<DeValue<'i>>)> {
    table.iter().find(|(name, _)| name.get_ref() == key).map(|(name, value)| (name.span(), value))
}

/// The spans of the keys and values along `path`, as far as it exists.
fn along<'a, 'i>(
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

fn depth_of(document: &DeTable<'_>, path: &[String]) -> usize {
    along(document, path).len()
}

fn value_at<'a, 'i>(document: &'a DeTable<'i>, path: &[String]) -> Option<&'a DeValue<'i>> {
    let steps = along(document, path);
    if steps.len() < path.len() { None } else { steps.last().map(|(_, value)| value.get_ref()) }
}

/// The span of a key or its value, or of the nearest table around it; `None` at the root.
fn span_of(document: &DeTable<'_>, path: &[String], part: Part) -> Option<Range<usize>> {
    let steps = along(document, path);
    let whole = steps.len() == path.len();
    let (key, value) = steps.last()?;
    match value.get_ref() {
        DeValue::Table(_) => Some(key.clone()),
        _ if part == Part::Key || !whole => Some(key.clone()),
        _ => Some(value.span()),
    }
}

/// The path to the smallest key or value around a span's start.
fn path_at(document: &DeTable<'_>, span: &Range<usize>) -> Vec<String> {
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
    // A table's span is its header, not its content: every child is asked.
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

// ---- words ----

struct Words {
    message: String,
    help: Option<String>,
    part: Part,
}

/// Says in the user's words what serde and toml say in theirs.
fn words(raw: &str, source: &Source, document: &DeTable<'_>, path: &[String]) -> Words {
    let value = |message: String, help: Option<String>| Words { message, help, part: Part::Value };
    let key = |message: String, help: Option<String>| Words { message, help, part: Part::Key };
    if let Some((name, allowed)) = unknown(raw, "unknown field `") {
        return key(format!("unknown key `{name}`"), Some(did_you_mean(name, &allowed)));
    }
    if let Some((name, allowed)) = unknown(raw, "unknown variant `") {
        return key(format!("unknown value `{name}`"), Some(did_you_mean(name, &allowed)));
    }
    if let Some((_, allowed)) =
        raw.strip_prefix("unexpected keys in table: ").and_then(|rest| rest.split_once(", available keys: "))
    {
        let name = path.last().map_or("", String::as_str);
        let allowed: Vec<&str> = allowed.split(", ").collect();
        return key(format!("unknown key `{name}`"), Some(did_you_mean(name, &allowed)));
    }
    if let Some(name) = raw.strip_prefix("missing field `").and_then(|rest| rest.strip_suffix('`')) {
        let within = if path.is_empty() { String::new() } else { format!(" in `{}`", dotted(path)) };
        let help = match unit_of(name) {
            Some(unit) => format!("add `{name} = ...`: a number in {}", unit.symbol),
            None => format!("add `{name} = ...`: it has no default"),
        };
        return key(format!("missing key `{name}`{within}"), Some(help));
    }
    if raw.starts_with("wanted exactly 1 element") {
        let mut held = keys_at(document, path);
        // The file's own kind is the one meant; a setting may have put another before it.
        let own = DeTable::parse(&source.base).map(|base| keys_at(base.get_ref(), path)).unwrap_or_default();
        held.sort_by_key(|key| !own.contains(key));
        let found = if held.is_empty() { "is empty".to_owned() } else { format!("holds {}", list(&held)) };
        let message = format!("`{}` {found}; it takes exactly one kind", dotted(path));
        let help = held.first().map(|kind| format!("a key of `{kind}` is `{}.{kind}.<key>`", dotted(path)));
        return key(message, help);
    }
    if raw == "wanted string or table" {
        return value(format!("expected text or a table, got {}", found_at(document, path)), None);
    }
    for prefix in ["invalid type: ", "invalid value: "] {
        if let Some((_, expected)) = raw.strip_prefix(prefix).and_then(|rest| rest.rsplit_once(", expected "))
        {
            let found = value_at(document, path);
            let message = format!("expected {}, got {}", plain(expected), found_at(document, path));
            let help = found.and_then(|found| type_help(found, expected, path));
            return value(message, help);
        }
    }
    if let Some((length, expected)) =
        raw.strip_prefix("invalid length ").and_then(|rest| rest.split_once(", expected "))
    {
        return value(format!("expected {}, got {length}", plain(expected)), None);
    }
    value(raw.trim_end().to_owned(), None)
}

/// `unknown field `x`, expected one of `a`, `b``: the name, and what is allowed.
fn unknown<'a>(raw: &'a str, prefix: &str) -> Option<(&'a str, Vec<&'a str>)> {
    let rest = raw.strip_prefix(prefix)?;
    if let Some((name, _)) = rest.rsplit_once("`, there are no ") {
        return Some((name, Vec::new()));
    }
    let (name, expected) = rest.rsplit_once("`, expected ")?;
    Some((name, expected.split('`').skip(1).step_by(2).collect()))
}

fn did_you_mean(name: &str, allowed: &[&str]) -> String {
    let listed = match allowed {
        [] => "nothing is allowed here".to_owned(),
        _ => format!("allowed here: {}", list(allowed)),
    };
    match same_but_unit(name, allowed).or_else(|| nearest(name, allowed)) {
        Some(near) => match units_differ(name, near) {
            Some(note) => format!("did you mean `{near}`? {note}\n{listed}"),
            None => format!("did you mean `{near}`?\n{listed}"),
        },
        None => listed,
    }
}

fn list<S: AsRef<str>>(names: &[S]) -> String {
    names.iter().map(|name| format!("`{}`", name.as_ref())).collect::<Vec<_>>().join(", ")
}

/// What Rust calls a type, in words.
fn plain(expected: &str) -> &str {
    match expected {
        "f64" | "f32" => "a number",
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number",
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number not below 0",
        "a string" | "str" | "string" | "path string" => "text in quotes",
        "a boolean" | "bool" => "true or false",
        "a map" => "a table",
        "a sequence" => "an array",
        _ if expected.starts_with("struct ") || expected.starts_with("internally") => "a table",
        _ if expected.starts_with("tuple ") => "an array",
        _ => expected,
    }
}

fn found_at(document: &DeTable<'_>, path: &[String]) -> String {
    match value_at(document, path) {
        Some(DeValue::String(text)) => format!("the text {:?}", shorten(text)),
        Some(DeValue::Integer(number)) => number.to_string(),
        Some(DeValue::Float(number)) => number.to_string(),
        Some(DeValue::Boolean(flag)) => flag.to_string(),
        Some(DeValue::Datetime(_)) => "a date".to_owned(),
        Some(DeValue::Array(_)) => "an array".to_owned(),
        Some(DeValue::Table(_)) | None => "a table".to_owned(),
    }
}

fn shorten(text: &str) -> String {
    if text.chars().count() <= 40 { text.to_owned() } else { text.chars().take(39).chain(['…']).collect() }
}

fn type_help(found: &DeValue<'_>, expected: &str, path: &[String]) -> Option<String> {
    let key = path.iter().rfind(|segment| segment.parse::<usize>().is_err())?;
    match (found, plain(expected)) {
        (DeValue::String(text), "a number" | "a whole number" | "a whole number not below 0") => {
            let (number, unit) = leading_number(text)?;
            Some(if unit.is_empty() {
                format!("write the number without quotes: `{key} = {number}`")
            } else {
                format!("the unit belongs to the key's name: write a number, `{key} = {number}`")
            })
        }
        (DeValue::Integer(_), "a number") => {
            Some("a whole number this long does not fit: write it with a dot".into())
        }
        _ => None,
    }
}

/// `400 N/m`: the number, and what follows it.
fn leading_number(text: &str) -> Option<(&str, &str)> {
    let text = text.trim();
    let ends = text.char_indices().map(|(index, _)| index).chain([text.len()]);
    let end = ends.rev().find(|&end| text[..end].parse().is_ok_and(f64::is_finite))?;
    Some((&text[..end], text[end..].trim()))
}

fn syntax_words(raw: &str, text: &str, span: &Range<usize>) -> (String, Option<String>) {
    let at = text.get(span.clone()).unwrap_or("").trim();
    if raw.starts_with("string values must be quoted") || raw.starts_with("invalid boolean") {
        return match leading_number(at) {
            _ if at.is_empty() => ("a value is missing after `=`".to_owned(), None),
            Some((number, _)) => (
                format!("`{at}` is not a TOML value"),
                Some(format!("the unit belongs to the key's name: write a number, `{number}`")),
            ),
            None => (format!("`{at}` is not a TOML value"), Some(format!("text needs quotes: {at:?}"))),
        };
    }
    if raw == "duplicate key" {
        return (format!("`{at}` stands twice in this table"), Some("remove one of the two".to_owned()));
    }
    (format!("not TOML: {raw}"), None)
}

// ---- near names ----

/// The candidate that a name was likely meant to be, if one is near.
///
/// Near is a Damerau-Levenshtein distance of at most a third of the name, or a Jaro-Winkler similarity of at
/// least 0.9; case, `-` and `_` do not count.
pub fn nearest<'a, S, I>(name: &str, candidates: I) -> Option<&'a str>
where
    S: AsRef<str> + ?Sized + 'a,
    I: IntoIterator<Item = &'a S>,
{
    let fold = |text: &str| text.to_lowercase().replace('-', "_");
    let name = fold(name);
    let limit = (name.chars().count() / 3).max(1);
    let scored = candidates.into_iter().map(AsRef::as_ref).filter_map(|candidate| {
        let other = fold(candidate);
        let distance = strsim::damerau_levenshtein(&name, &other);
        let similarity = strsim::jaro_winkler(&name, &other);
        // Two short names share no letter and are still one edit apart: `x` is not meant by `y`.
        let near = distance == 0 || similarity >= 0.9 || (distance <= limit && similarity > 0.5);
        near.then_some((candidate, distance, similarity))
    });
    let best = scored.min_by(|a, b| a.1.cmp(&b.1).then(b.2.total_cmp(&a.2)));
    best.map(|(candidate, ..)| candidate)
}

struct Unit {
    suffix: &'static str,
    symbol: &'static str,
    /// What it measures; two units of one quantity convert by the quotient of their `si`.
    quantity: &'static str,
    si: f64,
}

const fn unit(suffix: &'static str, symbol: &'static str, quantity: &'static str, si: f64) -> Unit {
    Unit { suffix, symbol, quantity, si }
}

/// Units as key names end; an ending that ends another stands after it.
const UNITS: &[Unit] = {
    use std::f64::consts::{PI, TAU};
    &[
        unit("nms_per_rad", "N·m·s/rad", "rotational damping", 1.0),
        unit("nm_per_rad", "N·m/rad", "rotational stiffness", 1.0),
        unit("nm_per_deg", "N·m/°", "rotational stiffness", 180.0 / PI),
        unit("nm_per_a", "N·m/A", "torque constant", 1.0),
        unit("n_per_mm", "N/mm", "stiffness", 1e3),
        unit("n_per_m", "N/m", "stiffness", 1.0),
        unit("ns_per_m", "N·s/m", "damping", 1.0),
        unit("rad_per_s2", "rad/s²", "angular acceleration", 1.0),
        unit("deg_per_s2", "°/s²", "angular acceleration", PI / 180.0),
        unit("mm_per_s", "mm/s", "speed", 1e-3),
        unit("m_per_s2", "m/s²", "acceleration", 1.0),
        unit("m_per_s", "m/s", "speed", 1.0),
        unit("rad_per_s", "rad/s", "frequency", 1.0),
        unit("deg_per_s", "°/s", "frequency", PI / 180.0),
        unit("per_s", "1/s", "rate", 1.0),
        unit("kg_m2", "kg·m²", "inertia", 1.0),
        unit("rpm", "rpm", "frequency", TAU / 60.0),
        unit("khz", "kHz", "frequency", TAU * 1e3),
        unit("hz", "Hz", "frequency", TAU),
        unit("rad", "rad", "angle", 1.0),
        unit("deg", "°", "angle", PI / 180.0),
        unit("nmm", "N·mm", "torque", 1e-3),
        unit("nm", "N·m", "torque", 1.0),
        unit("kn", "kN", "force", 1e3),
        unit("kg", "kg", "mass", 1.0),
        unit("ms", "ms", "time", 1e-3),
        unit("us", "µs", "time", 1e-6),
        unit("mm", "mm", "length", 1e-3),
        unit("cm", "cm", "length", 1e-2),
        unit("n", "N", "force", 1.0),
        unit("g", "g", "mass", 1e-3),
        unit("s", "s", "time", 1.0),
        unit("m", "m", "length", 1.0),
        unit("a", "A", "current", 1.0),
        unit("v", "V", "voltage", 1.0),
        unit("w", "W", "power", 1.0),
    ]
};

fn unit_of(key: &str) -> Option<&'static Unit> {
    UNITS.iter().find(|unit| key.strip_suffix(unit.suffix).is_some_and(|stem| stem.ends_with('_')))
}

/// The unit that a key's name ends in, as print writes it: `stiffness_n_per_m` is in `N/m`.
#[must_use]
pub fn unit_symbol(key: &str) -> Option<&'static str> {
    unit_of(key).map(|unit| unit.symbol)
}

fn stem(key: &str) -> &str {
    unit_of(key).map_or(key, |unit| &key[..key.len() - unit.suffix.len() - 1])
}

/// The allowed key that measures the same in another unit, or names the unit that was left out.
fn same_but_unit<'a>(name: &str, allowed: &[&'a str]) -> Option<&'a str> {
    allowed.iter().copied().find(|candidate| *candidate != name && stem(candidate) == stem(name))
}

/// What to heed when a key is renamed to one in another unit.
fn units_differ(name: &str, meant: &str) -> Option<String> {
    let to = unit_of(meant)?;
    match unit_of(name) {
        None if stem(meant) == name => Some(format!("The unit, {}, is part of the name.", to.symbol)),
        Some(from) if from.suffix == to.suffix => None,
        Some(from) if from.quantity == to.quantity => {
            let factor = format!("{:.5e}", from.si / to.si).parse::<f64>().unwrap_or(f64::NAN);
            Some(format!("The units differ: 1 {} is {factor} {}.", from.symbol, to.symbol))
        }
        Some(from) => Some(format!("The units differ: {} is not {}.", from.symbol, to.symbol)),
        None => None,
    }
}

// ---- files ----

fn missing_file(path: &Path, name: String) -> FileError {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
        _ => PathBuf::from("."),
    };
    if !folder.is_dir() {
        let message = format!("there is no such file, nor a folder `{}`", folder.display());
        return FileError::of_file(name, message, None);
    }
    let wanted = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let present = names_in(&folder);
    let whole = nearest(&wanted, &present);
    // `compliant-x` for `compliant-x.toml`.
    let near = whole.or_else(|| {
        present.iter().map(String::as_str).find(|other| Path::new(other).file_stem() == path.file_name())
    });
    let help = match near {
        Some(near) => Some(format!("did you mean `{}`?", path.with_file_name(near).display())),
        None => files_in(&folder),
    };
    FileError::of_file(name, "there is no such file", help)
}

fn names_in(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> =
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// The TOML files of a folder, as a help.
fn files_in(folder: &Path) -> Option<String> {
    let mut names = names_in(folder);
    names.retain(|name| name.ends_with(".toml"));
    let more = names.len().saturating_sub(12);
    names.truncate(12);
    let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
    (!names.is_empty()).then(|| format!("`{}` holds {}{rest}", folder.display(), list(&names)))
}
