//! Joint friction in the plant: the LuGre model with Stribeck's curve.
//!
//! Canudas de Wit, Olsson, Åström, Lischinsky, *A new model for control of systems with friction*, IEEE
//! Trans. Automatic Control 40(3), 1995:
//!
//! ```text
//! ż = v − σ₀ |v| z / g(v)       τ = σ₀ z + σ₁(v) ż + Fv v       g(v) = Fc + (Fs − Fc) exp(−(v/vs)²)
//! ```

use crate::parameters::BristleParameters;
use opspace_transformer::FrictionParameters;

/// Friction of one joint, with the deflection of its bristles as state.
#[derive(Clone, Debug)]
pub struct LuGre {
    coulomb: f64,
    stiction: f64,
    stribeck: f64,
    viscous: f64,
    bristle_stiffness: f64,
    bristle_damping: f64,
    damping_fades_over: f64,
    /// Coulomb friction per load, and the friction of the present load (Nm, N).
    per_load: f64,
    of_load: f64,
    deflection: f64,
}

impl LuGre {
    /// Returns the friction of a joint at rest with relaxed bristles; `scale` multiplies the nominal friction.
    #[must_use]
    pub fn new(friction: &FrictionParameters, bristle: &BristleParameters, scale: f64) -> Self {
        let coulomb = scale * friction.coulomb_nm.get();
        Self {
            coulomb,
            stiction: scale * friction.static_nm.get() - coulomb,
            stribeck: friction.stribeck_rad_per_s.get(),
            viscous: scale * friction.viscous_nms_per_rad.get(),
            bristle_stiffness: bristle.stiffness_nm_per_rad.get(),
            bristle_damping: bristle.damping_nms_per_rad.get(),
            damping_fades_over: bristle.damping_fade_velocity_rad_per_s.get(),
            per_load: 0.0,
            of_load: 0.0,
            deflection: 0.0,
        }
    }

    /// Adds Coulomb friction per load of the gear.
    #[must_use]
    pub fn with_friction_per_load(self, per_load: f64) -> Self {
        Self { per_load, ..self }
    }

    /// Sets the load of the gear (Nm, N).
    pub fn set_load(&mut self, load: f64) {
        self.of_load = self.per_load * load.abs();
    }

    /// Returns the friction torque (Nm, N) against the velocity `v` (rad/s, m/s), which is constant over the step `dt`
    /// (s). The bristles' equation is solved exactly for that velocity.
    pub fn step(&mut self, v: f64, dt: f64) -> f64 {
        let (torque, deflection) = self.after(v, dt);
        self.deflection = deflection;
        torque
    }

    /// Friction torque (Nm, N) that [`step`](Self::step) would return.
    pub(crate) fn torque(&self, v: f64, dt: f64) -> f64 {
        self.after(v, dt).0
    }

    /// Friction torque (Nm, N) and deflection (rad, m) after a step.
    fn after(&self, v: f64, dt: f64) -> (f64, f64) {
        let level = self.coulomb + self.of_load + self.stiction * (-(v / self.stribeck).powi(2)).exp();
        if level <= 0.0 {
            return (self.viscous * v, self.deflection);
        }
        let before = self.deflection;
        let steady = level * v.signum() / self.bristle_stiffness;
        let decay = (-self.bristle_stiffness * v.abs() / level * dt).exp();
        let deflection = steady + (before - steady) * decay;
        let rate = (deflection - before) / dt;
        // Bristle damping decreases with speed, and with the friction level if that is below 1 Nm.
        let damping = self.bristle_damping * (-(v / self.damping_fades_over).powi(2)).exp() * level.min(1.0);
        (self.bristle_stiffness * deflection + damping * rate + self.viscous * v, deflection)
    }
}
