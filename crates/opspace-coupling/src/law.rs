//! The interface of the laws of couplings. A law is an implementation of [`CouplingLaw`] in a file of its own.

use crate::coupled_parameters::CouplingSide;
use crate::coupled_rows::RowState;
use crate::packet_fields::RowField;
use crate::received::{Packet, ReceivedState};
use nalgebra::Vector6;
use opspace_backend::SignalRecorder;
use std::any::Any;
use std::fmt::Debug;

/// Law of one side of a coupling, with its state.
pub(crate) trait CouplingLaw: Any + Debug + Send + Sync {
    fn side(&self) -> CouplingSide;

    /// Fields of its packets beyond those of each law.
    fn further(&self) -> &'static [RowField];

    /// Those of [`further`](Self::further) without which a packet counts as lost: the first ones.
    fn needed(&self) -> &'static [RowField] {
        self.further()
    }

    /// True if the law continues with a partner whose program has begun anew, with other positions.
    fn meets_other_sessions(&self) -> bool;

    /// Reference of the rows, m or rad.
    fn reference(&self) -> Vector6<f64>;

    /// Packet for the other robot, without number, times and sessions.
    fn sent(&self, state: &RowState) -> Packet;

    /// Starts with zero displacement and an open coupling, in the session `clock_s` (s), at `time_s` since the start of control.
    fn start(&mut self, clock_s: f64, time_s: f64);

    /// Closes again after an interruption, from where the robot is.
    fn resume(&mut self, _state: &RowState, _time_s: f64) {}

    /// Continues from the law of another task set, if it is the same.
    fn inherit(&mut self, before: &dyn CouplingLaw);

    /// Returns force (N, Nm) and acceleration (m/s², rad/s²) of the rows in a cycle.
    fn update(&mut self, cycle: &Cycle<'_>) -> (Vector6<f64>, Vector6<f64>);

    /// Cycle in which the robot is held: the coupling is open.
    fn rest(&mut self, state: &RowState, partner: &ReceivedState, clock_s: f64);

    /// Notes the force that limits of the robot have taken from the rows in this cycle: it does no work.
    fn take_force(&mut self, _taken: &Vector6<f64>) {}

    /// Records what only this law has.
    fn record(&self, name: &str, out: &mut SignalRecorder<'_>);

    /// Returns a copy.
    fn boxed(&self) -> Box<dyn CouplingLaw>;
}

impl Clone for Box<dyn CouplingLaw> {
    fn clone(&self) -> Self {
        (**self).boxed()
    }
}

/// State of the robot and of its partner in a cycle, for the law.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cycle<'a> {
    pub(crate) state: &'a RowState,
    pub(crate) partner: &'a ReceivedState,
    /// Clutch of the robot's own operator, true if it is open; `None` for the times in the file.
    pub(crate) clutch_open: Option<bool>,
    /// Force against which the task's damping moves, N or Nm: the law subtracts it.
    pub(crate) damping: Vector6<f64>,
    /// Time since the start of control, and on the robot's clock, s.
    pub(crate) time_s: f64,
    pub(crate) clock_s: f64,
}
