//! Bounds on the command of one control cycle of the torque controller.
//!
//! Joint accelerations are within the interval of each joint (`joint_bound`). Torque and torque rate limits bound
//! the commanded torque. If these bounds contradict each other, the torque bounds take precedence, then the bounds that brake
//! the joint.

use crate::limits::joint_bound::{self, JointState, Uncommanded};
use crate::limits::joint_limits::JointLimits;
use crate::measurement::Measurement;
use crate::qp::interval::Interval;
use nalgebra::DVector;
use opspace_model::Model;

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
        let braking = joint_bound::braking(model, &limits, horizon_s);
        Self::with_braking(limits, braking, period_s, horizon_s)
    }

    fn with_braking(limits: JointLimits, braking: Vec<f64>, period_s: f64, horizon_s: f64) -> Self {
        let n = limits.lower.len();
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
        let l = &self.limits;
        let left = if upwards { l.upper[joint] - q } else { q - l.lower[joint] };
        joint_bound::viable_speed(left, self.braking[joint], self.horizon_s).min(l.velocity[joint])
    }

    /// Returns true if joint accelerations and commanded torques (n) are within the bounds of a state. This fast test
    /// needs neither the square roots nor the precedence rules for contradicting bounds; `false` means that the bounds
    /// must be computed. Pushes need no account: they count only where this test fails. `drag` are the least and largest
    /// accelerations by damping (n; rad/s² or m/s²).
    pub(crate) fn is_strictly_feasible(
        &self,
        measurement: &Measurement,
        drag: &[[f64; 2]],
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
            let ahead = q[i] + dq[i] * h;
            let (fastest, slowest) = (dq[i] + (a + drag[i][1]) * h, dq[i] + (a + drag[i][0]) * h);
            // v ≤ √((b h)² + 2 b x) − b h without the square root.
            let stops = |left: f64, speed: f64| {
                (left > 0.0)
                    & ((speed <= 0.0) | (speed * (speed + 2.0 * braking * h) <= 2.0 * braking * left))
            };
            allowed &= stops(l.upper[i] - ahead, fastest)
                & stops(ahead - l.lower[i], -slowest)
                & (fastest.max(-slowest).max(dq[i].abs()) <= l.velocity[i])
                & (a.abs() <= l.acceleration[i])
                & ((tau + added[i]).abs() <= l.torque[i])
                & ((tau - before[i]).abs() <= l.torque_rate[i] * self.period_s);
        }
        allowed
    }

    /// Computes the bounds for the measured state. `before` are the last commanded torques (n), `added` the torques
    /// that will be added to the next command (n; Nm or N).
    pub(crate) fn update(
        &mut self,
        measurement: &Measurement,
        uncommanded: Uncommanded<'_>,
        added: &[f64],
        before: &DVector<f64>,
    ) {
        let (l, horizon_s) = (&self.limits, self.horizon_s());
        let (q, dq) = (&measurement.q, &measurement.dq);
        for i in 0..before.len() {
            let (velocity, braking) = (l.velocity[i], self.braking[i]);
            let (push, drag) = (uncommanded.push[i], uncommanded.drag.accelerations()[i]);
            let joint = JointState { q: q[i], dq: dq[i], push, drag, velocity, braking, horizon_s };
            let [lower, upper] = joint.interval(l.lower[i], l.upper[i], l.acceleration[i]);
            (self.acceleration.lower[i], self.acceleration.upper[i]) = (lower, upper);

            // The torque limits apply to the sum with the added torques.
            let (low, high) = (-l.torque[i] - added[i], l.torque[i] - added[i]);
            let step = l.torque_rate[i] * self.period_s;
            // If the last command is NaN, any torque within the limits is allowed: NaN must not become a bound.
            self.torque.lower[i] = (before[i] - step).max(low).min(high);
            self.torque.upper[i] = (before[i] + step).min(high).max(low);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::drag::Drag;
    use crate::limits::horizon::HORIZON_S;

    /// Updates the bounds of a joint that nothing disturbs.
    fn update(bounds: &mut Bounds, measurement: &Measurement, before: f64) {
        let undisturbed = Uncommanded { push: &[0.0], drag: &Drag::new(1) };
        bounds.update(measurement, undisturbed, &[0.0], &DVector::from_element(1, before));
    }

    fn bounds(limits: JointLimits) -> Bounds {
        let braking = limits.acceleration.clone();
        braking_with(limits, braking)
    }

    fn braking_with(limits: JointLimits, mut braking: Vec<f64>) -> Bounds {
        joint_bound::at_least_one_horizon(&mut braking, &limits.velocity, HORIZON_S);
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
                update(&mut bounds, &at(q, dq), 0.0);
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
            let mut bounds = braking_with(limits.clone(), vec![braking]);
            for sign in [1.0, -1.0] {
                let viable =
                    |bounds: &Bounds, left: f64| bounds.viable_speed(0, sign * (end - left), sign > 0.0);
                assert_eq!(viable(&bounds, -0.1), 0.0);
                for left in [1e-3, 1e-2, 0.1, 0.5, 1.5] {
                    let v = viable(&bounds, left);
                    let mut most = |v: f64| {
                        update(&mut bounds, &at(sign * (end - left), sign * v), 0.0);
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
            update(&mut bounds, &at(q, dq), 0.0);
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
                let plain = bounds.is_strictly_feasible(
                    &measurement,
                    &[[0.0; 2]],
                    &[0.0],
                    &before,
                    |_| a,
                    |_| torque,
                );
                update(&mut bounds, &measurement, 0.0);
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
                    update(&mut bounds, &at(q, dq), before);
                    let [a, t] = [&bounds.acceleration, &bounds.torque];
                    assert!(a.lower[0] <= a.upper[0] && a.lower[0].is_finite() && a.upper[0].is_finite());
                    assert!(t.lower[0] <= t.upper[0] && t.upper[0] <= 5.0 && t.lower[0] >= -5.0);
                }
            }
        }
    }
}
