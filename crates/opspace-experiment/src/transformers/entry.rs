//! Entry of the table of transformers.

use crate::files::source::FileError;
use crate::transformers::setup::TransformerSetup;
use opspace_transformer::{Transformer, TransformerName};
use std::fmt;
use std::sync::Arc;

/// Built transformer, or the reason why it does not suit the robot.
pub type Built = Result<Box<dyn Transformer>, FileError>;

type Build = dyn Fn(&TransformerSetup<'_>) -> Built + Send + Sync;

/// Requirements of a transformer on the robot, which are checked before it is built, and properties that the predictions of
/// `opspace check` use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TransformerTraits {
    /// True if it needs measured motor current.
    pub needs_current: bool,
    /// True if it needs the delay until a setpoint acts.
    pub needs_delay: bool,
    /// True if it needs the measured closed loop of each joint's position servo.
    pub needs_closed_loops: bool,
    /// True if it evaluates the law of each servo up to the next setpoint.
    pub evaluates_servo_law: bool,
    /// True if it estimates the velocities of the joints.
    pub estimates_velocity: bool,
    /// True if it can adapt the gains of the servos (`adapt_gains` of a profile).
    pub adapts_gains: bool,
    /// True if it can damage a real robot: it is then refused on one.
    pub simulation_only: bool,
}

/// Transformer of a program: its name, one line about it, its requirements, and its construction.
#[derive(Clone)]
pub struct TransformerEntry {
    name: TransformerName,
    description: &'static str,
    traits: TransformerTraits,
    build: Arc<Build>,
}

impl TransformerEntry {
    /// Returns an entry without requirements. `build` returns an error for a robot that the transformer does not suit.
    #[must_use]
    pub fn new(
        name: impl Into<TransformerName>,
        description: &'static str,
        build: impl Fn(&TransformerSetup<'_>) -> Built + Send + Sync + 'static,
    ) -> Self {
        let traits = TransformerTraits::default();
        Self { name: name.into(), description, traits, build: Arc::new(build) }
    }

    /// Returns the entry with requirements and properties.
    #[must_use]
    pub fn with_traits(self, traits: TransformerTraits) -> Self {
        Self { traits, ..self }
    }

    /// Returns an entry for the same transformer with its torques corrected by measured motor current.
    #[must_use]
    pub fn with_current_feedback(&self, description: &'static str) -> Self {
        let plain = Arc::clone(&self.build);
        Self {
            name: self.name.with_current(true),
            description,
            traits: TransformerTraits { needs_current: true, ..self.traits },
            build: Arc::new(move |setup| Ok(setup.with_current_feedback(plain(setup)?))),
        }
    }

    /// Name in files and on the command line.
    #[must_use]
    pub fn transformer_name(&self) -> &TransformerName {
        &self.name
    }

    /// Description in one line.
    #[must_use]
    pub fn description(&self) -> &'static str {
        self.description
    }

    /// Requirements and properties.
    #[must_use]
    pub fn traits(&self) -> TransformerTraits {
        self.traits
    }

    /// Builds the transformer.
    ///
    /// # Errors
    /// A robot that it does not suit.
    pub fn build(&self, setup: &TransformerSetup<'_>) -> Built {
        (self.build)(setup)
    }
}

impl fmt::Debug for TransformerEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("TransformerEntry")
            .field("name", &self.name)
            .field("traits", &self.traits)
            .finish_non_exhaustive()
    }
}
