//! Moving references that limits, or the reach of the arm, keep tasks from, over a whole log.

use super::hold_counts::HoldCounts;
use super::holds::{HeldState, Hold, RowErrors, clipped, is_taken, norm_in};
use super::near_pairs::pair_names;
use super::run_log::Run;
use super::unreached_goals::{errors, joint_errors, task_set_at, task_sets, update_state};
use crate::codes::Code;
use crate::evaluate::findings::reference_limited;
use crate::files::controller_kind::ControllerKind;
use crate::finding::{Causes, Finding, Place};
use crate::run::experiment::Experiment;
use nalgebra::Vector6;
use opspace_backend::signal_names::{self, LIMITED, PHASE, Q, REFERENCE, REFERENCE_ORIENTATION, SLACK};
use opspace_control::{Task, TaskSet};
use opspace_loop::Phase;
use std::collections::BTreeMap;

/// Time between two examined control cycles, s.
const STEP_S: f64 = 5e-3;

/// Longest time between two examined cycles whose references are compared, s.
const MAX_GAP_S: f64 = 0.1;

/// Smallest error that counts, m and rad: errors of tracking are smaller.
const MIN_POSITION_M: f64 = 5e-3;
const MIN_ORIENTATION_RAD: f64 = 20e-3;

/// Speed above which a reference moves, m/s or rad/s.
const MOVING: f64 = 1e-3;

/// Shortest time that is reported, s, in sum, unless the error is large.
const MIN_DURATION_S: f64 = 0.1;

/// Error that is reported however short it is, relative to the smallest one that counts.
const LARGE: f64 = 4.0;

/// Moving references that the tasks of a run did not follow, while segments of the log arrive.
pub(super) struct LimitedReferences<'a> {
    experiment: &'a Experiment,
    state: HeldState<'a>,
    /// Task sets of the run, in order of time. They are built when control begins.
    sets: Option<Vec<Option<TaskSet>>>,
    /// Time before which no cycle is examined, s.
    next_s: f64,
    /// Time of the cycle that was examined before, s.
    before_s: f64,
    /// Number of examined cycles.
    cycles: usize,
    /// References of the tasks at the cycle that was examined before.
    references: BTreeMap<String, Vec<f64>>,
    found: BTreeMap<String, Found>,
}

/// Errors and their causes that are found for one task.
#[derive(Default)]
struct Found {
    begin_s: f64,
    largest_s: f64,
    position_m: Option<f64>,
    orientation_rad: Option<f64>,
    counts: HoldCounts,
    /// Largest errors of the joints of a task of all joints, rad or m; empty for other tasks.
    deviations: Vec<f64>,
}

/// Task that does not follow its moving reference in a cycle.
struct Behind {
    task: String,
    position_m: Option<f64>,
    orientation_rad: Option<f64>,
    hold: Hold,
    /// Errors that limits cause of the joints of a task of all joints, rad or m; empty for other tasks.
    joints: Vec<f64>,
}

impl<'a> LimitedReferences<'a> {
    pub(super) fn new(experiment: &'a Experiment) -> Self {
        Self {
            experiment,
            state: HeldState::new(experiment),
            sets: None,
            next_s: f64::NEG_INFINITY,
            before_s: f64::NEG_INFINITY,
            cycles: 0,
            references: BTreeMap::new(),
            found: BTreeMap::new(),
        }
    }

    /// Adds a segment.
    pub(super) fn add(&mut self, run: &Run<'_>) {
        let Some(phase) = run.tick.signal(PHASE) else { return };
        for k in 0..run.tick.len() {
            let time_s = run.tick.time_s[k];
            if phase.row(k)[0] != Phase::Control.code() || time_s < self.next_s - run.same_s {
                continue;
            }
            self.next_s = time_s + STEP_S;
            self.cycles += 1;
            let step_s = time_s - self.before_s;
            let behind = match self.experiment.options().controller {
                ControllerKind::Osc => self.behind(run, k, step_s),
                ControllerKind::Ik | ControllerKind::IkLead => self.clipped(run, k, step_s),
            };
            for behind in behind {
                let found = self.found.entry(behind.task.clone()).or_default();
                found.add(behind, time_s - run.start_s);
            }
            self.before_s = time_s;
        }
    }

    /// Returns the references in the order of their times.
    pub(super) fn finish(self) -> Vec<Finding> {
        let mut found: Vec<(String, Found)> = self.found.into_iter().collect();
        found.sort_by(|(_, a), (_, b)| a.begin_s.total_cmp(&b.begin_s));
        found
            .into_iter()
            .filter_map(|(task, found)| found.finish(task, self.cycles, self.experiment))
            .collect()
    }

    /// Tasks that do not follow their moving references in cycle `k`, `step_s` after the one that was examined before.
    fn behind(&mut self, run: &Run<'_>, k: usize, step_s: f64) -> Vec<Behind> {
        let sets = self.sets.get_or_insert_with(|| task_sets(self.experiment));
        let Some(Some(set)) = sets.get(task_set_at(run, k)) else { return Vec::new() };
        let mut behind = Vec::new();
        let mut is_updated = None;
        for (place, task) in set.tasks().enumerate() {
            let moves = moves(&mut self.references, run, k, task.name(), step_s);
            let errors = errors(run, k, task);
            let [position_m, orientation_rad] = ["m", "rad"].map(|unit| norm_in(unit, task, &errors));
            if !moves || size(position_m, orientation_rad) <= 1.0 {
                continue;
            }
            if !*is_updated.get_or_insert_with(|| update_state(&mut self.state, run, k)) {
                continue;
            }
            let taken = taken(run, k, task);
            let hold = self.state.of_moving_task(set, place, &in_motion(errors, task), &taken);
            let (task, joints) = (task.name().to_owned(), Vec::new());
            behind.push(Behind { task, position_m, orientation_rad, hold, joints });
        }
        if let Some(task) = set.joint_task()
            && moves(&mut self.references, run, k, task.name(), step_s)
            && let Some(errors) = joint_errors(run, k, task)
            && let Some(slack) = run.tick.signal(&signal_names::of(task.name(), SLACK))
            && *is_updated.get_or_insert_with(|| update_state(&mut self.state, run, k))
        {
            let [position_m, orientation_rad] = largest(self.experiment, &errors);
            if size(position_m, orientation_rad) > 1.0 {
                let wanted = errors.iter().enumerate().map(|(joint, error)| {
                    let gains = task.gains(joint, self.state.inertia(joint));
                    gains.map_or(0.0, |gains| gains.stiffness_per_s2 * error)
                });
                let wanted: Vec<f64> = wanted.collect();
                let hold = self.state.of_moving_joints(&wanted, slack.row(k));
                let deviates = |joint: usize| is_taken(wanted[joint], slack.row(k)[joint]);
                let joints = errors.iter().enumerate();
                let joints =
                    joints.map(|(joint, error)| if deviates(joint) { *error } else { 0.0 }).collect();
                let task = task.name().to_owned();
                behind.push(Behind { task, position_m, orientation_rad, hold, joints });
            }
        }
        behind.retain(|behind| behind.has_cause());
        behind
    }

    /// Tasks that do not follow their moving references in cycle `k`, in which inverse kinematics clips joints.
    fn clipped(&mut self, run: &Run<'_>, k: usize, step_s: f64) -> Vec<Behind> {
        let sets = self.sets.get_or_insert_with(|| task_sets(self.experiment));
        let Some(Some(set)) = sets.get(task_set_at(run, k)) else { return Vec::new() };
        let (Some(q), Some(limited)) = (run.tick.signal(Q), run.tick.signal(LIMITED)) else {
            return Vec::new();
        };
        let hold = || clipped(self.experiment, q.row(k), limited.row(k));
        let mut behind = Vec::new();
        for task in set.tasks() {
            let moves = moves(&mut self.references, run, k, task.name(), step_s);
            let errors = errors(run, k, task);
            let [position_m, orientation_rad] = ["m", "rad"].map(|unit| norm_in(unit, task, &errors));
            if moves && size(position_m, orientation_rad) > 1.0 {
                let (task, joints) = (task.name().to_owned(), Vec::new());
                behind.push(Behind { task, position_m, orientation_rad, hold: hold(), joints });
            }
        }
        if let Some(task) = set.joint_task()
            && moves(&mut self.references, run, k, task.name(), step_s)
            && let Some(joints) = joint_errors(run, k, task)
        {
            let [position_m, orientation_rad] = largest(self.experiment, &joints);
            if size(position_m, orientation_rad) > 1.0 {
                let task = task.name().to_owned();
                behind.push(Behind { task, position_m, orientation_rad, hold: hold(), joints });
            }
        }
        behind.retain(|behind| behind.has_cause());
        behind
    }
}

/// Returns the largest errors of joints, m and rad.
fn largest(experiment: &Experiment, errors: &[f64]) -> [Option<f64>; 2] {
    let units = experiment.robot().model.joint_units();
    ["m", "rad"].map(|unit| {
        let of_unit = errors.iter().zip(&units.position).filter(|(_, own)| **own == unit);
        of_unit.map(|(error, _)| error.abs()).filter(|error| *error > 0.0).reduce(f64::max)
    })
}

/// Returns the larger of two errors (m and rad) relative to the smallest that counts.
fn size(position_m: Option<f64>, orientation_rad: Option<f64>) -> f64 {
    let of = |error: Option<f64>, least: f64| error.map_or(0.0, |error| error / least);
    of(position_m, MIN_POSITION_M).max(of(orientation_rad, MIN_ORIENTATION_RAD))
}

/// Returns true if the reference of a task moves; `references` has the references at the cycle before.
fn moves(
    references: &mut BTreeMap<String, Vec<f64>>,
    run: &Run<'_>,
    k: usize,
    name: &str,
    step_s: f64,
) -> bool {
    let signals = [REFERENCE, REFERENCE_ORIENTATION].map(|signal| signal_names::of(name, signal));
    let rows = signals.iter().filter_map(|signal| Some(run.tick.signal(signal)?.row(k)));
    let now: Vec<f64> = rows.flatten().copied().collect();
    let changed = references.get(name).filter(|before| before.len() == now.len()).map(|before| {
        let squares = now.iter().zip(before).map(|(now, before)| (now - before).powi(2));
        squares.sum::<f64>().sqrt()
    });
    references.insert(name.to_owned(), now);
    // A reference that is absent is NaN, which does not exceed the speed.
    step_s <= MAX_GAP_S && changed.is_some_and(|changed| changed > MOVING * step_s)
}

/// Accelerations that limits take from the rows of a task; zero without limits.
fn taken(run: &Run<'_>, k: usize, task: &dyn Task) -> Vector6<f64> {
    let mut taken = Vector6::zeros();
    let Some(slack) = run.tick.signal(&signal_names::of(task.name(), SLACK)) else { return taken };
    for (row, name) in task.row_names().iter().enumerate().take(taken.len()) {
        let place = slack.elements().iter().position(|element| element == name);
        let value = place.map(|place| slack.row(k)[place]).filter(|value| value.is_finite());
        taken[row] = value.unwrap_or(0.0) * task.row_unit(row).1;
    }
    taken
}

/// Errors of the rows with a feedback of position.
fn in_motion(mut errors: RowErrors, task: &dyn Task) -> RowErrors {
    for (row, error) in errors.iter_mut().enumerate().take(task.rows()) {
        *error = error.filter(|_| task.gains(row).is_some());
    }
    errors
}

impl Behind {
    /// Returns true if the cause is known.
    fn has_cause(&self) -> bool {
        let hold = &self.hold;
        hold.singular_along.is_some() || hold.is_at_limits() || !hold.distances.is_empty()
    }
}

impl Found {
    fn add(&mut self, behind: Behind, since_start_s: f64) {
        if self.counts.cycles == 0 {
            self.begin_s = since_start_s;
        }
        let grows =
            size(behind.position_m, behind.orientation_rad) > size(self.position_m, self.orientation_rad);
        if grows {
            (self.position_m, self.orientation_rad) = (behind.position_m, behind.orientation_rad);
            self.largest_s = since_start_s;
        }
        self.counts.add(&behind.hold, grows);
        self.deviations.resize(behind.joints.len(), 0.0);
        self.deviations
            .iter_mut()
            .zip(&behind.joints)
            .for_each(|(most, error)| *most = most.max(error.abs()));
    }

    /// Returns the reference, if the task was held back for long enough or far enough; `cycles` is the number of all cycles.
    fn finish(self, task: String, cycles: usize, experiment: &Experiment) -> Option<Finding> {
        let joints = experiment.robot().model.joints();
        let names: Vec<&str> = joints.iter().map(|joint| joint.name.as_str()).collect();
        let [position_limits, speed_limits, torque_limits] = self.counts.limits(&names);
        let held = self.counts.cycles as f64;
        let causes = Causes {
            position_limits,
            speed_limits,
            torque_limits,
            kept_distances: pair_names(experiment, &self.counts.pairs()),
            singular_along: self.counts.singular_along(),
            ..Causes::default()
        };
        let counts = held * STEP_S >= MIN_DURATION_S || size(self.position_m, self.orientation_rad) >= LARGE;
        if !counts || causes.is_empty() {
            return None;
        }
        let ramp_s = experiment.robot().file.safety.torque_ramp_s.get();
        let settle_s = experiment.task().file.settle_s.get();
        let reference = Finding::of(Code::ReferenceLimited, Place::Task(task), String::new())
            .with("begin_s", Some(self.begin_s))
            .with("share", Some(held / cycles.max(1) as f64))
            .with("position_m", self.position_m)
            .with("orientation_rad", self.orientation_rad)
            .with("largest_s", Some(self.largest_s))
            .with("torque_ramp_s", (self.largest_s < ramp_s).then_some(ramp_s))
            .with("settle_s", (self.largest_s < settle_s).then_some(settle_s));
        let [least_m, least_rad] = [MIN_POSITION_M, MIN_ORIENTATION_RAD];
        let least = |unit: &str| if unit == "m" { least_m } else { least_rad };
        let units = experiment.robot().model.joint_units();
        let deviations = names.iter().zip(&units.position).zip(&self.deviations);
        let deviations = deviations.filter(|((_, unit), error)| **error > least(unit));
        let deviations = deviations.map(|((name, _), error)| ((*name).to_owned(), *error)).collect();
        Some(reference_limited(Finding { causes, deviations, ..reference }))
    }
}
