//! Tables of what a program knows by name: built-in entries, and those that a user adds.
//!
//! ```
//! use opspace_control::{ControlError, Reason};
//! use opspace_experiment::{Extensions, TaskKind};
//!
//! # #[derive(serde::Deserialize)]
//! # struct Parameters {}
//! let kind = TaskKind::new("distance", |_: &Parameters, _name, _model, _context| {
//!     Err(ControlError::new("task.NAME.distance", Reason::Value { message: "not built yet".to_owned() }))
//! });
//! let extensions = Extensions::default().with(kind);
//! assert!(extensions.names::<TaskKind>().any(|name| name == "distance"));
//! assert!(extensions.names::<TaskKind>().any(|name| name == "cartesian"), "a built-in kind");
//! ```

use crate::suggest::choices;
use opspace_backend::Driver;
use std::any::{Any, TypeId};
use std::collections::HashMap;
use std::fmt;
use std::ops::{Deref, DerefMut};
use std::sync::Arc;
use thiserror::Error;

/// Entry of a table: a type of entries has a table of its own.
pub trait Entry: Clone + Send + Sync + 'static {
    /// Kind of the entries, in errors: `task kind`.
    const KIND: &'static str;

    /// Entries that every program has, in the order in which they are listed.
    #[must_use]
    fn built_in() -> &'static [Self] {
        &[]
    }

    /// Name in files, on the command line and in errors.
    fn name(&self) -> &str;

    /// True if a name that both would have, other than [`name`](Self::name), is the same.
    fn shares_a_name(&self, _other: &Self) -> bool {
        false
    }
}

/// Everything that a program adds: entries of tables, and drivers, which need not be `Send`.
#[derive(Default)]
pub struct Extensions {
    tables: Tables,
    pub(crate) drivers: Vec<Box<dyn Driver>>,
}

/// One table for each type of [`Entry`], with the built-in entries before those that a program adds. Clones share the entries.
#[derive(Clone, Default)]
pub struct Tables {
    /// Added entries, a `Vec<T>` for the type `T`.
    added: HashMap<TypeId, Arc<dyn Any + Send + Sync>>,
    /// True if tasks may use what exists for comparisons in simulation and can damage a real robot, on which it is refused all
    /// the same.
    pub has_comparisons: bool,
}

/// Reason why an entry cannot be added.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("the {kind} '{name}' already exists{}", if *is_of_part { ", or a name that it brings" } else { "" })]
#[non_exhaustive]
pub struct NameTaken {
    /// Kind of the entries.
    pub kind: &'static str,
    /// Name of the entry.
    pub name: String,
    /// True if the name in use is not that of the entry, but one that it brings: that of a column.
    pub is_of_part: bool,
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

impl Extensions {
    /// Adds an entry whose name is free.
    ///
    /// # Panics
    /// If the name is already in use; [`Tables::add`] returns this as an error.
    #[must_use]
    pub fn with<T: Entry>(mut self, entry: T) -> Self {
        if let Err(taken) = self.add(entry) {
            panic!("{taken}");
        }
        self
    }

    /// Adds a driver whose name is free.
    ///
    /// # Panics
    /// If the name is already in use.
    #[must_use]
    pub fn with_driver(mut self, driver: impl Driver + 'static) -> Self {
        let name = driver.name();
        assert!(self.drivers.iter().all(|known| known.name() != name), "the driver '{name}' already exists");
        self.drivers.push(Box::new(driver));
        self
    }

    /// Drivers that the program has added.
    pub fn drivers(&self) -> impl Iterator<Item = &dyn Driver> {
        self.drivers.iter().map(AsRef::as_ref)
    }

    /// Allows in simulation what exists only for comparisons: handlings of singularities that can damage a real robot.
    #[must_use]
    pub fn with_comparisons(mut self) -> Self {
        self.tables.has_comparisons = true;
        self
    }
}

impl Deref for Extensions {
    type Target = Tables;

    fn deref(&self) -> &Tables {
        &self.tables
    }
}

impl DerefMut for Extensions {
    fn deref_mut(&mut self) -> &mut Tables {
        &mut self.tables
    }
}

impl Tables {
    /// Adds an entry.
    ///
    /// # Errors
    /// A name that is already in use.
    pub fn add<T: Entry>(&mut self, entry: T) -> Result<(), NameTaken> {
        let name = entry.name();
        if self.get::<T>(name).is_some() {
            return Err(NameTaken { kind: T::KIND, name: name.to_owned(), is_of_part: false });
        }
        if self.all::<T>().any(|known| known.shares_a_name(&entry)) {
            return Err(NameTaken { kind: T::KIND, name: name.to_owned(), is_of_part: true });
        }
        let mut table = self.added::<T>().to_vec();
        table.push(entry);
        self.added.insert(TypeId::of::<T>(), Arc::new(table));
        Ok(())
    }

    /// Entries that the program has added, in their order.
    #[must_use]
    pub fn added<T: Entry>(&self) -> &[T] {
        let table = self.added.get(&TypeId::of::<T>());
        table.and_then(|table| table.downcast_ref::<Vec<T>>()).map_or(&[], Vec::as_slice)
    }

    /// All entries, the built-in ones first.
    pub fn all<T: Entry>(&self) -> impl Iterator<Item = &T> {
        T::built_in().iter().chain(self.added())
    }

    /// Names of all entries.
    pub fn names<T: Entry>(&self) -> impl Iterator<Item = &str> {
        self.all::<T>().map(Entry::name)
    }

    /// Returns the entry with this name, if there is one.
    #[must_use]
    pub fn get<T: Entry>(&self, name: &str) -> Option<&T> {
        self.all::<T>().find(|entry| entry.name() == name)
    }

    /// Returns the entry with this name.
    ///
    /// # Errors
    /// A name that no entry has, with the names that there are.
    pub fn find<T: Entry>(&self, name: &str) -> Result<&T, UnknownName> {
        self.get(name).ok_or_else(|| UnknownName {
            kind: T::KIND,
            name: name.to_owned(),
            help: choices(name, self.names::<T>()),
        })
    }
}

impl fmt::Debug for Extensions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let drivers: Vec<&str> = self.drivers.iter().map(|driver| driver.name()).collect();
        f.debug_struct("Extensions").field("tables", &self.tables).field("drivers", &drivers).finish()
    }
}

impl fmt::Debug for Tables {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Tables({})", self.added.len())
    }
}

#[cfg(test)]
mod tests {
    use super::{Entry, Extensions};

    #[derive(Clone, Debug, PartialEq)]
    struct Plant(&'static str);

    impl Entry for Plant {
        const KIND: &'static str = "plant";

        fn built_in() -> &'static [Self] {
            &[Plant("own")]
        }

        fn name(&self) -> &str {
            self.0
        }
    }

    /// Compared: the entries found, and those built in and added.
    #[test]
    fn entries_are_found_by_name() {
        let mut extensions = Extensions::default().with(Plant("mujoco"));
        assert_eq!(extensions.names::<Plant>().collect::<Vec<_>>(), ["own", "mujoco"]);
        assert_eq!(extensions.get("mujoco"), Some(&Plant("mujoco")));
        for taken in ["own", "mujoco"] {
            let error = extensions.add(Plant(taken)).expect_err("a taken name").to_string();
            assert_eq!(error, format!("the plant '{taken}' already exists"));
        }
        let unknown = extensions.find::<Plant>("mujocco").expect_err("an unknown name");
        assert_eq!(unknown.to_string(), "unknown plant 'mujocco'");
        assert_eq!(unknown.help, "did you mean 'mujoco'? There are: own, mujoco");
    }
}
