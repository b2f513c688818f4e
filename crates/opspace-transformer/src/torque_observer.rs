//! Observer of the joint velocities of a torque robot: the steady-state Kalman filter of [`observer`](crate::observer),
//! whose prediction is the arm under the commanded torques.
//!
//! ```text
//! q̈ = M⁻¹ (τ + g_robot − h − n) + d        x = [q, q̇, d]        x = x⁻ + L (y − q⁻)
//! ```
//!
//! τ is the commanded torque in force, g_robot the gravity torque that the robot itself adds, h the Coriolis,
//! centrifugal and gravity torques, n the modelled friction. d is the acceleration that the prediction does not include,
//! contact forces for example. Friction is that at the beginning of a period, unless it could stop a joint within one: with
//! its part n ≈ C q̇ that follows the velocity, q̈ = (M + C T)⁻¹ (τ + g_robot − h − n) + d is stable for any C. A filtered difference of positions lags by the filter's time constant and half a period;
//! this estimate does not, as far as the model is right.

use crate::friction::FrictionCompensation;
use crate::observer::ObserverGain;
use crate::transformer::Transformer;
use nalgebra::{DMatrix, DVector};
use opspace_backend::{CommandDelay, CommandKind, CommandsInForce, GravityCompensation, Sample};
use opspace_model::{Data, MassMatrixFactor, Model};

/// Part of a joint's velocity that friction takes within a period, above which the prediction is implicit.
const STRONG: f64 = 0.25;

/// Parameters of the observer: joints and timing of a torque robot.
#[derive(Clone, Debug)]
pub struct TorqueObserverSetup {
    /// Nominal joint friction, with a compensation gain of 1.
    pub friction: FrictionCompensation,
    /// Resolution of each encoder at the joint (n; rad, m).
    pub resolution_rad: Vec<f64>,
    /// Time between two samples, s.
    pub period_s: f64,
    /// Delay until a torque acts, s.
    pub delay_s: f64,
    /// Side that compensates gravity: the robot or the controller.
    pub gravity_compensated_by: GravityCompensation,
}

/// Transformer of a torque robot that returns the torques unchanged and estimates the joint velocities: see the
/// [module](self).
#[derive(Clone, Debug)]
pub struct TorqueObserver {
    gains: Vec<ObserverGain>,
    friction: FrictionCompensation,
    gravity_compensated_by: GravityCompensation,
    period_s: f64,
    delay: CommandDelay,
    q: DVector<f64>,
    dq: DVector<f64>,
    /// Unmodelled joint accelerations (n; rad/s², m/s²).
    disturbance: DVector<f64>,
    /// Torques that act (n; Nm, N).
    torques: CommandsInForce,
    /// Accelerations under the torque that acts first in a period and under the next one (n; rad/s², m/s²).
    before: DVector<f64>,
    after: DVector<f64>,
    /// M + C T, and its factor.
    mass_matrix: DMatrix<f64>,
    factor: MassMatrixFactor,
    /// True if the last torque was sent in the cycle of the last sample.
    sent: bool,
    /// True if a torque was sent since the last reset.
    begun: bool,
}

impl TorqueObserver {
    /// Returns the observer of a robot at rest, with the structure of `model`.
    #[must_use]
    pub fn new(setup: &TorqueObserverSetup, model: &Model) -> Self {
        let gain = |&resolution_rad: &f64| ObserverGain::of_torque_drive(resolution_rad, setup.period_s);
        let zero = DVector::zeros(setup.resolution_rad.len());
        let delay = CommandDelay::of_time(setup.delay_s, setup.period_s);
        Self {
            gains: setup.resolution_rad.iter().map(gain).collect(),
            friction: setup.friction.clone(),
            gravity_compensated_by: setup.gravity_compensated_by,
            period_s: setup.period_s,
            delay,
            torques: CommandsInForce::new(zero.len(), delay),
            q: zero.clone(),
            dq: zero.clone(),
            disturbance: zero.clone(),
            before: zero.clone(),
            after: zero,
            mass_matrix: DMatrix::zeros(model.n(), model.n()),
            factor: MassMatrixFactor::new(model),
            sent: false,
            begun: false,
        }
    }

    /// Advances the state under constant accelerations.
    fn advance(q: &mut DVector<f64>, dq: &mut DVector<f64>, ddq: &DVector<f64>, duration_s: f64) {
        for ((q, dq), ddq) in q.iter_mut().zip(dq.iter_mut()).zip(ddq) {
            *q += duration_s * (*dq + 0.5 * duration_s * ddq);
            *dq += duration_s * ddq;
        }
    }

    /// Computes the accelerations in the present state, under the torque that acts at the end of the period or, if not
    /// `at_end`, at its beginning.
    fn accelerations(&mut self, data: &Data, at_end: bool, ddq: &mut DVector<f64>) {
        let torque = if at_end { self.torques.after() } else { self.torques.before() };
        for i in 0..torque.len() {
            let held = self.gravity_of_robot(data, i);
            ddq[i] = torque[i] + held - data.bias[i] - self.friction.torque(i, self.dq[i]);
        }
        if self.has_strong_friction(data) {
            self.solve_implicitly(data, ddq);
        } else {
            data.mass_matrix_factor.solve(ddq.as_mut_slice());
        }
        *ddq += &self.disturbance;
    }

    /// Returns true if friction takes a large part of a joint's velocity within a period.
    fn has_strong_friction(&self, data: &Data) -> bool {
        let diagonal = data.mass_matrix.as_slice().iter().step_by(self.dq.len() + 1);
        let mut joints = diagonal.zip(&self.dq).enumerate();
        joints.any(|(i, (inertia, dq))| {
            let is_strong = |damping: f64| damping * self.period_s > STRONG * inertia;
            is_strong(self.friction.most_damping(i, *dq)) && is_strong(self.friction.damping(i, *dq))
        })
    }

    /// Replaces the torques x by (M + C T)⁻¹ x.
    fn solve_implicitly(&mut self, data: &Data, x: &mut DVector<f64>) {
        self.mass_matrix.copy_from(&data.mass_matrix);
        for (i, dq) in self.dq.iter().enumerate() {
            self.mass_matrix[(i, i)] += self.period_s * self.friction.damping(i, *dq);
        }
        // M with non-negative terms added to its diagonal is positive definite if M is.
        if self.factor.update(&self.mass_matrix) {
            self.factor.solve(x.as_mut_slice());
        }
    }

    /// Gravity torque of a joint that the robot itself compensates, Nm or N.
    fn gravity_of_robot(&self, data: &Data, joint: usize) -> f64 {
        match self.gravity_compensated_by {
            GravityCompensation::Robot => data.gravity[joint],
            GravityCompensation::Controller => 0.0,
        }
    }
}

impl Transformer for TorqueObserver {
    fn takes(&self) -> CommandKind {
        CommandKind::Torque
    }

    /// Corrects the prediction. Without a torque since the last sample there is none: the robot holds itself.
    fn observe(&mut self, sample: &Sample) -> Option<&[f64]> {
        let sent = std::mem::take(&mut self.sent);
        if !sent {
            self.reset();
        }
        self.friction.advance(&sample.q);
        if !sent {
            self.q.copy_from_slice(&sample.q);
            self.dq.fill(0.0);
            return None;
        }
        for (i, gain) in self.gains.iter().enumerate() {
            let innovation = sample.q[i] - self.q[i];
            self.q[i] += gain.position * innovation;
            self.dq[i] += gain.velocity * innovation;
            self.disturbance[i] += gain.disturbance * innovation;
        }
        Some(self.dq.as_slice())
    }

    fn transform(&mut self, _data: &Data, torque: &[f64], command: &mut [f64]) {
        command.copy_from_slice(torque);
    }

    /// Predicts the state at the next sample.
    fn sent(&mut self, data: &Data, torque: &[f64]) {
        let mut ddq = std::mem::take(&mut self.after);
        if !self.begun {
            // The robot held itself.
            for (i, held) in ddq.iter_mut().enumerate() {
                *held = data.gravity[i] - self.gravity_of_robot(data, i);
            }
            self.torques.clear();
            self.torques.push(ddq.as_slice());
        }
        self.torques.push(torque);
        if self.delay.part > 0.0 {
            let mut before = std::mem::take(&mut self.before);
            self.accelerations(data, false, &mut before);
            self.before = before;
        }
        self.accelerations(data, true, &mut ddq);
        self.after = ddq;
        let Self { q, dq, before, after, delay, period_s, .. } = self;
        let delayed_s = delay.part * *period_s;
        Self::advance(q, dq, before, delayed_s);
        Self::advance(q, dq, after, *period_s - delayed_s);
        (self.sent, self.begun) = (true, true);
    }

    /// Predicts further: the last torque stays in force.
    fn missed(&mut self, periods: u64) {
        if self.sent {
            let Self { q, dq, after, period_s, torques, .. } = self;
            for _ in 0..periods {
                torques.repeat();
                Self::advance(q, dq, after, *period_s);
            }
        }
    }

    fn reset(&mut self) {
        self.disturbance.fill(0.0);
        self.friction.reset();
        (self.sent, self.begun) = (false, false);
    }
}
