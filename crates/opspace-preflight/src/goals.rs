//! References that are out of reach of the arm.

use super::case::PreflightCase;
use super::diagnostic::{at_least, short};
use super::motion::Motion;
use nalgebra::Vector6;
use opspace_control::reach;
use opspace_control::{AXIS_NAMES, BuildTask, CartesianReference, ControlledFrame, Task, TaskReference};
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::postures::posture_at::{PostureSearch, REACHED_M, norm_in};
use opspace_experiment::run::rollout::{Instant, Rollout, error};
use opspace_model::{Data, FrameId, kinematics};

/// Number of parts into which a run's instants are divided; the worst instant of each part is examined.
const PARTS: usize = 8;

/// Distance over the reach of the arm from which on a length was probably meant in mm.
const MANY_REACHES: f64 = 20.0;

/// Returns a diagnostic for each task whose reference is out of reach.
pub(crate) fn out_of_reach(case: &PreflightCase<'_>, followed: &Rollout) -> Vec<Finding> {
    let mut names: Vec<&str> = Vec::new();
    for task in case.task_sets.iter().flat_map(|stack| stack.tasks.tasks()) {
        if !names.contains(&task.name()) {
            names.push(task.name());
        }
    }
    let all = names.into_iter().map(|name| {
        let asked: Vec<Asked<'_>> =
            followed.instants.iter().filter_map(|instant| Asked::new(case, instant, name)).collect();
        let finding = too_far(case, &asked);
        let doubtful = if finding.is_none() { doubtful(case, &asked) } else { Vec::new() };
        (finding, doubtful)
    });
    let (found, doubtful): (Vec<Option<Finding>>, Vec<Vec<Asked<'_>>>) = all.unzip();
    let nearest = nearest_postures(case, &doubtful);
    let unattainable = nearest.into_iter().map(|nearest| unattainable(case, nearest));
    found.into_iter().zip(unattainable).filter_map(|(found, unattainable)| found.or(unattainable)).collect()
}

/// A task at an instant.
#[derive(Clone, Copy)]
struct Asked<'a> {
    instant: &'a Instant,
    name: &'a str,
    /// Index among the active tasks.
    place: usize,
}

impl<'a> Asked<'a> {
    fn new(case: &PreflightCase<'_>, instant: &'a Instant, name: &'a str) -> Option<Self> {
        let place = case.task_sets[instant.task_set].tasks.tasks().position(|task| task.name() == name)?;
        Some(Self { instant, name, place })
    }

    fn error(&self) -> &'a Vector6<f64> {
        &self.instant.tasks[self.place].error
    }

    /// Reference of a task that controls a frame or the centre of mass.
    fn cartesian_reference<'c>(&self, case: &'c PreflightCase<'_>) -> Option<&'c CartesianReference> {
        match case.task_sets[self.instant.task_set].task.get(self.name)?.reference()? {
            TaskReference::Cartesian(reference) => Some(reference),
            _ => None,
        }
    }

    /// Key of the reference in the files, of its nearest waypoint if it has waypoints.
    fn key(&self, case: &PreflightCase<'_>) -> Vec<String> {
        let mut key = case.reference_key(self.instant.task_set, self.name);
        if let (Some(CartesianReference::Waypoints(list)), Some("reference")) =
            (self.cartesian_reference(case), key.last().map(String::as_str))
        {
            let away_s = |place: usize| (list[place].time_s.get() - self.instant.time_s).abs();
            let nearest = (0..list.len()).min_by(|&a, &b| away_s(a).total_cmp(&away_s(b)));
            key.extend(["waypoints".to_owned(), nearest.unwrap_or(0).to_string()]);
        }
        key
    }
}

/// Finds references whose distance from the first joint is larger than the length of all links.
fn too_far(case: &PreflightCase<'_>, asked: &[Asked<'_>]) -> Option<Finding> {
    let (mut worst, mut most) = (None, 1.0 + 1e-6);
    for asked in asked {
        let motions = &case.task_sets[asked.instant.task_set].motions;
        let Some(motion) = motions.iter().find(|motion| motion.name == asked.name) else { continue };
        let ControlledFrame::Frame(frame) = motion.controlled else { continue };
        let Some((joint, distance_m)) = distance(case, asked, motion, frame) else { continue };
        let reach_m = reach(case.model, frame);
        if distance_m / reach_m > most + 1e-6 {
            most = distance_m / reach_m;
            worst = Some((asked, motion, joint, distance_m, reach_m));
        }
    }
    let (asked, motion, joint, distance_m, reach_m) = worst?;
    let message = format!(
        "task '{}': at {} s its reference is {} m from joint '{joint}', but {} reaches only {} m from there",
        motion.name,
        short(asked.instant.time_s),
        short(distance_m),
        motion.controlled_name(),
        short(reach_m)
    );
    let in_mm = if distance_m > MANY_REACHES * reach_m && 1e-3 * distance_m <= reach_m {
        "; lengths are in m: if the file means mm, divide them by 1000"
    } else {
        ""
    };
    let help = format!("move it {} m closer, or reduce the motion{in_mm}", at_least(distance_m - reach_m));
    Some(Finding::new(Code::GoalOutOfReach, &asked.key(case), message, help))
}

/// First joint that moves a frame, and the distance of the target from this joint, m. Only the motion axes count,
/// because the position along the other axes is free.
fn distance<'a>(
    case: &'a PreflightCase<'_>,
    asked: &Asked<'_>,
    motion: &Motion<'_>,
    frame: FrameId,
) -> Option<(&'a str, f64)> {
    let first = &case.model.bodies()[case.model.ancestors(frame).last()?];
    let from = case.model.base().act_point(&first.origin.translation);
    let mut data = case.data.clone();
    kinematics(case.model, &mut data, &asked.instant.q, &vec![0.0; case.model.n()]);
    let axes = motion.axes(case.model, &data);
    let away = axes.tr_mul(&(motion.controlled.placement(case.model, &data).translation - from));
    let task = case.task_sets[asked.instant.task_set].tasks.tasks().nth(asked.place)?;
    let along = |name: &str| AXIS_NAMES[..3].iter().position(|axis| *axis == name);
    let rows = task.row_names().into_iter().enumerate().filter(|(row, _)| task.follows_reference(*row));
    let parts = rows.filter_map(|(row, name)| along(&name).map(|axis| away[axis] + asked.error()[row]));
    Some((case.joint(first.joint), parts.map(|part| part * part).sum::<f64>().sqrt()))
}

/// Instants at which the rollout misses the reference of a task most, or leaves the joint ranges.
fn doubtful<'a>(case: &PreflightCase<'_>, asked: &[Asked<'a>]) -> Vec<Asked<'a>> {
    let length = asked.len().div_ceil(PARTS).max(1);
    let worst = asked.chunks(length).filter_map(|part| {
        let doubts = part.iter().map(|asked| (doubt(case, asked), *asked));
        first_of_largest(doubts.filter(|(doubt, _)| *doubt > 0.0))
    });
    worst.collect()
}

/// Nearest postures at the doubtful instants of each task.
fn nearest_postures<'a>(
    case: &PreflightCase<'_>,
    doubtful: &[Vec<Asked<'a>>],
) -> Vec<Vec<(Asked<'a>, Nearest)>> {
    let steps: Vec<usize> = doubtful.iter().flatten().map(|asked| asked.instant.step).collect();
    let mut nearest: Vec<Vec<(Asked<'a>, Nearest)>> = doubtful.iter().map(|_| Vec::new()).collect();
    Rollout::revisit(&case.rollout(), &steps, |step, tasks| {
        for (of_task, nearest) in doubtful.iter().zip(&mut nearest) {
            for asked in of_task.iter().filter(|asked| asked.instant.step == step) {
                if let Some(task) = tasks.tasks().nth(asked.place) {
                    nearest.push((*asked, Nearest::new(case, task, &asked.instant.q)));
                }
            }
        }
    });
    nearest
}

/// Finds references within the arm's length for which the search finds no posture within the joint ranges.
fn unattainable(case: &PreflightCase<'_>, nearest: Vec<(Asked<'_>, Nearest)>) -> Option<Finding> {
    let (asked, nearest) = first_of_largest(nearest.into_iter().map(|tried| (tried.1.missed, tried)))?;
    if nearest.missed <= REACHED_M {
        return None;
    }
    let [metres, radians] = nearest.missed_by;
    let by = match (metres > 1e-4, radians > 1e-3) {
        (_, false) => format!("{} m", short(metres)),
        (false, true) => format!("{} rad", short(radians)),
        (true, true) => format!("{} m and {} rad", short(metres), short(radians)),
    };
    let with = match nearest.at_ends.as_slice() {
        [] => String::new(),
        [joint] => format!(", with {joint} at the end of its range"),
        joints => format!(", with {} at the ends of their ranges", joints.join(", ")),
    };
    let message = format!(
        "task '{}': at {} s its reference cannot be reached within the joint ranges: the best of {} searches for a \
         posture misses it by {by}{with}",
        asked.name,
        short(asked.instant.time_s),
        nearest.tries,
    );
    let is_frame = asked.cartesian_reference(case).is_some();
    let help = if !is_frame {
        "choose a closer goal".to_owned()
    } else if radians > 1e-3 && metres <= 1e-4 {
        "choose another orientation, or free an axis of rotation".to_owned()
    } else {
        "choose a closer goal, or free an axis that the task does not need".to_owned()
    };
    Some(Finding::new(Code::GoalOutOfReach, &asked.key(case), message, help))
}

/// Returns the item with the largest number, or an earlier one whose number is at most 1 % smaller.
fn first_of_largest<T>(all: impl Iterator<Item = (f64, T)>) -> Option<T> {
    let larger = |best: (f64, T), next: (f64, T)| if next.0 > 1.01 * best.0 { next } else { best };
    all.reduce(larger).map(|(_, largest)| largest)
}

/// Error of the rollout, or its largest excess beyond a joint range if this is larger. Zero if it reaches the
/// reference within the joint ranges.
fn doubt(case: &PreflightCase<'_>, asked: &Asked<'_>) -> f64 {
    let missed = asked.error().norm();
    let missed = if missed > REACHED_M { missed } else { 0.0 };
    let beyond = asked.instant.q.iter().enumerate().map(|(joint, q)| {
        let (lower, upper) = case.range(joint);
        (lower - q).max(q - upper)
    });
    beyond.fold(missed, f64::max)
}

/// Posture that comes nearest to a task's reference.
struct Nearest {
    /// Norm of the error over all rows, m; rotations are scaled to m.
    missed: f64,
    /// Norms of the error of the rows in m and of the rows in rad.
    missed_by: [f64; 2],
    /// Joints at an end of their range.
    at_ends: Vec<String>,
    tries: usize,
}

impl Nearest {
    /// Searches from several postures, of which `q` (n) is the first; the task's target is that of its last update.
    fn new(case: &PreflightCase<'_>, task: &dyn Task, q: &[f64]) -> Self {
        let mut best = Self { missed: f64::INFINITY, missed_by: [0.0; 2], at_ends: Vec::new(), tries: 0 };
        let ranges = (0..case.model.n()).map(|joint| case.range(joint)).collect();
        let search = PostureSearch { model: case.model, ranges };
        for start in search.starts(&[q, &case.start]) {
            best.tries += 1;
            let data = search.solve(task, &start);
            let error = error(task, case.model, &data);
            if error.norm() < best.missed {
                best.missed = error.norm();
                best.missed_by = ["m", "rad"].map(|unit| norm_in(task, &error, unit));
                best.at_ends = at_ends(case, &data);
            }
            if best.missed <= REACHED_M {
                break;
            }
        }
        best
    }
}

fn at_ends(case: &PreflightCase<'_>, data: &Data) -> Vec<String> {
    let at_end = |&joint: &usize| {
        let ((lower, upper), q) = (case.range(joint), data.q[joint]);
        q <= lower + 1e-9 || q >= upper - 1e-9
    };
    (0..case.model.n()).filter(at_end).map(|joint| format!("joint '{}'", case.joint(joint))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use opspace_backend::quantity::Positive;
    use opspace_control::references::reference::Waypoint;
    use opspace_control::{
        Axes, AxisGains, AxisMode, CartesianParameters, CartesianTask, ControlContext, Measurement,
        OrientationGoal, PositionGoal, Targets,
    };
    use opspace_control::{TaskInput, TaskTarget};
    use opspace_experiment::{Experiment, Files, RunOptions};
    use opspace_model::frame_placement;
    use std::path::Path;

    /// Returns a task of the flange whose target is the end of a reference.
    fn task_at(case: &PreflightCase<'_>, reference: CartesianReference) -> CartesianTask {
        let (model, n) = (case.model, case.model.n());
        let context = ControlContext::new(model, 1e-3);
        let gains = AxisGains::new(10.0, 1.0).expect("good gains");
        let parameters = CartesianParameters::new("flange", Axes::pose(AxisMode::Motion), gains);
        let parameters = parameters.with_reference(reference);
        let mut task = CartesianTask::new("flange", &parameters, model, &context).expect("a good task");
        let mut measurement = Measurement::new(n, 0, false);
        measurement.q.copy_from_slice(&case.start);
        let (feedforward, targets) = (vec![0.0; n], Targets::none());
        task.start(&opspace_control::ControlInput::new(
            model,
            &case.data,
            &measurement,
            &feedforward,
            &targets,
        ));
        measurement.time_s = 1.0;
        let control =
            opspace_control::ControlInput::new(model, &case.data, &measurement, &feedforward, &targets);
        task.observe(&TaskInput { control, limited: true, target: TaskTarget::none(0.0) });
        task
    }

    /// Compared: poses of the Panda's flange by forward kinematics, and the postures that the search finds for them:
    /// it must find a posture for every pose. The poses come from postures distributed over the joint ranges, with
    /// two joints at an end of their range.
    #[test]
    fn every_reachable_pose_gets_a_posture() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/panda-reach.toml");
        let experiment =
            Experiment::load(Files::Disk, &path, None, RunOptions::default(), &[]).expect("a task");
        let case = PreflightCase::new(&experiment).expect("a start");
        let model = case.model;
        let flange = model.frame_id("flange").expect("a link");
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
            let rpy = Rotation3::from_matrix_unchecked(target.rotation).euler_angles();
            let goal = CartesianReference::Waypoints(vec![Waypoint {
                time_s: Positive::literal(1e-3),
                position: Some(PositionGoal::Absolute(target.translation.into())),
                orientation: Some(OrientationGoal::Absolute(rpy.into())),
            }]);
            let task = task_at(&case, goal);
            let nearest = Nearest::new(&case, &task, &case.start);
            if nearest.missed > REACHED_M {
                missed.push((k, nearest.missed));
            }
        }
        assert!(missed.is_empty(), "{} of 60 aren't found: {missed:?}", missed.len());
    }
}
