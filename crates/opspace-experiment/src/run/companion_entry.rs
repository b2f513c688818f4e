//! Table of the companions that a program adds to runs.

use crate::extensions::Entry;
use crate::run::companion::Companion;
use crate::run::error::RunError;
use crate::run::execute::Progress;
use crate::run::scenario::Scenario;
use std::fmt;
use std::sync::Arc;

type Open = dyn Fn(&Scenario, &Progress) -> Result<Option<Box<dyn Companion>>, RunError> + Send + Sync;

/// Companion that a program adds to each run on real robots, by which targets enter from outside.
#[derive(Clone)]
pub struct CompanionEntry {
    name: &'static str,
    open: Arc<Open>,
}

impl CompanionEntry {
    /// Returns an entry. `open` gets the scenario and the flags of its stop requests before the robots are opened, and returns
    /// `None` for a scenario that needs no such companion.
    #[must_use]
    pub fn new(
        name: &'static str,
        open: impl Fn(&Scenario, &Progress) -> Result<Option<Box<dyn Companion>>, RunError>
        + Send
        + Sync
        + 'static,
    ) -> Self {
        Self { name, open: Arc::new(open) }
    }

    /// Opens the companion of a run, if it needs one.
    ///
    /// # Errors
    /// A companion that cannot be opened.
    pub fn open(
        &self,
        scenario: &Scenario,
        progress: &Progress,
    ) -> Result<Option<Box<dyn Companion>>, RunError> {
        (self.open)(scenario, progress)
    }
}

impl Entry for CompanionEntry {
    const KIND: &'static str = "companion";

    fn name(&self) -> &str {
        self.name
    }
}

impl fmt::Debug for CompanionEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CompanionEntry").field("name", &self.name).finish_non_exhaustive()
    }
}
