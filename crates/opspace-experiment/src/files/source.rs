//! The text of a file, and errors that point into it.
//!
//! [`parse`] reads TOML strictly: it rejects numbers that are not finite, and unknown keys. [`FileError::at_key`]
//! reports a mistake that is only detected later, such as an unknown frame, at the line of its key. Errors about
//! settings from the command line ([`crate::files::overrides`]) have the same wording.

use std::fmt;
use std::io::ErrorKind;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use opspace_model::files::read_file;
use serde::de::DeserializeOwned;
use toml::de::{DeTable, DeValue};

use crate::codes::{Code, Effect};
use crate::files::explain::{list, syntax_words, words};
use crate::files::layered_path::stated_path;
use crate::files::strict::Strict;
use crate::files::toml_path::{Part, depth_of, dotted, keys_at, path_at, span_of};
use crate::suggest::nearest;

/// Maximum size of a file. A larger file is probably a log or a mesh given by mistake.
const MAX_BYTES: u64 = 4 << 20;

/// A file's text and its origin.
#[derive(Clone, Debug)]
pub struct Source {
    name: String,
    text: Arc<str>,
    /// Text of the file before settings; errors that no setting causes are shown at their line in this text.
    pub(crate) base: Arc<str>,
    settings: Vec<Setting>,
}

/// `--set` option that was applied to a [`Source`].
#[derive(Clone, Debug)]
pub(crate) struct Setting {
    /// The setting as the user wrote it.
    pub(crate) spelling: String,
    /// Byte range of `spelling` left of `=`.
    pub(crate) key: Range<usize>,
    /// Path of the key that it set, including omitted names of kinds.
    pub(crate) path: Vec<String>,
}

impl Source {
    /// Creates a source from a text and its name: a path as the user wrote it, or another name known to the user.
    pub fn new(name: impl Into<String>, text: impl Into<Arc<str>>) -> Self {
        let text = text.into();
        Self { name: name.into(), base: Arc::clone(&text), text, settings: Vec::new() }
    }

    /// Reads a text file.
    ///
    /// # Errors
    /// If the file is missing (similar names in its folder are suggested), is a folder, a pipe or a device, is
    /// unreadable, is not UTF-8, or is larger than 4 MiB.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, FileError> {
        let path = path.as_ref();
        let name = path.display().to_string();
        if path.is_dir() {
            return Err(FileError::of_file(name, "is a folder; a file is expected here", files_in(path)));
        }
        let bytes = match read_file(path, MAX_BYTES) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == ErrorKind::NotFound => return Err(missing_file(path, name)),
            Err(error) if error.kind() == ErrorKind::FileTooLarge => {
                return Err(FileError::of_file(name, "is larger than 4 MiB: is it the intended file?", None));
            }
            Err(error) => return Err(FileError::of_file(name, format!("cannot be read: {error}"), None)),
        };
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

    /// Name of the text in messages: a path.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Text with settings applied.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }

    /// True if a setting of the command line has changed the text.
    pub(crate) fn has_settings(&self) -> bool {
        !self.settings.is_empty()
    }

    pub(crate) fn with_setting(&self, text: String, setting: Setting) -> Self {
        let mut settings = self.settings.clone();
        settings.push(setting);
        Self { name: self.name.clone(), text: text.into(), base: Arc::clone(&self.base), settings }
    }
}

/// Mistake in a file or a setting: its place, the text at this place, and the suggested correction.
///
/// Displays as one line, `tasks/reach.toml:7: unknown key ...`, with the code of its kind, if it has one, at the end. Use [`excerpt`](Self::excerpt) to show and underline
/// the text, and [`help`](Self::help) for the suggested correction.
#[derive(Clone)]
pub struct FileError(Box<Inner>);

#[derive(Clone)]
struct Inner {
    path: String,
    text: Arc<str>,
    span: Option<Range<usize>>,
    line: Option<usize>,
    message: String,
    help: Option<String>,
    code: Option<Code>,
}

impl FileError {
    /// Creates an error about a whole file.
    pub fn of_file(path: impl Into<String>, message: impl Into<String>, help: Option<String>) -> Self {
        let path = path.into();
        Self(Box::new(Inner {
            path,
            text: Arc::from(""),
            span: None,
            line: None,
            message: message.into(),
            help,
            code: None,
        }))
    }

    /// Returns the error with the code of its kind.
    #[must_use]
    pub fn coded(mut self, code: Code) -> Self {
        self.0.code = Some(code);
        self
    }

    /// Returns the error as a refusal of this kind; the help says whether it can be allowed.
    #[must_use]
    pub fn refused(mut self, code: Code) -> Self {
        let note = match code.effect() {
            Effect::Refused | Effect::RefusedOnRealRobot => {
                Some(format!("--allow {code} runs it nevertheless; results carry a warning"))
            }
            Effect::Never(reason) => Some(format!("this cannot be allowed: {reason}")),
            Effect::Reported | Effect::Noted | Effect::Failed => None,
        };
        self.0.help = join(self.0.help.take(), note);
        self.coded(code)
    }

    /// Creates an error at a line (from 1) of a text that is not TOML, or about the whole text if `line` is `None`.
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
            let shown = text.trim_end();
            // A line without text is its own end.
            let indent = shown.len() - shown.trim_start().len();
            Some(begin + indent..begin + shown.len())
        });
        let path = source.name.clone();
        let text = Arc::clone(&source.text);
        Self(Box::new(Inner { path, text, span, line, message: message.into(), help, code: None }))
    }

    /// Creates an error at a key after parsing. The key is a dotted string (`"task.hand.cartesian.frame"`) or a list
    /// of segments, which may contain dots (`["joint", "arm.1"]`). The key of an array element is its index, from 0.
    /// If the key does not exist, the error points at the nearest enclosing table; if a setting wrote the key, it
    /// points at the setting.
    pub fn at_key(
        source: &Source,
        key: impl KeyPath,
        message: impl Into<String>,
        help: Option<String>,
    ) -> Self {
        let path = key.segments();
        let path = DeTable::parse(&source.text)
            .ok()
            .and_then(|document| stated_path(document.get_ref(), &path))
            .unwrap_or(path);
        let message = message.into();
        if let Some(setting) = setting_at(source, &path) {
            return Self::of_setting(setting, Part::Value, message, help);
        }
        let inside = source.settings.iter().rfind(|setting| setting.path.starts_with(&path));
        let note = inside.map(|setting| format!("`--set {}` changed it", setting.spelling));
        Self::in_base(source, &path, Part::Value, message, join(help, note))
    }

    /// Creates an error at `span` (bytes) of `text`.
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
            text: Arc::clone(text),
            span: Some(start..span.end.clamp(start, text.len())),
            line: Some(line),
            message,
            help,
            code: None,
        };
        Self(Box::new(inner))
    }

    /// Creates an error at a key of the file before settings: settings may have shifted the lines of the parsed text.
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
            text: Arc::from(setting.spelling.as_str()),
            span: Some(span),
            line: None,
            message,
            help,
            code: None,
        };
        Self(Box::new(inner))
    }

    /// Name of the file as the user gave it; `--set` for a setting.
    #[must_use]
    pub fn path(&self) -> &str {
        &self.0.path
    }

    /// Line number, from 1; `None` for a setting or a whole file.
    #[must_use]
    pub fn line(&self) -> Option<usize> {
        self.0.line
    }

    /// Description of the mistake, without the place.
    #[must_use]
    pub fn message(&self) -> &str {
        &self.0.message
    }

    /// Suggested correction.
    #[must_use]
    pub fn help(&self) -> Option<&str> {
        self.0.help.as_deref()
    }

    /// Code of the kind of problem; a mistake in a file has none.
    #[must_use]
    pub fn code(&self) -> Option<Code> {
        self.0.code
    }

    /// Key at the mistake, dotted; `None` for a whole file, and where no key is.
    #[must_use]
    pub fn key(&self) -> Option<String> {
        let span = self.0.span.as_ref()?;
        let document = DeTable::parse(&self.0.text).ok()?;
        Some(dotted(&path_at(document.get_ref(), span))).filter(|key| !key.is_empty())
    }

    /// Text that contains the mistake, and the byte range of the mistake; `None` for a whole file.
    #[must_use]
    pub fn excerpt(&self) -> Option<(&str, Range<usize>)> {
        Some((&self.0.text, self.0.span.clone()?))
    }
}

impl fmt::Display for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Inner { path, line, message, span, text, code, .. } = &*self.0;
        match (line, span) {
            (Some(line), _) => write!(f, "{path}:{line}: {message}")?,
            (None, Some(_)) => write!(f, "{path} {text}: {message}")?,
            (None, None) => write!(f, "{path}: {message}")?,
        }
        code.map_or(Ok(()), |code| write!(f, " [{code}]"))
    }
}

impl fmt::Debug for FileError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "FileError({self}; help: {:?})", self.0.help)
    }
}

impl std::error::Error for FileError {}

/// Path of a key through nested tables.
pub trait KeyPath {
    /// Returns the keys, from the root of the file to the innermost.
    fn segments(&self) -> Vec<String>;
}

/// Dotted key as in TOML; a segment that contains dots is quoted: `joint."arm.1"`.
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

/// Parses a TOML text into a `T`.
///
/// `T` determines if unknown keys are rejected (`#[serde(deny_unknown_fields)]`). Enums must be externally tagged;
/// otherwise errors have no line.
///
/// # Errors
/// Text that is not TOML, a number that is not finite, or a value that `T` rejects, each with its place.
pub fn parse<T: DeserializeOwned>(source: &Source) -> Result<T, FileError> {
    let document = checked(source)?;
    T::deserialize(Strict(toml::de::Deserializer::from(document.clone())))
        .map_err(|error| explain::<T>(source, document.get_ref(), &error))
}

/// Parsed document; each value has its byte range in the text.
pub(crate) type Document<'a> = toml::Spanned<DeTable<'a>>;

/// Largest size of a number with a decimal point or an exponent. Products of numbers up to this size do not overflow.
const LARGEST: f64 = 1e12;

/// Parses the document and checks the size of its numbers.
pub(crate) fn checked(source: &Source) -> Result<Document<'_>, FileError> {
    let document = check_syntax(source)?;
    check_size(document.get_ref(), &mut Vec::new()).map_err(|(path, number)| {
        // 1e400 is valid TOML and is parsed to infinity.
        let message = match number.parse() {
            Ok(value) if f64::is_finite(value) => {
                format!("{number} is too large: expected a number from -{LARGEST:e} to {LARGEST:e}")
            }
            _ => format!("expected a finite number, got {number}"),
        };
        FileError::at_key(source, path, message, None)
    })?;
    Ok(document)
}

/// Parses the document; an error points at the invalid TOML.
pub(crate) fn check_syntax(source: &Source) -> Result<Document<'_>, FileError> {
    DeTable::parse(&source.text).map_err(|error| {
        let span = error.span().unwrap_or(0..0);
        let (message, help) = syntax_words(error.message(), &source.text, &span);
        FileError::at_span(&source.name, &source.text, span, message, help)
    })
}

/// Returns an error with the key path and the text of the first number that is not finite, or too large.
fn check_size(table: &DeTable<'_>, path: &mut Vec<String>) -> Result<(), (Vec<String>, String)> {
    for (key, value) in table {
        path.push(key.get_ref().to_string());
        check_size_of_value(value.get_ref(), path)?;
        path.pop();
    }
    Ok(())
}

fn check_size_of_value(value: &DeValue<'_>, path: &mut Vec<String>) -> Result<(), (Vec<String>, String)> {
    match value {
        DeValue::Float(number) if !number.as_str().parse().is_ok_and(|x: f64| x.abs() <= LARGEST) => {
            Err((path.clone(), number.as_str().to_owned()))
        }
        DeValue::Array(array) => {
            for (index, element) in array.iter().enumerate() {
                path.push(index.to_string());
                check_size_of_value(element.get_ref(), path)?;
                path.pop();
            }
            Ok(())
        }
        DeValue::Table(table) => check_size(table, path),
        _ => Ok(()),
    }
}

/// Translates a deserializer error into a message for the user, with its place.
pub(crate) fn explain<T: DeserializeOwned>(
    source: &Source,
    document: &DeTable<'_>,
    error: &toml::de::Error,
) -> FileError {
    explain_with(source, document, error, |base| parse::<T>(base).is_ok())
}

/// Translates a deserializer error as [`explain`] does. `is_valid` tells of the file without settings if it is valid.
pub(crate) fn explain_with(
    source: &Source,
    document: &DeTable<'_>,
    error: &toml::de::Error,
    is_valid: impl FnOnce(&Source) -> bool,
) -> FileError {
    let span = error.span().unwrap_or(0..0);
    let path = path_at(document, &span);
    let words = words(error.message(), &source.base, document, &path);
    let (message, help, part) = (words.message, words.help, words.part);
    if source.settings.is_empty() {
        // An empty span denotes the root, that is, the whole file.
        if span.is_empty() {
            return FileError::of_file(source.name.clone(), message, help);
        }
        return FileError::at_span(&source.name, &source.text, span, message, help);
    }
    if let Some(setting) = setting_at(source, &path) {
        return FileError::of_setting(setting, part, message, join(made_here(source, setting), help));
    }
    // An extra key makes the enclosing table invalid. If the file without settings is valid, a setting in this table
    // is wrong.
    let inside = source.settings.iter().rfind(|setting| setting.path.starts_with(&path));
    if let Some(setting) = inside
        && is_valid(&Source::new(source.name.clone(), Arc::clone(&source.base)))
    {
        return FileError::of_setting(setting, Part::Key, message, join(made_here(source, setting), help));
    }
    FileError::in_base(source, &path, part, message, help)
}

/// Returns the last setting that wrote the value at `path`.
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

/// Describes where a setting created a table that the file does not have, probably because of a misspelt name.
fn made_here(source: &Source, setting: &Setting) -> Option<String> {
    let base = DeTable::parse(&source.base).ok()?;
    let depth = depth_of(base.get_ref(), &setting.path);
    let made = setting.path.get(depth).filter(|_| depth + 1 < setting.path.len())?;
    let siblings = keys_at(base.get_ref(), &setting.path[..depth]);
    let within =
        if depth == 0 { "the file".to_owned() } else { format!("`{}`", dotted(&setting.path[..depth])) };
    let mut note = format!("{within} has no `{made}`");
    if !siblings.is_empty() {
        note += &format!("; it has {}", list(&siblings));
    }
    if let Some(near) = nearest(made, &siblings) {
        note += &format!(": did you mean `{near}`?");
    }
    Some(note)
}

fn join(first: Option<String>, second: Option<String>) -> Option<String> {
    match (first, second) {
        (Some(first), Some(second)) => Some(format!("{first}\n{second}")),
        (first, second) => first.or(second),
    }
}

fn missing_file(path: &Path, name: String) -> FileError {
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
        _ => PathBuf::from("."),
    };
    if !folder.is_dir() {
        let message = format!("there is no such file, and no folder `{}`", folder.display());
        return FileError::of_file(name, message, None);
    }
    let wanted = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let present = names_in(&folder);
    let whole = nearest(&wanted, &present);
    // The file extension may be missing: `compliant-x` for `compliant-x.toml`.
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

/// Lists the TOML files of a folder as a hint.
fn files_in(folder: &Path) -> Option<String> {
    let mut names = names_in(folder);
    names.retain(|name| name.ends_with(".toml"));
    let more = names.len().saturating_sub(12);
    names.truncate(12);
    let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
    (!names.is_empty()).then(|| format!("`{}` contains {}{rest}", folder.display(), list(&names)))
}
