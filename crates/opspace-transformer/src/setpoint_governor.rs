//! Setpoints within the limits of the drives: the command of a transformer, followed as closely as limits of velocity,
//! acceleration and jerk allow.
//!
//! A drive that refuses or clamps a setpoint is no longer the drive that the transformer knows. The governor sends only
//! setpoints that it accepts. With the setpoint x, its velocity v and acceleration a of the last cycle, the limits V, A, J
//! and the period T, it chooses the acceleration a' of the next one, v' = v + T a', x' = x + T v':
//!
//! ```text
//! u = (x_desired − x_desired₋)/T        v' = (x_desired − x)/T, if within the limits; else
//! a' is the largest acceleration with   D(v' − u, a') ≤ x_desired − x − T (v' − u) − T u
//! a' within ±A, within a ± J T, and between s(−V − v) and s(V − v)
//! s(m) = sign(m) min(|m|/T, J (√(T²/4 + 2 |m|/J) − T/2))
//! ```
//!
//! D is the distance in which a motion comes to rest, relative to the desired setpoint, as fast as A and J allow: the
//! acceleration falls to a peak −p at the rate J, stays there if p = A, and returns to zero. The acceleration that brakes is thus
//! there in time, whatever the ratio of J to A. With a braking distance v²/2A, which supposes that A is there at once, setpoints
//! oscillated for J/A below 500/s. D is computed with a fraction of A and J (0.8): the desired setpoint accelerates, too.
//!
//! s(m) is the largest acceleration that can be taken back at the jerk J before the velocity has changed by m. Hence the
//! limits of velocity and jerk never contradict each other. Transformers work from the setpoints that were really sent,
//! so that a limited one causes no wind-up.

use crate::setpoint_limits::JointSetpointLimits;
use opspace_backend::CommandKind;
use opspace_backend::quantity::Positive;

/// Fraction of the limits that is used: rounding must not exceed them.
const USED: f64 = 1.0 - 1e-4;

/// Fraction of the limits with which coming to rest is planned. The rest is for what the desired setpoint does meanwhile.
const PLANNED: f64 = 0.8;

/// Halvings of the range of accelerations.
const BISECTIONS: u32 = 16;

/// Speed at which a setpoint is at rest, and change of speed in a cycle, rad/s (m/s): far above rounding.
const REST: f64 = 1e-8;

/// Setpoint of one joint, within the limits of its drive: see the [module](self).
#[derive(Clone, Copy, Debug)]
pub struct GovernedSetpoint {
    takes: CommandKind,
    period_s: f64,
    velocity_limit: f64,
    acceleration_limit: f64,
    jerk_limit: f64,
    /// Setpoint that was desired in the last cycle.
    desired: f64,
    /// Last setpoint, its velocity and its acceleration; `None` before the first.
    last: Option<[f64; 3]>,
}

impl GovernedSetpoint {
    /// Returns the governor of a joint before its first setpoint, of the quantity `takes`.
    #[must_use]
    pub fn new(limits: &JointSetpointLimits, takes: CommandKind, period_s: f64) -> Self {
        let limit = |limit: Option<Positive>| limit.map_or(f64::INFINITY, |limit| USED * limit.get());
        let velocity_limit = limit(limits.velocity_rad_per_s);
        // No use is made of accelerations above V/T and of jerks above A/T.
        let acceleration_limit = limit(limits.acceleration_rad_per_s2).min(velocity_limit / period_s);
        let jerk_limit = limit(limits.jerk_rad_per_s3).min(acceleration_limit / period_s);
        Self { takes, period_s, velocity_limit, acceleration_limit, jerk_limit, desired: 0.0, last: None }
    }

    /// True if a limit is declared.
    #[must_use]
    pub fn is_limited(&self) -> bool {
        self.acceleration_limit.is_finite() || self.jerk_limit.is_finite()
    }

    /// Returns the next setpoint (rad, m) of a position robot that comes to rest as soon as the limits allow, or `first` if there
    /// was none before.
    #[must_use]
    pub fn brake(&self, first: f64) -> f64 {
        let Some([setpoint, velocity, before]) = self.last else { return first };
        let acceleration = self.allowed(self.towards(-velocity, 0.0), velocity, before);
        setpoint + self.period_s * (velocity + self.period_s * acceleration)
    }

    /// Last setpoint, rad, m (rad/s, m/s for a velocity robot); `None` before the first.
    #[must_use]
    pub fn last(&self) -> Option<f64> {
        self.last.map(|[setpoint, ..]| setpoint)
    }

    /// True if the last setpoint rests: at any position, or at the velocity `end` (rad/s, m/s) or the nearest one within the limits.
    /// True if there was none.
    #[must_use]
    pub fn is_at_rest(&self, end: f64) -> bool {
        let nearest = end.clamp(-self.velocity_limit, self.velocity_limit);
        let at_rest = if self.takes == CommandKind::Velocity { nearest } else { 0.0 };
        self.last.is_none_or(|[_, velocity, acceleration]| {
            (velocity - at_rest).abs() <= REST && (self.period_s * acceleration).abs() <= REST
        })
    }

    /// Returns the setpoint within the limits that follows `desired` (rad, m; rad/s, m/s for a velocity robot).
    pub fn follow(&mut self, desired: f64) -> f64 {
        let followed = self.limited(desired);
        self.desired = desired;
        followed
    }

    fn limited(&self, desired: f64) -> f64 {
        let Some([setpoint, velocity, before]) = self.last else {
            // The first velocity has a limit, the first position has none.
            let most = if self.takes == CommandKind::Velocity { self.velocity_limit } else { f64::INFINITY };
            return desired.clamp(-most, most);
        };
        let allowed = |acceleration: f64| self.allowed(acceleration, velocity, before);
        // What is within the limits is followed exactly. What is not a number stays one, so that it stops the run.
        let exact = (self.velocity_to(desired, setpoint) - velocity) / self.period_s;
        if allowed(exact) == exact || exact.is_nan() {
            return desired;
        }
        let acceleration = if self.takes == CommandKind::Velocity || self.acceleration_limit.is_infinite() {
            allowed(self.towards(self.velocity_to(desired, setpoint) - velocity, 0.0))
        } else {
            self.approaching(desired, setpoint, velocity, [f64::NEG_INFINITY, f64::INFINITY].map(allowed))
        };
        let velocity = velocity + self.period_s * acceleration;
        match self.takes {
            CommandKind::Velocity => velocity,
            CommandKind::Position | CommandKind::Torque => setpoint + self.period_s * velocity,
        }
    }

    /// Acceleration within the limits that is nearest to `acceleration`, at a velocity, with the acceleration `before` it.
    fn allowed(&self, acceleration: f64, velocity: f64, before: f64) -> f64 {
        let reached = self.jerk_limit * self.period_s;
        // A whole number of steps changes the velocity by up to J T²/8 more than s assumes.
        let spare = if reached.is_finite() { 0.125 * reached * self.period_s } else { 0.0 };
        let [lowest, highest] =
            [-1.0, 1.0].map(|sign| self.towards(sign * self.velocity_limit - velocity, spare));
        acceleration
            .clamp(-self.acceleration_limit, self.acceleration_limit)
            .clamp(before - reached, before + reached)
            .clamp(lowest.min(highest), highest.max(lowest))
    }

    /// Acceleration within `range` from which the setpoint comes to rest relative to the desired one at no distance, or at the
    /// least. The desired setpoint moves on at its own velocity.
    fn approaching(&self, desired: f64, setpoint: f64, velocity: f64, range: [f64; 2]) -> f64 {
        let period_s = self.period_s;
        let moving = (desired - self.desired) / period_s;
        let overshoot = |acceleration: f64| {
            let relative = velocity + period_s * acceleration - moving;
            let left = desired - setpoint - period_s * (relative + moving);
            self.rest_distance(relative, acceleration) - left
        };
        let [mut low, mut high] = range;
        if overshoot(low) >= 0.0 {
            return low;
        }
        if overshoot(high) <= 0.0 {
            return high;
        }
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            if overshoot(middle) > 0.0 { high = middle } else { low = middle }
        }
        low
    }

    /// Distance within which a motion at this velocity and acceleration comes to rest as soon as the limits allow.
    fn rest_distance(&self, velocity: f64, acceleration: f64) -> f64 {
        let (a_limit, jerk) = (PLANNED * self.acceleration_limit, PLANNED * self.jerk_limit);
        if self.jerk_limit.is_infinite() {
            return 0.5 * velocity * velocity.abs() / a_limit;
        }
        // The sign of the velocity that remains when the acceleration has been taken back.
        let sign = (velocity + 0.5 * acceleration * acceleration.abs() / jerk).signum();
        let (v, a) = (sign * velocity, sign * acceleration);
        let peak = (0.5 * a * a + jerk * v).max(0.0).sqrt().min(a_limit.max(-a));
        let constant_s = ((v + (0.5 * a * a - peak * peak) / jerk) / peak).max(0.0);
        // From a to -peak, constant, and from -peak to 0.
        let first_s = (a + peak) / jerk;
        let v_first = v + 0.5 * (a * a - peak * peak) / jerk;
        let x_first = first_s * (v + first_s * (0.5 * a - first_s * jerk / 6.0));
        let x_constant = constant_s * (v_first - 0.5 * peak * constant_s);
        let last_s = peak / jerk;
        let x_last = jerk * last_s * last_s * last_s / 6.0;
        sign * (x_first + if peak > 0.0 { x_constant } else { 0.0 } + x_last)
    }

    /// Velocity with which the next setpoint is `desired`.
    fn velocity_to(&self, desired: f64, setpoint: f64) -> f64 {
        match self.takes {
            CommandKind::Velocity => desired,
            CommandKind::Position | CommandKind::Torque => (desired - setpoint) / self.period_s,
        }
    }

    /// Largest acceleration that can be taken back before the velocity has changed by `change`.
    /// `spare` of it is left.
    fn towards(&self, change: f64, spare: f64) -> f64 {
        let (period_s, size) = (self.period_s, change.abs());
        if self.jerk_limit.is_infinite() {
            return change / period_s;
        }
        let most = (size - spare).max(0.0);
        let taken_back = self.jerk_limit
            * ((0.25 * period_s * period_s + 2.0 * most / self.jerk_limit).sqrt() - 0.5 * period_s);
        taken_back.min(change.abs() / period_s).copysign(change)
    }

    /// Records the setpoint that was sent.
    pub fn take(&mut self, setpoint: f64) {
        let last = self.last.unwrap_or([
            setpoint,
            if self.takes == CommandKind::Velocity { setpoint } else { 0.0 },
            0.0,
        ]);
        let velocity = self.velocity_to(setpoint, last[0]);
        self.last = Some([setpoint, velocity, (velocity - last[1]) / self.period_s]);
    }

    /// Records a cycle without a setpoint: the drive rests at the last one.
    pub fn keep(&mut self) {
        if let Some(last) = &mut self.last {
            last[2] = 0.0;
            if self.takes != CommandKind::Velocity {
                last[1] = 0.0;
            }
        }
    }

    /// Forgets the setpoints: the next one is the first.
    pub fn restart(&mut self) {
        self.last = None;
    }
}
