//! Retraction of an arm from a collision, in joint space.
//!
//! ```text
//! s = sign(r) max(|r| − θ, 0)/τ_max          a = Σ s/max |Σ s|                              (T59)
//! q_r = q₀ + D a σ(t/T)                      τ = M (q̈_r + 2 ω (q̇_r − q̇) + ω² (q_r − q)) + h
//! ```
//!
//! A residual r, or its fast change, beyond its threshold θ has the sign of the torque of the contact; the rest of it may be friction. Each joint
//! therefore moves with the torque of the contact, or not at all, and the contact does positive work on the motion:
//! F · dx = τ_ext · dq > 0. So the touched point moves away to the side to which it was pushed, wherever it is on the arm;
//! neither the point nor the force need be known. It is the reflex of Haddadin, De Luca, Albu-Schäffer, *Robot collisions: a
//! survey on detection, isolation, and identification*, IEEE Trans. Robotics 33(6), 2017, q̇ = K r, over a stated distance.
//!
//! The sum is taken from the detection until the contact ends for the first time. σ is the minimum-jerk ramp from 0 to 1, D
//! the distance of the joint that moves farthest, T the duration. Joints move up to [`LIMIT_MARGIN_RAD`] before their
//! position limits. A torque against the motion after the first contact ends the retraction: there is something behind.

use nalgebra::DVector;
use opspace_backend::quantity::Positive;
use opspace_control::ramp::minimum_jerk;
use opspace_model::{Data, Limits, Model};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Retraction after a collision.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
#[non_exhaustive]
pub struct RetractionParameters {
    /// Distance of the joint that moves farthest, rad (m).
    pub distance_rad: Positive,
    /// Duration, s.
    pub duration_s: Positive,
}

impl Default for RetractionParameters {
    fn default() -> Self {
        Self { distance_rad: Positive::literal(0.25), duration_s: Positive::literal(0.6) }
    }
}

impl RetractionParameters {
    /// Highest speed of the joint that moves farthest, rad/s (m/s): that of a minimum-jerk motion.
    #[must_use]
    pub fn top_speed(&self) -> f64 {
        1.875 * self.distance_rad.get() / self.duration_s.get()
    }
}

/// Distance from the position limits that a retraction keeps for its tracking errors, rad (m).
pub const LIMIT_MARGIN_RAD: f64 = 0.02;

/// Frequency ω of the tracking, rad/s: the arm stops within 1/ω, and the delays of an interface of 100 Hz are small beside it.
const TRACKING_RAD_PER_S: f64 = 15.0;

/// Retraction of an arm: see the [module](self). Allocates only when it is created.
#[derive(Clone, Debug)]
pub(crate) struct Retraction {
    distance: f64,
    duration_s: f64,
    weight: Vec<f64>,
    limits: Vec<Limits>,
    elapsed_s: f64,
    /// True once no joint felt the contact.
    is_released: bool,
    is_over: bool,
    /// Sum Σ s of the torques of the contact (n).
    push: DVector<f64>,
    start: DVector<f64>,
    /// Reference q_r, q̇_r and q̈_r (n).
    reference: [DVector<f64>; 3],
    acceleration: DVector<f64>,
}

impl Retraction {
    /// Returns the retraction of an arm with these torque limits (n; Nm, N).
    pub(crate) fn new(parameters: &RetractionParameters, model: &Model, torque_limits: &[f64]) -> Self {
        let zero = DVector::zeros(model.n());
        Self {
            distance: parameters.distance_rad.get(),
            duration_s: parameters.duration_s.get(),
            weight: torque_limits.iter().map(|limit| limit.recip()).collect(),
            limits: model.joints().iter().map(|joint| joint.limits).collect(),
            elapsed_s: 0.0,
            is_released: false,
            is_over: false,
            push: zero.clone(),
            start: zero.clone(),
            reference: [zero.clone(), zero.clone(), zero.clone()],
            acceleration: zero,
        }
    }

    /// Begins the retraction at these joint positions (n; rad, m).
    pub(crate) fn begin(&mut self, q: &DVector<f64>) {
        self.start.copy_from(q);
        self.reference[0].copy_from(q);
    }

    /// Updates the reference with the torques beyond their thresholds (n; Nm, N), `elapsed_s` (s) after the previous cycle.
    pub(crate) fn update(&mut self, elapsed_s: f64, excess: &DVector<f64>) {
        self.elapsed_s += elapsed_s;
        let (mut is_pushed, mut along) = (false, 0.0);
        for (i, excess) in excess.iter().enumerate() {
            let push = excess * self.weight[i];
            is_pushed |= push != 0.0;
            along += push * self.push[i];
            if !self.is_released {
                self.push[i] += push;
            }
        }
        self.is_over |= self.elapsed_s >= self.duration_s || (self.is_released && along < 0.0);
        self.is_released |= !is_pushed;
        let ramp = minimum_jerk(self.elapsed_s, self.duration_s);
        let scale = self.distance / self.push.amax().max(f64::MIN_POSITIVE);
        for (i, limits) in self.limits.iter().enumerate() {
            let start = self.start[i];
            let (lower, upper) = (limits.lower + LIMIT_MARGIN_RAD, limits.upper - LIMIT_MARGIN_RAD);
            // A joint that is nearer to a limit does not move towards it.
            let end = (start + scale * self.push[i]).clamp(lower.min(start), upper.max(start));
            let way = end - start;
            for (reference, ramp) in self.reference.iter_mut().zip(ramp) {
                reference[i] = way * ramp;
            }
            self.reference[0][i] += start;
        }
    }

    /// Returns true at the end.
    pub(crate) fn is_over(&self) -> bool {
        self.is_over
    }

    /// Velocity q̇_r of the reference (n; rad/s, m/s).
    pub(crate) fn velocity(&self) -> &DVector<f64> {
        &self.reference[1]
    }

    /// Computes the torques τ − g that follow the reference, except those that hold the arm at rest (n; Nm, N).
    pub(crate) fn torque(&mut self, data: &Data, torque: &mut DVector<f64>) {
        let [q, dq, ddq] = &self.reference;
        for (i, acceleration) in self.acceleration.iter_mut().enumerate() {
            *acceleration = ddq[i]
                + TRACKING_RAD_PER_S * (2.0 * (dq[i] - data.dq[i]) + TRACKING_RAD_PER_S * (q[i] - data.q[i]));
        }
        torque.gemv(1.0, &data.mass_matrix, &self.acceleration, 0.0);
        *torque += &data.bias;
        *torque -= &data.gravity;
    }
}
