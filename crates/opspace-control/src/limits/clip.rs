//! Clip of the joint velocities that inverse kinematics commands: the [bounds of each joint](crate::limits::joint_bound),
//! for a controller that commands motion instead of torques.
//!
//! The desired velocity is q̇* = q̇_ff + q̇_fb, with the velocity of the references q̇_ff and the feedback q̇_fb = k Δq of
//! the distances Δq. The commanded one is, with the velocity q̇₋ of the last cycle and the period T,
//!
//! ```text
//! position        −v(q − x_min) ≤ q̇ ≤ v(x_max − q)                          each joint on its own
//! feedback        q̇ = s_v (q̇_ff + s q̇_fb)    s s_v |q̇_fb| ≤ v(|q̇_fb|/k)   the arm can brake before its reference
//! speed           q̇ ← s q̇                    s |q̇| ≤ v_max
//! acceleration    q̇ ← q̇₋ + s (q̇ − q̇₋)        s |q̇ − q̇₋| ≤ a T
//! ```
//!
//! with the viable speed v, and the factor s_v of the speed limits before the feedback is reduced. Each s is the largest factor from 0 to 1 that all joints allow: the velocity keeps its direction,
//! a joint that rests stays at rest, and a hand stays on a straight path. At a position limit the others go on.
//! If the last step would take a joint beyond the bounds above it, this joint alone brakes at its acceleration limit. What is
//! within all bounds is unchanged.
//!
//! Braking is planned with the acceleration b, half of what the torque limit leaves in the worst of many postures. The
//! acceleration limit a is the one that the robot declares, but at most twice as much as that, and so small that a joint takes
//! 0.1 s to its highest speed. Servos need some milliseconds to follow an acceleration, and are too fast by a times this time
//! when it ends: this leaves room below the speed and the following error at which a run stops.

use crate::limits::joint_bound::{braking, torque_accelerations, viable_speed};
use crate::limits::joint_limits::JointLimits;
use nalgebra::DVector;
use opspace_model::Model;

/// Horizon of the feedback, relative to the time constant 1/k. Feedback slower than b/k is not changed: there, it decelerates
/// with b at most.
const FEEDBACK_HORIZON: f64 = 0.25;

/// Fraction of the acceleration limit with which braking is planned: the rest keeps joints from passing their targets.
const PLANNED: f64 = 0.8;

/// Shortest time in which a joint reaches its highest speed, s.
const RISE_S: f64 = 0.1;

/// Value in the `limited` signal of a joint whose speed or acceleration is at a bound; that of the torque controller.
const LIMITED: f64 = 1.0;

/// Clip of joint velocities to the limits of position, speed and acceleration.
pub(crate) struct VelocityClip {
    limits: JointLimits,
    /// Braking acceleration b of each joint, rad/s² or m/s² (n).
    braking: Vec<f64>,
    /// Largest change of velocity in a period, a T, rad/s or m/s (n).
    step: Vec<f64>,
    horizon_s: f64,
    /// Joints at a bound: 1, else 0 (n).
    limited: DVector<f64>,
}

impl VelocityClip {
    /// Creates the clip for limits that are narrowed already, with the horizon `horizon_s` and the control period `period_s` (s).
    pub(crate) fn new(model: &Model, limits: JointLimits, horizon_s: f64, period_s: f64) -> Self {
        let mut braking = braking(model, &limits, horizon_s);
        let mut step = torque_accelerations(model, &limits.torque);
        for (i, (step, braking)) in step.iter_mut().zip(&mut braking).enumerate() {
            let most = limits.acceleration[i].min(2.0 * *step).min(limits.velocity[i] / RISE_S);
            (*step, *braking) = (period_s * most, braking.min(PLANNED * most));
        }
        Self { braking, step, limited: DVector::zeros(limits.lower.len()), limits, horizon_s }
    }

    /// Creates a clip that changes nothing.
    pub(crate) fn none(n: usize) -> Self {
        let free = vec![f64::INFINITY; n];
        Self {
            limits: JointLimits::none(n),
            braking: free.clone(),
            step: free,
            horizon_s: 0.0,
            limited: DVector::zeros(n),
        }
    }

    /// Joints at a bound in the last cycle: 1, else 0 (n).
    pub(crate) fn limited(&self) -> &[f64] {
        self.limited.as_slice()
    }

    /// Begins a cycle.
    pub(crate) fn begin(&mut self) {
        self.limited.fill(0.0);
    }

    /// Returns the position of the joint's range that is nearest to `q`, rad or m. A joint whose target is outside of its
    /// range counts as limited.
    pub(crate) fn within_range(&mut self, joint: usize, q: f64) -> f64 {
        let (lower, upper) = (self.limits.lower[joint], self.limits.upper[joint]);
        if q > upper || q < lower {
            self.limited[joint] = LIMITED;
        }
        // Not `clamp`: what is not a number stays so.
        if q > upper {
            upper
        } else if q < lower {
            lower
        } else {
            q
        }
    }

    /// Returns true if the joint at `q` may move at `dq` in the next period, after `before` in the last one.
    pub(crate) fn allows(&self, joint: usize, q: f64, dq: f64, before: f64) -> bool {
        let [least, most] = self.interval(joint, q);
        let speed = self.limits.velocity[joint];
        (least..=most).contains(&dq) && dq.abs() <= speed && (dq - before).abs() <= self.step[joint]
    }

    /// Viable velocities of a joint at `q`, rad/s or m/s.
    fn interval(&self, joint: usize, q: f64) -> [f64; 2] {
        let (l, braking) = (&self.limits, self.braking[joint]);
        [
            -viable_speed(q - l.lower[joint], braking, self.horizon_s),
            viable_speed(l.upper[joint] - q, braking, self.horizon_s),
        ]
    }

    /// Changes the desired velocities `dq` (n) of joints at `q` (n) that moved at `before` (n) in the last cycle. `feedforward`
    /// (n) is the part of `dq` that is not feedback with the gain `gain_per_s`.
    pub(crate) fn clip(
        &mut self,
        dq: &mut [f64],
        feedforward: &[f64],
        q: &[f64],
        before: &[f64],
        gain_per_s: f64,
    ) {
        self.bound_positions(dq, q);
        if self.slow_feedback(dq, feedforward, gain_per_s) {
            self.bound_positions(dq, q);
        }
        let slowed = self.factor(dq, |clip, i, dq| clip.limits.velocity[i] / dq.abs());
        if slowed < 1.0 {
            dq.iter_mut().for_each(|dq| *dq *= slowed);
        }
        self.accelerate(dq, q, before);
    }

    /// Keeps each joint viable with respect to its position limits.
    fn bound_positions(&mut self, dq: &mut [f64], q: &[f64]) {
        for (i, dq) in dq.iter_mut().enumerate() {
            let [least, most] = self.interval(i, q[i]);
            self.bound(i, dq, least, most);
        }
    }

    /// Reduces the feedback by one factor, such that each joint can brake before its reference; returns false if it was slow
    /// enough. The velocities are then within the speed limits: what these take off needs no reduction, which would weaken
    /// the feedback across the path, too.
    fn slow_feedback(&mut self, dq: &mut [f64], feedforward: &[f64], gain_per_s: f64) -> bool {
        let horizon_s = FEEDBACK_HORIZON / gain_per_s;
        let speeds = dq.iter().zip(&self.limits.velocity).map(|(dq, most)| most / dq.abs());
        let within_speeds = speeds.fold(1.0, f64::min);
        let slowed = self.factor(dq, |clip, i, dq| {
            let feedback = within_speeds * (dq - feedforward[i]).abs();
            if feedback <= clip.braking[i] / gain_per_s {
                return 1.0;
            }
            let distance = (dq - feedforward[i]).abs() / gain_per_s;
            viable_speed(distance, clip.braking[i], horizon_s) / feedback
        });
        if slowed < 1.0 {
            let slow = |dq: f64, ahead: f64| within_speeds * (ahead + slowed * (dq - ahead));
            dq.iter_mut().zip(feedforward).for_each(|(dq, ahead)| *dq = slow(*dq, *ahead));
        }
        slowed < 1.0
    }

    /// Changes the velocities `before` into `dq` at the acceleration limits.
    fn accelerate(&mut self, dq: &mut [f64], q: &[f64], before: &[f64]) {
        let share = self.factor(dq, |clip, i, dq| clip.step[i] / (dq - before[i]).abs());
        if share == 1.0 {
            return;
        }
        for (i, dq) in dq.iter_mut().enumerate() {
            *dq = before[i] + share * (*dq - before[i]);
            let ([least, most], speed) = (self.interval(i, q[i]), self.limits.velocity[i]);
            let (slowest, fastest) = (before[i] - self.step[i], before[i] + self.step[i]);
            self.bound(i, dq, least.max(-speed).min(fastest), most.min(speed).max(slowest));
        }
    }

    /// Moves `dq` into an interval.
    fn bound(&mut self, joint: usize, dq: &mut f64, least: f64, most: f64) {
        // A velocity that is not a number stays one, so that it stops the run.
        if *dq > most {
            *dq = most;
        } else if *dq < least {
            *dq = least;
        } else {
            return;
        }
        self.limited[joint] = LIMITED;
    }

    /// Returns the least factor that a joint allows, at most 1, and marks the joints that allow less.
    fn factor(&mut self, dq: &[f64], of: impl Fn(&Self, usize, f64) -> f64) -> f64 {
        let mut least = 1.0;
        for (i, &dq) in dq.iter().enumerate() {
            let factor = of(self, i, dq);
            if factor < 1.0 {
                self.limited[i] = LIMITED;
                least = f64::min(least, factor);
            }
        }
        least
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gain of the feedback, 1/s.
    const GAIN_PER_S: f64 = 20.0;

    /// Control period, s.
    const PERIOD_S: f64 = 1e-3;

    /// Clip of joints with these limits of speed and acceleration, ranges of ±1 rad and a period of 1 ms.
    fn clip(velocity: f64, acceleration: f64) -> VelocityClip {
        let n = 3;
        let limits = JointLimits {
            lower: vec![-1.0; n],
            upper: vec![1.0; n],
            velocity: vec![velocity; n],
            ..JointLimits::none(n)
        };
        let (braking, step) = (vec![acceleration; n], vec![PERIOD_S * acceleration; n]);
        VelocityClip { limits, braking, step, horizon_s: 0.02, limited: DVector::zeros(n) }
    }

    /// Compared: velocities within all bounds with themselves, bit by bit.
    #[test]
    fn velocities_within_limits_are_unchanged() {
        let mut clip = clip(2.0, 10.0);
        let wanted = [0.3, -0.1, 0.0];
        let mut dq = wanted;
        clip.clip(&mut dq, &[0.25, -0.1, 0.0], &[0.1, 0.2, -0.3], &[0.295, -0.095, 0.0], GAIN_PER_S);
        assert_eq!(dq, wanted);
        assert_eq!(clip.limited(), [0.0; 3]);
    }

    /// Compared: the direction of velocities that are too fast, and too sudden, with the desired one; the joint that rests
    /// with rest.
    #[test]
    fn velocities_keep_their_direction() {
        const ROUNDING: f64 = 1e-12;
        for (velocity, acceleration, before) in [(2.0, 1e6, 2.0), (10.0, 10.0, 0.0)] {
            let mut clip = clip(velocity, acceleration);
            let mut dq = [4.0, -1.0, 0.0];
            clip.clip(&mut dq, &[4.0, -1.0, 0.0], &[0.0; 3], &[before, -0.25 * before, 0.0], GAIN_PER_S);
            assert!(dq[0] > 0.0 && dq[0] <= velocity && dq[0] - before <= PERIOD_S * acceleration + ROUNDING);
            assert!((dq[1] + 0.25 * dq[0]).abs() < ROUNDING, "{dq:?}");
            assert_eq!(dq[2], 0.0);
        }
    }

    /// Joints with a constant target far away. Compared: their speeds and accelerations with the limits, and the end with the
    /// target, which they do not pass.
    #[test]
    fn joints_brake_before_their_target() {
        const ROUNDING: f64 = 1e-9;
        const SPEED: f64 = 2.0;
        const ACCELERATION: f64 = 10.0;
        let mut clip = clip(SPEED, ACCELERATION);
        let (mut q, mut before) = ([-0.9, 0.5, 0.0], [0.0; 3]);
        let target = [0.9, -0.2, 0.0];
        for _ in 0..3000 {
            let mut dq: [f64; 3] = std::array::from_fn(|i| GAIN_PER_S * (target[i] - q[i]));
            clip.clip(&mut dq, &[0.0; 3], &q, &before, GAIN_PER_S);
            for i in 0..3 {
                let step = (dq[i] - before[i]).abs();
                assert!(dq[i].abs() <= SPEED && step <= PERIOD_S * ACCELERATION + ROUNDING, "{dq:?}");
                q[i] += PERIOD_S * dq[i];
            }
            assert!(q[0] <= target[0] + ROUNDING && q[1] >= target[1] - ROUNDING, "{q:?}");
            before = dq;
        }
        assert!((q[0] - target[0]).abs() < ROUNDING && (q[1] - target[1]).abs() < ROUNDING, "{q:?}");
        assert_eq!(q[2], 0.0);
    }

    /// A velocity that is not a number is not replaced by a bound.
    #[test]
    fn nan_remains() {
        let mut dq = [f64::NAN, 1.0, 0.0];
        clip(2.0, 10.0).clip(&mut dq, &[0.0; 3], &[0.0; 3], &[0.0; 3], GAIN_PER_S);
        assert!(dq[0].is_nan(), "{dq:?}");
    }
}
