//! Bounds of the joints' limits of speed, acceleration and torque on the motion along time-optimal paths.
//!
//! With the joint motion q(s) of a rollout with all tasks, joint velocities and accelerations along a path are
//!
//! ```text
//! q̇ = q'(s) ṡ          q̈ = q'(s) s̈ + q''(s) ṡ²
//! ```
//!
//! The largest ṡ at s is therefore ṡ / r, where r is the largest ratio of a joint's speed to its limit v(q): the velocity
//! limit, or less where the joint must be able to stop before its position limit. The controller keeps this limit with the
//! horizon h, q̇ + h q̈ ≤ v(q), which bounds s̈ too. The torques are
//! (Bobrow, Dubowsky and Gibson 1985, equation 10)
//!
//! ```text
//! τ = a(s) s̈ + b(s) ṡ² + g(s) + friction          a = M q'          b = M q'' + C(q, q') q'
//! ```
//!
//! so that each direction of each joint's torque and acceleration bounds s̈ and ṡ² together. A bound must be convex in
//! (s̈, ṡ): what b ṡ² takes off a torque is therefore not counted. The timing law of the path then keeps these bounds like
//! its own ones, by a pass forward and one backward.

use crate::run::path_dynamics::{JointBounds, MotionInstant};
use crate::run::rollout::{Instant, Rollout};
use opspace_control::{
    AccelerationBound, CartesianReference, PartBounds, PathBounds, PathPlace, TaskParameters, TimedReference,
};
use std::collections::BTreeMap;

/// Largest number of rollouts: the joint motion of a redundant arm depends slightly on the speed.
pub(crate) const PASSES: usize = 4;

/// Ratio of a quantity to its limit up to which a pass changes nothing.
const KEPT: f64 = 1.0 + 1e-9;

/// Margin of speeds for places between two instants of a rollout, and for its errors.
const MARGIN: f64 = 1.005;

/// Largest error of a rollout, m, at which its joint velocities are counted: a reference out of reach demands arbitrary
/// ones.
const FOLLOWED_M: f64 = 0.02;

/// Largest number of parts of a path.
const MAX_PARTS: f64 = 2000.0;

/// Speed, relative to the largest one, below which its ratio to the joint velocities is not used.
const SLOW: f64 = 1e-3;

/// A time-optimal path of a task.
#[derive(Clone, Debug)]
pub(crate) struct TaskPath {
    pub task: String,
    pub path: TimedReference,
    /// Numbers of the task sets in which the task follows the path.
    pub sets: Vec<usize>,
}

/// Collects the time-optimal paths of the task sets.
pub(crate) fn time_optimal_paths<'a>(
    sets: impl Iterator<Item = &'a mut BTreeMap<String, TaskParameters>>,
) -> Vec<TaskPath> {
    let mut paths: Vec<TaskPath> = Vec::new();
    for (set, tasks) in sets.enumerate() {
        for (task, parameters) in tasks {
            let Some(path) = path_of(parameters) else { continue };
            match paths.iter_mut().find(|known| known.task == *task && known.path == *path) {
                Some(known) => known.sets.push(set),
                None => paths.push(TaskPath { task: task.clone(), path: path.clone(), sets: vec![set] }),
            }
        }
    }
    paths
}

/// Time-optimal path in the parameters of a task, if it has one.
pub(crate) fn path_of(parameters: &mut TaskParameters) -> Option<&mut TimedReference> {
    let reference = match parameters {
        TaskParameters::Cartesian(parameters) => &mut parameters.reference,
        TaskParameters::CenterOfMass(parameters) => &mut parameters.reference,
        _ => return None,
    };
    match reference {
        CartesianReference::Path(path) if path.time_optimal => Some(path),
        _ => None,
    }
}

/// Place on a path at an instant of a rollout, and what the joints' limits permit there.
struct Place {
    s_m: f64,
    /// Highest speed, m/s.
    speed_m_per_s: f64,
    acceleration: Vec<AccelerationBound>,
}

/// Computes the bounds of a path from a rollout, for joints with the given limits. `None` if the path keeps them, or if the
/// rollout does not visit it.
pub(crate) fn bounds(path: &TaskPath, rollout: &Rollout, joints: &mut JointBounds<'_>) -> Option<PathBounds> {
    let TaskPath { task, path, sets } = path;
    let highest = path.speed_m_per_s.get();
    let counts = |instant: &Instant| {
        sets.contains(&instant.task_set) && instant.tasks.iter().all(|task| task.error.norm() < FOLLOWED_M)
    };
    let mut places: Vec<Place> = Vec::new();
    // Largest ratios of speeds, and largest usage of torques and accelerations: of the path and of the way to its start.
    let (mut largest, mut approach) = (0.0_f64, 0.0_f64);
    let (mut usage, mut approach_usage) = (0.0_f64, 0.0_f64);
    for (k, instant) in rollout.instants.iter().enumerate().filter(|(_, instant)| counts(instant)) {
        let Some(at) = instant.paths.get(task) else { continue };
        let neighbours = [k.checked_sub(1), Some(k + 1)]
            .map(|k| rollout.instants.get(k?).filter(|instant| counts(instant)))
            .map(|instant| instant.and_then(|instant| MotionInstant::new(instant, task, SLOW * highest)));
        let ratio = joints.speed_ratio(&instant.q, &instant.dq).max(at.speed_ratio);
        let Some(motion) = MotionInstant::new(instant, task, SLOW * highest) else { continue };
        match at.place {
            PathPlace::Approach => {
                approach = approach.max(ratio);
                approach_usage = approach_usage.max(joints.usage_in_time(&motion, &neighbours));
            }
            PathPlace::Along { s_m, speed_m_per_s, acceleration_m_per_s2, .. } => {
                largest = largest.max(ratio);
                let fastest = highest.min(speed_m_per_s / ratio);
                let limits = joints.along(&motion, &neighbours);
                usage = usage.max(limits.usage(speed_m_per_s, acceleration_m_per_s2));
                places.push(Place {
                    s_m,
                    speed_m_per_s: speed_m_per_s / ratio,
                    acceleration: limits.with_margin(fastest),
                });
            }
        }
    }
    let keeps = usage <= KEPT && approach_usage <= KEPT;
    if largest <= KEPT && approach <= KEPT && keeps {
        return None;
    }
    let of_speed = if approach > KEPT { MARGIN * approach } else { 1.0 };
    let of_torque = if approach_usage > KEPT { JointBounds::approach_factor(approach_usage) } else { 1.0 };
    let approach_factor = of_speed.max(of_torque) * path.bounds.approach_factor;
    let bounded = path.bounds.parts.iter().any(|part| !part.acceleration.is_empty());
    // If only speeds are too high, accelerations are not bounded.
    if usage <= KEPT && !bounded {
        places.iter_mut().for_each(|place| place.acceleration.clear());
    }
    drop_unused(&mut places, highest, path.acceleration_m_per_s2.get());
    let mut parts = parts(places, highest);
    let visited_m = parts.last().map_or(0.0, |part| part.end_m);
    parts.extend(path.bounds.parts.iter().filter(|part| part.end_m > visited_m).cloned());
    Some(PathBounds { approach_factor, parts })
}

/// Removes the bounds that the highest speed (m/s) and acceleration (m/s²) of the path keep everywhere.
fn drop_unused(places: &mut [Place], speed: f64, acceleration: f64) {
    let count = places.iter().map(|place| place.acceleration.len()).max().unwrap_or(0);
    let binds = |place: &Place, k: usize| {
        let Some(bound) = place.acceleration.get(k) else { return false };
        bound.usage(speed, acceleration).max(bound.usage(speed, -acceleration)) > 1.0
    };
    let used: Vec<bool> = (0..count).map(|k| places.iter().any(|place| binds(place, k))).collect();
    for place in places {
        let mut each = used.iter();
        place.acceleration.retain(|_| each.next().copied().unwrap_or(true));
    }
}

/// Parts between the `places`. A speed of at least `speed` (m/s) is no bound.
fn parts(mut places: Vec<Place>, speed: f64) -> Vec<PartBounds> {
    places.sort_by(|a, b| a.s_m.total_cmp(&b.s_m));
    let least_m = places.last().map_or(0.0, |last| last.s_m / MAX_PARTS);
    let mut parts: Vec<PartBounds> = Vec::new();
    let mut begin_m = 0.0;
    for pair in places.windows(2) {
        let bound = pair[0].speed_m_per_s.min(pair[1].speed_m_per_s) / MARGIN;
        let bound = if bound < speed { bound } else { f64::INFINITY };
        let mut acceleration = pair[0].acceleration.clone();
        AccelerationBound::merge(&mut acceleration, &pair[1].acceleration);
        let part = PartBounds { end_m: pair[1].s_m, speed_m_per_s: bound, acceleration };
        let free = part.acceleration.is_empty();
        match parts.last_mut() {
            // What is short, or has no bound like its neighbour, is one part.
            Some(last)
                if last.end_m - begin_m < least_m
                    || (free && last.speed_m_per_s.min(bound) == f64::INFINITY) =>
            {
                last.end_m = part.end_m;
                last.speed_m_per_s = bound.min(last.speed_m_per_s);
                AccelerationBound::merge(&mut last.acceleration, &part.acceleration);
            }
            last => {
                begin_m = last.map_or(0.0, |last| last.end_m);
                parts.push(part);
            }
        }
    }
    parts
}
