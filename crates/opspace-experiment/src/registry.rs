//! Tables of what a program knows by name: its built-in entries, and those that a user adds.

use crate::suggest::choices;
use std::fmt;
use thiserror::Error;

/// Entry of a [`Registry`].
pub trait Named {
    /// Name in files, on the command line and in errors.
    fn name(&self) -> &str;
}

/// Entries of one kind, each with a name of its own, in the order in which they were registered.
#[derive(Clone)]
pub struct Registry<T> {
    kind: &'static str,
    entries: Vec<T>,
}

/// Reason why an entry cannot be registered.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("the {kind} '{name}' already exists")]
#[non_exhaustive]
pub struct NameTaken {
    /// Kind of the entries, for example "task kind".
    pub kind: &'static str,
    /// Name of the entry.
    pub name: String,
}

impl<T: Named> Registry<T> {
    /// Creates a table with entries of a kind, which is named in errors.
    ///
    /// # Panics
    /// If two entries have the same name.
    #[must_use]
    pub fn new(kind: &'static str, entries: Vec<T>) -> Self {
        let mut new = Self { kind, entries: Vec::new() };
        entries.into_iter().for_each(|entry| new.add(entry));
        new
    }

    /// Adds an entry whose name is known to be free.
    ///
    /// # Panics
    /// If the name is already in use.
    pub fn add(&mut self, entry: T) {
        if let Err(taken) = self.register(entry) {
            panic!("{taken}");
        }
    }

    /// Adds an entry.
    ///
    /// # Errors
    /// A name that is already in use.
    pub fn register(&mut self, entry: T) -> Result<(), NameTaken> {
        if self.get(entry.name()).is_some() {
            return Err(NameTaken { kind: self.kind, name: entry.name().to_owned() });
        }
        self.entries.push(entry);
        Ok(())
    }

    /// Returns the entry with this name, if there is one.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&T> {
        self.iter().find(|entry| entry.name() == name)
    }

    /// Returns the entry with this name.
    ///
    /// # Errors
    /// An unknown name: the text says what is unknown, and which names there are.
    pub fn find(&self, name: &str) -> Result<&T, UnknownName> {
        self.get(name).ok_or_else(|| UnknownName {
            kind: self.kind,
            name: name.to_owned(),
            help: choices(name, self.names()),
        })
    }

    /// Entries in their order.
    pub fn iter(&self) -> std::slice::Iter<'_, T> {
        self.entries.iter()
    }

    /// Names of the entries in their order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.iter().map(Named::name)
    }
}

/// Name that no entry has.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("unknown {kind} '{name}'")]
#[non_exhaustive]
pub struct UnknownName {
    /// Kind of the entries.
    pub kind: &'static str,
    /// Unknown name.
    pub name: String,
    /// Similar name, if there is one, and all names.
    pub help: String,
}

impl<T: Named> fmt::Debug for Registry<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.names()).finish()
    }
}

impl<T: Named + ?Sized> Named for Box<T> {
    fn name(&self) -> &str {
        (**self).name()
    }
}

#[cfg(test)]
mod tests {
    use super::{Named, Registry};

    impl Named for &str {
        fn name(&self) -> &str {
            self
        }
    }

    /// Compared: the entries found, and those registered.
    #[test]
    fn entries_are_found_by_name() {
        let mut table = Registry::new("plant", vec!["own"]);
        table.register("mujoco").expect("a new name");
        assert_eq!(table.names().collect::<Vec<_>>(), ["own", "mujoco"]);
        assert_eq!(table.get("mujoco"), Some(&"mujoco"));
        assert_eq!(
            table.register("own").expect_err("a taken name").to_string(),
            "the plant 'own' already exists"
        );
        let unknown = table.find("mujocco").expect_err("an unknown name");
        assert_eq!(unknown.to_string(), "unknown plant 'mujocco'");
        assert_eq!(unknown.help, "did you mean 'mujoco'? There are: own, mujoco");
    }
}
