//! Detection of collisions from the torques of the motors, and the reaction to them.
//!
//! ```text
//! |r| > θ
//! θ = LP[ Fs − Fc + Fc exp(−s/δ) + 2 a (1 + ε) Fs + ε (Fs + Fv |q̇|) + μ max(|τ_m|, |τ_m − n̂ + r|) + ν ]      (T56)
//! ν = 5 σ √(Ko T/(2 + Ko T))
//! ```
//!
//! r is the residual of the [`MomentumObserver`] with the whole nominal friction n̂ among the known torques. The threshold θ of
//! each joint is what r may be without a collision: the breakaway friction that is not in the nominal one; the friction that
//! is unknown until the joint has moved by a path s beyond its presliding displacement δ; the relative errors ε of the
//! friction, and μ of the measured torque τ_m, or of the model's torque τ_m − n̂ + r for the measured motion; and the noise ν, of motor
//! torques with the rms noise σ. LP is the low-pass of the observer: a bound of its input, low-passed, is a bound of its output.
//!
//! Fast changes of the residual are compared with smaller thresholds: the file `fast_residual.rs`.
//!
//! n̂ and s follow positions with a play of δ/20, so that noise of the encoders below it is no motion. With the
//! play a δ the friction changes by up to 2 a (1 + ε) Fs unseen.

use crate::fast_residual::{FastResidual, Inputs, PLAY, noise_of_residual};
use crate::retraction::RetractionParameters;
use nalgebra::DVector;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_model::Data;
use opspace_transformer::{
    FrictionCompensation, FrictionCompensationParameters, FrictionLaw, FrictionParameters, MomentumObserver,
};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Detection of collisions, and the reaction to them.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct CollisionDetectionParameters {
    /// Reaction to a collision.
    pub reaction: CollisionReaction,
    /// Contact that is expected, and no collision.
    pub expected: ExpectedContact,
    /// Corner frequency of the observer, rad/s.
    pub observer_rad_per_s: Positive,
    /// Relative error of the joint friction, including what a creeping joint has above its static friction.
    pub friction_error: NonNegative,
    /// Error of the model and of the measured motor torques, relative to the motor torque.
    pub model_error: NonNegative,
    /// Rms noise of the motor torques, as a fraction of the torque limit of each joint.
    pub noise_of_limit: NonNegative,
    /// True if fast changes of the external torque are also collisions: on by default. Without effect if contact is expected.
    pub fast_residual: bool,
}

impl Default for CollisionDetectionParameters {
    fn default() -> Self {
        Self {
            reaction: CollisionReaction::default(),
            expected: ExpectedContact::default(),
            observer_rad_per_s: Positive::literal(150.0),
            friction_error: NonNegative::literal(0.35),
            model_error: NonNegative::literal(0.1),
            noise_of_limit: NonNegative::literal(0.005),
            fast_residual: true,
        }
    }
}

/// Reaction to a collision.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum CollisionReaction {
    /// The run ends with a fault; the robot enters its safe state.
    #[default]
    Stop,
    /// Until the end of the run the robot balances its weight, and damps its motion, without any task.
    Compliant,
    /// The robot moves away from the contact; then the run ends as with `stop`.
    Retract(RetractionParameters),
}

/// Contact that is no collision.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
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

/// A collision: joint with the largest residual relative to its threshold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Collision {
    pub(crate) joint: usize,
    pub(crate) torque: f64,
    pub(crate) threshold: f64,
}

/// Friction of a joint.
#[derive(Clone, Debug)]
struct JointFriction {
    coulomb: f64,
    presliding: f64,
}

/// Detector of collisions: see the [module](self). Allocates only when it is created.
#[derive(Clone, Debug)]
pub struct CollisionDetector {
    pub(crate) reaction: CollisionReaction,
    pub(crate) expected: ExpectedContact,
    corner_rad_per_s: f64,
    observer: MomentumObserver,
    friction: FrictionCompensation,
    joints: Vec<JointFriction>,
    /// Positions with play (n; rad, m).
    q: DVector<f64>,
    /// Share exp(−s/δ) of the bristles' deflections that is that before the first sample (n).
    unknown: DVector<f64>,
    /// Nominal friction n̂ (n; Nm, N).
    nominal: DVector<f64>,
    fast: Option<FastResidual>,
    /// Torques beyond their thresholds (n; Nm, N).
    excess: DVector<f64>,
    has_collided: bool,
    model_error: f64,
    /// Rms noise of the motor torques (n; Nm, N).
    noise: Vec<f64>,
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
        let constant = friction.iter().map(|friction| {
            let (breakaway, moving) = (friction.static_nm.get(), friction.coulomb_nm.get());
            (breakaway - moving).max(0.0) + (error + 2.0 * PLAY * (1.0 + error)) * breakaway
        });
        let joints = friction.iter().map(|friction| JointFriction {
            coulomb: friction.coulomb_nm.get(),
            presliding: friction.presliding_rad.get(),
        });
        let noise: Vec<f64> =
            torque_limits.iter().map(|limit| parameters.noise_of_limit.get() * limit).collect();
        let model_error = parameters.model_error.get();
        let fast =
            || FastResidual::new(parameters.observer_rad_per_s, friction, &noise, [error, model_error]);
        // The delay of a force sensor would be a change of the residual.
        let has_fast = parameters.fast_residual && parameters.expected == ExpectedContact::None;
        let zero = DVector::zeros(friction.len());
        Self {
            fast: has_fast.then(fast),
            unknown: zero.clone(),
            nominal: zero.clone(),
            excess: zero.clone(),
            has_collided: false,
            reaction: parameters.reaction,
            expected: parameters.expected,
            corner_rad_per_s: parameters.observer_rad_per_s.get(),
            joints: joints.collect(),
            q: DVector::from_element(friction.len(), f64::NAN),
            observer: MomentumObserver::new(friction.len(), parameters.observer_rad_per_s),
            friction: FrictionCompensation::new(friction.iter(), &whole),
            model_error,
            noise,
            constant: constant.collect(),
            viscous: friction.iter().map(|friction| error * friction.viscous_nms_per_rad.get()).collect(),
            threshold: zero,
        }
    }

    /// Thresholds of the joints at rest, after they have moved, with these motor torques (n; Nm, N) and this
    /// period (s).
    #[must_use]
    pub fn thresholds_at_rest(&self, motor_torque: &[f64], period_s: f64) -> Vec<f64> {
        let noise = noise_of_residual(self.corner_rad_per_s * period_s);
        let parts = self.constant.iter().zip(&self.noise).zip(motor_torque);
        parts
            .map(|((constant, rms), torque)| constant + noise * rms + self.model_error * torque.abs())
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
        let is_first = self.follow(data);
        for i in 0..self.nominal.len() {
            self.nominal[i] = self.friction.torque(i, data.dq[i]);
        }
        *known -= &self.nominal;
        self.observer.update(elapsed_s, &data.momentum, known);
        let gain = self.corner_rad_per_s * elapsed_s;
        let noise = noise_of_residual(gain);
        for (i, residual) in self.observer.residual().iter().enumerate() {
            let model = motor[i] - self.nominal[i] + residual;
            let bound = self.constant[i]
                + noise * self.noise[i]
                + self.joints[i].coulomb * self.unknown[i]
                + self.viscous[i] * data.dq[i].abs()
                + self.model_error * motor[i].abs().max(model.abs());
            let before = if is_first { bound } else { self.threshold[i] };
            self.threshold[i] = (before + gain * bound) / (1.0 + gain);
        }
        if let Some(fast) = &mut self.fast {
            let (momentum, friction, unknown, dq) = (&data.momentum, &self.nominal, &self.unknown, &data.dq);
            let inputs = Inputs { momentum, known, motor, friction, unknown, dq };
            fast.update(elapsed_s, &inputs, self.has_collided);
        }
        let found = self.compare();
        self.has_collided |= found.is_some();
        found
    }

    /// Compares the torques with their thresholds. Returns the largest one relative to its threshold, if it is beyond.
    fn compare(&mut self) -> Option<Collision> {
        let mut largest: Option<Collision> = None;
        self.excess.fill(0.0);
        let settled = self.fast.as_ref().filter(|fast| fast.is_settled());
        let slow = (self.observer.residual(), &self.threshold);
        for (torques, thresholds) in
            [Some(slow), settled.map(|f| (f.change(), f.threshold()))].into_iter().flatten()
        {
            for (joint, (&torque, &threshold)) in torques.iter().zip(thresholds).enumerate() {
                if torque.abs() <= threshold {
                    continue;
                }
                self.excess[joint] += torque.signum() * (torque.abs() - threshold);
                let ratio = |c: &Collision| c.torque.abs() / c.threshold;
                let found = Collision { joint, torque, threshold };
                if largest.as_ref().is_none_or(|before| ratio(&found) > ratio(before)) {
                    largest = Some(found);
                }
            }
        }
        largest
    }

    /// Moves the positions that friction follows. Returns true at the first sample.
    fn follow(&mut self, data: &Data) -> bool {
        let is_first = self.q.iter().any(|q| q.is_nan());
        let states = self.q.iter_mut().zip(&mut self.unknown);
        for ((joint, (followed, unknown)), &q) in self.joints.iter().zip(states).zip(&data.q) {
            if is_first {
                (*followed, *unknown) = (q, 1.0);
            }
            let play = PLAY * joint.presliding;
            let step = (q - *followed) - (q - *followed).clamp(-play, play);
            *followed += step;
            *unknown *= (-step.abs() / joint.presliding).exp();
        }
        self.friction.advance(self.q.as_slice());
        is_first
    }

    /// Residual torques r (n; Nm, N).
    pub(crate) fn residual(&self) -> &DVector<f64> {
        self.observer.residual()
    }

    /// Thresholds θ (n; Nm, N).
    pub(crate) fn threshold(&self) -> &DVector<f64> {
        &self.threshold
    }

    /// Fast part of the residual, if it is used.
    pub(crate) fn fast(&self) -> Option<&FastResidual> {
        self.fast.as_ref()
    }

    /// Torques beyond their thresholds (n; Nm, N): each has the sign of the torque of a contact.
    pub(crate) fn excess(&self) -> &DVector<f64> {
        &self.excess
    }

    /// Starts the observers anew.
    pub(crate) fn reset(&mut self) {
        self.observer.reset();
        if let Some(fast) = &mut self.fast {
            fast.reset();
        }
        self.friction.reset();
        self.q.fill(f64::NAN);
    }
}
