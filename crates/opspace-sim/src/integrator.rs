//! Classical fourth-order Runge–Kutta step of a robot under constant joint torques.

use nalgebra::DVector;
use opspace_model::{Data, Model, aba, kinematics};

/// Fourth-order Runge–Kutta integrator for n joints, with preallocated stages.
#[derive(Clone, Debug)]
pub struct RungeKutta {
    data: Data,
    q: DVector<f64>,
    dq: DVector<f64>,
    sum_dq: DVector<f64>,
    sum_ddq: DVector<f64>,
}

impl RungeKutta {
    /// Returns the integrator of one model.
    #[must_use]
    pub fn new(model: &Model) -> Self {
        let zero = DVector::zeros(model.n());
        Self {
            data: Data::new(model),
            q: zero.clone(),
            dq: zero.clone(),
            sum_dq: zero.clone(),
            sum_ddq: zero,
        }
    }

    /// Advances `q` (n; rad, m) and `dq` (n; rad/s, m/s) by `dt` (s) under the joint torques `tau` (n; Nm, N). The
    /// error per step is O(dt⁵).
    pub fn step(&mut self, model: &Model, q: &mut [f64], dq: &mut [f64], tau: &[f64], dt: f64) {
        self.q.copy_from_slice(q);
        self.dq.copy_from_slice(dq);
        self.sum_dq.fill(0.0);
        self.sum_ddq.fill(0.0);
        for (weight, reach) in [(1.0, 0.5), (2.0, 0.5), (2.0, 1.0), (1.0, 0.0)] {
            kinematics(model, &mut self.data, self.q.as_slice(), self.dq.as_slice());
            aba(model, &mut self.data, tau);
            self.sum_dq.axpy(weight, &self.dq, 1.0);
            self.sum_ddq.axpy(weight, &self.data.ddq, 1.0);
            for i in 0..q.len() {
                self.q[i] = q[i] + reach * dt * self.dq[i];
                self.dq[i] = dq[i] + reach * dt * self.data.ddq[i];
            }
        }
        for i in 0..q.len() {
            q[i] += dt / 6.0 * self.sum_dq[i];
            dq[i] += dt / 6.0 * self.sum_ddq[i];
        }
    }
}
