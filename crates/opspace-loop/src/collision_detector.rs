//! Detection of collisions from the torques of the motors, and the reaction to them.
//!
//! ```text
//! |r| > θ          θ = Fs − Fc + ε (Fs + Fv |q̇|) + μ |τ_m| + ν                            (T56)
//! ```
//!
//! r is the residual of the [`MomentumObserver`] with the whole nominal friction among the known torques. The threshold θ of
//! each joint is what r may be without a collision: the breakaway friction that is not in the nominal one, the relative
//! errors ε of the friction and μ of the model (weight, inertia, gains of the current measurement), and the noise ν.

use nalgebra::DVector;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_model::Data;
use opspace_transformer::{
    FrictionCompensation, FrictionCompensationParameters, FrictionLaw, FrictionParameters, MomentumObserver,
};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// Detection of collisions, and the reaction to them.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct CollisionDetectionParameters {
    /// Reaction to a collision.
    #[serde(default)]
    pub reaction: CollisionReaction,
    /// Contact that is expected, and no collision.
    #[serde(default)]
    pub expected: ExpectedContact,
    /// Corner frequency of the observer, rad/s.
    #[serde(default = "default_observer")]
    pub observer_rad_per_s: Positive,
    /// Relative error of the joint friction.
    #[serde(default = "default_friction_error")]
    pub friction_error: NonNegative,
    /// Error of the model and of the measured motor torques, relative to the motor torque.
    #[serde(default = "default_model_error")]
    pub model_error: NonNegative,
    /// Noise of the residual, as a fraction of the torque limit of each joint.
    #[serde(default = "default_noise")]
    pub noise_of_limit: NonNegative,
}

/// Reaction to a collision.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum CollisionReaction {
    /// The run ends with a fault; the robot enters its safe state.
    #[default]
    Stop,
    /// Until the end of the run the robot balances its weight, and damps its motion, without any task.
    Compliant,
}

/// Contact that is no collision.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum ExpectedContact {
    /// Every contact is a collision.
    #[default]
    None,
    /// Contact that a force sensor measures is no collision.
    Sensed,
}

const fn default_observer() -> Positive {
    Positive::literal(150.0)
}

const fn default_friction_error() -> NonNegative {
    NonNegative::literal(0.3)
}

const fn default_model_error() -> NonNegative {
    NonNegative::literal(0.1)
}

const fn default_noise() -> NonNegative {
    NonNegative::literal(0.01)
}

/// A collision: joint with the largest residual relative to its threshold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Collision {
    pub(crate) joint: usize,
    pub(crate) torque: f64,
    pub(crate) threshold: f64,
}

/// Detector of collisions: see the [module](self). Allocates only when it is created.
#[derive(Clone, Debug)]
pub struct CollisionDetector {
    pub(crate) reaction: CollisionReaction,
    pub(crate) expected: ExpectedContact,
    observer: MomentumObserver,
    friction: FrictionCompensation,
    model_error: f64,
    /// Constant part of the thresholds (n; Nm, N).
    constant: Vec<f64>,
    /// Part of the thresholds per velocity (n; Nms/rad, Ns/m).
    viscous: Vec<f64>,
    threshold: DVector<f64>,
}

impl CollisionDetector {
    /// Returns the detector of an arm with this nominal friction and these torque limits (n; Nm, N).
    #[must_use]
    pub fn new(
        parameters: &CollisionDetectionParameters,
        friction: &[FrictionParameters],
        torque_limits: &[f64],
    ) -> Self {
        let whole = FrictionCompensationParameters {
            gain: NonNegative::literal(1.0),
            follows: FrictionLaw::Displacement,
            ..FrictionCompensationParameters::default()
        };
        let error = parameters.friction_error.get();
        let constant = friction.iter().zip(torque_limits).map(|(friction, limit)| {
            let (breakaway, moving) = (friction.static_nm.get(), friction.coulomb_nm.get());
            (breakaway - moving).max(0.0) + error * breakaway + parameters.noise_of_limit.get() * limit
        });
        Self {
            reaction: parameters.reaction,
            expected: parameters.expected,
            observer: MomentumObserver::new(friction.len(), parameters.observer_rad_per_s),
            friction: FrictionCompensation::new(friction.iter(), &whole),
            model_error: parameters.model_error.get(),
            constant: constant.collect(),
            viscous: friction.iter().map(|friction| error * friction.viscous_nms_per_rad.get()).collect(),
            threshold: DVector::zeros(friction.len()),
        }
    }

    /// Thresholds of the joints at rest with these motor torques (n; Nm, N).
    #[must_use]
    pub fn thresholds_at_rest(&self, motor_torque: &[f64]) -> Vec<f64> {
        self.constant
            .iter()
            .zip(motor_torque)
            .map(|(constant, torque)| constant + self.model_error * torque.abs())
            .collect()
    }

    /// Updates the residual with a sample, `elapsed_s` (s) after the previous one: mean torques `motor` of the
    /// motors since then, and mean of all `known` torques but friction, from which friction is taken off (n; Nm, N). Returns
    /// the collision, if there is one.
    pub(crate) fn update(
        &mut self,
        data: &Data,
        elapsed_s: f64,
        motor: &DVector<f64>,
        known: &mut DVector<f64>,
    ) -> Option<Collision> {
        self.friction.advance(data.q.as_slice());
        let mut largest: Option<Collision> = None;
        for (i, known) in known.iter_mut().enumerate() {
            *known -= self.friction.torque(i, data.dq[i]);
            self.threshold[i] =
                self.constant[i] + self.viscous[i] * data.dq[i].abs() + self.model_error * motor[i].abs();
        }
        self.observer.update(elapsed_s, &data.momentum, known);
        for (joint, (&torque, &threshold)) in self.observer.residual().iter().zip(&self.threshold).enumerate()
        {
            let ratio = |c: &Collision| c.torque.abs() / c.threshold;
            let found = Collision { joint, torque, threshold };
            let is_larger = largest.as_ref().is_none_or(|before| ratio(&found) > ratio(before));
            if torque.abs() > threshold && is_larger {
                largest = Some(found);
            }
        }
        largest
    }

    /// Residual torques r (n; Nm, N).
    pub(crate) fn residual(&self) -> &DVector<f64> {
        self.observer.residual()
    }

    /// Thresholds θ (n; Nm, N).
    pub(crate) fn threshold(&self) -> &DVector<f64> {
        &self.threshold
    }

    /// Starts the observer anew.
    pub(crate) fn reset(&mut self) {
        self.observer.reset();
        self.friction.reset();
    }
}
