//! Damping that a transformer leaves to a joint, because the gains of its servo are not known exactly.
//!
//! A transformer cancels the damping kv of a position servo by a setpoint that leads the joint. It asks for a torque of −D v, for a
//! joint of velocity v, by the setpoint
//!
//! ```text
//! kp kv (q_d − q) = (kv − D) v
//! ```
//!
//! If the true gain is (1 + u) kp, the torque is (1 + u)(kv − D) v − kv v. It does not drive the joint if
//!
//! ```text
//! D ≥ kv u/(1 + u)
//! ```
//!
//! With equality, the impedance of the drive at the gain (1 + u) kp is that of an exact transformer at kp, at any frequency at which
//! the velocity is known: no damping at low ones, and a positive real part at others. A smaller kp adds damping. A factor of
//! both gains, as that of a wrong torque constant, changes nothing.
//!
//! # Torques that hold the arm
//!
//! Wrong gains scale the desired torque as well. A torque that balances gravity is then wrong by up to 2 u of it, and would
//! accelerate a joint without damping beyond its speed limit. D is therefore larger by
//!
//! ```text
//! u τ_max/((1 + u) q̇_max)
//! ```
//!
//! with which half of the torque limit moves the joint at most at its speed limit.
//!
//! # Motion along the reference
//!
//! A damping opposes the motion that a task asks for. The part E ≤ D of it acts on the velocity beyond that of the reference:
//!
//! ```text
//! τ = −D v + E c        c = v_ref, but between 0 and v
//! ```
//!
//! A reference that the joint does not follow does not push it. With true gains at the upper end of their interval, the joint is
//! driven along the reference as by the damping −E, up to its velocity. E is at most [`ALONG_REFERENCE`] kv. For a velocity loop of
//! 40 Hz that is 25 1/s times the inertia: the damping 2 ζ ω of a task with 12.5 rad/s. Twice as much made a Panda exceed its speed
//! limits at gains 20 % above the nominal ones.

/// Largest part of a servo's damping that does not act on the motion of the reference.
pub const ALONG_REFERENCE: f64 = 0.1;

/// Damping that is left to a joint: see the [module](self).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RemainingDamping {
    /// Damping D, Nms/rad (Ns/m).
    pub damping: f64,
    /// Part E of it that does not act on motion along the reference, Nms/rad (Ns/m).
    pub along_reference: f64,
    /// Largest damping with which a drive whose gains are at the upper ends of their intervals drives the joint along the reference:
    /// E at these gains, Nms/rad (Ns/m).
    pub driving: f64,
}

impl RemainingDamping {
    /// Returns the damping D (Nms/rad, Ns/m) of a servo that opposes motion by `opposing` (Nms/rad, Ns/m), and whose gains are known
    /// to the fraction `gain_uncertainty` of them.
    pub(crate) fn new(damping: f64, opposing: f64, gain_uncertainty: f64) -> Self {
        let along_reference = damping.min(ALONG_REFERENCE * opposing);
        Self { damping, along_reference, driving: (1.0 + gain_uncertainty) * along_reference }
    }

    /// Returns this damping for a joint with these limits of torque (Nm, N) and speed (rad/s, m/s), whose gains are known to the
    /// fraction `gain_uncertainty` of them.
    #[must_use]
    pub fn with_limits(self, gain_uncertainty: f64, torque_limit: f64, speed_limit: f64) -> Self {
        let against_errors = gain_uncertainty / (1.0 + gain_uncertainty) * torque_limit / speed_limit;
        if self.damping == 0.0 || !against_errors.is_finite() {
            return self;
        }
        Self { damping: self.damping + against_errors, ..self }
    }

    /// Interval of the torques that the drive of a joint of velocity `v` (rad/s, m/s), whose reference has this velocity, adds to
    /// the desired one, Nm (N). Gains at the lower ends of their intervals, (1 − u) kp, leave twice the damping. Gains at the upper
    /// ends leave none, and the drive adds (1 + u) E c.
    pub(crate) fn torques(self, v: f64, reference: f64) -> [f64; 2] {
        let driving = self.driving * followed(v, reference);
        let [a, b] = [-2.0 * self.torque(v, reference), driving];
        [a.min(b), a.max(b)]
    }

    /// Torque that opposes the velocity `v` (rad/s, m/s) of a joint whose reference has this velocity, Nm (N).
    pub(crate) fn torque(self, v: f64, reference: f64) -> f64 {
        self.damping * v - self.along_reference * followed(v, reference)
    }
}

/// Velocity c: the one of the reference, between 0 and `v`.
fn followed(v: f64, reference: f64) -> f64 {
    reference.max(v.min(0.0)).min(v.max(0.0))
}
