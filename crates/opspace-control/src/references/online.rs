//! Online trajectory generation: from any state of motion to rest at a goal, within limits of velocity, acceleration
//! and jerk.
//!
//! ```text
//! (x, ẋ, ẍ) → (x_goal, 0, 0)        |ẋ| ≤ v    |ẍ| ≤ a    |x⃛| ≤ j
//! ```
//!
//! The motion of each coordinate is time-optimal: up to two segments bring a state beyond the limits back within them,
//! and up to seven segments of constant jerk follow (Berscheid and Kröger 2021, *Jerk-limited Real-time Trajectory
//! Generation with Arbitrary Target States*; the crate `rsruckig` computes the segments). The whole motion is computed
//! when it starts; nothing allocates.

use crate::references::goal::{OrientationGoal, PositionGoal};
use crate::references::ramp::Quintic;
use nalgebra::{Matrix3, Vector3};
use opspace_backend::quantity::Positive;
use rsruckig::block::Block;
use rsruckig::position_third_step1::PositionThirdOrderStep1;
use rsruckig::profile::Profile;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;

/// A motion to one pose as fast as the limits allow, from any state of motion at the start.
///
/// The motion is split into a part along the line from the start to the goal and a part perpendicular to it; the limits
/// apply to each part separately. From rest, the frame therefore moves on a straight line, and the limits apply to its
/// path velocity; likewise for a rotation, with the rotation vector from the start orientation. Position and
/// orientation arrive independently of each other. A position or orientation without a goal keeps its start value, or
/// returns to it within half a second. A motion beyond the limits is first brought within them, over a distance that
/// follows from the limits.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(with = "OnlineGoalFile"))]
#[serde(try_from = "OnlineGoalFile")]
pub struct OnlineGoal {
    /// Goal position and limits of the motion (m/s, m/s², m/s³).
    pub position: Option<(PositionGoal, MotionLimits)>,
    /// Goal orientation and limits of the rotation (rad/s, rad/s², rad/s³).
    pub orientation: Option<(OrientationGoal, MotionLimits)>,
}

/// Limits of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionLimits {
    /// Highest speed, m/s or rad/s.
    pub velocity: Positive,
    /// Highest acceleration, m/s² or rad/s².
    pub acceleration: Positive,
    /// Highest jerk, m/s³ or rad/s³.
    pub jerk: Positive,
}

/// File format of [`OnlineGoal`].
#[derive(Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
struct OnlineGoalFile {
    /// Goal position.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the present one")))]
    position: Option<PositionGoal>,
    /// Goal orientation.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the present one")))]
    orientation: Option<OrientationGoal>,
    /// Highest speed, m/s; required with `position`, not allowed without it.
    velocity_m_per_s: Option<Positive>,
    /// Highest acceleration, m/s²; required with `position`, not allowed without it.
    acceleration_m_per_s2: Option<Positive>,
    /// Highest jerk, m/s³; required with `position`, not allowed without it.
    jerk_m_per_s3: Option<Positive>,
    /// Highest angular speed, rad/s; required with `orientation`, not allowed without it.
    angular_velocity_rad_per_s: Option<Positive>,
    /// Highest angular acceleration, rad/s²; required with `orientation`, not allowed without it.
    angular_acceleration_rad_per_s2: Option<Positive>,
    /// Highest angular jerk, rad/s³; required with `orientation`, not allowed without it.
    angular_jerk_rad_per_s3: Option<Positive>,
}

impl TryFrom<OnlineGoalFile> for OnlineGoal {
    type Error = String;

    fn try_from(file: OnlineGoalFile) -> Result<Self, String> {
        if file.position.is_none() && file.orientation.is_none() {
            return Err("the goal names neither `position` nor `orientation`".to_owned());
        }
        let linear = [
            ("velocity_m_per_s", file.velocity_m_per_s),
            ("acceleration_m_per_s2", file.acceleration_m_per_s2),
            ("jerk_m_per_s3", file.jerk_m_per_s3),
        ];
        let angular = [
            ("angular_velocity_rad_per_s", file.angular_velocity_rad_per_s),
            ("angular_acceleration_rad_per_s2", file.angular_acceleration_rad_per_s2),
            ("angular_jerk_rad_per_s3", file.angular_jerk_rad_per_s3),
        ];
        Ok(Self {
            position: limited("position", file.position, linear)?,
            orientation: limited("orientation", file.orientation, angular)?,
        })
    }
}

/// Combines a goal with its limits: a goal needs all three limits; without a goal no limit is allowed.
fn limited<T>(
    key: &str,
    goal: Option<T>,
    limits: [(&str, Option<Positive>); 3],
) -> Result<Option<(T, MotionLimits)>, String> {
    let Some(goal) = goal else {
        return match limits.iter().find(|(_, limit)| limit.is_some()) {
            Some((name, _)) => Err(format!("`{name}` limits the motion to `{key}`, which is not given")),
            None => Ok(None),
        };
    };
    let [velocity, acceleration, jerk] = limits.map(|(name, limit)| {
        limit.ok_or_else(|| format!("`{key}` needs the limit `{name}`, which is missing"))
    });
    Ok(Some((goal, MotionLimits { velocity: velocity?, acceleration: acceleration?, jerk: jerk? })))
}

/// Motion of one coordinate to rest at a goal.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OnlineMotion {
    goal: f64,
    duration_s: f64,
    /// Segments of the motion in the order of their start times, the first of which is 0.
    pieces: [Piece; PIECES],
    count: usize,
}

/// Maximum number of segments: two that brake, seven that move.
const PIECES: usize = 9;

/// A segment of the motion; its polynomial is cubic if the jerk is constant.
#[derive(Clone, Copy, Debug, Default)]
struct Piece {
    begin_s: f64,
    /// Polynomial in the time since `begin_s`.
    polynomial: Quintic,
}

impl Piece {
    fn at(&self, time_s: f64) -> [f64; 3] {
        self.polynomial.at(time_s - self.begin_s)
    }
}

/// Returns true if two states are equal within the rounding errors of the generator; false if one of them is NaN.
fn meet(one: [f64; 3], other: [f64; 3]) -> bool {
    one.iter().zip(other).all(|(a, b)| (a - b).abs() <= 1e-8 * (1.0 + b.abs()))
}

impl OnlineMotion {
    /// Computes a motion from `from` (position, velocity, acceleration) to rest at `goal`. If the generator finds none
    /// (for limits or states of very different magnitude), the motion is a smooth one that may exceed the limits.
    pub(crate) fn new(from: [f64; 3], goal: f64, limits: &MotionLimits) -> Self {
        Self::limited(from, goal, limits)
            .unwrap_or_else(|| Self::quintic(from, goal, unhurried_s(from, goal, limits)))
    }

    /// Returns a motion that rests at `at`.
    pub(crate) fn rest(at: f64) -> Self {
        Self::quintic([at, 0.0, 0.0], at, 1.0)
    }

    /// The quintic polynomial from the state `from` (position, velocity, acceleration) to rest at `goal` in
    /// `duration_s` (s).
    pub(crate) fn quintic(from: [f64; 3], goal: f64, duration_s: f64) -> Self {
        let mut pieces = [Piece::default(); PIECES];
        pieces[0] = Piece { begin_s: 0.0, polynomial: Quintic::new(from, goal, duration_s) };
        Self { goal, duration_s, pieces, count: 1 }
    }

    /// Returns the motion from `from` to rest, wherever it ends, as fast as the limits of acceleration and jerk allow.
    pub(crate) fn stop(from: [f64; 3], limits: &MotionLimits) -> Self {
        let [_, v, a] = from;
        let [a_max, j_max] = [limits.acceleration, limits.jerk].map(Positive::get);
        // The sign of the velocity that remains when the acceleration has been brought to zero and that must be braked.
        let sign = if v + a * a.abs() / (2.0 * j_max) < 0.0 { -1.0 } else { 1.0 };
        let (speed, rise) = (sign * v, sign * a);
        let unlimited = (j_max * speed + 0.5 * rise * rise).max(0.0).sqrt();
        let brake = unlimited.min(a_max).max(-rise).max(0.0);
        let plateau_s = if brake > 0.0 {
            ((speed + 0.5 * rise * rise / j_max - brake * brake / j_max) / brake).max(0.0)
        } else {
            0.0
        };
        let phases =
            [(-sign * j_max, (rise + brake) / j_max), (0.0, plateau_s), (sign * j_max, brake / j_max)];
        let mut pieces = [Piece::default(); PIECES];
        let (mut count, mut begin_s, mut reached) = (0, 0.0, from);
        for (jerk, lasts_s) in phases.into_iter().filter(|(_, lasts_s)| *lasts_s > 0.0) {
            let [x, v, a] = reached;
            let polynomial = Quintic { coefficients: [x, v, a / 2.0, jerk / 6.0, 0.0, 0.0] };
            pieces[count] = Piece { begin_s, polynomial };
            begin_s += lasts_s;
            reached = pieces[count].at(begin_s);
            count += 1;
        }
        if count == 0 {
            return Self::rest(from[0]);
        }
        Self { goal: reached[0], duration_s: begin_s, pieces, count }
    }

    /// Returns the motion from `from` to rest in `duration_s` (s); the velocity is cubic in time.
    pub(crate) fn stop_within([x, v, a]: [f64; 3], duration_s: f64) -> Self {
        let goal = x + duration_s * (v / 2.0 + a * duration_s / 12.0);
        Self::quintic([x, v, a], goal, duration_s)
    }

    /// Returns the time-optimal motion; `None` if the generator finds none, or one that does not connect start and
    /// goal.
    fn limited(from: [f64; 3], goal: f64, limits: &MotionLimits) -> Option<Self> {
        if from == [goal, 0.0, 0.0] {
            return Some(Self::rest(goal));
        }
        let [x, v, a] = from;
        let [v_max, a_max, j_max] = [limits.velocity, limits.acceleration, limits.jerk].map(Positive::get);
        let mut profile = Profile::default();
        profile.brake.get_position_brake_trajectory(v, a, v_max, -v_max, a_max, -a_max, j_max);
        profile.set_boundary(x, v, a, goal, 0.0, 0.0);
        profile.brake.finalize(&mut profile.p[0], &mut profile.v[0], &mut profile.a[0]);
        let [x, v, a] = [profile.p[0], profile.v[0], profile.a[0]];
        let mut block = Block::default();
        let mut solver =
            PositionThirdOrderStep1::new(x, v, a, goal, 0.0, 0.0, v_max, -v_max, a_max, -a_max, j_max);
        if !solver.get_profile(&profile, &mut block) {
            return None;
        }
        Self::of_profile(&block.p_min, from, goal)
    }

    fn of_profile(profile: &Profile, from: [f64; 3], goal: f64) -> Option<Self> {
        let brake = &profile.brake;
        let braking = if brake.duration > 0.0 { 2 } else { 0 };
        let brakes = (0..braking).map(|i| ([brake.p[i], brake.v[i], brake.a[i]], brake.j[i], brake.t[i]));
        let moves = (0..7).map(|i| ([profile.p[i], profile.v[i], profile.a[i]], profile.j[i], profile.t[i]));
        let mut pieces = [Piece::default(); PIECES];
        let (mut count, mut begin_s, mut reached) = (0, 0.0, from);
        for (state, jerk, lasts_s) in brakes.chain(moves).filter(|(_, _, lasts_s)| *lasts_s > 0.0) {
            if !meet(reached, state) {
                return None;
            }
            let [x, v, a] = state;
            let polynomial = Quintic { coefficients: [x, v, a / 2.0, jerk / 6.0, 0.0, 0.0] };
            let piece = Piece { begin_s, polynomial };
            pieces[count] = piece;
            count += 1;
            begin_s += lasts_s;
            reached = piece.at(begin_s);
        }
        let whole = Self { goal, duration_s: begin_s, pieces, count };
        meet(reached, [goal, 0.0, 0.0]).then_some(whole)
    }

    /// Position, velocity and acceleration at `time_s` after the start.
    pub(crate) fn at(&self, time_s: f64) -> [f64; 3] {
        if time_s >= self.duration_s {
            return [self.goal, 0.0, 0.0];
        }
        let time_s = time_s.max(0.0);
        let next = self.pieces[..self.count].partition_point(|piece| piece.begin_s <= time_s);
        self.pieces[next - 1].at(time_s)
    }
}

/// Returns a duration (s) in which a quintic polynomial approximately keeps the limits: the time for the peaks of the
/// minimum-jerk motion over the distance, plus a time longer than the limits need to brake the initial state.
fn unhurried_s([x, v, a]: [f64; 3], goal: f64, limits: &MotionLimits) -> f64 {
    let [v_max, a_max, j_max] = [limits.velocity, limits.acceleration, limits.jerk].map(Positive::get);
    let way = (goal - x).abs();
    let minimum_jerk =
        (1.875 * way / v_max).max((5.774 * way / a_max).sqrt()).max((60.0 * way / j_max).cbrt());
    let braking = (4.0 * v.abs() / a_max).max((8.0 * v.abs() / j_max).sqrt()).max(4.0 * a.abs() / j_max);
    // The lower bound is at most a control period; it avoids a division by zero in the polynomial.
    (minimum_jerk + braking).clamp(1e-3, 1e9)
}

/// Time in which a quantity without a goal returns to its start value if it moves at the start, s.
const RETURN_S: f64 = 0.5;

/// Motion of a displacement or a rotation vector, from zero.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OnlineVector {
    /// Orthonormal directions, one per column: the first along the path, the others perpendicular to it.
    directions: Matrix3<f64>,
    motions: [OnlineMotion; 3],
}

impl OnlineVector {
    pub(crate) fn rest() -> Self {
        Self { directions: Matrix3::identity(), motions: [OnlineMotion::rest(0.0); 3] }
    }

    /// Creates the motion from zero, with `velocity` and `acceleration`, to rest at `goal`.
    pub(crate) fn new(
        velocity: &Vector3<f64>,
        acceleration: &Vector3<f64>,
        goal: &Vector3<f64>,
        limits: &MotionLimits,
    ) -> Self {
        let directions = directions(goal, velocity, acceleration);
        let [v, a] = [velocity, acceleration].map(|vector| directions.tr_mul(vector));
        let goals = [goal.norm(), 0.0, 0.0];
        let motion = |i: usize| OnlineMotion::new([0.0, v[i], a[i]], goals[i], limits);
        Self { directions, motions: [motion(0), motion(1), motion(2)] }
    }

    /// Creates the motion from zero, with `velocity` and `acceleration`, back to rest at zero.
    pub(crate) fn back(velocity: &Vector3<f64>, acceleration: &Vector3<f64>) -> Self {
        let motion = |i: usize| OnlineMotion::quintic([0.0, velocity[i], acceleration[i]], 0.0, RETURN_S);
        Self { directions: Matrix3::identity(), motions: [motion(0), motion(1), motion(2)] }
    }

    /// Creates the motion from zero, with `velocity` and `acceleration`, to rest as fast as limits of acceleration and
    /// jerk allow.
    pub(crate) fn stop(velocity: &Vector3<f64>, acceleration: &Vector3<f64>, limits: &MotionLimits) -> Self {
        let directions = directions(velocity, acceleration, &Vector3::zeros());
        let [v, a] = [velocity, acceleration].map(|vector| directions.tr_mul(vector));
        let motion = |i: usize| OnlineMotion::stop([0.0, v[i], a[i]], limits);
        Self { directions, motions: [motion(0), motion(1), motion(2)] }
    }

    /// Creates the motion from zero, with `velocity` and `acceleration`, to rest in `duration_s` (s); the velocity is
    /// cubic in time.
    pub(crate) fn stop_within(velocity: &Vector3<f64>, acceleration: &Vector3<f64>, duration_s: f64) -> Self {
        let motion = |i: usize| OnlineMotion::stop_within([0.0, velocity[i], acceleration[i]], duration_s);
        Self { directions: Matrix3::identity(), motions: [motion(0), motion(1), motion(2)] }
    }

    /// Vector and its first two derivatives at `time_s` (s) after the start.
    pub(crate) fn at(&self, time_s: f64) -> [Vector3<f64>; 3] {
        let along = self.motions.map(|motion| motion.at(time_s));
        [0, 1, 2].map(|k| self.directions * Vector3::new(along[0][k], along[1][k], along[2][k]))
    }
}

/// Returns orthonormal directions: along `first`, then along the parts of the other vectors that are perpendicular to
/// it.
fn directions(first: &Vector3<f64>, second: &Vector3<f64>, third: &Vector3<f64>) -> Matrix3<f64> {
    let mut basis = [Vector3::zeros(); 3];
    let mut found = 0;
    for vector in [first, second, third, &Vector3::x(), &Vector3::y(), &Vector3::z()] {
        if found == 3 {
            break;
        }
        // The orthogonalisation is repeated because a single pass is inaccurate for a vector that is nearly parallel to
        // the others.
        let mut across = *vector;
        for _ in 0..2 {
            for known in &basis[..found] {
                across -= known * known.dot(&across);
            }
        }
        let norm = across.norm();
        if norm > 1e-9 * vector.norm() {
            basis[found] = across / norm;
            found += 1;
        }
    }
    Matrix3::from_columns(&basis)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn limits([velocity, acceleration, jerk]: [f64; 3]) -> MotionLimits {
        let [velocity, acceleration, jerk] = [velocity, acceleration, jerk].map(Positive::literal);
        MotionLimits { velocity, acceleration, jerk }
    }

    /// Limits within two decades around the values of typical arms.
    fn any_limits() -> impl Strategy<Value = [f64; 3]> {
        [-1.0..1.0, -1.0..1.0, -1.0..1.0]
            .prop_map(|d: [f64; 3]| [0.5 * 10f64.powf(d[0]), 2.0 * 10f64.powf(d[1]), 20.0 * 10f64.powf(d[2])])
    }

    /// Tolerance of the step between two segments, like that of the generator.
    const SEAM: f64 = 1e-8;

    /// Compared: velocity and acceleration with central differences within the segments; values on both sides of each
    /// boundary between segments.
    fn check_smooth(motion: &OnlineMotion, jerk: f64) {
        let h = motion.duration_s * 1e-4;
        for k in 0..100 {
            let t = motion.duration_s * (f64::from(k) + 0.5) / 100.0;
            let [before, now, after] = [t - h, t, t + h].map(|t| motion.at(t));
            let scale = 1.0 + now.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
            let velocity = (after[0] - before[0]) / (2.0 * h);
            // The error of the difference is at most 2 jerk h²/6, plus the tolerance of a boundary over h.
            let tolerance = jerk * h * h + SEAM * scale * (1.0 + 1.0 / h);
            assert!((now[1] - velocity).abs() <= tolerance, "{motion:?} at {t}");
            // A segment that ends within h changes the difference by at most 2 jerk h/2.
            let change = (after[2] - before[2]).abs();
            assert!(change <= 2.0 * jerk * h * (1.0 + 1e-9) + SEAM * scale, "{motion:?} at {t}");
            let acceleration = (after[1] - before[1]) / (2.0 * h);
            assert!((now[2] - acceleration).abs() <= jerk * h + SEAM * scale / h, "{motion:?} at {t}");
        }
    }

    proptest! {
        /// Compared: motions from initial states that can stay within the limits with the initial state, with the
        /// limits at 200 instants (the jerk as a difference of accelerations) and with the goal at rest.
        #[test]
        fn limits_hold_throughout_the_motion(
            limit in any_limits(),
            [x, way] in [-2.0..2.0, -3.0..3.0f64],
            [v, a] in [-1.0..1.0, -1.0..1.0f64],
        ) {
            let [v_max, a_max, j_max] = limit;
            // The speed that a0 adds until it is zero, a0²/2j, is reserved.
            let a = a * a_max.min((v_max * j_max).sqrt());
            let v = v * (v_max - a * a / (2.0 * j_max));
            let goal = x + way;
            let motion = OnlineMotion::limited([x, v, a], goal, &limits(limit)).expect("a motion");
            let begin = motion.at(0.0);
            prop_assert_eq!(begin, [x, v, a]);
            prop_assert_eq!(motion.at(motion.duration_s), [goal, 0.0, 0.0]);
            let close = 1.0 + 1e-9;
            let step = motion.duration_s / 200.0;
            let mut before = begin;
            for k in 1..=200 {
                let now = motion.at(step * f64::from(k));
                prop_assert!(now[1].abs() <= v_max * close && now[2].abs() <= a_max * close, "{:?}", now);
                prop_assert!((now[2] - before[2]).abs() <= j_max * step * close + SEAM, "{:?}", now);
                before = now;
            }
            check_smooth(&motion, j_max);
        }

        /// Motions that start beyond the limits return within them; the jerk is always within its limit.
        #[test]
        fn start_beyond_limits_is_braked(
            limit in any_limits(),
            [v, a, way] in [-3.0..3.0, -3.0..3.0, -3.0..3.0f64],
        ) {
            let [v_max, a_max, j_max] = limit;
            let start = [0.1, v * v_max, a * a_max];
            let motion = OnlineMotion::limited(start, way, &limits(limit)).expect("a motion");
            prop_assert_eq!(motion.at(0.0), start);
            prop_assert_eq!(motion.at(motion.duration_s), [way, 0.0, 0.0]);
            // Longest braking: the acceleration changes to its opposite limit and back, then brakes the speed.
            let beyond = 2.0 * v_max + 4.0 * a_max * a_max * 2.0 / j_max;
            let braked_s = 8.0 * a_max / j_max + (beyond + 3.0 * v_max) / a_max;
            for k in 0..200 {
                let t = motion.duration_s * f64::from(k) / 200.0;
                let now = motion.at(t);
                let within = now[1].abs() <= v_max * (1.0 + 1e-9) && now[2].abs() <= a_max * (1.0 + 1e-9);
                prop_assert!(within || t < braked_s, "{:?} at {}", now, t);
            }
            check_smooth(&motion, j_max);
        }

        /// Motions of any magnitude start at the given state, arrive, and are finite in between.
        #[test]
        fn extreme_magnitudes_cause_no_jump(
            decades in [-9.0..9.0, -9.0..9.0, -9.0..9.0f64],
            start in [-5.0..5.0, -5.0..5.0, -5.0..5.0f64],
            signs in [-1.0..1.0, -1.0..1.0, -1.0..1.0f64],
        ) {
            let [x, v, a] = [0, 1, 2].map(|i| signs[i] * 10f64.powf(start[i]));
            let motion = OnlineMotion::new([x, v, a], 0.7, &limits(decades.map(|d| 10f64.powf(d))));
            prop_assert!(meet(motion.at(0.0), [x, v, a]), "{:?}", motion);
            prop_assert_eq!(motion.at(motion.duration_s), [0.7, 0.0, 0.0]);
            for k in 0..50 {
                let now = motion.at(motion.duration_s * f64::from(k) / 50.0);
                prop_assert!(now.iter().all(|x| x.is_finite()), "{:?}", motion);
            }
        }

        /// Compared: the polynomial at its ends with the states that it connects, and its derivatives with differences.
        #[test]
        fn fallback_motion_is_smooth(
            [x, v, a, goal] in [-2.0..2.0, -2.0..2.0, -2.0..2.0, -2.0..2.0f64],
            duration_s in 0.1..5.0f64,
        ) {
            let motion = OnlineMotion::quintic([x, v, a], goal, duration_s);
            prop_assert_eq!(motion.at(0.0), [x, v, a]);
            let end = motion.at(duration_s * (1.0 - 1e-12));
            let scale = 10.0 / duration_s.min(1.0).powi(3);
            for (end, wanted) in end.iter().zip([goal, 0.0, 0.0]) {
                prop_assert!((end - wanted).abs() < 1e-9 * scale, "{:?}", motion);
            }
            // Sixty times the distance, plus the part of the initial state, divided by the cube of the duration.
            check_smooth(&motion, 60.0 * (4.0 + 2.0 * duration_s + duration_s * duration_s) / duration_s.powi(3));
        }
    }

    /// The fallback's duration is long enough for its peaks to stay within the limits, from rest.
    #[test]
    fn fallback_motion_from_rest_keeps_limits() {
        for limit in [[0.5, 2.0, 20.0], [5.0, 1.0, 100.0], [5.0, 20.0, 1.0]] {
            let from = [0.0; 3];
            let motion = OnlineMotion::quintic(from, 1.0, unhurried_s(from, 1.0, &limits(limit)));
            for k in 0..=100 {
                let now = motion.at(motion.duration_s * f64::from(k) / 100.0);
                assert!(now[1].abs() <= limit[0] * 1.001 && now[2].abs() <= limit[1] * 1.001, "{limit:?}");
            }
        }
    }

    proptest! {
        /// Compared: state at the end of a stop with rest; its accelerations and their changes with the limits.
        #[test]
        fn stop_ends_at_rest_within_limits(
            limit in any_limits(),
            [v, a] in [-1.0..1.0, -1.0..1.0f64],
        ) {
            let motion = OnlineMotion::stop([0.3, v * limit[0], a * limit[1]], &limits(limit));
            prop_assert_eq!(motion.at(0.0), [0.3, v * limit[0], a * limit[1]]);
            let end = motion.at(motion.duration_s * (1.0 - 1e-12));
            prop_assert!((end[0] - motion.goal).abs() < 1e-9 && end[1].abs() < 1e-6 && end[2].abs() < 1e-6, "{:?}", end);
            for k in 0..=100 {
                let now = motion.at(motion.duration_s * f64::from(k) / 100.0);
                prop_assert!(now[2].abs() <= limit[1] * (1.0 + 1e-9), "{:?}", now);
            }
            check_smooth(&motion, limit[2]);
        }
    }

    #[test]
    fn directions_are_orthonormal_along_the_path() {
        let along = Vector3::new(0.3, -0.4, 1.2);
        let nothing = Vector3::zeros();
        for (first, second, third) in [
            (along, along * 2.0, Vector3::new(0.1, 0.2, 0.3)),
            (along, Vector3::new(1.0, 0.0, 0.0), Vector3::new(1.0, 1e-12, 0.0)),
            (nothing, along, nothing),
            (nothing, nothing, nothing),
            (along * 1e-200, along + Vector3::x() * 1e-8, nothing),
        ] {
            let basis = directions(&first, &second, &third);
            assert!((basis.tr_mul(&basis) - Matrix3::identity()).norm() < 1e-14, "{basis}");
            let aligned = basis.tr_mul(&first);
            assert!((aligned.x - first.norm()).abs() <= 1e-15 * first.norm() + 1e-150, "{aligned}");
        }
    }
}
