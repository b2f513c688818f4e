//! Task that is coupled with a task of another robot: haptic teleoperation, or an object that both carry.
//!
//! Its rows command the forces of the law (`teleoperation.rs`, `carry.rs`), and a damping. What the other robot sent is
//! an input of the task, so that a log contains all that is needed to compute the run again. Without a partner, and while
//! the coupling is open, a leader is a compliant handle, and a follower holds its place by the coupling's spring.

use crate::carry::Carry;
use crate::coupled_parameters::{CoupledParameters, CouplingSide};
use crate::coupled_rows::{CoupledRows, RowState};
use crate::error::Mistake;
use crate::received::{Packet, ReceivedState};
use crate::teleoperation::Teleoperation;
use nalgebra::{Matrix6, Matrix6xX, Vector6};
use opspace_backend::signal_names::{
    DISPLACEMENT, INTERNAL_FORCE, PACKET_AGE, PACKETS_LOST, PASSIVITY_TIME, PORT_CLOSED, PORT_ECHO,
    PORT_ENERGY_IN, PORT_ENERGY_OUT, PORT_FORCE, PORT_LIMITED, PORT_PARTNER_SESSION, PORT_PATH,
    PORT_PATH_ACCELERATION, PORT_PATH_VELOCITY, PORT_POSITION, PORT_SEQUENCE, PORT_SESSION, PORT_TIME,
    PORT_VELOCITY, PORT_WAVE, REFERENCE, SENSED_FORCE,
};
use opspace_backend::{Signal, SignalRecorder};
use opspace_control::{ControlContext, ControlError, ControlInput, Task, TaskInput, TaskSignals};
use opspace_model::{Data, Model};
use std::any::Any;
use std::f64::consts::TAU;

/// Inputs with one value: number of the packet, time on the sender's clock, time of the
/// newest packet that the sender had received, on the receiver's clock, 1 if the sender's coupling is closed, 1 if its passivity
/// control reduces its force, cumulative energy that entered the
/// coupling at the sender (J), session of the sender, session of the receiver for which echo and energy are meant.
const SCALARS: [(&str, &str); 8] = [
    ("sequence", "1"),
    ("time_sent", "s"),
    ("echo", "s"),
    ("closed", "1"),
    ("limited", "1"),
    ("energy_in", "J"),
    ("session", "1"),
    ("partner_session", "1"),
];
/// Inputs with one value per row: position, velocity and force of the sender in the leader's coordinates.
const VECTORS: [&str; 3] = ["position", "velocity", "force"];
/// Input with one value per row: the integral of the sender's wave variable.
const WAVE: &str = "wave";
/// Inputs in place of the wave, for robots that carry an object: its path.
const PATH: [&str; 3] = ["path", "path_velocity", "path_acceleration"];
/// Input of the robot's own operator: 1 to open the clutch, 0 to close it, NaN for the times in the file.
const CLUTCH: &str = "clutch_open";

/// Session of a sender that states none.
const UNSTATED_SESSION: f64 = 0.0;

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
        let scalars = [
            PORT_SEQUENCE,
            PORT_TIME,
            PORT_ECHO,
            PORT_CLOSED,
            PORT_LIMITED,
            PORT_ENERGY_IN,
            PORT_SESSION,
            PORT_PARTNER_SESSION,
        ];
        let vectors = [PORT_POSITION, PORT_VELOCITY, PORT_FORCE].into_iter().zip(VECTORS);
        let scalars = scalars.into_iter().zip(SCALARS.map(|(name, _)| name));
        scalars.chain(vectors).chain(self.further().iter().copied()).collect()
    }

    /// The further vectors of a packet: their signals and inputs.
    const fn further(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Self::Teleoperation => &[(PORT_WAVE, WAVE)],
            Self::Carry => {
                &[(PORT_PATH, PATH[0]), (PORT_PATH_VELOCITY, PATH[1]), (PORT_PATH_ACCELERATION, PATH[2])]
            }
        }
    }
}

/// Law of a coupling, with its state.
#[derive(Clone, Debug)]
enum CouplingLaw {
    Teleoperation(Box<Teleoperation>),
    Carry(Box<Carry>),
}

/// Vectors beyond position, velocity and force that a law needs of each packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Further {
    None,
    Wave,
    Path,
}

/// Packet without a value that the law needs.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Incomplete {
    session: f64,
    sequence: u64,
}

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
    law: Option<CouplingLaw>,
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
        let law = match (parameters.side, &parameters.teleoperation, &parameters.carry) {
            (None, None, None) => None,
            (Some(side), Some(p), None) => {
                let spring = of_rows(p.stiffness_n_per_m.get(), p.stiffness_nm_per_rad.get());
                let damper = of_rows(p.damping_ns_per_m.get(), p.damping_nms_per_rad.get());
                let angular = std::array::from_fn(|row| !is_linear(row));
                let lag_s = 1.0 / (TAU * parameters.filter_hz.get());
                let law = Teleoperation::new(
                    (side, p),
                    [spring, damper, damping],
                    (&angular, rows.is_sensed(), rows.is_measured()),
                    (context, lag_s),
                    &format!("{key}.teleoperation"),
                )?;
                Some(CouplingLaw::Teleoperation(Box::new(law)))
            }
            (Some(side), None, Some(p)) => {
                if !rows.is_of_position() || !rows.is_sensed() {
                    return Err(ControlError::new(key, Mistake::CarryRows));
                }
                let law = Carry::new(side, p, context.period_s, &format!("{key}.carry"))?;
                Some(CouplingLaw::Carry(Box::new(law)))
            }
            _ => return Err(ControlError::new(key, Mistake::Side)),
        };
        let timeout_s = match &law {
            Some(CouplingLaw::Carry(_)) => parameters.carry.as_ref().map_or(0.0, |p| p.timeout_s.get()),
            _ => parameters.teleoperation.as_ref().map_or(0.0, |p| p.timeout_s.get()),
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
        self.law.as_ref().map(|law| match law {
            CouplingLaw::Teleoperation(law) => law.side(),
            CouplingLaw::Carry(law) => law.side(),
        })
    }

    fn kind_of_law(&self) -> Option<CouplingKind> {
        self.law.as_ref().map(|law| match law {
            CouplingLaw::Teleoperation(_) => CouplingKind::Teleoperation,
            CouplingLaw::Carry(_) => CouplingKind::Carry,
        })
    }

    /// Packet that is sent in this cycle.
    fn sent(&self) -> Packet {
        match &self.law {
            None => Packet::default(),
            Some(CouplingLaw::Teleoperation(law)) => law.sent(&self.state),
            Some(CouplingLaw::Carry(law)) => law.sent(&self.state),
        }
    }

    /// Units of the further vectors of a packet, by rows.
    fn further_units(&self, kind: CouplingKind) -> Vec<Vec<String>> {
        let of_all = |unit: &str| vec![unit.to_owned(); self.count()];
        match kind {
            CouplingKind::Teleoperation => vec![of_all("J^0.5 s^0.5")],
            CouplingKind::Carry => ["m", "m/s", "m/s^2"].map(of_all).into(),
        }
    }

    fn is_carry(&self) -> bool {
        matches!(self.law, Some(CouplingLaw::Carry(_)))
    }

    /// Further vectors that the law needs of each packet.
    fn further(&self) -> Further {
        match &self.law {
            Some(CouplingLaw::Teleoperation(law)) if law.uses_waves() => Further::Wave,
            Some(CouplingLaw::Carry(_)) => Further::Path,
            _ => Further::None,
        }
    }

    fn count(&self) -> usize {
        self.row_names.len()
    }

    /// Updates the state, and takes the packet of this cycle.
    fn receive(&mut self, input: &TaskInput<'_>) {
        self.state = self.rows.update(&input.control);
        self.sequence += 1;
        self.clock_s = input.control.clock_s;
        let Some(packet) = packet(input.target.values, self.count(), self.further()) else { return };
        let session = packet.map_or_else(|incomplete| incomplete.session, |packet| packet.session);
        // The positions of both hands belong together, so that one can't begin anew alone.
        if self.is_carry() && self.partner.is_of_other_session(session) {
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

/// Reads the packet of `rows` rows from the values of the task's inputs, with the further vectors that the law needs.
/// `Err` if it lacks a value that the law needs, `None` before the first packet.
fn packet(values: &[f64], rows: usize, further: Further) -> Option<Result<Packet, Incomplete>> {
    let (&[sequence, ref numbers @ .., session, partner_session], _) =
        values.split_first_chunk::<{ SCALARS.len() }>()?;
    // A task that has not started sends the number zero, and no session.
    let is_unstarted = session.is_nan() && sequence == 0.0;
    if !sequence.is_finite() || is_unstarted {
        return None;
    }
    let session = if session.is_finite() { session } else { UNSTATED_SESSION };
    let id = (session, partner_session, sequence as u64);
    let packet = complete(values, rows, further, id, *numbers);
    Some(packet.ok_or(Incomplete { session, sequence: id.2 }))
}

/// Returns the packet with these numbers, and its vectors from `values`; `None` if it lacks a value that the law needs.
fn complete(
    values: &[f64],
    rows: usize,
    further: Further,
    (session, partner_session, sequence): (f64, f64, u64),
    [sent_s, echo_s, closed, limited, energy_in_j]: [f64; 5],
) -> Option<Packet> {
    if ![sent_s, closed, energy_in_j].iter().all(|value| value.is_finite()) {
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
        session,
        partner_session,
        sequence,
        sent_s,
        echo_s,
        closed: closed == 1.0,
        limited: limited == 1.0,
        energy_in_j,
        position: vector(0)?,
        velocity: vector(1)?,
        force: vector(2)?,
        wave: if further == Further::Wave { vector(3)? } else { Vector6::zeros() },
        reference: if further == Further::Path {
            [vector(3)?, vector(4)?, vector(5)?]
        } else {
            [Vector6::zeros(); 3]
        },
    })
}

impl CoupledTask {
    /// Records displacement, velocity and law.
    fn record_motion(&self, out: &mut SignalRecorder<'_>) {
        let (name, rows) = (&self.name, self.count());
        let position = &self.state.position;
        out.signal((name, DISPLACEMENT), &self.position_units, &self.row_names, &position.as_slice()[..rows]);
        if self.law.is_none() {
            return;
        }
        let sent = self.sent();
        let reference = match &self.law {
            Some(CouplingLaw::Carry(law)) => law.reference(),
            Some(CouplingLaw::Teleoperation(law)) => *law.reference(),
            None => Vector6::zeros(),
        };
        out.signal((name, REFERENCE), &self.position_units, &self.row_names, &reference.as_slice()[..rows]);
        out.scalar((name, PORT_SEQUENCE), "1", self.sequence as f64);
        out.scalar((name, PORT_TIME), "s", self.clock_s);
        let echo_s = self.partner.newest().map_or(f64::NAN, |packet| packet.sent_s);
        out.scalar((name, PORT_ECHO), "s", echo_s);
        out.scalar((name, PORT_CLOSED), "1", f64::from(u8::from(sent.closed)));
        out.scalar((name, PORT_LIMITED), "1", f64::from(u8::from(sent.limited)));
        out.scalar((name, PORT_ENERGY_IN), "J", sent.energy_in_j);
        out.scalar((name, PORT_SESSION), "1", self.session);
        let partner_session = self.partner.newest().map_or(f64::NAN, |packet| packet.session);
        out.scalar((name, PORT_PARTNER_SESSION), "1", partner_session);
        let port = |vector: &Vector6<f64>| -> [f64; 6] { (*vector).into() };
        out.signal(
            (name, PORT_POSITION),
            &self.position_units,
            &self.row_names,
            &port(&sent.position)[..rows],
        );
        out.signal(
            (name, PORT_VELOCITY),
            &self.velocity_units,
            &self.row_names,
            &port(&sent.velocity)[..rows],
        );
        out.signal((name, PORT_FORCE), &self.force_units, &self.row_names, &port(&sent.force)[..rows]);
        out.scalar((name, PACKETS_LOST), "1", self.partner.missing() as f64);
        out.scalar((name, PACKET_AGE), "s", self.partner.age_s(self.clock_s).unwrap_or(f64::NAN));
        match &self.law {
            Some(CouplingLaw::Teleoperation(law)) => {
                out.scalar((name, PORT_ENERGY_OUT), "J", law.passivity().energy_out_j());
                out.scalar((name, PASSIVITY_TIME), "s", law.passivity().active_s());
                out.signal((name, PORT_WAVE), "J^0.5 s^0.5", &self.row_names, &port(&sent.wave)[..rows]);
            }
            Some(CouplingLaw::Carry(law)) => {
                out.scalar((name, INTERNAL_FORCE), "N", law.internal_n());
                let [path, speed, acceleration] = &sent.reference;
                out.signal((name, PORT_PATH), "m", &self.row_names, &port(path)[..rows]);
                out.signal((name, PORT_PATH_VELOCITY), "m/s", &self.row_names, &port(speed)[..rows]);
                let last = &port(acceleration)[..rows];
                out.signal((name, PORT_PATH_ACCELERATION), "m/s^2", &self.row_names, last);
            }
            None => {}
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
        let clutch = self.clutch(input.target.values);
        let (time_s, clock_s) = (input.control.measurement.time_s, self.clock_s);
        (self.force, self.acceleration) = match &mut self.law {
            None => (-damping, Vector6::zeros()),
            Some(CouplingLaw::Teleoperation(law)) => {
                (law.update(&self.state, &self.partner, clutch, time_s, clock_s), Vector6::zeros())
            }
            Some(CouplingLaw::Carry(law)) => {
                law.update(&self.state, &self.partner, time_s, clock_s);
                (law.force() - damping, law.acceleration())
            }
        };
    }

    fn observe(&mut self, input: &TaskInput<'_>) {
        self.receive(input);
        (self.force, self.acceleration) = (Vector6::zeros(), Vector6::zeros());
        match &mut self.law {
            None => {}
            Some(CouplingLaw::Teleoperation(law)) => law.rest(&self.state, &self.partner, self.clock_s),
            Some(CouplingLaw::Carry(law)) => law.rest(&self.state),
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
        if let Some(CouplingLaw::Teleoperation(law)) = &mut self.law {
            law.take_force(&Vector6::from_fn(|row, _| force[row] * self.rows.scale(row)));
        }
    }

    fn start(&mut self, input: &ControlInput<'_>) {
        self.rows.start(input);
        self.partner.restart();
        self.state = self.rows.update(input);
        self.sequence = 0;
        self.session = input.clock_s;
        match &mut self.law {
            None => {}
            Some(CouplingLaw::Teleoperation(law)) => law.start(self.session),
            Some(CouplingLaw::Carry(law)) => law.start(input.measurement.time_s),
        }
    }

    /// The coupling closes again from where the robot is.
    fn resume(&mut self, input: &ControlInput<'_>) {
        if let Some(CouplingLaw::Carry(law)) = &mut self.law {
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
                match (&mut self.law, &before.law) {
                    (Some(CouplingLaw::Teleoperation(law)), Some(CouplingLaw::Teleoperation(before))) => {
                        law.inherit_state(before)
                    }
                    (Some(CouplingLaw::Carry(law)), Some(CouplingLaw::Carry(before))) => {
                        law.inherit_state(before)
                    }
                    _ => {}
                }
            }
            _ => self.start(input),
        }
    }

    fn inputs(&self) -> Vec<Signal> {
        let Some(kind) = self.kind_of_law() else { return Vec::new() };
        let scalars = SCALARS.map(|(name, unit)| Signal::scalar(name, unit));
        let [position, velocity, force] = VECTORS;
        let vectors = [
            Signal::new(position, &self.position_units, &self.row_names),
            Signal::new(velocity, &self.velocity_units, &self.row_names),
            Signal::new(force, &self.force_units, &self.row_names),
        ];
        let further = kind.further().iter().zip(self.further_units(kind));
        let further = further.map(|(&(_, input), units)| Signal::new(input, &units, &self.row_names));
        scalars.into_iter().chain(vectors).chain(further).chain([Signal::scalar(CLUTCH, "1")]).collect()
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
                let sensed = &self.state.sensed.as_slice()[..self.count()];
                out.signal((&self.name, SENSED_FORCE), &self.force_units, &self.row_names, sensed);
            }
            other => self.record_force_of_rows(other, out),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of the inputs of a packet of two rows, with a wave.
    fn values(sequence: f64, wave: [f64; 2]) -> Vec<f64> {
        let scalars = [sequence, 0.1, f64::NAN, 1.0, 0.0, 0.5, f64::NAN, f64::NAN];
        let vectors = [[0.01, 0.02], [0.1, 0.2], [1.0, 2.0], wave];
        scalars.into_iter().chain(vectors.concat()).collect()
    }

    /// Compared: what is read of a packet without a wave by laws with and without waves, and the packets that count as lost.
    #[test]
    fn wave_is_needed_by_wave_variables_only() {
        let without = values(7.0, [f64::NAN; 2]);
        let read = packet(&without, 2, Further::None).and_then(Result::ok).expect("is accepted");
        assert_eq!((read.sequence, read.wave), (7, Vector6::zeros()));
        assert_eq!(read.position, Vector6::new(0.01, 0.02, 0.0, 0.0, 0.0, 0.0));
        assert_eq!(packet(&without, 2, Further::Wave), Some(Err(Incomplete { session: 0.0, sequence: 7 })));
        let complete =
            packet(&values(8.0, [3.0, 4.0]), 2, Further::Wave).and_then(Result::ok).expect("is accepted");
        assert_eq!(complete.wave, Vector6::new(3.0, 4.0, 0.0, 0.0, 0.0, 0.0));
        assert_eq!(packet(&values(f64::NAN, [f64::NAN; 2]), 2, Further::None), None);
    }
}
