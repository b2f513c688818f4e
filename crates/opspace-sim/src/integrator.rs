//! Midpoint steps of a robot under constant joint torques.
//!
//! ```text
//! q_m = q + h/2 q̇        q̇_m = q̇ + h/2 q̈₋        q̈ = q̈(q_m, q̇_m, τ)        q ← q + h (q̇ + h/2 q̈)        q̇ ← q̇ + h q̈
//! ```
//!
//! q̈₋ is the acceleration of the step before, so that a step needs the dynamics once. The order is two. At the plant's
//! 20 kHz that is enough: motor torques and friction are constant over a step, and steps of fourth order cost four times
//! as much.

use nalgebra::DVector;
use opspace_model::{Data, Model, aba, kinematics};

/// Midpoint integrator for n joints.
#[derive(Clone, Debug)]
pub struct Midpoint {
    middle: Data,
    q: DVector<f64>,
    dq: DVector<f64>,
    /// Acceleration of the last step (n; rad/s², m/s²).
    ddq: DVector<f64>,
}

impl Midpoint {
    /// Returns the integrator of one model, before its first step; the robot is at rest.
    #[must_use]
    pub fn new(model: &Model) -> Self {
        let zero = DVector::zeros(model.n());
        Self { middle: Data::new(model), q: zero.clone(), dq: zero.clone(), ddq: zero }
    }

    /// Predicts the middle of the next step of `dt` (s) from `q` (n; rad, m) and `dq` (n; rad/s, m/s): the kinematics
    /// there are those for contact forces.
    pub fn predict(&mut self, model: &Model, q: &[f64], dq: &[f64], dt: f64) -> &Data {
        for i in 0..q.len() {
            self.q[i] = q[i] + 0.5 * dt * dq[i];
            self.dq[i] = dq[i] + 0.5 * dt * self.ddq[i];
        }
        kinematics(model, &mut self.middle, self.q.as_slice(), self.dq.as_slice());
        &self.middle
    }

    /// Positions in the middle of the step that was predicted last (n; rad, m).
    #[must_use]
    pub fn middle_q(&self) -> &[f64] {
        self.q.as_slice()
    }

    /// Velocities in the middle of the step that was predicted last (n; rad/s, m/s).
    #[must_use]
    pub fn middle_dq(&self) -> &[f64] {
        self.dq.as_slice()
    }

    /// Kinematics in the middle of the step that was predicted last.
    #[must_use]
    pub fn middle(&self) -> &Data {
        &self.middle
    }

    /// Accelerations in the middle of the step that was predicted, under the joint torques `tau` (n; Nm, N; rad/s², m/s²).
    pub(crate) fn accelerations(&mut self, model: &Model, tau: &[f64]) -> &[f64] {
        aba(model, &mut self.middle, tau);
        self.middle.ddq.as_slice()
    }

    /// Advances `q` and `dq` by the step that was predicted, under the joint torques `tau` (n; Nm, N). The error per
    /// step is O(dt³) where the torques do not jump.
    pub fn advance(&mut self, model: &Model, q: &mut [f64], dq: &mut [f64], tau: &[f64], dt: f64) {
        aba(model, &mut self.middle, tau);
        self.ddq.copy_from(&self.middle.ddq);
        self.step(q, dq, dt);
    }

    /// Advances `q` and `dq` by the step that was predicted, with the acceleration in its middle, `ddq` (n; rad/s²,
    /// m/s²), from another program.
    pub fn accelerate(&mut self, q: &mut [f64], dq: &mut [f64], ddq: &[f64], dt: f64) {
        self.ddq.copy_from_slice(ddq);
        self.step(q, dq, dt);
    }

    fn step(&self, q: &mut [f64], dq: &mut [f64], dt: f64) {
        for i in 0..q.len() {
            q[i] += dt * (dq[i] + 0.5 * dt * self.ddq[i]);
            dq[i] += dt * self.ddq[i];
        }
    }

    /// Changes the position `q` (rad, m) of a joint after a step of `dt` (s) to that of a backward Euler step, which moves at the
    /// velocity of its end.
    pub(crate) fn step_backward(&self, joint: usize, q: &mut f64, dt: f64) {
        *q += 0.5 * dt * dt * self.ddq[joint];
    }
}
