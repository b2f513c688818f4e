//! Torques into positions by emulating the servo between two interface ticks.
//!
//! Equation (10) of the paper is exact at the instant at which the set-point is taken. A servo that runs R times faster
//! then meets the same set-point with other positions. Here every servo tick up to the next set-point is emulated with
//! the drive's own law, on the arm as it stands, and the set-point is the one whose **mean** torque over the interval
//! in which it acts is the desired one:
//!
//! ```text
//! τ̄ = Y₀ + Y₁ q_desired        q_desired = Y₁⁻¹ (τ − δ − Y₀)
//! ```
//!
//! Y₀ holds what the state and the set-point before still do, Y₁ (n × n) what a unit of set-point does. The state at the
//! end of the emulated interval is the prediction of the [observer](crate::observer), which so knows what the drive did
//! within the interval. δ is how much more torque the motors give than the emulation says, where their current is
//! measured: a disturbance observer on interval means.

use crate::friction::FrictionCompensation;
use crate::interface::GravityBy;
use crate::observer::ObserverGain;
use crate::robot::Sample;
use crate::servo::ServoParameters;
use crate::transformer::{Transformer, TransformerKind};
use nalgebra::{DMatrix, DVector};
use opspace_control::Measurement;
use opspace_model::Data;
use std::f64::consts::TAU;

/// What of a new difference between measured and emulated torque is believed: fast enough for a wrong gain, slow enough
/// for the noise of the current.
const CURRENT_GAIN: f64 = 0.35;

/// How far δ may go, in torque limits: it is an offset of a set-point, not a torque of a motor, and at speed a wrong gain
/// asks for more than the motor's own torque.
const CURRENT_LIMIT: f64 = 3.0;

/// What is known of the robot.
#[derive(Clone, Debug)]
pub struct EmulationSetup {
    /// The servos, one a joint.
    pub servos: Vec<ServoParameters>,
    /// The whole friction that is believed of the joints.
    pub friction: FrictionCompensation,
    /// Resolution of each encoder at the joint, rad.
    pub resolution_rad: Vec<f64>,
    /// Of each drive, Nm.
    pub torque_limits: Vec<f64>,
    /// Time between two servo ticks, s.
    pub servo_period_s: f64,
    /// Servo ticks per interface tick.
    pub ratio: u32,
    /// Servo ticks until a set-point acts.
    pub delay: u32,
    /// Who carries the weight.
    pub gravity_by: GravityBy,
    /// Whether measured motor torques are made use of.
    pub current: bool,
}

/// See the [module](self).
#[derive(Clone, Debug)]
pub struct EmulatingTransformer {
    drives: Vec<Drive>,
    friction: FrictionCompensation,
    ticks: Ticks,
    gravity_by: GravityBy,
    current: bool,
    /// The arm and its drives at the present interface tick, as estimated.
    state: State,
    /// As predicted for the next one.
    predicted: State,
    rollout: State,
    /// Unknown joint accelerations, rad/s² (n).
    disturbance: DVector<f64>,
    /// δ, Nm (n).
    surplus: DVector<f64>,
    /// The set-points in force when a tick begins, rad (n).
    active: DVector<f64>,
    /// Whether there are any: before the first the robot holds itself.
    begun: bool,
    /// M⁻¹, and the accelerations without any motor torque (n).
    mass_inverse: DMatrix<f64>,
    free: DVector<f64>,
    /// Whether these are of the present tick.
    frozen: bool,
    holding: DVector<f64>,
    response: DMatrix<f64>,
    /// Mean emulated torque over the last interface interval, Nm (n).
    mean_torque: DVector<f64>,
    /// No acceleration but by the drives (n).
    rest: DVector<f64>,
}

/// A cascaded servo with its filtered finite difference.
#[derive(Clone, Copy, Debug)]
struct Drive {
    kp: f64,
    kv: f64,
    filter: f64,
    torque_limit: f64,
    gain: ObserverGain,
}

#[derive(Clone, Copy, Debug)]
struct Ticks {
    period_s: f64,
    ratio: u32,
    delay: u32,
}

/// An arm and the memory of its drives, at a servo tick.
#[derive(Clone, Debug)]
struct State {
    q: DVector<f64>,
    dq: DVector<f64>,
    /// The drives' velocities, and the positions that they saw last.
    velocity: DVector<f64>,
    last: DVector<f64>,
    torque: DVector<f64>,
}

impl State {
    fn new(n: usize) -> Self {
        let zero = DVector::zeros(n);
        Self { q: zero.clone(), dq: zero.clone(), velocity: zero.clone(), last: zero.clone(), torque: zero }
    }

    fn copy_from(&mut self, other: &Self) {
        self.q.copy_from(&other.q);
        self.dq.copy_from(&other.dq);
        self.velocity.copy_from(&other.velocity);
        self.last.copy_from(&other.last);
        self.torque.copy_from(&other.torque);
    }

    fn clear(&mut self) {
        [&mut self.q, &mut self.dq, &mut self.velocity, &mut self.last, &mut self.torque]
            .into_iter()
            .for_each(|v| v.fill(0.0));
    }

    /// The drives' torques at this tick for a set-point, without limits.
    fn drive(&mut self, drives: &[Drive], period_s: f64, set_point: impl Fn(usize) -> f64) {
        for (i, drive) in drives.iter().enumerate() {
            let difference = (self.q[i] - self.last[i]) / period_s;
            self.velocity[i] += drive.filter * (difference - self.velocity[i]);
            self.last[i] = self.q[i];
            self.torque[i] = drive.kv * (drive.kp * (set_point(i) - self.q[i]) - self.velocity[i]);
        }
    }

    /// A servo period under these torques and the accelerations `free`.
    fn travel(&mut self, mass_inverse: &DMatrix<f64>, free: &DVector<f64>, period_s: f64) {
        let n = self.q.len();
        for i in 0..n {
            self.q[i] += period_s * (self.dq[i] + 0.5 * period_s * free[i]);
            self.dq[i] += period_s * free[i];
        }
        for (column, &torque) in mass_inverse.as_slice().chunks_exact(n).zip(&self.torque) {
            let (v, x) = (period_s * torque, 0.5 * period_s * period_s * torque);
            for ((q, dq), m) in self.q.iter_mut().zip(&mut self.dq).zip(column) {
                *q += x * m;
                *dq += v * m;
            }
        }
    }
}

impl EmulatingTransformer {
    /// For a robot at rest.
    #[must_use]
    pub fn new(setup: &EmulationSetup) -> Self {
        let n = setup.servos.len();
        let ticks = Ticks { period_s: setup.servo_period_s, ratio: setup.ratio, delay: setup.delay };
        let interface_s = f64::from(setup.ratio) * setup.servo_period_s;
        let drive = |i: usize| {
            let servo = setup.servos[i].cascade();
            Drive {
                kp: servo.kp_per_s.get(),
                kv: servo.kv_nms_per_rad.get(),
                filter: 1.0 - (-TAU * servo.velocity_filter_hz.get() * setup.servo_period_s).exp(),
                torque_limit: setup.torque_limits[i],
                gain: ObserverGain::steady(setup.resolution_rad[i], interface_s),
            }
        };
        let zero = DVector::zeros(n);
        Self {
            drives: (0..n).map(drive).collect(),
            friction: setup.friction.clone(),
            ticks,
            gravity_by: setup.gravity_by,
            current: setup.current,
            state: State::new(n),
            predicted: State::new(n),
            rollout: State::new(n),
            disturbance: zero.clone(),
            surplus: zero.clone(),
            active: zero.clone(),
            begun: false,
            mass_inverse: DMatrix::zeros(n, n),
            free: zero.clone(),
            frozen: false,
            holding: zero.clone(),
            response: DMatrix::zeros(n, n),
            mean_torque: zero.clone(),
            rest: zero,
        }
    }

    /// At rest at the measured positions, before anything was commanded.
    fn stand(&mut self, q: &DVector<f64>) {
        self.state.clear();
        self.state.q.copy_from(q);
        self.state.last.copy_from(q);
    }

    /// Takes in the measured positions against the predicted ones.
    fn correct(&mut self, sample: &Sample) {
        self.state.copy_from(&self.predicted);
        // The drive last looked one servo period before this tick.
        let seen = f64::from(self.ticks.ratio - 1) / f64::from(self.ticks.ratio);
        for (i, drive) in self.drives.iter().enumerate() {
            let innovation = sample.q[i] - self.state.q[i];
            self.state.q[i] += drive.gain.position * innovation;
            self.state.last[i] += drive.gain.position * seen * innovation;
            self.state.dq[i] += drive.gain.velocity * innovation;
            self.state.velocity[i] += drive.gain.velocity * innovation;
            self.disturbance[i] += drive.gain.disturbance * innovation;
        }
        let Some(measured) = sample.motor_torque.as_ref().filter(|_| self.current) else { return };
        for (i, drive) in self.drives.iter().enumerate() {
            let more = measured[i] - self.mean_torque[i];
            let limit = CURRENT_LIMIT * drive.torque_limit;
            self.surplus[i] =
                (self.surplus[i] + CURRENT_GAIN * (more - self.surplus[i])).clamp(-limit, limit);
        }
    }

    /// The arm as it stands, for a whole interval: M⁻¹ and what accelerates it beside the drives.
    fn freeze(&mut self, data: &Data) {
        if self.frozen {
            return;
        }
        self.frozen = true;
        self.mass_inverse.fill_with_identity();
        data.mass_matrix_factor.solve_matrix(&mut self.mass_inverse);
        for i in 0..self.free.len() {
            let carried = if self.gravity_by == GravityBy::Robot { data.gravity[i] } else { 0.0 };
            let friction = self.friction.torque(i, self.state.dq[i]);
            self.free[i] = self.surplus[i] + carried - data.bias[i] - friction;
            self.holding[i] = data.gravity[i] - carried;
        }
        data.mass_matrix_factor.solve(self.free.as_mut_slice());
        self.free += &self.disturbance;
    }

    /// One servo tick of the rollout under the set-point that is still in force, or the robot's own hold.
    fn roll_old(&mut self) {
        self.rollout.drive(&self.drives, self.ticks.period_s, |i| self.active[i]);
        if !self.begun {
            self.rollout.torque.copy_from(&self.holding);
        }
    }

    /// Y₁, column by column, from the drives' and the arm's linear answer.
    fn respond(&mut self) {
        let n = self.drives.len();
        for joint in 0..n {
            self.rollout.clear();
            let mut column = self.response.column_mut(joint);
            column.fill(0.0);
            for _ in 0..self.ticks.ratio {
                let set_point = |i: usize| if i == joint { 1.0 } else { 0.0 };
                self.rollout.drive(&self.drives, self.ticks.period_s, set_point);
                column += &self.rollout.torque;
                self.rollout.travel(&self.mass_inverse, &self.rest, self.ticks.period_s);
            }
            column /= f64::from(self.ticks.ratio);
        }
    }

    /// The next interface tick, if the drives are given these set-points at the present one; without any they hold those
    /// that they have.
    fn predict(&mut self, q_desired: Option<&[f64]>) {
        self.rollout.copy_from(&self.state);
        self.mean_torque.fill(0.0);
        for tick in 0..self.ticks.ratio {
            match q_desired {
                Some(new) if tick >= self.ticks.delay => {
                    self.rollout.drive(&self.drives, self.ticks.period_s, |i| new[i]);
                }
                _ => self.roll_old(),
            }
            // What the motor gives is limited, not what the emulation says of it.
            for ((torque, drive), more) in self.rollout.torque.iter_mut().zip(&self.drives).zip(&self.surplus)
            {
                *torque = torque.clamp(-drive.torque_limit - more, drive.torque_limit - more);
            }
            self.mean_torque += &self.rollout.torque;
            self.rollout.travel(&self.mass_inverse, &self.free, self.ticks.period_s);
        }
        self.mean_torque /= f64::from(self.ticks.ratio);
        self.predicted.copy_from(&self.rollout);
    }
}

impl Transformer for EmulatingTransformer {
    fn kind(&self) -> TransformerKind {
        if self.current { TransformerKind::EmulationCurrent } else { TransformerKind::Emulation }
    }

    fn observe(&mut self, sample: &Sample) -> Option<&DVector<f64>> {
        if !self.begun {
            self.stand(&sample.q);
        } else {
            // Nothing was sent since the last sample.
            if !self.frozen {
                self.predict(None);
            }
            self.correct(sample);
        }
        self.frozen = false;
        Some(&self.state.dq)
    }

    fn transform(&mut self, data: &Data, measurement: &Measurement, tau: &[f64], q_desired: &mut [f64]) {
        self.freeze(data);
        self.respond();
        self.rollout.copy_from(&self.state);
        for _ in 0..self.ticks.delay {
            self.roll_old();
            self.rollout.travel(&self.mass_inverse, &self.free, self.ticks.period_s);
        }
        // Y₀, about the measured positions: small numbers keep their digits.
        q_desired.copy_from_slice(measurement.q.as_slice());
        self.mean_torque.fill(0.0);
        for _ in 0..self.ticks.ratio {
            self.rollout.drive(&self.drives, self.ticks.period_s, |i| measurement.q[i]);
            self.mean_torque += &self.rollout.torque;
            self.rollout.travel(&self.mass_inverse, &self.free, self.ticks.period_s);
        }
        self.mean_torque /= f64::from(self.ticks.ratio);
        for (i, missing) in self.mean_torque.iter_mut().enumerate() {
            *missing = tau[i] - self.surplus[i] - *missing;
        }
        eliminate(&mut self.response, self.mean_torque.as_mut_slice());
        for (qd, more) in q_desired.iter_mut().zip(&self.mean_torque) {
            *qd += more;
        }
    }

    fn sent(&mut self, data: &Data, q_desired: &[f64]) {
        self.freeze(data);
        self.predict(Some(q_desired));
        self.active.copy_from_slice(q_desired);
        self.begun = true;
    }
}

/// x of A x = b in place of b, by Gauss' elimination; A (n × n) is overwritten. Its diagonal dominates: what a set-point
/// does to its own drive is more than what it does to others through the arm.
fn eliminate(a: &mut DMatrix<f64>, b: &mut [f64]) {
    let n = b.len();
    for k in 0..n {
        for r in k + 1..n {
            let factor = a[(r, k)] / a[(k, k)];
            for c in k..n {
                a[(r, c)] -= factor * a[(k, c)];
            }
            b[r] -= factor * b[k];
        }
    }
    for k in (0..n).rev() {
        let known: f64 = (k + 1..n).map(|c| a[(k, c)] * b[c]).sum();
        b[k] = (b[k] - known) / a[(k, k)];
    }
}
