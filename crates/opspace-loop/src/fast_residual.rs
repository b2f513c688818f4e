//! Fast part of the residual torque, by which collisions are detected before it exceeds what friction may be.
//!
//! ```text
//! d = r_f − m(r_f)
//! |d| > (1 + ε) Fs (|Δz| + |Δu| + 2 a) + (1 + ε)(Fs − Fc) |Δe| + ε Fv |Δq̇| + μ max(|Δτ_m|, |Δ(τ_m − n̂ + r_f)|) + ν   (T58)
//! ν = 5 max(σ √(Ko T/(2 + Ko T)), rms d)          e = exp(−(q̇/v_s)²)          u = exp(−s/δ)
//! ```
//!
//! r_f is the residual of a faster [`MomentumObserver`], m(·) a mean over 50 ms, and Δ the difference from it. While a joint moves
//! steadily, or rests, errors of friction and model remain what they are, and so does the residual. Its change is bounded
//! by the changes of what the errors are proportional to: the direction z of the nominal Coulomb friction and its unknown share u, the
//! Stribeck term e, the velocity, and the torques of motors and model. Motion within the play, the fraction a of
//! the presliding displacement, changes friction unseen. The noise is measured: the rms of d over a second. It is a high-pass as in
//! Haddadin, De Luca, Albu-Schäffer, *Robot collisions: a survey on detection, isolation, and identification*, IEEE Trans. Robotics
//! 33(6), 2017, with a threshold that grows where a joint reverses.
//!
//! After a collision the means are kept: d remains the change since then.

use nalgebra::DVector;
use opspace_backend::quantity::Positive;
use opspace_transformer::{FrictionParameters, MomentumObserver};

/// Play of the positions that friction follows, as a fraction of the presliding displacement.
pub(crate) const PLAY: f64 = 0.05;

/// Corner frequency relative to that of the residual.
const FASTER: f64 = 3.0;

/// Rate of the means, 1/s: contact at 0.25 m/s takes a few ms, which they hardly follow; motions of an arm take longer.
const MEAN_PER_S: f64 = 20.0;

/// Rate of the mean of the noise, 1/s.
const NOISE_PER_S: f64 = 1.0;

/// Time after a start in which the means settle and nothing is detected, s.
const SETTLE_S: f64 = 0.3;

/// Noise that the thresholds allow for, in standard deviations: white noise exceeds it once in a million samples.
const DEVIATIONS: f64 = 5.0;

/// Noise of a residual that the thresholds allow for, relative to the rms noise of its input, which is white, at Ko T =
/// `gain`.
pub(crate) fn noise_of_residual(gain: f64) -> f64 {
    DEVIATIONS * (gain / (2.0 + gain)).sqrt()
}

/// Quantities to which errors of the residual are proportional, and the residual itself.
#[derive(Clone, Copy, Debug, Default)]
struct Sample {
    residual: f64,
    direction: f64,
    unknown: f64,
    stribeck: f64,
    velocity: f64,
    motor: f64,
    model: f64,
}

impl Sample {
    /// Moves each value by a fraction of its distance from `to`.
    fn approach(&mut self, to: &Self, fraction: f64) {
        self.residual += fraction * (to.residual - self.residual);
        self.direction += fraction * (to.direction - self.direction);
        self.unknown += fraction * (to.unknown - self.unknown);
        self.stribeck += fraction * (to.stribeck - self.stribeck);
        self.velocity += fraction * (to.velocity - self.velocity);
        self.motor += fraction * (to.motor - self.motor);
        self.model += fraction * (to.model - self.model);
    }
}

/// Joint, with its means.
#[derive(Clone, Debug)]
struct Joint {
    coulomb: f64,
    breakaway: f64,
    stribeck: f64,
    viscous: f64,
    /// Rms noise of the motor torque, Nm (N).
    noise: f64,
    means: Sample,
    variance: f64,
}

/// Inputs of an update (n each).
pub(crate) struct Inputs<'a> {
    /// Momentum, Nms (Ns).
    pub(crate) momentum: &'a DVector<f64>,
    /// All known torques, Nm (N).
    pub(crate) known: &'a DVector<f64>,
    /// Torques of the motors, Nm (N).
    pub(crate) motor: &'a DVector<f64>,
    /// Nominal friction, Nm (N).
    pub(crate) friction: &'a DVector<f64>,
    /// Share of the Coulomb friction that is unknown.
    pub(crate) unknown: &'a DVector<f64>,
    /// Velocities, rad/s (m/s).
    pub(crate) dq: &'a DVector<f64>,
}

/// Fast part of the residual: see the [module](self). Allocates only when it is created.
#[derive(Clone, Debug)]
pub(crate) struct FastResidual {
    corner_rad_per_s: f64,
    observer: MomentumObserver,
    friction_error: f64,
    model_error: f64,
    joints: Vec<Joint>,
    /// Time since the start, s.
    passed_s: f64,
    change: DVector<f64>,
    threshold: DVector<f64>,
}

impl FastResidual {
    /// Returns the fast part of a residual with the corner frequency `corner` (rad/s), of joints with this nominal friction and this
    /// rms noise of the motor torques (n; Nm, N), for these relative errors of friction and model.
    pub(crate) fn new(
        corner: Positive,
        friction: &[FrictionParameters],
        noise: &[f64],
        [friction_error, model_error]: [f64; 2],
    ) -> Self {
        let joint = |(friction, &noise): (&FrictionParameters, &f64)| Joint {
            coulomb: friction.coulomb_nm.get(),
            breakaway: friction.static_nm.get(),
            stribeck: friction.stribeck_rad_per_s.get(),
            viscous: friction.viscous_nms_per_rad.get(),
            noise,
            means: Sample::default(),
            variance: 0.0,
        };
        let corner_rad_per_s = FASTER * corner.get();
        let zero = DVector::zeros(friction.len());
        Self {
            corner_rad_per_s,
            observer: MomentumObserver::new(friction.len(), Positive::literal(corner_rad_per_s)),
            friction_error,
            model_error,
            joints: friction.iter().zip(noise).map(joint).collect(),
            passed_s: 0.0,
            change: zero.clone(),
            threshold: zero,
        }
    }

    /// Updates change and thresholds with a sample, `elapsed_s` (s) after the previous one. After a collision (`has_collided`) the
    /// means are kept.
    pub(crate) fn update(&mut self, elapsed_s: f64, inputs: &Inputs<'_>, has_collided: bool) {
        self.observer.update(elapsed_s, inputs.momentum, inputs.known);
        let is_first = self.passed_s == 0.0;
        self.passed_s += elapsed_s;
        let noise = noise_of_residual(self.corner_rad_per_s * elapsed_s);
        let toward_mean = if is_first { 1.0 } else { fraction(MEAN_PER_S * elapsed_s) };
        // In the first second all samples count alike.
        let toward_noise = fraction(NOISE_PER_S * elapsed_s).max(elapsed_s / self.passed_s);
        for (i, joint) in self.joints.iter_mut().enumerate() {
            let residual = self.observer.residual()[i];
            let (motor, friction, velocity) = (inputs.motor[i], inputs.friction[i], inputs.dq[i]);
            let coulomb = friction - joint.viscous * velocity;
            let now = Sample {
                residual,
                direction: if joint.coulomb > 0.0 { coulomb / joint.coulomb } else { 0.0 },
                unknown: inputs.unknown[i],
                stribeck: (-(velocity / joint.stribeck).powi(2)).exp(),
                velocity,
                motor,
                model: motor - friction + residual,
            };
            let (means, error) = (&joint.means, self.friction_error);
            let moved = (now.motor - means.motor).abs().max((now.model - means.model).abs());
            let noise = (DEVIATIONS * joint.variance.sqrt()).max(noise * joint.noise);
            let direction =
                (now.direction - means.direction).abs() + (now.unknown - means.unknown).abs() + 2.0 * PLAY;
            let stribeck = (joint.breakaway - joint.coulomb).max(0.0) * (now.stribeck - means.stribeck).abs();
            let change = now.residual - means.residual;
            self.change[i] = change;
            self.threshold[i] = (1.0 + error) * (joint.breakaway * direction + stribeck)
                + error * joint.viscous * (now.velocity - means.velocity).abs()
                + self.model_error * moved
                + noise;
            if !has_collided {
                joint.variance += toward_noise * (change * change - joint.variance);
                joint.means.approach(&now, toward_mean);
            }
        }
    }

    /// Returns true once the means have settled.
    pub(crate) fn is_settled(&self) -> bool {
        self.passed_s > SETTLE_S
    }

    /// Change d of the residual (n; Nm, N).
    pub(crate) fn change(&self) -> &DVector<f64> {
        &self.change
    }

    /// Thresholds (n; Nm, N).
    pub(crate) fn threshold(&self) -> &DVector<f64> {
        &self.threshold
    }

    /// Starts anew.
    pub(crate) fn reset(&mut self) {
        self.observer.reset();
        self.passed_s = 0.0;
        self.joints.iter_mut().for_each(|joint| joint.variance = 0.0);
    }
}

/// Fraction of the distance that an implicit first-order low-pass covers in a step with this rate times time.
fn fraction(gain: f64) -> f64 {
    gain / (1.0 + gain)
}
