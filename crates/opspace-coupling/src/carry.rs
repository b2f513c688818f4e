//! Law of two robots that carry an object together: an absolute task, a relative one, and the internal force.
//!
//! With p, v the displacement and velocity of a robot's hand, F the force sensed on it, a hat for what was received from the
//! other robot, and x_d the path of the object, which the leader sends:
//!
//! ```text
//! absolute   a = ẍ_d + 2ζω (ẋ_d − (v + v̂)/2) + ω² (x_d − (p + p̂)/2)
//! relative   a −= 2ζω (v − v̂)/2 + ω² (p − p̂)/2                               across the line e between the hands
//! command    Λ a − F across e; along e, −(F + F̂)·e/2 ± [f_d + k (f_d − f) + k_i ∫ (f_d − f) dt]
//!            f = (F̂ − F)·e/2 of the leader: the internal force, by which the hands press on the object; + of the leader
//! ```
//!
//! Without f_d, the relative task holds the distance along e too, and nothing presses.
//!
//! The sensed forces contain weight and inertia of the object: each robot carries what acts on it. The internal force moves
//! nothing and is controlled; across the line, the hands keep their distance (Khatib, *Augmented object and virtual linkage*,
//! 1995, for two hands that can only push along a line). Each robot computes both tasks with what it has received.

use crate::coupled_parameters::{CarryParameters, CouplingSide};
use crate::coupled_rows::RowState;
use crate::error::Mistake;
use crate::law::{CouplingLaw, Cycle};
use crate::packet_fields::{RowField, RowUnit};
use crate::received::{Packet, ReceivedState};
use nalgebra::{Matrix3, Vector3, Vector6};
use opspace_backend::SignalRecorder;
use opspace_backend::signal_names::{INTERNAL_FORCE, PORT_PATH, PORT_PATH_ACCELERATION, PORT_PATH_VELOCITY};
use opspace_control::references::reference::Trajectory;
use opspace_control::{CartesianReference, ControlError, Target};
use opspace_model::Placement;
use std::any::Any;

/// Path of the object, with its derivatives.
pub(crate) const FURTHER: [RowField; 3] = [
    RowField { signal: PORT_PATH, input: "path", unit: RowUnit::All("m"), of: |p| &mut p.reference[0] },
    RowField {
        signal: PORT_PATH_VELOCITY,
        input: "path_velocity",
        unit: RowUnit::All("m/s"),
        of: |p| &mut p.reference[1],
    },
    RowField {
        signal: PORT_PATH_ACCELERATION,
        input: "path_acceleration",
        unit: RowUnit::All("m/s^2"),
        of: |p| &mut p.reference[2],
    },
];

/// One side of two robots that carry an object, with its state.
#[derive(Clone, Debug)]
pub(crate) struct Carry {
    side: CouplingSide,
    stiffness: f64,
    damping: f64,
    /// Line from the leader's hand to the follower's, in the task axes.
    direction: Vector3<f64>,
    internal_force_n: Option<f64>,
    gain: f64,
    integral_per_s: f64,
    integral_limit_n: f64,
    ramp_s: f64,
    period_s: f64,
    trajectory: Trajectory,
    is_started: bool,
    /// Time at which the path began, and at which the internal force begins to ramp up, s.
    start_s: f64,
    closed_s: Option<f64>,
    /// Integral of the error of the internal force, N.
    integral_n: f64,
    closed: bool,
    /// Position, velocity and acceleration of the path in this cycle, as displacements of the object.
    path: [Vector3<f64>; 3],
    acceleration: Vector3<f64>,
    /// Internal force, N: positive if the hands press on the object.
    internal_n: f64,
    force: Vector3<f64>,
    sensed: Vector3<f64>,
}

impl Carry {
    pub(crate) fn new(
        side: CouplingSide,
        p: &CarryParameters,
        period_s: f64,
        key: &str,
    ) -> Result<Self, ControlError> {
        let length = Vector3::from(p.direction).norm();
        if !(length.is_finite() && length > 0.0) {
            return Err(ControlError::new(format!("{key}.direction"), Mistake::ZeroLength));
        }
        let zero = Vector3::zeros();
        let frequency = p.frequency_rad_per_s.get();
        Ok(Self {
            side,
            stiffness: frequency * frequency,
            damping: 2.0 * p.damping_ratio.get() * frequency,
            direction: Vector3::from(p.direction) / length,
            internal_force_n: p.internal_force_n,
            gain: p.gain.get(),
            integral_per_s: p.integral_per_s.get(),
            integral_limit_n: p.integral_limit_n.get(),
            ramp_s: p.ramp_s.get(),
            period_s,
            trajectory: Trajectory::new(
                &p.path.clone().map_or(CartesianReference::Hold, CartesianReference::Sinusoid),
            ),
            is_started: false,
            start_s: 0.0,
            closed_s: None,
            integral_n: 0.0,
            closed: false,
            path: [zero; 3],
            acceleration: zero,
            internal_n: 0.0,
            force: zero,
            sensed: zero,
        })
    }

    fn open(&mut self) {
        (self.closed, self.closed_s, self.integral_n) = (false, None, 0.0);
        (self.acceleration, self.force) = (Vector3::zeros(), Vector3::zeros());
        self.internal_n = 0.0;
    }

    /// Computes acceleration and force of a cycle.
    fn compute(&mut self, cycle: &Cycle<'_>) {
        let Cycle { state, partner, time_s, clock_s, .. } = *cycle;
        let (p, v, sensed) = (linear(&state.position), linear(&state.velocity), linear(&state.sensed));
        self.sensed = sensed;
        let packet = partner.fresh(clock_s);
        self.closed = packet.is_some();
        let packet = packet.filter(|packet| packet.closed);
        if self.side == CouplingSide::Leader {
            let time_s = time_s - self.start_s;
            let target = self.trajectory.at(time_s);
            self.path = [target.placement.translation, target.velocity.linear, target.acceleration.linear];
        } else if let Some(packet) = packet {
            self.path = packet.reference.map(|vector| linear(&vector));
        }
        let Some(packet) = packet else {
            // Alone, the robot holds its place and carries what it senses.
            let closed = self.closed;
            self.open();
            self.closed = closed;
            self.acceleration = -v * self.damping;
            self.force = -sensed;
            return;
        };
        let [path, speed, acceleration] = self.path;
        let (other, other_v, other_sensed) =
            (linear(&packet.position), linear(&packet.velocity), linear(&packet.force));
        let absolute = acceleration
            + (speed - (v + other_v) * 0.5) * self.damping
            + (path - (p + other) * 0.5) * self.stiffness;
        let relative = (v - other_v) * (0.5 * self.damping) + (p - other) * (0.5 * self.stiffness);
        let e = self.direction;
        let across = |vector: Vector3<f64>| vector - e * e.dot(&vector);
        let held = match self.internal_force_n {
            Some(_) => across(relative) + e * (e.dot(&(v - other_v)) * 0.5 * self.damping),
            None => relative,
        };
        self.acceleration = absolute - held;
        let sign = if self.side == CouplingSide::Leader { 1.0 } else { -1.0 };
        self.internal_n = sign * 0.5 * e.dot(&(other_sensed - sensed));
        let pressed_n = self.internal_force_n.map_or(0.0, |force_n| self.pressed(force_n, time_s));
        self.force = -across(sensed) + e * (sign * pressed_n - 0.5 * e.dot(&(sensed + other_sensed)));
    }

    /// Force by which the hand presses on the object along the line, N.
    fn pressed(&mut self, force_n: f64, time_s: f64) -> f64 {
        let closed_s = *self.closed_s.get_or_insert(time_s);
        let ramp = if self.ramp_s > 0.0 { ((time_s - closed_s) / self.ramp_s).min(1.0) } else { 1.0 };
        let wanted_n = force_n * ramp;
        let error_n = wanted_n - self.internal_n;
        self.integral_n = (self.integral_n + self.integral_per_s * self.period_s * error_n)
            .clamp(-self.integral_limit_n, self.integral_limit_n);
        wanted_n + self.gain * error_n + self.integral_n
    }
}

impl CouplingLaw for Carry {
    fn side(&self) -> CouplingSide {
        self.side
    }

    fn further(&self) -> &'static [RowField] {
        &FURTHER
    }

    /// The positions of both hands belong together, so that one can't begin anew alone.
    fn meets_other_sessions(&self) -> bool {
        false
    }

    /// Path of the object, as a displacement, m.
    fn reference(&self) -> Vector6<f64> {
        rows(&self.path[0])
    }

    fn sent(&self, state: &RowState) -> Packet {
        Packet {
            closed: self.closed && self.is_started,
            position: state.position,
            velocity: state.velocity,
            force: rows(&self.sensed),
            reference: self.path.map(|vector| rows(&vector)),
            ..Packet::default()
        }
    }

    /// Starts the path at the present position.
    fn start(&mut self, _clock_s: f64, time_s: f64) {
        let home = Placement::identity();
        self.trajectory.start(&home, &Target::at_rest(home), &Matrix3::identity());
        (self.start_s, self.is_started) = (time_s, true);
        self.open();
    }

    /// Joins the path from the position of the object at rest.
    fn resume(&mut self, state: &RowState, time_s: f64) {
        let at = Placement { rotation: Matrix3::identity(), translation: linear(&state.position) };
        self.trajectory.join(time_s - self.start_s, &Target::at_rest(at));
        self.open();
    }

    fn inherit(&mut self, before: &dyn CouplingLaw) {
        let Some(before) = (before as &dyn Any).downcast_ref::<Self>() else { return };
        let Self { trajectory, start_s, closed_s, integral_n, closed, path, internal_n, .. } = before.clone();
        self.trajectory = trajectory;
        (self.start_s, self.closed_s, self.integral_n) = (start_s, closed_s, integral_n);
        (self.closed, self.path, self.internal_n, self.is_started) = (closed, path, internal_n, true);
    }

    fn update(&mut self, cycle: &Cycle<'_>) -> (Vector6<f64>, Vector6<f64>) {
        self.compute(cycle);
        (rows(&self.force) - cycle.damping, rows(&self.acceleration))
    }

    fn rest(&mut self, state: &RowState, _partner: &ReceivedState, _clock_s: f64) {
        self.open();
        self.path = [linear(&state.position), Vector3::zeros(), Vector3::zeros()];
        self.sensed = linear(&state.sensed);
    }

    fn record(&self, name: &str, out: &mut SignalRecorder<'_>) {
        out.scalar((name, INTERNAL_FORCE), "N", self.internal_n);
    }

    fn boxed(&self) -> Box<dyn CouplingLaw> {
        Box::new(self.clone())
    }
}

fn linear(rows: &Vector6<f64>) -> Vector3<f64> {
    Vector3::new(rows[0], rows[1], rows[2])
}

fn rows(linear: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(linear.x, linear.y, linear.z, 0.0, 0.0, 0.0)
}
