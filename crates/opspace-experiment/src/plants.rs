//! Plants that a program knows by name: the library's own, and other physics engines.

use crate::extensions::Entry;
use opspace_sim::{PhysicsEngine, RigidEngine};
use std::error::Error;
use std::fmt;
use std::sync::{Arc, LazyLock};

/// Opened physics engine, or the reason why there is none.
pub type Opened = Result<Arc<dyn PhysicsEngine>, Box<dyn Error + Send + Sync>>;

type Open = dyn Fn(Option<&str>) -> Opened + Send + Sync;

/// Plant of a program, `NAME` or `NAME:ARGUMENT` on the command line: rigid bodies and contacts of a simulation.
#[derive(Clone)]
pub struct PlantEntry {
    name: &'static str,
    argument: Option<&'static str>,
    description: &'static str,
    open: Arc<Open>,
}

impl PlantEntry {
    /// Returns a plant without an argument; `open` gets `None`.
    #[must_use]
    pub fn new(
        name: &'static str,
        description: &'static str,
        open: impl Fn(Option<&str>) -> Opened + Send + Sync + 'static,
    ) -> Self {
        Self { name, argument: None, description, open: Arc::new(open) }
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

impl Entry for PlantEntry {
    const KIND: &'static str = "plant";

    fn built_in() -> &'static [Self] {
        static OWN: LazyLock<[PlantEntry; 1]> = LazyLock::new(|| {
            let open = |_: Option<&str>| Ok(Arc::new(RigidEngine) as Arc<dyn PhysicsEngine>);
            [PlantEntry::new(RigidEngine::NAME, "the library's own plant", open)]
        });
        &*OWN
    }

    fn name(&self) -> &str {
        self.name
    }
}

impl fmt::Debug for PlantEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PlantEntry").field("name", &self.name).finish_non_exhaustive()
    }
}
