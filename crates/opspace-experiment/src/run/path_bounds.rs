//! Bounds of the joints' speed limits on the speed along time-optimal paths.
//!
//! The joint velocities that a path demands are proportional to its speed: q̇ = q'(s) ṡ, with the joint motion q(s) of a
//! rollout with all tasks. The largest ṡ at s is therefore ṡ / r, where r is the largest ratio of a joint's speed to its
//! limit. The timing law of the path then keeps this bound like its own ones, by a pass forward and one backward.

use crate::run::rollout::Rollout;
use opspace_control::{CartesianReference, PathBounds, PathPlace, PathReference, SpeedBound, TaskParameters};
use std::collections::BTreeMap;

/// Largest number of rollouts: the joint motion of a redundant arm depends slightly on the speed.
pub(crate) const PASSES: usize = 4;

/// Ratio of a speed to its limit up to which a pass changes nothing.
const KEPT: f64 = 1.0 + 1e-9;

/// Margin for places between two instants of a rollout, and for its errors.
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
    pub path: PathReference,
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
pub(crate) fn path_of(parameters: &mut TaskParameters) -> Option<&mut PathReference> {
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

/// Computes the bounds of a path from a rollout, for joints with the speeds `allowed` (n; rad/s or m/s). `None` if the
/// path keeps them, or if the rollout does not visit it.
pub(crate) fn bounds(path: &TaskPath, rollout: &Rollout, allowed: &[f64]) -> Option<PathBounds> {
    let TaskPath { task, path, sets } = path;
    let visits = rollout.instants.iter().filter(|instant| {
        sets.contains(&instant.task_set) && instant.tasks.iter().all(|task| task.error.norm() < FOLLOWED_M)
    });
    let mut places: Vec<(f64, f64)> = Vec::new();
    let (mut largest, mut approach) = (0.0_f64, 0.0_f64);
    for instant in visits {
        let Some(at) = instant.paths.get(task) else { continue };
        let of_joints = instant.dq.iter().zip(allowed).map(|(dq, allowed)| dq.abs() / allowed);
        let ratio = of_joints.fold(at.speed_ratio, f64::max);
        match at.place {
            PathPlace::Approach => approach = approach.max(ratio),
            PathPlace::Along { s_m, speed_m_per_s } if speed_m_per_s > SLOW * path.speed_m_per_s.get() => {
                largest = largest.max(ratio);
                places.push((s_m, speed_m_per_s / ratio));
            }
            PathPlace::Along { .. } => {}
        }
    }
    if largest <= KEPT && approach <= KEPT {
        return None;
    }
    let longer = if approach > KEPT { MARGIN * approach } else { 1.0 };
    let approach_factor = longer * path.bounds.approach_factor;
    let mut parts = parts(places, path.speed_m_per_s.get());
    let visited_m = parts.last().map_or(0.0, |part| part.end_m);
    parts.extend(path.bounds.parts.iter().filter(|part| part.end_m > visited_m));
    Some(PathBounds { approach_factor, parts })
}

/// Parts between the `places`, pairs of an arc length and a highest speed (m, m/s). A speed of at least `speed` (m/s) is no
/// bound.
fn parts(mut places: Vec<(f64, f64)>, speed: f64) -> Vec<SpeedBound> {
    places.sort_by(|a, b| a.0.total_cmp(&b.0));
    let least_m = places.last().map_or(0.0, |last| last.0 / MAX_PARTS);
    let mut parts: Vec<SpeedBound> = Vec::new();
    let mut begin_m = 0.0;
    for pair in places.windows(2) {
        let bound = pair[0].1.min(pair[1].1) / MARGIN;
        let bound = if bound < speed { bound } else { f64::INFINITY };
        let part = SpeedBound { end_m: pair[1].0, speed_m_per_s: bound };
        match parts.last_mut() {
            // What is short, or has no bound like its neighbour, is one part.
            Some(last)
                if last.end_m - begin_m < least_m || last.speed_m_per_s.min(bound) == f64::INFINITY =>
            {
                *last = SpeedBound { speed_m_per_s: bound.min(last.speed_m_per_s), ..part };
            }
            last => {
                begin_m = last.map_or(0.0, |last| last.end_m);
                parts.push(part);
            }
        }
    }
    parts
}
