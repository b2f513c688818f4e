//! Joint friction: the model, and its compensation (equation (K11) of the paper).

use nalgebra::DVector;
use opspace_backend::quantity::{NonNegative, Positive};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Friction of one joint: Coulomb and static friction with the Stribeck effect, and viscous friction.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FrictionParameters {
    /// Coulomb friction Fc while moving, Nm (N).
    pub coulomb_nm: NonNegative,
    /// Static (breakaway) friction Fs, Nm (N).
    pub static_nm: NonNegative,
    /// Stribeck velocity, over which static friction decreases to Coulomb friction, rad/s (m/s).
    pub stribeck_rad_per_s: Positive,
    /// Viscous friction Fv, Nms/rad (Ns/m).
    pub viscous_nms_per_rad: NonNegative,
}

/// Compensation of joint friction.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct FrictionCompensationParameters {
    /// Fraction of the modelled friction that is compensated. Compensation above the true friction makes the joint move
    /// by itself; 0.65 is safe for true friction down to two thirds of the model.
    #[serde(default = "default_gain")]
    pub gain: NonNegative,
    /// Speed v₀ over which the compensation of Coulomb friction changes sign, rad/s (m/s).
    #[serde(default = "default_smoothing")]
    pub smoothing_rad_per_s: Positive,
}

impl Default for FrictionCompensationParameters {
    fn default() -> Self {
        Self { gain: default_gain(), smoothing_rad_per_s: default_smoothing() }
    }
}

const fn default_gain() -> NonNegative {
    NonNegative::literal(0.65)
}

const fn default_smoothing() -> Positive {
    Positive::literal(0.05)
}

/// Friction compensation n̂ of equation (K11): `gain (Fc tanh(q̇/v₀) + Fv q̇)` for n joints. It is applied once, before
/// the backend, for all kinds of robot.
#[derive(Clone, Debug)]
pub struct FrictionCompensation {
    coulomb: DVector<f64>,
    viscous: DVector<f64>,
    smoothing: f64,
}

impl FrictionCompensation {
    /// Returns the compensation for joints with this nominal friction.
    #[must_use]
    pub fn new<'a>(
        joints: impl Iterator<Item = &'a FrictionParameters> + Clone,
        parameters: &FrictionCompensationParameters,
    ) -> Self {
        let gain = parameters.gain.get();
        let collect = |f: fn(&FrictionParameters) -> f64| {
            DVector::from_iterator(joints.clone().count(), joints.clone().map(|j| gain * f(j)))
        };
        Self {
            coulomb: collect(|j| j.coulomb_nm.get()),
            viscous: collect(|j| j.viscous_nms_per_rad.get()),
            smoothing: parameters.smoothing_rad_per_s.get(),
        }
    }

    /// Number of joints.
    #[must_use]
    pub fn joints(&self) -> usize {
        self.coulomb.len()
    }

    /// Returns a compensation of zero for n joints.
    #[must_use]
    pub fn none(n: usize) -> Self {
        let zero = DVector::zeros(n);
        Self { coulomb: zero.clone(), viscous: zero, smoothing: default_smoothing().get() }
    }

    /// Friction torque n̂ of one joint (Nm, N) at the velocity `dq` (rad/s, m/s).
    #[inline]
    #[must_use]
    pub fn torque(&self, joint: usize, dq: f64) -> f64 {
        self.coulomb[joint] * (dq / self.smoothing).tanh() + self.viscous[joint] * dq
    }
}
