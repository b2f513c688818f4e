//! Observer of the external joint torque from the generalised momentum p = M q̇.
//!
//! ```text
//! r = Ko [p − p₀ − ∫ (τ + Cᵀ q̇ − g + r) dt]                                        (T52)
//! ```
//!
//! with the sum τ of all joint torques that are known: those of the motors, friction that a model predicts, contact that a
//! sensor measures. By ṗ = τ + τ_ext + Cᵀ q̇ − g, r is the torque τ_ext that is not known, low-passed with the corner
//! frequency Ko: contact, and errors of the model and of its friction. No acceleration is needed, and the matrices M and C
//! only as products with q̇. De Luca, Albu-Schäffer, Haddadin, Hirzinger, *Collision detection and safe reaction with the
//! DLR-III lightweight manipulator arm*, IROS 2006.
//!
//! The integral is discretised implicitly in r, so that it is stable for any Ko and any interval T between two samples:
//!
//! ```text
//! r = [r₋ + Ko (p − p₋ − T τ̄)]/(1 + Ko T)                                          (T53)
//! ```
//!
//! with the mean τ̄ of τ + Cᵀ q̇ − g over the interval.

use nalgebra::DVector;
use opspace_backend::quantity::Positive;

/// Observer of the unknown torques on n joints: see the [module](self). Allocates only when it is created.
#[derive(Clone, Debug)]
pub struct MomentumObserver {
    corner_rad_per_s: f64,
    /// Residual r (n; Nm, N).
    residual: DVector<f64>,
    /// Momentum p₋ at the last sample (n; Nms, Ns).
    momentum: DVector<f64>,
    /// True if p₋ is that of the previous sample.
    is_continued: bool,
}

impl MomentumObserver {
    /// Returns the observer of `n` joints with the corner frequency Ko (rad/s). Its residual is zero.
    #[must_use]
    pub fn new(n: usize, corner_rad_per_s: Positive) -> Self {
        let zero = DVector::zeros(n);
        Self {
            corner_rad_per_s: corner_rad_per_s.get(),
            residual: zero.clone(),
            momentum: zero,
            is_continued: false,
        }
    }

    /// Updates the residual with the momentum (n; Nms, Ns) at a sample, and the mean of all known torques τ + Cᵀ q̇ − g
    /// (n; Nm, N) over the time `elapsed_s` (s) since the previous one. The first sample after a reset only starts the
    /// observer.
    pub fn update(&mut self, elapsed_s: f64, momentum: &DVector<f64>, torque: &DVector<f64>) {
        if self.is_continued {
            let gain = self.corner_rad_per_s;
            let knowns = momentum.iter().zip(torque);
            for ((residual, before), (now, torque)) in
                self.residual.iter_mut().zip(&self.momentum).zip(knowns)
            {
                let unexplained = now - before - elapsed_s * torque;
                *residual = (*residual + gain * unexplained) / (1.0 + gain * elapsed_s);
            }
        }
        self.momentum.copy_from(momentum);
        self.is_continued = true;
    }

    /// Residual r: low-passed torque on the joints that is not among the known ones (n; Nm, N).
    #[must_use]
    pub fn residual(&self) -> &DVector<f64> {
        &self.residual
    }

    /// Sets the residual to zero; the next sample starts the observer anew.
    pub fn reset(&mut self) {
        self.residual.fill(0.0);
        self.is_continued = false;
    }
}
