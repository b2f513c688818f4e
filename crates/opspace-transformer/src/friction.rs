//! Joint friction: its parameters, and its compensation n̂ (equation (K11) of the paper).
//!
//! ```text
//! n̂ = γ (Fc d + Fv q̇)
//! ```
//!
//! d, from −1 to 1, is the direction in which Coulomb friction is compensated. Each [`FrictionLaw`] has its own:
//!
//! ```text
//! velocity        d = tanh(q̇/v₀)
//! displacement    d = z/δ                     dz = dq − |dq| z/δ
//! reference       d = r + (1 − |r|) z/δ       r = tanh(q̇_r/v₀)
//! ```
//!
//! The first is that of the paper, with the estimated velocity q̇. A joint that is held by its bristles feels it as the
//! negative damping −γ Fc/v₀. Where that exceeds the damping of the bristles, the joint oscillates at rest at the frequency
//! of its inertia and its bristles, 15 Hz for the arm of the paper.
//!
//! In the second, z is the deflection of Dahl's bristles, driven by the measured motion, and δ the presliding displacement
//! (Dahl, *Solid friction damping of mechanical vibrations*, AIAA Journal 14(12), 1976). The compensation reverses over a
//! displacement of about δ, as friction does. At rest it is therefore constant, whatever the noise of a velocity estimate.
//! A cycle of amplitude A gets the energy 4 γ Fc (A − δ tanh(A/δ)) from it. The joint's own bristles, of stiffness σ₀, take
//! at least as much for any A if δ ≥ √(γ Fc Fs)/σ₀. The slope at rest, the stiffness −γ Fc/δ, is then below σ₀, and a delay
//! of the loop turns it into damping.
//!
//! The third follows the joint velocities q̇_r of the references where they move, and the displacement where they do not:
//! at rest, and along compliant directions. r depends on time alone, so that it adds no feedback: the compensation reverses
//! when the reference does, before the arm's velocity can be measured.

use opspace_backend::quantity::{NonNegative, Positive};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Friction of one joint: Coulomb and static friction with the Stribeck effect, and viscous friction.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(transform = crate::optional_keys::with_optional_keys))]
#[serde(deny_unknown_fields)]
pub struct FrictionParameters {
    /// Coulomb friction Fc while moving, Nm (N).
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the URDF")))]
    pub coulomb_nm: NonNegative,
    /// Static (breakaway) friction Fs, Nm (N).
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "`coulomb_nm`")))]
    pub static_nm: NonNegative,
    /// Stribeck velocity, over which static friction decreases to Coulomb friction, rad/s (m/s).
    #[serde(default = "default_stribeck")]
    pub stribeck_rad_per_s: Positive,
    /// Viscous friction Fv, Nms/rad (Ns/m).
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "damping of the URDF")))]
    pub viscous_nms_per_rad: NonNegative,
    /// Presliding displacement δ, over which static friction builds up from zero like a spring, rad (m). Too small a
    /// value makes the joint oscillate at rest when its friction is compensated.
    #[serde(default = "default_presliding")]
    pub presliding_rad: Positive,
}

/// Compensation of joint friction.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct FrictionCompensationParameters {
    /// Fraction of the modelled friction that is compensated. Compensation above the true friction makes the joint move by
    /// itself; 0.65 is safe for true friction down to two thirds of the model.
    pub gain: NonNegative,
    /// Quantity that the compensation of Coulomb friction follows.
    pub follows: FrictionLaw,
    /// Speed v₀ over which the compensation of Coulomb friction changes sign if it follows the reference or the velocity,
    /// rad/s (m/s).
    pub smoothing_rad_per_s: Positive,
    /// Corner frequency of the friction observer, rad/s; none if absent. It adds the friction that the compensation leaves,
    /// and errors of the model, as far as the motion shows them. It needs a force sensor. 60 rad/s is a good value; below
    /// 20 rad/s, arms at rest may hunt.
    pub observer_rad_per_s: Option<Positive>,
    /// Largest torque of the friction observer at each joint, Nm (N).
    pub observer_limit_nm: Positive,
}

/// Quantity that the compensation of Coulomb friction follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum FrictionLaw {
    /// The joint velocities of the references, where they move; the measured displacement otherwise. Joints come to rest
    /// without oscillation, and reversals are anticipated.
    #[default]
    Reference,
    /// The measured displacement, over `presliding_rad` of the joint's friction: Fc z/δ. Joints come to rest without
    /// oscillation. Errors of tracking through reversals are larger.
    Displacement,
    /// The estimated velocity: Fc tanh(q̇/v₀), as in the paper. Near rest it is negative damping, with which joints may
    /// oscillate or creep.
    Velocity,
}

impl Default for FrictionCompensationParameters {
    fn default() -> Self {
        Self {
            gain: NonNegative::literal(0.65),
            follows: FrictionLaw::default(),
            smoothing_rad_per_s: Positive::literal(0.05),
            observer_rad_per_s: None,
            observer_limit_nm: Positive::literal(6.0),
        }
    }
}

const fn default_stribeck() -> Positive {
    Positive::literal(0.06)
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
    law: FrictionLaw,
    /// Speed v₀, rad/s (m/s).
    smoothing: f64,
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
    /// Direction r of the reference's motion, from −1 to 1.
    reference: f64,
}

impl CompensatedJoint {
    /// Deflection after a motion (rad, m), exact for a motion without reversal.
    fn deflected(&self, motion: f64) -> f64 {
        let slipping = self.presliding * motion.signum();
        // A joint that has moved far in one direction keeps its deflection.
        let remaining = self.deflection - slipping;
        if remaining == 0.0 {
            slipping
        } else {
            slipping + remaining * (-motion.abs() / self.presliding).exp()
        }
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
            law: parameters.follows,
            smoothing: parameters.smoothing_rad_per_s.get(),
            is_continued: false,
        }
    }

    /// Returns a compensation of zero for n joints.
    #[must_use]
    pub fn none(n: usize) -> Self {
        let none = CompensatedJoint { presliding: 1.0, ..CompensatedJoint::default() };
        Self { joints: vec![none; n], law: FrictionLaw::Displacement, smoothing: 1.0, is_continued: false }
    }

    /// Number of joints.
    #[must_use]
    pub fn joints(&self) -> usize {
        self.joints.len()
    }

    /// Relaxes all deflections at the next sample, from which they continue, and stops the reference.
    pub fn reset(&mut self) {
        self.is_continued = false;
        self.joints.iter_mut().for_each(|joint| joint.reference = 0.0);
    }

    /// Advances the deflections to the measured positions `q` (n; rad, m). Call it once per sample.
    pub fn advance(&mut self, q: &[f64]) {
        if self.law == FrictionLaw::Velocity {
            return;
        }
        let is_continued = std::mem::replace(&mut self.is_continued, true);
        for (joint, &q) in self.joints.iter_mut().zip(q) {
            joint.deflection = if is_continued { joint.deflected(q - joint.position) } else { 0.0 };
            joint.position = q;
        }
    }

    /// Returns true if the compensation follows the references, and there is friction to compensate.
    #[must_use]
    pub fn follows_reference(&self) -> bool {
        self.law == FrictionLaw::Reference && self.joints.iter().any(|joint| joint.coulomb > 0.0)
    }

    /// Sets the joint velocities q̇_r of the references (n; rad/s, m/s), zero until then.
    pub fn set_reference_velocity(&mut self, velocity: &[f64]) {
        for (joint, v) in self.joints.iter_mut().zip(velocity) {
            joint.reference = (v / self.smoothing).tanh();
        }
    }

    /// Friction torque n̂ of one joint (Nm, N) at the estimated velocity `dq` (rad/s, m/s).
    #[inline]
    #[must_use]
    pub fn torque(&self, joint: usize, dq: f64) -> f64 {
        let joint = &self.joints[joint];
        let bristles = joint.deflection / joint.presliding;
        let direction = match self.law {
            FrictionLaw::Displacement => bristles,
            FrictionLaw::Velocity => (dq / self.smoothing).tanh(),
            FrictionLaw::Reference => joint.reference + (1.0 - joint.reference.abs()) * bristles,
        };
        joint.coulomb * direction + joint.viscous * dq
    }

    /// Upper bound of [`damping`](Self::damping), which takes a fraction of its time.
    #[inline]
    #[must_use]
    pub(crate) fn most_damping(&self, joint: usize, dq: f64) -> f64 {
        let joint = &self.joints[joint];
        let coulomb = match self.law {
            FrictionLaw::Velocity => joint.coulomb / self.smoothing.max(dq.abs()),
            FrictionLaw::Displacement | FrictionLaw::Reference => 0.0,
        };
        coulomb + joint.viscous
    }

    /// Part c q̇ of the friction torque n̂ of one joint that follows the velocity `dq` (rad/s, m/s): c, Nms/rad (Ns/m).
    #[inline]
    #[must_use]
    pub fn damping(&self, joint: usize, dq: f64) -> f64 {
        let joint = &self.joints[joint];
        let coulomb = match self.law {
            FrictionLaw::Velocity if dq.abs() < 1e-6 * self.smoothing => joint.coulomb / self.smoothing,
            FrictionLaw::Velocity => joint.coulomb * (dq / self.smoothing).tanh() / dq,
            FrictionLaw::Displacement | FrictionLaw::Reference => 0.0,
        };
        coulomb + joint.viscous
    }
}
