//! True state of the robot, which is known only in a simulation.

use crate::signal::Layout;

/// Rows of the true state, for logs and metrics. Controllers have no access to them.
pub trait GroundTruth {
    /// Returns the layouts of the rows. Called once, before the run.
    fn layouts(&self) -> TruthLayouts;

    /// Visits the rows of the last [`read`](crate::Backend::read), including those of missed cycles, in chronological
    /// order. Does not allocate.
    fn visit(&self, visit: &mut dyn FnMut(TruthRow<'_>));

    /// Returns the number of the interface cycle of the next sample, counted from 0; `None` if the simulation does not
    /// know it. Cycles with lower numbers that have not been read are lost on the simulated bus: a program that reads
    /// several robots on one clock skips them.
    fn next_sample_cycle(&self) -> Option<u64> {
        None
    }
}

/// Layouts of the rows of a simulation.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct TruthLayouts {
    /// Layout of the true state at each interface cycle.
    pub truth: Layout,
    /// Layout of the states of the drives at each servo tick.
    pub servo: Layout,
    /// Layout of the external forces that are applied during the run; `None` if the simulation does not allow any.
    pub external: Option<Layout>,
}

impl TruthLayouts {
    /// Returns the layouts of a simulation without external forces.
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

/// A row of a simulation. All times are on the robot's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum TruthRow<'a> {
    /// The true state at an interface cycle, with the layout [`TruthLayouts::truth`].
    State {
        /// Time, s.
        time_s: f64,
        /// Values.
        row: &'a [f64],
    },
    /// The states of the drives in one servo period, with the layout [`TruthLayouts::servo`].
    Servo {
        /// Time at the beginning of the period, s.
        time_s: f64,
        /// Number of the command in effect, counted from 1 and including [`Hold`](crate::Command::Hold) commands.
        /// `None` while the robot holds itself: before the first command and after a stop.
        command: Option<u64>,
        /// Values.
        row: &'a [f64],
    },
    /// The external forces in an interface cycle, with the layout [`TruthLayouts::external`].
    External {
        /// Time, s.
        time_s: f64,
        /// Values.
        row: &'a [f64],
    },
}
