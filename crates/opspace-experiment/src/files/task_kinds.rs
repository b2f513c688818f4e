//! Kinds of tasks: the built-in ones, and those that a program adds.

use crate::extensions::{Entry, Extensions};
use crate::files::source::{Document, FileError, Source, explain_with};
use crate::files::strict::Strict;
use crate::suggest::{list, nearest};
use opspace_control::{ControlContext, ControlError, RegisteredTask, Task, TaskParameters};
use opspace_coupling::{CoupledParameters, CoupledTask};
use opspace_model::Model;
#[cfg(feature = "schema")]
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::any::Any;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, LazyLock};
use toml::de::{DeTable, DeValue, ValueDeserializer};

type Build = Arc<dyn Fn(&str, &Model, &ControlContext) -> Result<Box<dyn Task>, ControlError> + Send + Sync>;
type Parameters = Arc<dyn Any + Send + Sync>;
type Parser =
    Arc<dyn Fn(ValueDeserializer<'_>) -> Result<(Parameters, Build), toml::de::Error> + Send + Sync>;

/// Kind of tasks: `[task.NAME.KIND]` in a file.
#[derive(Clone)]
pub struct TaskKind {
    name: Cow<'static, str>,
    /// Parser of the table of a task; `None` for a kind that [`TaskParameters`] contains.
    parser: Option<Parser>,
    #[cfg(feature = "schema")]
    schema: Option<fn(&mut SchemaGenerator) -> Schema>,
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
            let (parameters, build) = (Arc::new(P::deserialize(Strict(table))?), Arc::clone(&build));
            let read: Parameters = Arc::clone(&parameters) as Parameters;
            let build: Build = Arc::new(move |name, model, context| build(&parameters, name, model, context));
            Ok((read, build))
        });
        Self { parser: Some(parser), ..Self::without_parser(name.into()) }
    }

    const fn without_parser(name: Cow<'static, str>) -> Self {
        Self {
            name,
            parser: None,
            #[cfg(feature = "schema")]
            schema: None,
        }
    }

    /// Adds the schema of the table in a file, that of `P`. Without it, `opspace schema` allows all keys.
    #[cfg(feature = "schema")]
    #[must_use]
    pub fn with_schema<P: JsonSchema>(mut self) -> Self {
        self.schema = Some(SchemaGenerator::subschema_for::<P>);
        self
    }

    /// Schema of the table in a file, if the kind has one and [`TaskParameters`] does not contain it. Its definitions are added
    /// to those of the generator.
    #[cfg(feature = "schema")]
    #[must_use]
    pub fn schema(&self, generator: &mut SchemaGenerator) -> Option<Schema> {
        self.schema.map(|schema| schema(generator))
    }

    /// Returns the kind of tasks that are coupled with a task of another robot.
    fn coupled() -> Self {
        let kind = Self::new("coupled", |p: &CoupledParameters, name, model, context| {
            Ok(Box::new(CoupledTask::new(name, p, model, context)?))
        });
        #[cfg(feature = "schema")]
        let kind = kind.with_schema::<CoupledParameters>();
        kind
    }
}

impl Entry for TaskKind {
    const KIND: &'static str = "task kind";

    fn built_in() -> &'static [Self] {
        static KINDS: LazyLock<Vec<TaskKind>> = LazyLock::new(|| {
            let kinds =
                TaskParameters::KINDS.iter().map(|name| TaskKind::without_parser(Cow::Borrowed(name)));
            kinds.chain([TaskKind::coupled()]).collect()
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

/// Removes the tasks of kinds that [`TaskParameters`] does not contain from a task file's document, and returns them.
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
        let is_valid = |base: &Source| is_valid(base, &name, &kind, parser);
        let explained = |error: &toml::de::Error| explain_with(source, whole.get_ref(), error, is_valid);
        let (parameters, build) =
            parser(ValueDeserializer::from(table.clone())).map_err(|e| explained(&e))?;
        let text = toml::Value::deserialize(ValueDeserializer::from(table.clone()));
        let text = text.map_err(|e| explained(&e))?.to_string();
        let task = RegisteredTask::new(kind, text, build).with_parameters(parameters);
        taken.insert(name.clone(), TaskParameters::Registered(task));
        tasks.remove(name.as_str());
    }
    Ok(taken)
}

/// True if a file has a valid table for a task of a kind.
fn is_valid(source: &Source, name: &str, kind: &str, parser: &Parser) -> bool {
    let Ok(mut document) = DeTable::parse(source.text()) else { return false };
    let kinds = table_mut(document.get_mut(), "task").and_then(|tasks| table_mut(tasks, name));
    let table = kinds.and_then(|kinds| kinds.get(kind)).cloned();
    table.is_some_and(|table| parser(ValueDeserializer::from(table)).is_ok())
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
