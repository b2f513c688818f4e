//! Parts that the driver and the nodes of tasks of a program share.

use crate::node::Participants;
use crate::reports::Reports;
use crate::tare::Tare;

/// Parts that the driver and the nodes of tasks share.
#[derive(Clone, Default)]
pub struct Program {
    /// Participants of the nodes.
    pub participants: Participants,
    /// Sentences about the runs.
    pub reports: Reports,
    /// Tare of the force sensors.
    pub tare: Tare,
}
