//! Drivers and tasks defined by the user, compiled into the program.

use crate::files::task_kinds::TaskKinds;
use opspace_backend::Driver;
use std::fmt;

/// Drivers that `[driver]` of robot.toml can select, and task kinds that task files can use.
#[derive(Default)]
#[non_exhaustive]
pub struct Extensions {
    /// Robot drivers.
    pub drivers: Vec<Box<dyn Driver>>,
    /// Task kinds in addition to the built-in ones.
    pub tasks: TaskKinds,
}

impl Extensions {
    /// Replaces the additional task kinds.
    #[must_use]
    pub fn with_tasks(self, tasks: TaskKinds) -> Self {
        Self { tasks, ..self }
    }

    /// Adds a driver.
    #[must_use]
    pub fn with_driver(mut self, driver: impl Driver + 'static) -> Self {
        self.drivers.push(Box::new(driver));
        self
    }
}

impl fmt::Debug for Extensions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let drivers: Vec<&str> = self.drivers.iter().map(|driver| driver.name()).collect();
        f.debug_struct("Extensions").field("drivers", &drivers).finish()
    }
}
