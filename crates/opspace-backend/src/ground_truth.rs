//! The true state behind the interface, which only a simulation has.

use crate::signal::Layout;

/// Rows of the true state, for logs and metrics. A controller never sees them.
pub trait GroundTruth {
    /// The layouts of the rows. Called once, before the run.
    fn layouts(&self) -> TruthLayouts;

    /// Visits the rows that belong to the last [`read`](crate::Backend::read), those of missed cycles included, in the
    /// order of time. Allocates nothing.
    fn visit(&self, visit: &mut dyn FnMut(TruthRow<'_>));

    /// Number of the interface cycle of the next sample, where the simulation knows it; the first cycle is 0. The
    /// simulated bus loses the cycles with lower numbers that were not read: several robots on one clock are read
    /// without them.
    fn next_sample_cycle(&self) -> Option<u64> {
        None
    }
}

/// The layouts of the rows of a simulation.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct TruthLayouts {
    /// True state at each interface cycle.
    pub truth: Layout,
    /// The drives at each servo tick.
    pub servo: Layout,
    /// External forces that were put in while it runs, where there can be any.
    pub external: Option<Layout>,
}

impl TruthLayouts {
    /// The layouts of a simulation without external forces.
    #[must_use]
    pub fn new(truth: Layout, servo: Layout) -> Self {
        Self { truth, servo, external: None }
    }

    /// Adds a layout of external forces.
    #[must_use]
    pub fn with_external(self, external: Layout) -> Self {
        Self { external: Some(external), ..self }
    }
}

/// A row of a simulation. `time_s` is on the robot's clock, s.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum TruthRow<'a> {
    /// The true state at an interface cycle, as [`TruthLayouts::truth`].
    State {
        /// Time, s.
        time_s: f64,
        /// Values.
        row: &'a [f64],
    },
    /// The drives in one servo period, as [`TruthLayouts::servo`].
    Servo {
        /// Time at the beginning of the period, s.
        time_s: f64,
        /// Number of the command in force: 1 is the first that was written, holds included. `None` while the robot
        /// holds itself, before the first command and after a stop.
        command: Option<u64>,
        /// Values.
        row: &'a [f64],
    },
    /// The external forces of an interface cycle, as [`TruthLayouts::external`].
    External {
        /// Time, s.
        time_s: f64,
        /// Values.
        row: &'a [f64],
    },
}
