//! Drivers and tasks defined by the user, compiled into the program.

use crate::files::task_kinds::TaskKinds;
use crate::registry::{Named, Registry};
use opspace_backend::Driver;

/// Tables to which a program adds entries of its own. Those of the built-in entries are in them from the start.
#[derive(Debug)]
#[non_exhaustive]
pub struct Extensions {
    /// Robot drivers, which `[driver]` of robot.toml selects.
    pub drivers: Registry<Box<dyn Driver>>,
    /// Task kinds in addition to the built-in ones.
    pub tasks: TaskKinds,
}

impl Default for Extensions {
    fn default() -> Self {
        Self { drivers: Registry::new("driver", Vec::new()), tasks: TaskKinds::default() }
    }
}

impl Named for dyn Driver {
    fn name(&self) -> &str {
        Driver::name(self)
    }
}

impl Extensions {
    /// Replaces the additional task kinds.
    #[must_use]
    pub fn with_tasks(self, tasks: TaskKinds) -> Self {
        Self { tasks, ..self }
    }

    /// Adds a driver.
    ///
    /// # Panics
    /// If another driver has the same name; [`Registry::register`] returns this as an error.
    #[must_use]
    pub fn with_driver(mut self, driver: impl Driver + 'static) -> Self {
        self.drivers.add(Box::new(driver));
        self
    }
}
