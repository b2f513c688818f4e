//! Torques and accelerations of joints along a path, from the instants of a rollout.

use crate::run::rollout::Instant;
use nalgebra::DVector;
use opspace_control::{AccelerationBound, JointLimits, PathPlace, ViableSpeeds};
use opspace_model::{Data, Model, kinematics, rnea};
use opspace_transformer::FrictionParameters;

/// Fraction of a limit of torque or acceleration that is left to the feedback, and to places between two instants.
const MARGIN: f64 = 0.05;

/// Least fraction of a torque limit that counts as available for the motion. Where gravity and friction leave less, the path
/// is not slowed down any further: the controller then does what it can, and a diagnostic says that the arm is too heavy.
const LEAST_AVAILABLE: f64 = 0.05;

/// Speed to which a path slows down joints that move towards a position limit near them, or beyond it, rad/s or m/s: it would
/// never arrive at a limit. The controller then does what it can.
const SLOWEST: f64 = 0.05;

/// Joint motion at an instant of a rollout.
pub(crate) struct MotionInstant<'a> {
    instant: &'a Instant,
    /// Arc length (m), speed (m/s) and section, on the path itself.
    along: Option<(f64, f64, usize)>,
}

impl<'a> MotionInstant<'a> {
    /// Creates the motion at an instant at which `task` follows its path; `None` if it does not, or more slowly than `slow`
    /// (m/s).
    pub(crate) fn new(instant: &'a Instant, task: &str, slow: f64) -> Option<Self> {
        match instant.paths.get(task)?.place {
            PathPlace::Approach => Some(Self { instant, along: None }),
            PathPlace::Along { s_m, speed_m_per_s, section, .. } if speed_m_per_s > slow => {
                Some(Self { instant, along: Some((s_m, speed_m_per_s, section)) })
            }
            PathPlace::Along { .. } => None,
        }
    }

    /// Derivative of the joint positions with respect to arc length (n; rad/m or 1).
    fn slope(&self) -> DVector<f64> {
        let speed = self.along.map_or(1.0, |(_, speed, _)| speed);
        DVector::from_column_slice(&self.instant.dq) / speed
    }

    /// Derivative of [`slope`](Self::slope) with respect to arc length, from the neighbours in the same section: that of the
    /// parabola through three instants, or the slope between two. `None` without a neighbour.
    fn second_derivative(&self, neighbours: &[Option<Self>; 2]) -> Option<DVector<f64>> {
        let (s, _, section) = self.along?;
        let own = self.slope();
        let difference = |other: &Option<Self>, sign: f64| {
            let other = other.as_ref()?;
            let (other_s, _, other_section) = other.along?;
            let length = sign * (other_s - s);
            (other_section == section && length > 0.0)
                .then(|| ((other.slope() - &own) / (other_s - s), length))
        };
        let [before, after] = neighbours;
        weighted([difference(before, -1.0), difference(after, 1.0)])
    }

    /// Derivative of the joint velocities with respect to time (n), from the neighbours.
    fn acceleration(&self, neighbours: &[Option<Self>; 2]) -> Option<DVector<f64>> {
        let own = DVector::from_column_slice(&self.instant.dq);
        let difference = |other: &Option<Self>| {
            let other = other.as_ref().filter(|other| other.along.is_none())?;
            let later_s = other.instant.time_s - self.instant.time_s;
            Some(((DVector::from_column_slice(&other.instant.dq) - &own) / later_s, later_s.abs()))
        };
        weighted(neighbours.each_ref().map(difference))
    }
}

/// Derivative at the middle one of three points from the two difference quotients and the lengths of their intervals.
fn weighted(quotients: [Option<(DVector<f64>, f64)>; 2]) -> Option<DVector<f64>> {
    match quotients {
        [Some((before, first)), Some((after, second))] => {
            Some((before * second + after * first) / (first + second))
        }
        [Some((quotient, _)), None] | [None, Some((quotient, _))] => Some(quotient),
        [None, None] => None,
    }
}

/// Limits of the joints that a path keeps.
pub(crate) struct JointBounds<'a> {
    pub model: &'a Model,
    pub data: Data,
    /// Limits that are in force, of which speeds, torques and accelerations count.
    pub limits: JointLimits,
    /// Friction (n).
    pub friction: Vec<FrictionParameters>,
    /// False if the robot compensates gravity itself: its torque limits then apply to the rest.
    pub with_gravity: bool,
    /// Speeds v(q) that the controller enforces, q̇ + h q̈ ≤ v(q), if it does.
    pub viable: Option<ViableSpeeds>,
}

/// One direction of a joint's torque, acceleration or speed: `along` s̈ + `squared` ṡ² + `viscous` ṡ ≤ `limit` − `taken`.
#[derive(Clone, Copy)]
struct Direction {
    along: f64,
    squared: f64,
    viscous: f64,
    limit: f64,
    /// Gravity and Coulomb friction in this direction, Nm or N; 0 for an acceleration.
    taken: f64,
}

impl Direction {
    /// Part of the limit that is left, of the given fraction of it.
    fn available(&self, fraction: f64) -> f64 {
        (fraction * self.limit - self.taken).max(LEAST_AVAILABLE * self.limit)
    }

    /// Bound with the given fraction of the limit. Viscous friction c ṡ is at most c (ṡ²/v + v)/2, and equal to it at the
    /// speed v = `speed` (m/s).
    fn bound(&self, fraction: f64, speed: f64) -> AccelerationBound {
        let taken = self.taken + 0.5 * self.viscous * speed;
        let available = Self { taken, ..*self }.available(fraction);
        let squared = self.squared + 0.5 * self.viscous / speed;
        AccelerationBound {
            gaining_s2_per_m: self.along.max(0.0) / available,
            braking_s2_per_m: (-self.along).max(0.0) / available,
            squared_speed_s2_per_m2: squared.max(0.0) / available,
        }
    }
}

/// Limits of torque and acceleration at a place of a path.
pub(crate) struct PlaceLimits {
    directions: Vec<Direction>,
}

impl PlaceLimits {
    /// Largest ratio of what a motion with the speed `ds` (m/s) and the acceleration `dds` (m/s²) needs to what is available.
    pub(crate) fn usage(&self, ds: f64, dds: f64) -> f64 {
        let usage =
            |at: &Direction| (at.along * dds + at.squared * ds * ds + at.viscous * ds) / at.available(1.0);
        self.directions.iter().map(usage).fold(0.0, f64::max)
    }

    /// Bounds that leave a margin, for speeds up to `fastest` (m/s).
    pub(crate) fn with_margin(&self, fastest: f64) -> Vec<AccelerationBound> {
        let fraction = 1.0 - MARGIN;
        let squared = |at: &Direction| (at.available(fraction) / at.squared.max(0.0)).sqrt();
        let speed = self.directions.iter().map(squared).fold(fastest, f64::min);
        self.directions.iter().map(|direction| direction.bound(fraction, speed)).collect()
    }
}

impl JointBounds<'_> {
    /// Highest speed of a joint in a direction.
    fn highest_speed(&self, joint: usize, q: f64, upwards: bool) -> f64 {
        let limit = self.limits.velocity[joint];
        let viable = self.viable.as_ref().map_or(limit, |speeds| speeds.highest(joint, q, upwards));
        viable.max(SLOWEST.min(limit))
    }

    /// Largest ratio of the speed of a joint to its limit, at joint positions and velocities (n).
    pub(crate) fn speed_ratio(&self, q: &[f64], dq: &[f64]) -> f64 {
        let ratio =
            |(joint, (&q, dq)): (usize, (&f64, &f64))| dq.abs() / self.highest_speed(joint, q, *dq > 0.0);
        q.iter().zip(dq).enumerate().map(ratio).fold(0.0, f64::max)
    }

    /// Torques M q̈ + C q̇ at a state (n).
    fn torque(&mut self, q: &[f64], dq: &DVector<f64>, ddq: &DVector<f64>, gravity: &[f64]) -> DVector<f64> {
        kinematics(self.model, &mut self.data, q, dq.as_slice());
        rnea(self.model, &mut self.data, ddq.as_slice());
        DVector::from_fn(q.len(), |i, _| self.data.torque[i] - gravity[i])
    }

    /// Directions of all joints for torques and accelerations per s̈ and per ṡ², at velocities `dq` per ṡ (n).
    fn directions(
        &self,
        instant: &Instant,
        dq: &DVector<f64>,
        torque: [&DVector<f64>; 2],
        acceleration: [&DVector<f64>; 2],
    ) -> Vec<Direction> {
        let mut directions = Vec::new();
        for joint in 0..dq.len() {
            for sign in [1.0, -1.0] {
                let mut add = |[along, squared]: [&DVector<f64>; 2], limit: f64, viscous, taken| {
                    if limit.is_finite() {
                        let (along, squared) = (sign * along[joint], sign * squared[joint]);
                        directions.push(Direction { along, squared, viscous, limit, taken });
                    }
                };
                let gravity = if self.with_gravity { sign * instant.gravity[joint] } else { 0.0 };
                // Friction that helps is not counted.
                let opposing = if sign * dq[joint] >= 0.0 { 1.0 } else { 0.0 };
                let friction = &self.friction[joint];
                let coulomb = opposing * friction.coulomb_nm.get();
                let viscous = opposing * friction.viscous_nms_per_rad.get() * dq[joint].abs();
                add(torque, self.limits.torque[joint], viscous, gravity + coulomb);
                add(acceleration, self.limits.acceleration[joint], 0.0, 0.0);
                if let Some(viable) = &self.viable {
                    // q̈ + q̇/h ≤ v/h.
                    let speed = opposing * dq[joint].abs() / viable.horizon_s();
                    let limit = self.highest_speed(joint, instant.q[joint], sign > 0.0) / viable.horizon_s();
                    add(acceleration, limit, speed, 0.0);
                }
            }
        }
        directions
    }

    /// Limits at a place on a path.
    pub(crate) fn along(
        &mut self,
        motion: &MotionInstant<'_>,
        neighbours: &[Option<MotionInstant<'_>>; 2],
    ) -> PlaceLimits {
        let slope = motion.slope();
        let instant = motion.instant;
        let Some(second) = motion.second_derivative(neighbours) else {
            return PlaceLimits { directions: Vec::new() };
        };
        let still = DVector::zeros(slope.len());
        let along = self.torque(&instant.q, &still, &slope, &instant.gravity);
        let squared = self.torque(&instant.q, &slope, &second, &instant.gravity);
        PlaceLimits { directions: self.directions(instant, &slope, [&along, &squared], [&slope, &second]) }
    }

    /// Largest ratio of what the motion at an instant needs to what is available.
    pub(crate) fn usage_in_time(
        &mut self,
        motion: &MotionInstant<'_>,
        neighbours: &[Option<MotionInstant<'_>>; 2],
    ) -> f64 {
        let Some(ddq) = motion.acceleration(neighbours) else { return 0.0 };
        let instant = motion.instant;
        let dq = DVector::from_column_slice(&instant.dq);
        let torque = self.torque(&instant.q, &dq, &ddq, &instant.gravity);
        let none = DVector::zeros(dq.len());
        let directions = self.directions(instant, &dq, [&torque, &none], [&ddq, &none]);
        let with_friction = |at: Direction| Direction { viscous: 0.0, taken: at.taken + at.viscous, ..at };
        PlaceLimits { directions: directions.into_iter().map(with_friction).collect() }.usage(0.0, 1.0)
    }

    /// Factor by which a motion has to last longer that uses `usage` of what is available.
    pub(crate) fn approach_factor(usage: f64) -> f64 {
        // What is available shrinks by the margin, relative to the limit: twice the margin counts for half of it.
        (usage * (1.0 + 2.0 * MARGIN)).sqrt()
    }
}
