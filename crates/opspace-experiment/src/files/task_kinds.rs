//! Kinds of tasks: the built-in ones, and those that a program adds.

use crate::extensions::{Entry, Extensions};
use crate::files::source::{Document, FileError, Source, explain};
use crate::files::strict::Strict;
use crate::suggest::{list, nearest};
use opspace_control::{ControlContext, ControlError, RegisteredTask, Task, TaskParameters};
use opspace_model::Model;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, LazyLock};
use toml::de::{DeTable, DeValue, ValueDeserializer};

type Build = Arc<dyn Fn(&str, &Model, &ControlContext) -> Result<Box<dyn Task>, ControlError> + Send + Sync>;
type Parser = Arc<dyn Fn(ValueDeserializer<'_>) -> Result<Build, toml::de::Error> + Send + Sync>;

/// Kind of tasks: `[task.NAME.KIND]` in a file.
#[derive(Clone)]
pub struct TaskKind {
    name: Cow<'static, str>,
    /// Parser of the table of a task; `None` for a built-in kind, which [`TaskParameters`] contains.
    parser: Option<Parser>,
}

impl TaskKind {
    /// Creates a kind. Its table in a file is parsed into a `P`; `build` creates the task from this `P`, the task's
    /// name, the model and the context. `P` determines if unknown keys are rejected
    /// (`#[serde(deny_unknown_fields)]`). Keys in errors are relative to the root of the file.
    #[must_use]
    pub fn new<P: DeserializeOwned + Send + Sync + 'static>(
        name: impl Into<Cow<'static, str>>,
        build: impl Fn(&P, &str, &Model, &ControlContext) -> Result<Box<dyn Task>, ControlError>
        + Send
        + Sync
        + 'static,
    ) -> Self {
        let build = Arc::new(build);
        let parser: Parser = Arc::new(move |table| {
            let (parameters, build) = (P::deserialize(Strict(table))?, Arc::clone(&build));
            Ok(Arc::new(move |name: &str, model: &Model, context: &ControlContext| {
                build(&parameters, name, model, context)
            }))
        });
        Self { name: name.into(), parser: Some(parser) }
    }
}

impl Entry for TaskKind {
    const KIND: &'static str = "task kind";

    fn built_in() -> &'static [Self] {
        static KINDS: LazyLock<Vec<TaskKind>> = LazyLock::new(|| {
            let kinds = TaskParameters::KINDS.iter();
            kinds.map(|name| TaskKind { name: Cow::Borrowed(name), parser: None }).collect()
        });
        &KINDS
    }

    fn name(&self) -> &str {
        &self.name
    }
}

impl fmt::Debug for TaskKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

/// Removes the tasks of kinds that are not built in from a task file's document, and returns them.
pub(crate) fn take(
    extensions: &Extensions,
    source: &Source,
    document: &mut Document<'_>,
) -> Result<BTreeMap<String, TaskParameters>, FileError> {
    let mut taken = BTreeMap::new();
    let whole = document.clone();
    let Some(tasks) = table_mut(document.get_mut(), "task") else { return Ok(taken) };
    let names: Vec<String> = tasks.keys().map(|name| name.get_ref().to_string()).collect();
    for name in names {
        let Some(kinds) = table_mut(tasks, &name).filter(|kinds| kinds.len() == 1) else { continue };
        let Some((kind, table)) = kinds.iter().next() else { continue };
        let kind = kind.get_ref().to_string();
        let Some(parser) = extensions.get::<TaskKind>(&kind).and_then(|kind| kind.parser.as_ref()) else {
            // A misspelt setting may have made a task that the file does not have: it is reported as a setting.
            if !source.has_settings() {
                check_known(extensions, source, &name, &kind)?;
            }
            continue;
        };
        let explained = |error: &toml::de::Error| explain::<toml::Table>(source, whole.get_ref(), error);
        let build = parser(ValueDeserializer::from(table.clone())).map_err(|e| explained(&e))?;
        let text = toml::Value::deserialize(ValueDeserializer::from(table.clone()));
        let text = text.map_err(|e| explained(&e))?.to_string();
        taken.insert(name.clone(), TaskParameters::Registered(RegisteredTask::new(kind, text, build)));
        tasks.remove(name.as_str());
    }
    Ok(taken)
}

fn check_known(extensions: &Extensions, source: &Source, name: &str, kind: &str) -> Result<(), FileError> {
    if extensions.get::<TaskKind>(kind).is_some() {
        return Ok(());
    }
    let near = nearest(kind, extensions.names::<TaskKind>());
    let near = near.map(|near| format!("did you mean `{near}`? ")).unwrap_or_default();
    let added = match extensions.added::<TaskKind>() {
        [] => "kinds of your own need the program that registers them".to_owned(),
        kinds => format!("registered: {}", list(kinds.iter().map(Entry::name))),
    };
    let built_in = list(TaskKind::built_in().iter().map(Entry::name));
    let help = format!("{near}Built in: {built_in}; {added}");
    let key = ["task", name, kind];
    Err(FileError::at_key(source, key, format!("unknown task kind `{kind}`"), Some(help)))
}

/// Returns the table at a key of a table.
fn table_mut<'a, 'i>(table: &'a mut DeTable<'i>, key: &str) -> Option<&'a mut DeTable<'i>> {
    match table.get_mut(key)?.get_mut() {
        DeValue::Table(table) => Some(table),
        _ => None,
    }
}
