//! Task that is coupled with a task of another robot: haptic teleoperation, or an object that both carry.
//!
//! Its rows command the forces of the law (`teleoperation.rs`, `carry.rs`), and a damping. What the other robot sent is
//! an input of the task, so that a log contains all that is needed to compute the run again. Without a partner, and while
//! the coupling is open, a leader is a compliant handle, and a follower holds its place by the coupling's spring.

use crate::carry::{self, Carry};
use crate::coupled_parameters::{CoupledParameters, CouplingSide};
use crate::coupled_rows::{CoupledRows, RowState};
use crate::error::Mistake;
use crate::law::{CouplingLaw, Cycle};
use crate::packet_fields::{Incomplete, NUMBERS, ROWS, RowField, RowUnit, packet};
use crate::received::{Packet, ReceivedState};
use crate::teleoperation::{self, Teleoperation};
use nalgebra::{Matrix6, Matrix6xX, Vector6};
use opspace_backend::signal_names::{self, DISPLACEMENT, PACKET_AGE, PACKETS_LOST, REFERENCE, SENSED_FORCE};
use opspace_backend::{Signal, SignalRecorder};
use opspace_control::{ControlContext, ControlError, ControlInput, Task, TaskInput, TaskSignals};
use opspace_model::{Data, Model};
use std::any::Any;
use std::f64::consts::TAU;

/// Input of the robot's own operator: 1 to open the clutch, 0 to close it, NaN for the times in the file.
const CLUTCH: &str = "clutch_open";

/// Law of a coupling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum CouplingKind {
    /// Haptic teleoperation.
    Teleoperation,
    /// Two robots carry an object.
    Carry,
}

impl CouplingKind {
    /// Signals of a coupled task that its partner receives, without the name of the task, and the inputs to which they are
    /// copied.
    #[must_use]
    pub fn packet_signals(self) -> Vec<(&'static str, &'static str)> {
        let further: &[RowField] = match self {
            Self::Teleoperation => &teleoperation::FURTHER,
            Self::Carry => &carry::FURTHER,
        };
        let numbers = NUMBERS.iter().map(|field| (field.signal, field.input));
        let rows = ROWS.iter().chain(further).map(|field| (field.signal, field.input));
        numbers.chain(rows).collect()
    }
}

/// A frame, or some joints, coupled with a task of another robot: see [`CoupledParameters`].
#[derive(Clone, Debug)]
pub struct CoupledTask {
    name: String,
    rows: CoupledRows,
    row_names: Vec<String>,
    position_units: Vec<&'static str>,
    /// Damping of each row, Ns/m or Nms/rad.
    damping: Vector6<f64>,
    law: Option<Box<dyn CouplingLaw>>,
    state: RowState,
    partner: ReceivedState,
    /// Time of the start on the robot's clock, s; NaN before it. Distinguishes this run from earlier ones of the program.
    session: f64,
    /// Cycles since the start: the number of the packet.
    sequence: u64,
    clock_s: f64,
    /// Force (N, Nm) and acceleration (m/s², rad/s²) of the rows.
    force: Vector6<f64>,
    acceleration: Vector6<f64>,
}

impl CoupledTask {
    /// Creates the task from its parameters.
    ///
    /// # Errors
    /// Unknown names, contradicting values, a coupling that needs a sensor which the task does not name.
    pub fn new(
        name: &str,
        parameters: &CoupledParameters,
        model: &Model,
        context: &ControlContext,
    ) -> Result<Self, ControlError> {
        let key = format!("task.{name}.coupled");
        let rows = CoupledRows::new(parameters, model, context, &key)?;
        let is_linear = |row: usize| rows.names().get(row).is_some_and(|(_, unit)| *unit == "m");
        let of_rows = |linear: f64, angular: f64| {
            Vector6::from_fn(|row, _| if is_linear(row) { linear } else { angular })
        };
        let damping = of_rows(parameters.damping_ns_per_m.get(), parameters.damping_nms_per_rad.get());
        let (law, timeout_s): (Option<Box<dyn CouplingLaw>>, f64) =
            match (parameters.side, &parameters.teleoperation, &parameters.carry) {
                (None, None, None) => (None, 0.0),
                (Some(side), Some(p), None) => {
                    let spring = of_rows(p.stiffness_n_per_m.get(), p.stiffness_nm_per_rad.get());
                    let damper = of_rows(p.damping_ns_per_m.get(), p.damping_nms_per_rad.get());
                    let angular = std::array::from_fn(|row| !is_linear(row));
                    let lag_s = 1.0 / (TAU * parameters.filter_hz.get());
                    let law = Teleoperation::new(
                        (side, p),
                        [spring, damper],
                        (&angular, rows.is_sensed(), rows.is_measured()),
                        (context, lag_s),
                        &format!("{key}.teleoperation"),
                    )?;
                    (Some(Box::new(law)), p.timeout_s.get())
                }
                (Some(side), None, Some(p)) => {
                    if !rows.is_of_position() || !rows.is_sensed() {
                        return Err(ControlError::new(key, Mistake::CarryRows));
                    }
                    let law = Carry::new(side, p, context.period_s, &format!("{key}.carry"))?;
                    (Some(Box::new(law)), p.timeout_s.get())
                }
                _ => return Err(ControlError::new(key, Mistake::Side)),
            };
        let position_units: Vec<_> = rows.names().iter().map(|(_, unit)| *unit).collect();
        Ok(Self {
            name: name.to_owned(),
            row_names: rows.names().iter().map(|(name, _)| name.clone()).collect(),
            position_units,
            rows,
            damping,
            law,
            state: RowState::default(),
            partner: ReceivedState::new(timeout_s),
            session: f64::NAN,
            sequence: 0,
            clock_s: 0.0,
            force: Vector6::zeros(),
            acceleration: Vector6::zeros(),
        })
    }

    /// Side of the robot in its coupling, if it has one.
    #[must_use]
    pub fn side(&self) -> Option<CouplingSide> {
        self.law.as_ref().map(|law| law.side())
    }

    /// Packet that `law` sends in this cycle.
    fn sent(&self, law: &dyn CouplingLaw) -> Packet {
        let partner = self.partner.newest();
        Packet {
            session: self.session,
            partner_session: partner.map_or(f64::NAN, |packet| packet.session),
            sequence: self.sequence,
            sent_s: self.clock_s,
            echo_s: partner.map_or(f64::NAN, |packet| packet.sent_s),
            ..law.sent(&self.state)
        }
    }

    /// Signal with one value per row.
    fn signal(&self, name: impl Into<String>, unit: RowUnit) -> Signal {
        let of_rows = |linear: &str, angular: &str| -> Vec<String> {
            let unit = |position| if position == "m" { linear } else { angular };
            self.position_units.iter().map(|&position| unit(position).to_owned()).collect()
        };
        let units = match unit {
            RowUnit::Position => of_rows("m", "rad"),
            RowUnit::Velocity => of_rows("m/s", "rad/s"),
            RowUnit::Force => of_rows("N", "Nm"),
            RowUnit::All(unit) => of_rows(unit, unit),
        };
        Signal::new(name, &units, &self.row_names)
    }

    fn record_rows(
        &self,
        (quantity, unit): (&str, RowUnit),
        values: &Vector6<f64>,
        out: &mut SignalRecorder<'_>,
    ) {
        let signal = || self.signal(signal_names::of(&self.name, quantity), unit);
        out.signal_with(signal, &values.as_slice()[..self.count()]);
    }

    fn count(&self) -> usize {
        self.row_names.len()
    }

    /// Updates the state, and takes the packet of this cycle.
    fn receive(&mut self, input: &TaskInput<'_>) {
        self.state = self.rows.update(&input.control);
        self.sequence += 1;
        self.clock_s = input.control.clock_s;
        let Some(law) = &self.law else { return };
        let Some(packet) = packet(input.target.values, self.count(), law.needed()) else { return };
        let session = packet.map_or_else(|incomplete| incomplete.session, |packet| packet.session);
        if !law.meets_other_sessions() && self.partner.is_of_other_session(session) {
            return;
        }
        match packet {
            Ok(packet) => _ = self.partner.accept(&packet, self.clock_s),
            Err(Incomplete { session, sequence }) => self.partner.lose(session, sequence),
        }
    }

    /// Clutch of the robot's own operator, if one is streamed.
    fn clutch(&self, values: &[f64]) -> Option<bool> {
        values.last().filter(|open| open.is_finite()).map(|open| *open != 0.0)
    }
}

impl CoupledTask {
    /// Records displacement, velocity and law.
    fn record_motion(&self, out: &mut SignalRecorder<'_>) {
        self.record_rows((DISPLACEMENT, RowUnit::Position), &self.state.position, out);
        let Some(law) = self.law.as_deref() else { return };
        self.record_rows((REFERENCE, RowUnit::Position), &law.reference(), out);
        let mut sent = self.sent(law);
        for field in &NUMBERS {
            out.scalar((&self.name, field.signal), field.unit, (field.get)(&sent));
        }
        for field in &ROWS {
            self.record_rows((field.signal, field.unit), (field.of)(&mut sent), out);
        }
        out.scalar((&self.name, PACKETS_LOST), "1", self.partner.missing() as f64);
        out.scalar((&self.name, PACKET_AGE), "s", self.partner.age_s(self.clock_s).unwrap_or(f64::NAN));
        law.record(&self.name, out);
        for field in law.further() {
            self.record_rows((field.signal, field.unit), (field.of)(&mut sent), out);
        }
    }
}

impl Task for CoupledTask {
    fn name(&self) -> &str {
        &self.name
    }

    fn rows(&self) -> usize {
        self.count()
    }

    fn jacobian(&self, model: &Model, data: &Data, rows: &mut Matrix6xX<f64>) {
        self.rows.jacobian(model, data, rows);
    }

    fn update(&mut self, input: &TaskInput<'_>) {
        self.receive(input);
        let damping = self.damping.component_mul(&self.state.velocity);
        let cycle = Cycle {
            state: &self.state,
            partner: &self.partner,
            clutch_open: self.clutch(input.target.values),
            damping,
            time_s: input.control.measurement.time_s,
            clock_s: self.clock_s,
        };
        (self.force, self.acceleration) = match &mut self.law {
            None => (-damping, Vector6::zeros()),
            Some(law) => law.update(&cycle),
        };
    }

    fn observe(&mut self, input: &TaskInput<'_>) {
        self.receive(input);
        (self.force, self.acceleration) = (Vector6::zeros(), Vector6::zeros());
        if let Some(law) = &mut self.law {
            law.rest(&self.state, &self.partner, self.clock_s);
        }
    }

    /// The packet that was sent contains the predicted state, in which the force acts.
    fn observe_measurement(&mut self, _input: &TaskInput<'_>) {}

    fn bias(&self, model: &Model, data: &Data) -> Vector6<f64> {
        self.rows.bias(model, data)
    }

    /// The rows are at rest for inverse kinematics and for previews.
    fn kinematic_target(&self, _model: &Model, _data: &Data, _gain_per_s: f64) -> Vector6<f64> {
        Vector6::zeros()
    }

    fn kinematic_infeasibility(&self) -> Option<ControlError> {
        Some(ControlError::new(format!("task.{}.coupled", self.name), Mistake::Kinematics))
    }

    fn acceleration(&self) -> Vector6<f64> {
        self.acceleration
    }

    fn yields_to_force(&self, _row: usize) -> bool {
        true
    }

    fn force(&self, _task_inertia: &Matrix6<f64>) -> Option<Vector6<f64>> {
        Some(Vector6::from_fn(|row, _| self.force[row] / self.rows.scale(row)))
    }

    fn set_force_taken(&mut self, force: &Vector6<f64>) {
        if let Some(law) = &mut self.law {
            law.take_force(&Vector6::from_fn(|row, _| force[row] * self.rows.scale(row)));
        }
    }

    fn start(&mut self, input: &ControlInput<'_>) {
        self.rows.start(input);
        self.partner.restart();
        self.state = self.rows.update(input);
        self.sequence = 0;
        self.session = input.clock_s;
        if let Some(law) = &mut self.law {
            law.start(input.clock_s, input.measurement.time_s);
        }
    }

    /// The coupling closes again from where the robot is.
    fn resume(&mut self, input: &ControlInput<'_>) {
        if let Some(law) = &mut self.law {
            law.resume(&self.state, input.measurement.time_s);
        }
    }

    fn inherit(&mut self, before: &mut dyn Task, input: &ControlInput<'_>) {
        match (before as &mut dyn Any).downcast_mut::<Self>() {
            Some(before) if before.row_names == self.row_names && before.side() == self.side() => {
                self.rows = before.rows.clone();
                self.partner = before.partner;
                (self.session, self.sequence) = (before.session, before.sequence);
                self.state = before.state;
                if let (Some(law), Some(before)) = (&mut self.law, before.law.as_deref()) {
                    law.inherit(before);
                }
            }
            _ => self.start(input),
        }
    }

    fn inputs(&self) -> Vec<Signal> {
        let Some(law) = &self.law else { return Vec::new() };
        let numbers = NUMBERS.iter().map(|field| Signal::scalar(field.input, field.unit));
        let rows = ROWS.iter().chain(law.further()).map(|field| self.signal(field.input, field.unit));
        numbers.chain(rows).chain([Signal::scalar(CLUTCH, "1")]).collect()
    }

    fn follows_reference(&self, _row: usize) -> bool {
        false
    }

    fn rows_key(&self) -> String {
        let list = if self.rows.is_of_joints() { "joints" } else { "axes" };
        format!("task.{}.coupled.{list}", self.name)
    }

    fn kind(&self) -> &'static str {
        "coupled"
    }

    fn row_names(&self) -> Vec<String> {
        self.row_names.clone()
    }

    fn row_unit(&self, row: usize) -> (&'static str, f64) {
        (self.position_units.get(row).copied().unwrap_or("1"), self.rows.scale(row))
    }

    fn record(&self, signals: TaskSignals<'_>, out: &mut SignalRecorder<'_>) {
        match signals {
            TaskSignals::Motion => self.record_motion(out),
            TaskSignals::Sensed if self.rows.is_sensed() => {
                self.record_rows((SENSED_FORCE, RowUnit::Force), &self.state.sensed, out);
            }
            other => self.record_force_of_rows(other, out),
        }
    }
}
