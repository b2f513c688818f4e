//! Joint friction: its parameters, and its compensation n̂ (equation (K11) of the paper). It follows the estimated velocity
//! or the measured displacement ([`FrictionLaw`]):
//!
//! ```text
//! n̂ = γ (Fc tanh(q̇/v₀) + Fv q̇)          n̂ = γ (Fc z/δ + Fv q̇),   dz = dq − |dq| z/δ
//! ```
//!
//! A joint that is held by its bristles feels the first as the negative damping −γ Fc/v₀. Where that exceeds the damping
//! of the bristles, the joint oscillates at rest at the frequency of its inertia and its bristles, 15 Hz for the arm of the
//! paper.
//!
//! In the second, z is the deflection of Dahl's bristles, driven by the measured motion, and δ the presliding displacement
//! (Dahl, *Solid friction damping of mechanical vibrations*, AIAA Journal 14(12), 1976). The compensation reverses over a
//! displacement of about δ, as friction does. At rest it is therefore constant, whatever the noise of a velocity estimate.
//! A cycle of amplitude A gets the energy 4 γ Fc (A − δ tanh(A/δ)) from it. The joint's own bristles, of stiffness σ₀, take
//! at least as much for any A if δ ≥ √(γ Fc Fs)/σ₀. The slope at rest, the stiffness −γ Fc/δ, is then below σ₀, and a delay
//! of the loop turns it into damping.

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
    /// Presliding displacement δ, over which static friction builds up from zero like a spring, rad (m). Too small a
    /// value makes the joint oscillate at rest when its friction is compensated.
    #[serde(default = "default_presliding")]
    pub presliding_rad: Positive,
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
    /// Quantity that the compensation of Coulomb friction follows; `velocity` if absent.
    #[serde(default)]
    pub follows: FrictionLaw,
    /// Speed v₀ over which the compensation of Coulomb friction changes sign if it follows the velocity, rad/s (m/s).
    #[serde(default = "default_smoothing")]
    pub smoothing_rad_per_s: Positive,
}

/// Quantity that the compensation of Coulomb friction follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum FrictionLaw {
    /// The estimated velocity: Fc tanh(q̇/v₀). It tracks slow references well. Near rest it is negative damping, with which
    /// joints may oscillate or creep.
    #[default]
    Velocity,
    /// The measured displacement, over `presliding_rad` of the joint's friction: Fc z/δ. Joints come to rest and neither
    /// oscillate nor chatter. Errors of tracking through reversals are larger.
    Displacement,
}

impl Default for FrictionCompensationParameters {
    fn default() -> Self {
        Self {
            gain: default_gain(),
            follows: FrictionLaw::default(),
            smoothing_rad_per_s: default_smoothing(),
        }
    }
}

const fn default_gain() -> NonNegative {
    NonNegative::literal(0.65)
}

const fn default_smoothing() -> Positive {
    Positive::literal(0.05)
}

const fn default_presliding() -> Positive {
    Positive::literal(0.001)
}

/// Friction n̂ of n joints, times a gain: see the [module](self). With the gain of the task it is the friction
/// compensation of equation (K11), applied once, before the backend, for all kinds of robot; with a gain of 1 it is the
/// friction that observers expect.
#[derive(Clone, Debug)]
pub struct FrictionCompensation {
    joints: Vec<CompensatedJoint>,
    /// Speed v₀ of the law that follows the velocity, rad/s (m/s).
    smoothing: Option<f64>,
    /// True if the displacements continue from the last cycle.
    is_continued: bool,
}

/// Friction of one joint, times the gain.
#[derive(Clone, Debug, Default)]
struct CompensatedJoint {
    coulomb: f64,
    viscous: f64,
    /// Presliding displacement δ (rad, m).
    presliding: f64,
    /// Measured position of the last cycle (rad, m).
    position: f64,
    /// Deflection z of the bristles, from −δ to δ (rad, m).
    deflection: f64,
}

impl CompensatedJoint {
    /// Deflection after a motion (rad, m), exact for a motion without reversal.
    fn deflected(&self, motion: f64) -> f64 {
        let slipping = self.presliding * motion.signum();
        slipping + (self.deflection - slipping) * (-motion.abs() / self.presliding).exp()
    }
}

impl FrictionCompensation {
    /// Returns the compensation for joints with this nominal friction.
    #[must_use]
    pub fn new<'a>(
        joints: impl Iterator<Item = &'a FrictionParameters>,
        parameters: &FrictionCompensationParameters,
    ) -> Self {
        let gain = parameters.gain.get();
        let joint = |friction: &FrictionParameters| CompensatedJoint {
            coulomb: gain * friction.coulomb_nm.get(),
            viscous: gain * friction.viscous_nms_per_rad.get(),
            presliding: friction.presliding_rad.get(),
            ..CompensatedJoint::default()
        };
        Self {
            joints: joints.map(joint).collect(),
            smoothing: (parameters.follows == FrictionLaw::Velocity)
                .then_some(parameters.smoothing_rad_per_s.get()),
            is_continued: false,
        }
    }

    /// Returns a compensation of zero for n joints.
    #[must_use]
    pub fn none(n: usize) -> Self {
        let none = CompensatedJoint { presliding: 1.0, ..CompensatedJoint::default() };
        Self { joints: vec![none; n], smoothing: None, is_continued: false }
    }

    /// Number of joints.
    #[must_use]
    pub fn joints(&self) -> usize {
        self.joints.len()
    }

    /// Relaxes all deflections at the next sample, from which they continue.
    pub fn reset(&mut self) {
        self.is_continued = false;
    }

    /// Advances the deflections to the measured positions `q` (n; rad, m). Call it once per sample.
    pub fn advance(&mut self, q: &[f64]) {
        if self.smoothing.is_some() {
            return;
        }
        let is_continued = std::mem::replace(&mut self.is_continued, true);
        for (joint, &q) in self.joints.iter_mut().zip(q) {
            joint.deflection = if is_continued { joint.deflected(q - joint.position) } else { 0.0 };
            joint.position = q;
        }
    }

    /// Friction torque n̂ of one joint (Nm, N) at the estimated velocity `dq` (rad/s, m/s).
    #[inline]
    #[must_use]
    pub fn torque(&self, joint: usize, dq: f64) -> f64 {
        let joint = &self.joints[joint];
        let direction = match self.smoothing {
            None => joint.deflection / joint.presliding,
            Some(smoothing) => (dq / smoothing).tanh(),
        };
        joint.coulomb * direction + joint.viscous * dq
    }
}
