//! Observer of the friction that the compensation n̂ leaves, and of errors of the model.
//!
//! ```text
//! τ ← τ − clamp(r)          τ̄ = τ_m + Jᵀ F + Cᵀ q̇ − g − n̂                             (T54)
//! ```
//!
//! r is the residual (T53) with the friction compensation n̂ and the wrench F that a force sensor measures among the known
//! torques: what is left is friction that n̂ does not have, with the opposite sign, errors of the model, and contact that no
//! sensor measures. Measured contact is not opposed. By linearity r is the residual without F, minus Jᵀ F low-passed with
//! the same corner frequency.

use crate::momentum_observer::MomentumObserver;
use nalgebra::DVector;
use opspace_backend::quantity::Positive;

/// Observer of uncompensated friction of n joints: see the [module](self). Allocates only when it is created.
#[derive(Clone, Debug)]
pub struct FrictionObserver {
    observer: MomentumObserver,
    limit: f64,
    /// Torque to add (n; Nm, N).
    torque: DVector<f64>,
}

impl FrictionObserver {
    /// Returns the observer of `n` joints with the corner frequency Ko (rad/s), whose torque is at most `limit_nm` at each
    /// joint (Nm, N).
    #[must_use]
    pub fn new(n: usize, corner_rad_per_s: Positive, limit_nm: Positive) -> Self {
        Self {
            observer: MomentumObserver::new(n, corner_rad_per_s),
            limit: limit_nm.get(),
            torque: DVector::zeros(n),
        }
    }

    /// Updates the observer like [`MomentumObserver::update`]; n̂ and Jᵀ F are among the known torques.
    pub fn update(&mut self, elapsed_s: f64, momentum: &DVector<f64>, torque: &DVector<f64>) {
        self.observer.update(elapsed_s, momentum, torque);
        for (torque, residual) in self.torque.iter_mut().zip(self.observer.residual()) {
            *torque = (-residual).clamp(-self.limit, self.limit);
        }
    }

    /// Torque to add to the compensation n̂ (n; Nm, N).
    #[must_use]
    pub fn torque(&self) -> &DVector<f64> {
        &self.torque
    }

    /// Sets the torque to zero; the next sample starts the observer anew.
    pub fn reset(&mut self) {
        self.observer.reset();
        self.torque.fill(0.0);
    }
}
