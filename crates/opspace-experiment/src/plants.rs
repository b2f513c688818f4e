//! Plants that a program knows by name: the library's own, and other physics engines.

use crate::registry::{Named, Registry};
use opspace_sim::{PhysicsEngine, RigidEngine};
use std::error::Error;
use std::fmt;
use std::sync::Arc;

/// Opened physics engine, or the reason why there is none.
pub type Opened = Result<Arc<dyn PhysicsEngine>, Box<dyn Error + Send + Sync>>;

type Open = dyn Fn(Option<&str>) -> Opened + Send + Sync;

/// Plant of a program, `NAME` or `NAME:ARGUMENT` on the command line: rigid bodies and contacts of a simulation.
pub struct PlantEntry {
    name: &'static str,
    argument: Option<&'static str>,
    description: &'static str,
    open: Box<Open>,
}

impl PlantEntry {
    /// Returns a plant without an argument; `open` gets `None`.
    #[must_use]
    pub fn new(
        name: &'static str,
        description: &'static str,
        open: impl Fn(Option<&str>) -> Opened + Send + Sync + 'static,
    ) -> Self {
        Self { name, argument: None, description, open: Box::new(open) }
    }

    /// Returns the plant with an argument that may follow its name, for example `SCENE.xml`.
    #[must_use]
    pub fn with_argument(self, argument: &'static str) -> Self {
        Self { argument: Some(argument), ..self }
    }

    /// Description in one line.
    #[must_use]
    pub fn description(&self) -> &'static str {
        self.description
    }

    /// Name of the argument that may follow, if any.
    #[must_use]
    pub fn argument(&self) -> Option<&'static str> {
        self.argument
    }

    /// Forms on the command line, for example `mujoco` and `mujoco:SCENE.xml`.
    #[must_use]
    pub fn forms(&self) -> Vec<String> {
        let with_argument = self.argument.map(|argument| format!("{}:{argument}", self.name));
        std::iter::once(self.name.to_owned()).chain(with_argument).collect()
    }

    /// Opens the physics engine.
    ///
    /// # Errors
    /// An engine that is not installed, or an argument that it cannot use.
    pub fn open(&self, argument: Option<&str>) -> Opened {
        (self.open)(argument)
    }
}

/// Plants of every program.
#[must_use]
pub fn built_in() -> Registry<PlantEntry> {
    let own = PlantEntry::new(RigidEngine::NAME, "the library's own plant", |_| Ok(Arc::new(RigidEngine)));
    Registry::new("plant", vec![own])
}

impl Named for PlantEntry {
    fn name(&self) -> &str {
        self.name
    }
}

impl fmt::Debug for PlantEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PlantEntry").field("name", &self.name).finish_non_exhaustive()
    }
}
