//! References that the arm can't reach.

use super::followed::{Followed, Instant};
use super::motion::Motion;
use super::{Case, Finding, short};
use nalgebra::{DVector, Matrix6, Vector6};
use opspace_control::rank::reach;
use opspace_control::{CartesianReference, Subject};
use opspace_model::{Data, FrameId, Model, Placement, kinematics};

/// Missed by less, a goal is reached: m, with rotations scaled to it.
const REACHED_M: f64 = 1e-3;

/// A run's instants are looked at in so many parts, the worst of each.
const PARTS: usize = 8;

/// One for each task that asks for more than the arm can do.
pub(crate) fn out_of_reach(case: &Case<'_>, followed: &Followed) -> Vec<Finding> {
    let mut names: Vec<&str> = Vec::new();
    for motion in case.stacks.iter().flat_map(|stack| &stack.motions) {
        if !names.contains(&motion.name) {
            names.push(motion.name);
        }
    }
    let found = |name: &str| {
        let asked: Vec<Asked<'_>> =
            followed.instants.iter().filter_map(|instant| Asked::new(case, instant, name)).collect();
        too_far(case, &asked).or_else(|| unattainable(case, &asked))
    };
    names.into_iter().filter_map(found).collect()
}

/// Where a task should be at an instant.
#[derive(Clone, Copy)]
struct Asked<'a> {
    instant: &'a Instant,
    motion: &'a Motion<'a>,
    target: &'a Placement,
    missed: f64,
}

impl<'a> Asked<'a> {
    fn new(case: &'a Case<'_>, instant: &'a Instant, name: &str) -> Option<Self> {
        let motions = &case.stacks[instant.stack].motions;
        let place = motions.iter().position(|motion| motion.name == name)?;
        let target = &instant.targets[place];
        let motion = &motions[place];
        Some(Self { instant, motion, target: &target.placement, missed: target.missed })
    }

    /// Where what asks for it stands in the files: the nearest waypoint, if there are any.
    fn key(&self, case: &Case<'_>) -> Vec<String> {
        let reference = &self.motion.parameters.reference;
        let mut key = case.key(self.instant.stack, self.motion.name, &[self.motion.kind, "reference"]);
        if let (CartesianReference::Waypoints(list), Some("reference")) =
            (reference, key.last().map(String::as_str))
        {
            let away_s = |place: usize| (list[place].time_s.get() - self.instant.time_s).abs();
            let nearest = (0..list.len()).min_by(|&a, &b| away_s(a).total_cmp(&away_s(b)));
            key.extend(["waypoints".to_owned(), nearest.unwrap_or(0).to_string()]);
        }
        key
    }
}

/// Farther from the first joint than all links together.
fn too_far(case: &Case<'_>, asked: &[Asked<'_>]) -> Option<Finding> {
    let (mut worst, mut most) = (None, 1.0 + 1e-6);
    for asked in asked {
        let Subject::Frame(frame) = asked.motion.subject else { continue };
        let Some((joint, distance_m)) = distance(case, asked, frame) else { continue };
        let reach_m = reach(case.model, frame);
        if distance_m / reach_m > most + 1e-6 {
            most = distance_m / reach_m;
            worst = Some((asked, joint, distance_m, reach_m));
        }
    }
    let (asked, joint, distance_m, reach_m) = worst?;
    let motion = asked.motion;
    let message = format!(
        "task '{}': at {} s its reference is {} m from joint '{joint}', and {} reaches {} m from there",
        motion.name,
        short(asked.instant.time_s),
        short(distance_m),
        motion.led(),
        short(reach_m)
    );
    let help = format!("bring it {} m nearer, or choose a smaller motion", short(distance_m - reach_m));
    Some(Finding::new(&asked.key(case), message, help))
}

/// The first joint that moves a frame, and how far from it the target is, m: along the axes in motion, since
/// along the others the frame may be anywhere.
fn distance<'a>(case: &'a Case<'_>, asked: &Asked<'_>, frame: FrameId) -> Option<(&'a str, f64)> {
    let first = &case.model.bodies()[case.model.support(frame).last()?];
    let from = case.model.base().act_point(&first.origin.translation);
    let axes = asked.motion.axes(case.model, &case.data, [false; 6]).rotation;
    let away = axes.tr_mul(&(asked.target.translation - from));
    let motion = asked.motion.parameters.motion_axes();
    let counted = (0..3).filter(|&axis| motion[axis]);
    Some((case.joint(first.joint), counted.map(|axis| away[axis] * away[axis]).sum::<f64>().sqrt()))
}

/// Near enough, but no posture within the joints' ranges was found that is there.
fn unattainable(case: &Case<'_>, asked: &[Asked<'_>]) -> Option<Finding> {
    let length = asked.len().div_ceil(PARTS).max(1);
    let worst = asked.chunks(length).filter_map(|part| {
        let doubts = part.iter().map(|asked| (doubt(case, asked), asked));
        first_of_largest(doubts.filter(|(doubt, _)| *doubt > 0.0))
    });
    let tried = worst.map(|asked| (asked, Nearest::new(case, asked)));
    let (asked, nearest) = first_of_largest(tried.map(|tried| (tried.1.missed, tried)))?;
    if nearest.missed <= REACHED_M {
        return None;
    }
    let missed = asked.motion.error(case.model, &nearest.data, asked.target);
    let [metres, radians] = [0, 3].map(|first| missed.fixed_rows::<3>(first).norm());
    let by = match (metres > 1e-4, radians > 1e-3) {
        (_, false) => format!("{} m", short(metres)),
        (false, true) => format!("{} rad", short(radians)),
        (true, true) => format!("{} m and {} rad", short(metres), short(radians)),
    };
    let at_ends = nearest.at_ends(case);
    let with =
        if at_ends.is_empty() { String::new() } else { format!(", with {} at its end", at_ends.join(", ")) };
    let message = format!(
        "task '{}': at {} s its reference can't be reached within the joints' ranges: the nearest of {} postures \
         misses it by {by}{with}",
        asked.motion.name,
        short(asked.instant.time_s),
        nearest.tries,
    );
    let help = if radians > 1e-3 && metres <= 1e-4 {
        "choose another orientation, or free an axis of rotation".to_owned()
    } else {
        "choose a nearer goal, or free an axis that need not be kept".to_owned()
    };
    Some(Finding::new(&asked.key(case), message, help))
}

/// What has the largest number, or comes before it with hardly less.
fn first_of_largest<T>(all: impl Iterator<Item = (f64, T)>) -> Option<T> {
    let larger = |best: (f64, T), next: (f64, T)| if next.0 > 1.01 * best.0 { next } else { best };
    all.reduce(larger).map(|(_, largest)| largest)
}

/// By how much joints that follow freely miss it or leave their ranges; nothing to doubt if they do neither.
fn doubt(case: &Case<'_>, asked: &Asked<'_>) -> f64 {
    let missed = if asked.missed > REACHED_M { asked.missed } else { 0.0 };
    let beyond = asked.instant.q.iter().enumerate().map(|(joint, q)| {
        let (lower, upper) = case.range(joint);
        (lower - q).max(q - upper)
    });
    beyond.fold(missed, f64::max)
}

/// The posture that comes nearest to where a task should be.
struct Nearest {
    data: Data,
    missed: f64,
    tries: usize,
}

impl Nearest {
    fn new(case: &Case<'_>, asked: &Asked<'_>) -> Self {
        let mut best = Self { data: case.data.clone(), missed: f64::INFINITY, tries: 0 };
        for start in starts(case, &asked.instant.q) {
            best.tries += 1;
            let data = solve(case, asked.motion, asked.target, start);
            let missed = missed(case.model, &data, asked.motion, asked.target).norm();
            if missed < best.missed {
                (best.data, best.missed) = (data, missed);
            }
            if best.missed <= REACHED_M {
                break;
            }
        }
        best
    }

    fn at_ends(&self, case: &Case<'_>) -> Vec<String> {
        let at_end = |&joint: &usize| {
            let ((lower, upper), q) = (case.range(joint), self.data.q[joint]);
            q <= lower + 1e-9 || q >= upper - 1e-9
        };
        (0..case.model.n()).filter(at_end).map(|joint| format!("joint '{}'", case.joint(joint))).collect()
    }
}

/// Postures to search from: where the joints would be, the start, and some spread over the joints' ranges.
fn starts(case: &Case<'_>, followed: &[f64]) -> Vec<Vec<f64>> {
    const SPREAD: usize = 18;
    let mut starts = vec![followed.to_vec(), case.start.clone()];
    starts.extend((0..SPREAD).map(|k| {
        (0..case.model.n())
            .map(|joint| {
                let (lower, upper) = case.range(joint);
                // Multiples of powers of the golden ratio's inverse fill an interval evenly, each joint's its own way.
                let share = (0.5 + 0.618_034_f64.powi(joint as i32 + 1) * k as f64).fract();
                if (upper - lower).is_finite() { lower + share * (upper - lower) } else { case.start[joint] }
            })
            .collect()
    }));
    starts
}

fn missed(model: &Model, data: &Data, motion: &Motion<'_>, target: &Placement) -> Vector6<f64> {
    let axes = motion.axes(model, data, motion.parameters.motion_axes());
    axes.rows_of(&motion.error(model, data, target))
}

/// Inverse kinematics within the joints' ranges: damped least squares (Levenberg and Marquardt), joints that are at an
/// end and would go beyond it left out.
fn solve(case: &Case<'_>, motion: &Motion<'_>, target: &Placement, start: Vec<f64>) -> Data {
    const ITERATIONS: usize = 300;
    let (model, n) = (case.model, case.model.n());
    let clamped = |joint: usize, q: f64| {
        let (lower, upper) = case.range(joint);
        // A range that its margins leave nothing of keeps its middle.
        if lower < upper { q.clamp(lower, upper) } else { 0.5 * (lower + upper) }
    };
    let rest = vec![0.0; n];
    let mut q: Vec<f64> = start.into_iter().enumerate().map(|(joint, q)| clamped(joint, q)).collect();
    let mut data = case.data.clone();
    kinematics(model, &mut data, &q, &rest);
    let mut error = missed(model, &data, motion, target);
    let mut damping = 1e-3;
    for _ in 0..ITERATIONS {
        if error.norm() < 0.1 * REACHED_M || damping > 1e9 {
            break;
        }
        let axes = motion.axes(model, &data, motion.parameters.motion_axes());
        let mut rows = motion.rows(model, &data, &axes);
        let downhill = rows.tr_mul(&error);
        for joint in 0..n {
            if clamped(joint, q[joint] + 1e-9 * downhill[joint].signum()) == q[joint] {
                rows.column_mut(joint).fill(0.0);
            }
        }
        let square = &rows * rows.transpose();
        let damped = square + Matrix6::identity() * (damping * square.trace().max(1e-9));
        let Some(factor) = damped.cholesky() else { break };
        let step: DVector<f64> = rows.tr_mul(&factor.solve(&error));
        let next: Vec<f64> = (0..n).map(|joint| clamped(joint, q[joint] + step[joint])).collect();
        kinematics(model, &mut data, &next, &rest);
        let after = missed(model, &data, motion, target);
        if after.norm() < error.norm() {
            (q, error, damping) = (next, after, (0.3 * damping).max(1e-9));
        } else {
            kinematics(model, &mut data, &q, &rest);
            damping *= 4.0;
        }
    }
    data
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Choice, Experiment, Files};
    use opspace_model::frame_placement;
    use std::path::Path;

    /// Poses of the Panda's flange by forward kinematics, from postures spread over the joints' ranges with two joints
    /// at an end of theirs, against what is found for them: no pose that has a posture is said to have none.
    #[test]
    fn a_posture_is_found_for_every_pose_that_has_one() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/panda-reach.toml");
        let experiment = Experiment::load(Files::Disk, &path, None, Choice::default(), &[]).expect("a task");
        let case = Case::new(&experiment).expect("a start");
        let (model, motion) = (case.model, &case.stacks[0].motions[0]);
        let flange = model.frame("flange").expect("a link");
        let mut data = case.data.clone();
        let mut missed = Vec::new();
        for k in 0..60 {
            let posture: Vec<f64> = (0..model.n())
                .map(|joint| {
                    let (lower, upper) = case.range(joint);
                    let share = match (k % model.n(), (k + 3) % model.n()) {
                        (low, _) if low == joint => 0.0,
                        (_, high) if high == joint => 1.0,
                        _ => (0.3 + 2.0_f64.sqrt().powi(joint as i32 + 1) * (k + 1) as f64).fract(),
                    };
                    lower + share * (upper - lower)
                })
                .collect();
            kinematics(model, &mut data, &posture, &vec![0.0; model.n()]);
            let target = frame_placement(model, &data, flange);
            let instant = Instant {
                time_s: 0.0,
                stack: 0,
                q: case.start.clone(),
                dq: vec![0.0; model.n()],
                gravity: vec![0.0; model.n()],
                targets: Vec::new(),
                joints: std::collections::BTreeMap::new(),
            };
            let asked = Asked { instant: &instant, motion, target: &target, missed: 1.0 };
            let nearest = Nearest::new(&case, &asked);
            if nearest.missed > REACHED_M {
                missed.push((k, nearest.missed));
            }
        }
        assert!(missed.is_empty(), "{} of 60 aren't found: {missed:?}", missed.len());
    }
}
