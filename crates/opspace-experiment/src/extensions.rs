//! Drivers, tasks, transformers and plants of a program: the built-in ones, and those of the user.

use crate::files::task_kinds::TaskKinds;
use crate::plants::{self, PlantEntry};
use crate::registry::{Named, Registry};
use crate::transformers;
use crate::transformers::entry::TransformerEntry;
use opspace_backend::Driver;

/// Tables to which a program adds entries of its own. Those of the built-in entries are in them from the start.
#[derive(Debug)]
#[non_exhaustive]
pub struct Extensions {
    /// Robot drivers, which `[driver]` of robot.toml selects.
    pub drivers: Registry<Box<dyn Driver>>,
    /// Task kinds in addition to the built-in ones.
    pub tasks: TaskKinds,
    /// Plants of simulations, which `--plant` and `--plants` name.
    pub plants: Registry<PlantEntry>,
    /// Transformers, which `--transformer`, profiles, suites and experiments name.
    pub transformers: Registry<TransformerEntry>,
    /// True if tasks may use what exists for comparisons in simulation and can damage a real robot, on which it is refused all
    /// the same.
    pub has_comparisons: bool,
}

impl Default for Extensions {
    fn default() -> Self {
        Self {
            drivers: Registry::new("driver", Vec::new()),
            tasks: TaskKinds::default(),
            plants: plants::built_in(),
            transformers: transformers::built_in(),
            has_comparisons: false,
        }
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

    /// Adds a transformer.
    ///
    /// # Panics
    /// If another transformer has the same name; [`Registry::register`] returns this as an error.
    #[must_use]
    pub fn with_transformer(mut self, transformer: TransformerEntry) -> Self {
        self.transformers.add(transformer);
        self
    }

    /// Adds a plant.
    ///
    /// # Panics
    /// If another plant has the same name; [`Registry::register`] returns this as an error.
    #[must_use]
    pub fn with_plant(mut self, plant: PlantEntry) -> Self {
        self.plants.add(plant);
        self
    }

    /// Allows in simulation what exists only for comparisons: handlings of singularities that can damage a real robot.
    #[must_use]
    pub fn with_comparisons(self) -> Self {
        Self { has_comparisons: true, ..self }
    }
}
