//! Task that is coupled with a task of another robot: haptic teleoperation.
//!
//! Its rows command forces: that of the [coupling](crate::tasks::teleoperation), and a damping. What the other robot sent is
//! an input of the task, so that a log contains all that is needed to compute the run again. Without a partner, and while
//! the coupling is open, a leader is a compliant handle, and a follower holds its place by the coupling's spring.

use crate::context::ControlContext;
use crate::controller::ControlInput;
use crate::coupling::received::{Packet, ReceivedState};
use crate::error::{ControlError, Reason};
use crate::references::streamed::given;
use crate::tasks::coupled_parameters::{CoupledParameters, CouplingSide};
use crate::tasks::coupled_rows::{CoupledRows, RowState};
use crate::tasks::task::{Task, TaskInput};
use crate::tasks::teleoperation::Teleoperation;
use nalgebra::{Matrix6, Matrix6xX, Vector6};
use opspace_backend::signal_names::{
    DISPLACEMENT, PACKET_AGE, PACKETS_LOST, PASSIVITY_TIME, PORT_CLOSED, PORT_ECHO, PORT_ENERGY_IN,
    PORT_ENERGY_OUT, PORT_FORCE, PORT_POSITION, PORT_SEQUENCE, PORT_TIME, PORT_VELOCITY, PORT_WAVE,
    REFERENCE, SENSED_FORCE,
};
use opspace_backend::{Signal, SignalRecorder};
use opspace_model::{Data, Model};
use std::any::Any;
use std::f64::consts::TAU;

/// Inputs with one value: number of the packet, time on the sender's clock, time of the
/// newest packet that the sender had received, on the receiver's clock, 1 if the sender's coupling is closed, cumulative energy that entered the
/// coupling at the sender (J).
const SCALARS: [(&str, &str); 5] =
    [("sequence", "1"), ("time_sent", "s"), ("echo", "s"), ("closed", "1"), ("energy_in", "J")];
/// Inputs with one value per row: position, velocity and force of the sender in the leader's coordinates, and the integral of
/// its wave variable.
const VECTORS: [&str; 4] = ["position", "velocity", "force", "wave"];
/// Input of the robot's own operator: 1 to open the clutch, 0 to close it, NaN for the times in the file.
const CLUTCH: &str = "clutch_open";

/// Signals of a coupled task that its partner receives, and the inputs to which they are copied.
pub const PACKET_SIGNALS: [(&str, &str); 9] = [
    (PORT_SEQUENCE, SCALARS[0].0),
    (PORT_TIME, SCALARS[1].0),
    (PORT_ECHO, SCALARS[2].0),
    (PORT_CLOSED, SCALARS[3].0),
    (PORT_ENERGY_IN, SCALARS[4].0),
    (PORT_POSITION, VECTORS[0]),
    (PORT_VELOCITY, VECTORS[1]),
    (PORT_FORCE, VECTORS[2]),
    (PORT_WAVE, VECTORS[3]),
];

/// A frame, or some joints, coupled with a task of another robot: see [`CoupledParameters`].
#[derive(Clone, Debug)]
pub struct CoupledTask {
    name: String,
    rows: CoupledRows,
    row_names: Vec<String>,
    position_units: Vec<&'static str>,
    velocity_units: Vec<String>,
    force_units: Vec<&'static str>,
    /// Damping of each row, Ns/m or Nms/rad.
    damping: Vector6<f64>,
    coupling: Option<Box<Teleoperation>>,
    state: RowState,
    partner: ReceivedState,
    /// Cycles since the start: the number of the packet.
    sequence: u64,
    clock_s: f64,
    /// Force on the rows, N or Nm.
    force: Vector6<f64>,
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
        let coupling = match (parameters.side, &parameters.teleoperation) {
            (None, None) => None,
            (Some(_), None) | (None, Some(_)) => return Err(ControlError::new(key, Reason::CouplingSide)),
            (Some(side), Some(coupling)) => {
                let spring = of_rows(coupling.stiffness_n_per_m.get(), coupling.stiffness_nm_per_rad.get());
                let damper = of_rows(coupling.damping_ns_per_m.get(), coupling.damping_nms_per_rad.get());
                let (angular, sensed) = (std::array::from_fn(|row| !is_linear(row)), rows.is_sensed());
                let lag_s = 1.0 / (TAU * parameters.filter_hz.get());
                let key = format!("{key}.teleoperation");
                let law = Teleoperation::new(
                    (side, coupling),
                    [spring, damper],
                    (&angular, sensed),
                    [context.period_s, lag_s],
                    &key,
                )?;
                Some(Box::new(law))
            }
        };
        let position_units: Vec<_> = rows.names().iter().map(|(_, unit)| *unit).collect();
        Ok(Self {
            name: name.to_owned(),
            row_names: rows.names().iter().map(|(name, _)| name.clone()).collect(),
            velocity_units: position_units.iter().map(|unit| format!("{unit}/s")).collect(),
            force_units: position_units.iter().map(|&unit| if unit == "m" { "N" } else { "Nm" }).collect(),
            position_units,
            rows,
            damping,
            coupling,
            state: RowState::default(),
            partner: ReceivedState::new(parameters.teleoperation.as_ref().map_or(0.0, |p| p.timeout_s.get())),
            sequence: 0,
            clock_s: 0.0,
            force: Vector6::zeros(),
        })
    }

    /// Side of the robot in its coupling, if it has one.
    #[must_use]
    pub fn side(&self) -> Option<CouplingSide> {
        self.coupling.as_ref().map(|coupling| coupling.side())
    }

    fn count(&self) -> usize {
        self.row_names.len()
    }

    /// Updates the state, and takes the packet of this cycle.
    fn receive(&mut self, input: &TaskInput<'_>) {
        self.state = self.rows.update(&input.control);
        self.sequence += 1;
        self.clock_s = input.control.clock_s;
        if let Some(packet) = packet(input.target.values, self.count()) {
            let _ = self.partner.accept(&packet, self.clock_s);
        }
    }

    /// Clutch of the robot's own operator, if one is streamed.
    fn clutch(&self, values: &[f64]) -> Option<bool> {
        given::<1>(values, SCALARS.len() + VECTORS.len() * self.count()).map(|[open]| open != 0.0)
    }
}

/// Reads the packet of `rows` rows from the values of the task's inputs; `None` before the first one.
fn packet(values: &[f64], rows: usize) -> Option<Packet> {
    let (&[sequence, sent_s, echo_s, closed, energy_in_j], _) = values.split_first_chunk()?;
    if ![sequence, sent_s, closed, energy_in_j].iter().all(|value| value.is_finite()) {
        return None;
    }
    let vector = |number: usize| {
        let values = values.get(SCALARS.len() + number * rows..)?.get(..rows)?;
        values
            .iter()
            .all(|value| value.is_finite())
            .then(|| Vector6::from_fn(|i, _| values.get(i).copied().unwrap_or(0.0)))
    };
    Some(Packet {
        sequence: sequence as u64,
        sent_s,
        echo_s,
        closed: closed == 1.0,
        energy_in_j,
        position: vector(0)?,
        velocity: vector(1)?,
        force: vector(2)?,
        wave: vector(3)?,
    })
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
        self.force = -self.damping.component_mul(&self.state.velocity);
        let clutch = self.clutch(input.target.values);
        if let Some(coupling) = &mut self.coupling {
            let (time_s, clock_s) = (input.control.measurement.time_s, self.clock_s);
            self.force += coupling.update(&self.state, &self.partner, clutch, time_s, clock_s);
        }
    }

    fn observe(&mut self, input: &TaskInput<'_>) {
        self.receive(input);
        self.force = Vector6::zeros();
        if let Some(coupling) = &mut self.coupling {
            coupling.rest(&self.state, &self.partner);
        }
    }

    fn bias(&self, model: &Model, data: &Data) -> Vector6<f64> {
        self.rows.bias(model, data)
    }

    /// The rows are at rest for inverse kinematics and for previews.
    fn kinematic_target(&self, _model: &Model, _data: &Data, _gain_per_s: f64) -> Vector6<f64> {
        Vector6::zeros()
    }

    fn kinematic_infeasibility(&self) -> Option<ControlError> {
        Some(ControlError::new(format!("task.{}.coupled", self.name), Reason::CouplingOfPositions))
    }

    fn acceleration(&self) -> Vector6<f64> {
        Vector6::zeros()
    }

    fn force(&self, _task_inertia: &Matrix6<f64>) -> Option<Vector6<f64>> {
        Some(Vector6::from_fn(|row, _| self.force[row] / self.rows.scale(row)))
    }

    fn start(&mut self, input: &ControlInput<'_>) {
        self.rows.start(input);
        self.partner.restart();
        self.state = self.rows.update(input);
        self.sequence = 0;
        if let Some(coupling) = &mut self.coupling {
            coupling.start();
        }
    }

    /// The coupling closes again from where the robot is.
    fn resume(&mut self, _input: &ControlInput<'_>) {}

    fn inherit(&mut self, before: &mut dyn Task, input: &ControlInput<'_>) {
        match (before as &mut dyn Any).downcast_mut::<Self>() {
            Some(before) if before.row_names == self.row_names && before.side() == self.side() => {
                self.rows = before.rows.clone();
                self.partner = before.partner;
                self.sequence = before.sequence;
                self.state = before.state;
                if let (Some(coupling), Some(before)) = (&mut self.coupling, &before.coupling) {
                    coupling.inherit_state(before);
                }
            }
            _ => self.start(input),
        }
    }

    fn inputs(&self) -> Vec<Signal> {
        if self.coupling.is_none() {
            return Vec::new();
        }
        let scalars = SCALARS.map(|(name, unit)| Signal::scalar(name, unit));
        let [position, velocity, force, wave] = VECTORS;
        let vectors = [
            Signal::new(position, &self.position_units, &self.row_names),
            Signal::new(velocity, &self.velocity_units, &self.row_names),
            Signal::new(force, &self.force_units, &self.row_names),
            Signal::new(wave, "J^0.5 s^0.5", &self.row_names),
        ];
        scalars.into_iter().chain(vectors).chain([Signal::scalar(CLUTCH, "1")]).collect()
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

    fn record(&self, out: &mut SignalRecorder<'_>) {
        let (name, rows) = (&self.name, self.count());
        let position = &self.state.position;
        out.signal((name, DISPLACEMENT), &self.position_units, &self.row_names, &position.as_slice()[..rows]);
        let Some(coupling) = &self.coupling else { return };
        let sent = coupling.sent(&self.state);
        let reference = coupling.reference();
        out.signal((name, REFERENCE), &self.position_units, &self.row_names, &reference.as_slice()[..rows]);
        out.scalar((name, PORT_SEQUENCE), "1", self.sequence as f64);
        out.scalar((name, PORT_TIME), "s", self.clock_s);
        let echo_s = self.partner.newest().map_or(f64::NAN, |packet| packet.sent_s);
        out.scalar((name, PORT_ECHO), "s", echo_s);
        out.scalar((name, PORT_CLOSED), "1", f64::from(u8::from(sent.closed)));
        let passivity = coupling.passivity();
        out.scalar((name, PORT_ENERGY_IN), "J", passivity.energy_in_j());
        out.scalar((name, PORT_ENERGY_OUT), "J", passivity.energy_out_j());
        out.scalar((name, PASSIVITY_TIME), "s", passivity.active_s());
        let port = &sent.position.as_slice()[..rows];
        out.signal((name, PORT_POSITION), &self.position_units, &self.row_names, port);
        let port = &sent.velocity.as_slice()[..rows];
        out.signal((name, PORT_VELOCITY), &self.velocity_units, &self.row_names, port);
        let port = &sent.force.as_slice()[..rows];
        out.signal((name, PORT_FORCE), &self.force_units, &self.row_names, port);
        out.signal((name, PORT_WAVE), "J^0.5 s^0.5", &self.row_names, &sent.wave.as_slice()[..rows]);
        out.scalar((name, PACKETS_LOST), "1", self.partner.missing() as f64);
        out.scalar((name, PACKET_AGE), "s", self.partner.age_s(self.clock_s).unwrap_or(f64::NAN));
    }

    fn record_sensed(&self, out: &mut SignalRecorder<'_>) {
        if self.rows.is_sensed() {
            let sensed = &self.state.sensed.as_slice()[..self.count()];
            out.signal((&self.name, SENSED_FORCE), &self.force_units, &self.row_names, sensed);
        }
    }
}
