//! Bounds of one joint: the one definition of its viable speed and acceleration, for all controllers.
//!
//! Limits of position and velocity are combined into one interval of the joint acceleration a. After a horizon h, the
//! joint must neither exceed its velocity limit v nor be too fast to stop before its position limit x with the braking
//! acceleration b:
//!
//! ```text
//! q̇ + a h ≤ v          q̇ + a h ≤ √((b h)² + 2 b (x − q − q̇ h)) − b h
//! ```
//!
//! and the mirrored inequalities for the lower limit. The second bound is the velocity from which a joint that
//! decelerates with b, in steps of one horizon, just stops at x (viability; compare Del Prete, *Joint position and
//! velocity bounds in discrete-time acceleration/torque control of robot arms*, IEEE RA-L 3(1), 2018). Near the limit
//! it is (x − q − q̇ h)/h: the joint arrives without overshoot. A joint beyond its limit returns at a bounded speed. The torque
//! controller takes this interval as [rows](crate::limits::bounds).
//!
//! The highest speed at q at which a joint need not brake (a = 0) is the solution of the second bound for q̇:
//!
//! ```text
//! v(x − q) = √((2 b h)² + 2 b (x − q)) − 2 b h
//! ```
//!
//! Along v(x − q), the deceleration is b v/(v + 2 b h), less than b. Inverse kinematics, which commands velocities,
//! [clips](crate::limits::clip) them to it.
//!
//! These bounds act as a spring and a damper, which beyond the limit an external force would deflect by d h 0.2 s, where d is
//! the acceleration that it causes (estimated in `push.rs`). A joint that is too fast, or would be beyond its limit after the
//! horizon, counters it, up to the braking acceleration:
//!
//! ```text
//! q̇ + a h ≤ … − w min(d, b) h          w = max(q + q̇ h − x, (q̇ − v) h)/GIVE, from 0 to 1
//! ```
//!
//! A joint at rest then passes its limit by less than GIVE, for any d up to b; a load that rises within a few control periods
//! moves it further before the estimate follows. Because w vanishes at the limit, a joint that
//! friction holds there does not creep.
//!
//! # Damping
//!
//! The drives may add torques to the commanded ones that are known within intervals only ([`drag`](crate::limits::drag)). The
//! largest acceleration by them that is directed towards a bound is subtracted from the bound.

use crate::limits::drag::Drag;
use crate::limits::joint_limits::JointLimits;
use opspace_model::{Data, Model, Postures, update};

/// Time constant of the return of a joint beyond its position limit, s.
const RETURN_S: f64 = 0.2;

/// Distance beyond its limit at which a joint counters a push completely, rad or m; half of the default margin.
const GIVE: f64 = 0.005;

/// Number of postures sampled for the acceleration that a torque limit leaves.
const SAMPLES: usize = 64;

/// Returns the braking acceleration of each joint, rad/s² or m/s² (n): at most the acceleration limit, and so small that a stop
/// from the velocity limit (at most 1e3) takes at least one horizon (s).
pub(crate) fn braking(model: &Model, limits: &JointLimits, horizon_s: f64) -> Vec<f64> {
    let mut braking = torque_accelerations(model, &limits.torque);
    for (i, braking) in braking.iter_mut().enumerate() {
        *braking = limits.acceleration[i].min(*braking);
    }
    at_least_one_horizon(&mut braking, &limits.velocity, horizon_s);
    braking
}

/// Reduces braking accelerations such that a stop from the velocity limits (at most 1e3) takes at least one horizon.
pub(crate) fn at_least_one_horizon(braking: &mut [f64], velocity: &[f64], horizon_s: f64) {
    for (braking, velocity) in braking.iter_mut().zip(velocity) {
        *braking = braking.min(velocity.min(1e3) / horizon_s);
    }
}

/// Returns half of the acceleration that the torque limits allow for the joint's own inertia against gravity, in the
/// worst of many postures; the torque left besides gravity is assumed to be at least a tenth of the limit. rad/s² or
/// m/s² (n).
pub(crate) fn torque_accelerations(model: &Model, torque: &[f64]) -> Vec<f64> {
    let n = model.n();
    let mut data = Data::new(model);
    let postures = Postures::new(model, 1.0);
    let mut least = vec![f64::INFINITY; n];
    for sample in 0..SAMPLES {
        if !update(model, &mut data, &postures.posture(sample), &vec![0.0; n]) {
            continue;
        }
        for i in 0..n {
            let left = (torque[i] - data.gravity[i].abs()).max(0.1 * torque[i]);
            least[i] = least[i].min(0.5 * left / data.mass_matrix[(i, i)]);
        }
    }
    least
}

/// Returns the highest speed v at which a joint at the distance `left` (rad or m) before its limit need not brake yet; 0 at
/// the limit and beyond it.
pub(crate) fn viable_speed(left: f64, braking: f64, horizon_s: f64) -> f64 {
    if left == f64::INFINITY {
        return f64::INFINITY;
    }
    let reach = 2.0 * braking * horizon_s;
    (reach * reach + 2.0 * braking * left.max(0.0)).sqrt() - reach
}

/// Accelerations that no command causes (n; rad/s² or m/s²).
#[derive(Clone, Copy)]
pub(crate) struct Uncommanded<'a> {
    /// By external forces, as the motion shows them.
    pub push: &'a [f64],
    /// By the damping of the joints.
    pub drag: &'a Drag,
}

/// State, acceleration by external forces and by damping, velocity limit and braking acceleration of a joint, and the horizon
/// of its bounds. Also of a pair of objects: its position is then its distance, with the opposite sign.
#[derive(Clone, Copy)]
pub(crate) struct JointState {
    pub q: f64,
    pub dq: f64,
    pub push: f64,
    pub drag: [f64; 2],
    pub velocity: f64,
    pub braking: f64,
    pub horizon_s: f64,
}

impl JointState {
    /// Returns the state for the opposite direction of the joint.
    fn mirrored(self) -> Self {
        Self { q: -self.q, dq: -self.dq, push: -self.push, drag: [-self.drag[1], -self.drag[0]], ..self }
    }

    /// Returns the interval of accelerations between the position limits `lower` and `upper`, with the acceleration limit
    /// `acceleration`: bounds that brake take precedence.
    pub(crate) fn interval(self, lower: f64, upper: f64, acceleration: f64) -> [f64; 2] {
        let (mut low, mut high) = (-self.mirrored().highest(-lower), self.highest(upper));
        // Braking bounds may be stricter than accelerating ones; between two limits that are too close, nothing
        // moves.
        if low > high {
            let middle = if self.dq > 0.0 { high } else { low };
            (low, high) = (middle, middle);
        }
        [low.max(-acceleration).min(high), high.min(acceleration).max(low)]
    }

    /// Returns the highest acceleration for which the joint stays below its velocity limit and can stop at the position
    /// limit `end`.
    pub(crate) fn highest(self, end: f64) -> f64 {
        let h = self.horizon_s;
        let mut allowed = self.velocity;
        // Distance beyond the limit after the horizon; a speed limit counts as one that moves with it.
        let mut beyond = (self.dq - self.velocity) * h;
        if end < f64::INFINITY {
            let left = end - self.q;
            let ahead = left - self.dq * h;
            let reach = self.braking * h;
            let to_end = if ahead > 0.0 {
                (reach * reach + 2.0 * self.braking * ahead).sqrt() - reach
            } else {
                (left.min(0.0) / RETURN_S).max(-self.velocity)
            };
            allowed = allowed.min(to_end);
            beyond = beyond.max(-ahead);
        }
        let excess = self.dq - allowed;
        let counted = (beyond / GIVE).clamp(0.0, 1.0);
        -excess / h - counted * self.push.max(0.0).min(self.braking) - self.drag[1]
    }
}
