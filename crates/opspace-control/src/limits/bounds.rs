//! Bounds on the command of one control cycle, derived from the joint limits.
//!
//! Position and velocity limits are combined into one interval of the joint acceleration a. After a horizon h, the
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
//! it is (x − q − q̇ h)/h: the joint arrives without overshoot. A joint beyond its limit returns at a bounded speed.
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
//! Torque and torque rate limits bound the commanded torque. If these bounds contradict each other, the torque bounds
//! take precedence, then the bounds that brake the joint.

use crate::limits::joint_limits::JointLimits;
use crate::measurement::Measurement;
use crate::qp::interval::Interval;
use nalgebra::DVector;
use opspace_model::{Data, Model, Postures, update};

/// Time constant of the return of a joint beyond its position limit, s.
const RETURN_S: f64 = 0.2;

/// Distance beyond its limit at which a joint counters a push completely, rad or m; half of the default margin.
const GIVE: f64 = 0.005;

/// Number of postures sampled for the acceleration that a torque limit leaves.
const SAMPLES: usize = 64;

/// Returns the braking acceleration of each joint, rad/s² or m/s² (n).
fn braking(model: &Model, limits: &JointLimits) -> Vec<f64> {
    let derived = braking_accelerations(model, &limits.torque);
    limits.acceleration.iter().zip(derived).map(|(&given, derived)| given.min(derived)).collect()
}

/// Returns half of the acceleration that the torque limits allow for the joint's own inertia against gravity, in the
/// worst of many postures; the torque left besides gravity is assumed to be at least a tenth of the limit. rad/s² or
/// m/s² (n).
fn braking_accelerations(model: &Model, torque: &[f64]) -> Vec<f64> {
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

/// Bounds of one control cycle.
#[derive(Clone, Debug)]
pub(crate) struct Bounds {
    limits: JointLimits,
    /// Braking acceleration of each joint, rad/s² or m/s² (n).
    braking: Vec<f64>,
    period_s: f64,
    horizon_s: f64,
    /// Bounds on joint accelerations, rad/s² or m/s² (n).
    pub acceleration: Interval,
    /// Bounds on commanded torques, Nm or N (n).
    pub torque: Interval,
}

impl Bounds {
    /// Creates the bounds of a robot with the control period `period_s` and the horizon `horizon_s` (s).
    pub(crate) fn new(model: &Model, limits: JointLimits, period_s: f64, horizon_s: f64) -> Self {
        let braking = braking(model, &limits);
        Self::with_braking(limits, braking, period_s, horizon_s)
    }

    fn with_braking(limits: JointLimits, mut braking: Vec<f64>, period_s: f64, horizon_s: f64) -> Self {
        let n = limits.lower.len();
        for (braking, velocity) in braking.iter_mut().zip(&limits.velocity) {
            // Limits the braking acceleration so that a stop from the velocity limit (at most 1e3) takes at least one
            // horizon.
            *braking = braking.min(velocity.min(1e3) / horizon_s);
        }
        Self {
            limits,
            braking,
            period_s,
            horizon_s,
            acceleration: Interval::new(n),
            torque: Interval::new(n),
        }
    }

    /// Control period, s.
    pub(crate) fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Horizon of the bounds on accelerations, s.
    pub(crate) fn horizon_s(&self) -> f64 {
        self.horizon_s
    }

    /// Braking acceleration of each joint, rad/s² or m/s² (n).
    pub(crate) fn braking(&self) -> &[f64] {
        &self.braking
    }

    /// Highest speed of each joint, rad/s or m/s (n).
    pub(crate) fn velocity(&self) -> &[f64] {
        &self.limits.velocity
    }

    /// Returns the highest speed that a joint at the position `q` may keep for now, towards its upper position limit, or
    /// towards its lower one if `upwards` is false: the v with v = √((b h)² + 2 b (x − q − v h)) − b h, at most the
    /// velocity limit; 0 beyond the limit.
    pub(crate) fn viable_speed(&self, joint: usize, q: f64, upwards: bool) -> f64 {
        let (l, velocity, braking) = (&self.limits, self.limits.velocity[joint], self.braking[joint]);
        let left = if upwards { l.upper[joint] - q } else { q - l.lower[joint] };
        if left == f64::INFINITY {
            return velocity;
        }
        let reach = 2.0 * braking * self.horizon_s;
        ((reach * reach + 2.0 * braking * left.max(0.0)).sqrt() - reach).min(velocity)
    }

    /// Returns true if joint accelerations and commanded torques (n) are within the bounds of a state. This fast test
    /// needs neither the square roots nor the precedence rules for contradicting bounds; `false` means that the bounds
    /// must be computed. Pushes need no account: they count only where this test fails.
    pub(crate) fn is_strictly_feasible(
        &self,
        measurement: &Measurement,
        added: &[f64],
        before: &DVector<f64>,
        acceleration: impl Fn(usize) -> f64,
        torque: impl Fn(usize) -> f64,
    ) -> bool {
        let (l, h) = (&self.limits, self.horizon_s());
        let (q, dq) = (&measurement.q, &measurement.dq);
        let mut allowed = true;
        // Branch-free, because the sign of a velocity is unpredictable.
        for i in 0..before.len() {
            let (a, tau, braking) = (acceleration(i), torque(i), self.braking[i]);
            let (ahead, speed) = (q[i] + dq[i] * h, dq[i] + a * h);
            // v ≤ √((b h)² + 2 b x) − b h without the square root.
            let stops = |left: f64, speed: f64| {
                (left > 0.0)
                    & ((speed <= 0.0) | (speed * (speed + 2.0 * braking * h) <= 2.0 * braking * left))
            };
            allowed &= stops(l.upper[i] - ahead, speed)
                & stops(ahead - l.lower[i], -speed)
                & (speed.abs().max(dq[i].abs()) <= l.velocity[i])
                & (a.abs() <= l.acceleration[i])
                & ((tau + added[i]).abs() <= l.torque[i])
                & ((tau - before[i]).abs() <= l.torque_rate[i] * self.period_s);
        }
        allowed
    }

    /// Computes the bounds for the measured state. `before` are the last commanded torques (n), `added` the torques
    /// that will be added to the next command (n; Nm or N), `push` accelerations by external forces (n; rad/s² or m/s²).
    pub(crate) fn update(
        &mut self,
        measurement: &Measurement,
        push: &[f64],
        added: &[f64],
        before: &DVector<f64>,
    ) {
        let (l, horizon_s) = (&self.limits, self.horizon_s());
        let (q, dq) = (&measurement.q, &measurement.dq);
        for i in 0..before.len() {
            let (velocity, braking) = (l.velocity[i], self.braking[i]);
            let joint = JointState { q: q[i], dq: dq[i], push: push[i], velocity, braking, horizon_s };
            let (mut lower, mut upper) = (-joint.mirrored().highest(-l.lower[i]), joint.highest(l.upper[i]));
            // Braking bounds may be stricter than accelerating ones; between two limits that are too close, nothing
            // moves.
            if lower > upper {
                let middle = if joint.dq > 0.0 { upper } else { lower };
                (lower, upper) = (middle, middle);
            }
            let a = l.acceleration[i];
            self.acceleration.lower[i] = lower.max(-a).min(upper);
            self.acceleration.upper[i] = upper.min(a).max(lower);

            // The torque limits apply to the sum with the added torques.
            let (low, high) = (-l.torque[i] - added[i], l.torque[i] - added[i]);
            let step = l.torque_rate[i] * self.period_s;
            // If the last command is NaN, any torque within the limits is allowed: NaN must not become a bound.
            self.torque.lower[i] = (before[i] - step).max(low).min(high);
            self.torque.upper[i] = (before[i] + step).min(high).max(low);
        }
    }
}

/// State, acceleration by external forces, velocity limit and braking acceleration of a joint, and the horizon of its
/// bounds. Also of a pair of objects: its position is then its distance, with the opposite sign.
#[derive(Clone, Copy)]
pub(crate) struct JointState {
    pub q: f64,
    pub dq: f64,
    pub push: f64,
    pub velocity: f64,
    pub braking: f64,
    pub horizon_s: f64,
}

impl JointState {
    /// Returns the state for the opposite direction of the joint.
    fn mirrored(self) -> Self {
        Self { q: -self.q, dq: -self.dq, push: -self.push, ..self }
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
        -excess / h - counted * self.push.max(0.0).min(self.braking)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::horizon::HORIZON_S;

    fn bounds(limits: JointLimits) -> Bounds {
        let braking = limits.acceleration.clone();
        Bounds::with_braking(limits, braking, 1e-3, HORIZON_S)
    }

    fn at(q: f64, dq: f64) -> Measurement {
        let mut measurement = Measurement::new(1, 0, false);
        (measurement.q[0], measurement.dq[0]) = (q, dq);
        measurement
    }

    /// Compared: position, speed and braking acceleration of a joint that accelerates at its upper bound, at 1 kHz,
    /// with their limits.
    #[test]
    fn pushed_joint_stays_viable() {
        for (velocity, acceleration) in [(2.0, 5.0), (8.0, 30.0), (1.0, 100.0), (3.0, 1.0)] {
            let (end, period) = (1.0, 1e-3);
            let limits = JointLimits {
                upper: vec![end],
                velocity: vec![velocity],
                acceleration: vec![acceleration],
                ..JointLimits::none(1)
            };
            let mut bounds = bounds(limits);
            let (mut q, mut dq) = (0.0, 0.0);
            let (mut fastest, mut hardest) = (0.0_f64, 0.0_f64);
            for _ in 0..5000 {
                bounds.update(&at(q, dq), &[0.0], &[0.0], &DVector::zeros(1));
                let a = bounds.acceleration.upper[0];
                hardest = hardest.max(a.abs());
                q += period * (dq + 0.5 * period * a);
                dq += period * a;
                fastest = fastest.max(dq);
                assert!(q <= end + 1e-9, "{velocity} {acceleration}: at {q}");
            }
            assert!(
                fastest <= velocity * (1.0 + 1e-9)
                    && fastest > 0.5 * velocity.min((2.0 * acceleration).sqrt())
            );
            assert!(hardest <= acceleration * 1.02, "{velocity}: {hardest} of {acceleration}");
            assert!(end - q < 1e-3 && dq.abs() < 1e-3, "arrived: {q} {dq}");
        }
    }

    /// Compared: the acceleration bound of a joint at its highest viable speed with zero, and those at 1 % less and more.
    #[test]
    fn joint_need_not_brake_at_its_viable_speed() {
        const ROUNDING: f64 = 1e-9;
        let (end, velocity) = (1.0, 3.0);
        let limits = JointLimits {
            lower: vec![-end],
            upper: vec![end],
            velocity: vec![velocity],
            ..JointLimits::none(1)
        };
        for braking in [0.1, 1.0, 10.0, 100.0] {
            let mut bounds = Bounds::with_braking(limits.clone(), vec![braking], 1e-3, HORIZON_S);
            for sign in [1.0, -1.0] {
                let viable =
                    |bounds: &Bounds, left: f64| bounds.viable_speed(0, sign * (end - left), sign > 0.0);
                assert_eq!(viable(&bounds, -0.1), 0.0);
                for left in [1e-3, 1e-2, 0.1, 0.5, 1.5] {
                    let v = viable(&bounds, left);
                    let mut most = |v: f64| {
                        bounds.update(&at(sign * (end - left), sign * v), &[0.0], &[0.0], &DVector::zeros(1));
                        let a = &bounds.acceleration;
                        if sign > 0.0 { a.upper[0] } else { -a.lower[0] }
                    };
                    let place = format!("{braking} rad/s^2, {left} rad before the limit");
                    assert!(
                        v > 0.0 && v <= velocity && (v == velocity || most(v).abs() < ROUNDING),
                        "{place}"
                    );
                    assert!(most(0.99 * v) > 0.0 && most(1.01 * v) < 0.0, "{place}");
                }
            }
        }
    }

    /// A joint that starts beyond its position limit and moves outward returns and stays within the limit.
    #[test]
    fn joint_beyond_its_limit_returns() {
        let limits = JointLimits {
            upper: vec![1.0],
            velocity: vec![2.0],
            acceleration: vec![10.0],
            ..JointLimits::none(1)
        };
        let mut bounds = bounds(limits);
        let (mut q, mut dq) = (1.2, 0.5);
        for _ in 0..5000 {
            bounds.update(&at(q, dq), &[0.0], &[0.0], &DVector::zeros(1));
            let a = bounds.acceleration.upper[0];
            assert!(a.is_finite() && bounds.acceleration.lower[0] <= a);
            q += 1e-3 * (dq + 0.5e-3 * a);
            dq += 1e-3 * a;
        }
        assert!(q <= 1.0 + 1e-6 && q > 0.99, "{q}");
    }

    /// Accelerations and torques that pass the fast test are within the bounds. The converse holds unless bounds
    /// contradict each other; here they do not, for joints that start within their limits and slowly enough to stop.
    #[test]
    fn strictly_feasible_commands_are_within_bounds() {
        let limits = JointLimits {
            lower: vec![-1.0],
            upper: vec![1.0],
            velocity: vec![2.0],
            acceleration: vec![10.0],
            torque: vec![5.0],
            torque_rate: vec![1000.0],
        };
        let mut bounds = bounds(limits);
        let grid = |end: f64| (-40..=40).map(move |i| end * f64::from(i) / 40.0 + 1e-4);
        let (mut allowed, mut refused) = (0, 0);
        for (q, dq) in grid(0.99).flat_map(|q| grid(2.0).map(move |dq| (q, dq))) {
            let measurement = at(q, dq);
            for (a, torque) in
                [-12.0, -9.9, -3.0, 0.0, 5.0, 9.9, 12.0].into_iter().zip([0.5, -0.9, 1.1].into_iter().cycle())
            {
                let before = DVector::from_element(1, 0.0);
                let plain = bounds.is_strictly_feasible(&measurement, &[0.0], &before, |_| a, |_| torque);
                bounds.update(&measurement, &[0.0], &[0.0], &before);
                let within = bounds.acceleration.contains(0, a) && bounds.torque.contains(0, torque);
                assert!(within || !plain, "{q} {dq} {a} {torque}");
                let viable =
                    dq.abs() <= 1.8 && dq.abs() <= (2.0 * 9.0 * (1.0 - q * dq.signum())).sqrt() - 0.2;
                assert!(!viable || plain == within, "{q} {dq} {a} {torque}: {plain} {within}");
                allowed += u32::from(plain);
                refused += u32::from(!plain);
            }
        }
        assert!(allowed > 1000 && refused > 1000, "{allowed} {refused}");
    }

    /// Compared: the lower with the upper bound of every interval, in any state: no interval is empty.
    #[test]
    fn no_interval_is_empty() {
        let limits = JointLimits {
            lower: vec![-0.01],
            upper: vec![0.01],
            velocity: vec![2.0],
            acceleration: vec![10.0],
            torque: vec![5.0],
            torque_rate: vec![100.0],
        };
        let mut bounds = bounds(limits);
        for q in [-1.0, -0.01, -0.005, 0.0, 0.01, 0.5] {
            for dq in [-5.0, -0.3, 0.0, 0.2, 5.0] {
                for before in [-9.0, -5.0, 0.0, 4.99, 7.0] {
                    bounds.update(&at(q, dq), &[0.0], &[0.0], &DVector::from_element(1, before));
                    let [a, t] = [&bounds.acceleration, &bounds.torque];
                    assert!(a.lower[0] <= a.upper[0] && a.lower[0].is_finite() && a.upper[0].is_finite());
                    assert!(t.lower[0] <= t.upper[0] && t.upper[0] <= 5.0 && t.lower[0] >= -5.0);
                }
            }
        }
    }
}
