//! Registry of task kinds in addition to the built-in ones.

use crate::files::source::{Document, FileError, Source, explain};
use crate::files::strict::Strict;
use crate::suggest::nearest;
use opspace_control::{ControlContext, ControlError, RegisteredTask, Task, TaskParameters};
use opspace_model::Model;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use thiserror::Error;
use toml::de::{DeTable, DeValue, ValueDeserializer};

/// Names of the built-in kinds.
pub const BUILT_IN: [&str; 7] =
    ["cartesian", "center-of-mass", "swivel", "coupled", "joint-tracking", "joint-posture", "joint-damping"];

/// Registered kinds by name: `[task.NAME.KIND]` in a file becomes a task defined by the user.
#[derive(Clone, Default)]
pub struct TaskKinds(BTreeMap<String, Parser>);

type Build = Arc<dyn Fn(&str, &Model, &ControlContext) -> Result<Box<dyn Task>, ControlError> + Send + Sync>;
type Parser = Arc<dyn Fn(ValueDeserializer<'_>) -> Result<Build, toml::de::Error> + Send + Sync>;

/// Reason why a task kind cannot be registered.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum TaskKindError {
    /// The name is that of a built-in or already registered kind.
    #[error("the task kind '{kind}' already exists")]
    Taken {
        /// Name of the kind.
        kind: String,
    },
}

impl TaskKinds {
    /// Creates a registry without additional kinds.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Registers a kind. Its table in a file is parsed into a `P`; `build` creates the task from this `P`, the task's
    /// name, the model and the context. `P` determines if unknown keys are rejected
    /// (`#[serde(deny_unknown_fields)]`). Keys in errors are relative to the root of the file.
    ///
    /// # Errors
    /// A name that is already in use.
    pub fn register<P: DeserializeOwned + Send + Sync + 'static>(
        &mut self,
        kind: impl Into<String>,
        build: impl Fn(&P, &str, &Model, &ControlContext) -> Result<Box<dyn Task>, ControlError>
        + Send
        + Sync
        + 'static,
    ) -> Result<(), TaskKindError> {
        let kind = kind.into();
        if BUILT_IN.contains(&kind.as_str()) || self.0.contains_key(&kind) {
            return Err(TaskKindError::Taken { kind });
        }
        let build = Arc::new(build);
        let parser: Parser = Arc::new(move |table| {
            let (parameters, build) = (P::deserialize(Strict(table))?, Arc::clone(&build));
            Ok(Arc::new(move |name: &str, model: &Model, context: &ControlContext| {
                build(&parameters, name, model, context)
            }))
        });
        self.0.insert(kind, parser);
        Ok(())
    }

    /// Names of the registered kinds.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }

    /// Removes the tasks of registered kinds from a task file's document, and returns them.
    pub(crate) fn take(
        &self,
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
            let Some(parser) = self.0.get(&kind) else {
                // A misspelt setting may have made a task that the file does not have: it is reported as a setting.
                if !source.has_settings() {
                    self.check_built_in(source, &name, &kind)?;
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

    fn check_built_in(&self, source: &Source, name: &str, kind: &str) -> Result<(), FileError> {
        if BUILT_IN.contains(&kind) {
            return Ok(());
        }
        let registered: Vec<&str> = self.names().collect();
        let all: Vec<&str> = BUILT_IN.into_iter().chain(registered.iter().copied()).collect();
        let near = nearest(kind, &all).map(|near| format!("did you mean `{near}`? ")).unwrap_or_default();
        let registered = match registered.as_slice() {
            [] => "kinds of your own need the program that registers them".to_owned(),
            names => format!("registered: {}", names.join(", ")),
        };
        let help = format!("{near}Built in: {}; {registered}", BUILT_IN.join(", "));
        let key = ["task", name, kind];
        Err(FileError::at_key(source, key, format!("unknown task kind `{kind}`"), Some(help)))
    }
}

impl fmt::Debug for TaskKinds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.names()).finish()
    }
}

/// Returns the table at a key of a table.
fn table_mut<'a, 'i>(table: &'a mut DeTable<'i>, key: &str) -> Option<&'a mut DeTable<'i>> {
    match table.get_mut(key)?.get_mut() {
        DeValue::Table(table) => Some(table),
        _ => None,
    }
}
