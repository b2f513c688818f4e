//! Intervals in which tasks rest away from their references, over a whole log.

use super::hold_counts::HoldCounts;
use super::holds::{Cycle, HeldState, Hold, MAX_SPEED, NO_ERRORS, RowErrors, clipped, norm_in};
use super::near_pairs::pair_names;
use super::run_log::Run;
use crate::codes::Code;
use crate::evaluate::findings::goal_not_reached;
use crate::files::controller_kind::ControllerKind;
use crate::finding::{Causes, Finding, Place};
use crate::run::experiment::Experiment;
use opspace_backend::signal_names::{
    self, COMMAND, DQ, ERROR, LIMITED, MODES, PHASE, Q, STANDSTILL, TASK_SET, TORQUE_DESIRED,
    TORQUE_SATURATED,
};
use opspace_control::{AxisMode, JointTask, Task, TaskSet};
use opspace_loop::Phase;
use std::cmp::Ordering;
use std::collections::BTreeMap;

/// Time between two examined control cycles, s.
const STEP_S: f64 = 5e-3;

/// Smallest error that counts, m and rad.
const MIN_POSITION_M: f64 = 1e-3;
const MIN_ORIENTATION_RAD: f64 = 5e-3;

/// Smallest error that counts with inverse kinematics, m and rad: servos sag by less under gravity.
const MIN_CLIPPED_M: f64 = 5e-3;
const MIN_CLIPPED_RAD: f64 = 20e-3;

/// Shortest interval that is reported, s.
const MIN_DURATION_S: f64 = 0.5;

/// Longest interruption of an interval, s.
const MAX_GAP_S: f64 = 0.1;

/// Goals that the tasks of a run did not reach, while segments of the log arrive.
pub(super) struct UnreachedGoals<'a> {
    experiment: &'a Experiment,
    state: HeldState<'a>,
    /// Task sets of the run: that at the start, and those after each event. They are built when the first task has an
    /// error.
    sets: Option<Vec<Option<TaskSet>>>,
    /// Time before which no cycle is examined, s.
    next_s: f64,
    last_s: f64,
    start_s: f64,
    open: BTreeMap<String, Episode>,
    found: Vec<Finding>,
}

/// Interval in which a task is held.
#[derive(Default)]
struct Episode {
    begin_s: f64,
    last_s: f64,
    position_m: Option<f64>,
    orientation_rad: Option<f64>,
    counts: HoldCounts,
    overridden_by: BTreeMap<String, usize>,
}

/// Task that is held in a cycle, with its errors.
struct Held<'a> {
    name: &'a str,
    position_m: Option<f64>,
    orientation_rad: Option<f64>,
    hold: Hold,
}

impl<'a> UnreachedGoals<'a> {
    pub(super) fn new(experiment: &'a Experiment) -> Self {
        Self {
            experiment,
            state: HeldState::new(experiment),
            sets: None,
            next_s: f64::NEG_INFINITY,
            last_s: 0.0,
            start_s: 0.0,
            open: BTreeMap::new(),
            found: Vec::new(),
        }
    }

    /// Adds a segment.
    pub(super) fn add(&mut self, run: &Run<'_>) {
        let Some(phase) = run.tick.signal(PHASE) else { return };
        self.start_s = run.start_s;
        for k in 0..run.tick.len() {
            let time_s = run.tick.time_s[k];
            if phase.row(k)[0] != Phase::Control.code() || time_s < self.next_s - run.same_s {
                continue;
            }
            self.next_s = time_s + STEP_S;
            self.last_s = time_s;
            match self.experiment.options().controller {
                ControllerKind::Osc => self.examine(run, k, time_s),
                ControllerKind::Ik | ControllerKind::IkLead => self.examine_clip(run, k, time_s),
            }
            self.continue_at_standstill(run, k, time_s);
            self.close_before(time_s - MAX_GAP_S);
        }
    }

    /// Returns the intervals in order of their begin.
    pub(super) fn finish(mut self) -> Vec<Finding> {
        let end_s = self.last_s - MAX_GAP_S;
        let open = std::mem::take(&mut self.open);
        for (name, episode) in open {
            let lasts = episode.last_s >= end_s;
            self.found.extend(episode.finish(name, self.start_s, lasts, self.experiment));
        }
        self.found
            .sort_by(|a, b| a.number("begin_s").partial_cmp(&b.number("begin_s")).unwrap_or(Ordering::Equal));
        self.found
    }

    /// Continues the intervals of tasks at a standstill: they no longer demand what the cause does not allow.
    fn continue_at_standstill(&mut self, run: &Run<'_>, k: usize, time_s: f64) {
        for (name, episode) in &mut self.open {
            let share = run.tick.signal(&signal_names::of(name, STANDSTILL));
            if share.is_some_and(|share| share.row(k)[0] > 0.0) {
                episode.last_s = time_s;
            }
        }
    }

    /// Closes the intervals whose last cycle was before `time_s`.
    fn close_before(&mut self, time_s: f64) {
        while let Some(name) =
            self.open.iter().find(|(_, episode)| episode.last_s < time_s).map(|(name, _)| name.clone())
        {
            let Some(episode) = self.open.remove(&name) else { return };
            self.found.extend(episode.finish(name, self.start_s, false, self.experiment));
        }
    }

    fn examine(&mut self, run: &Run<'_>, k: usize, time_s: f64) {
        let sets = self.sets.get_or_insert_with(|| task_sets(self.experiment));
        let number = task_set_at(run, k);
        let Some(Some(set)) = sets.get(number) else { return };
        let errors: Vec<RowErrors> = set.tasks().map(|task| errors(run, k, task)).collect();
        let is_large = |(task, errors): (&dyn Task, &RowErrors)| {
            let exceeds = |unit: &str, least: f64| norm_in(unit, task, errors).is_some_and(|e| e > least);
            exceeds("m", MIN_POSITION_M) || exceeds("rad", MIN_ORIENTATION_RAD)
        };
        let large: Vec<bool> = set.tasks().zip(&errors).map(is_large).collect();
        let joint_errors = set.joint_task().and_then(|task| joint_errors(run, k, task));
        if !large.contains(&true) && joint_errors.is_none() {
            return;
        }
        if !update_state(&mut self.state, run, k) {
            return;
        }
        let set = self.sets.as_ref().and_then(|sets| sets.get(number)?.as_ref());
        let Some(set) = set else { return };
        let names: Vec<&str> = set.tasks().map(Task::name).collect();
        let mut held = Vec::new();
        for (place, (task, hold)) in set.tasks().zip(self.state.of_tasks(set, &errors)).enumerate() {
            let Some(hold) = hold.filter(|_| large[place]) else { continue };
            let [position_m, orientation_rad] = ["m", "rad"].map(|unit| norm_in(unit, task, &errors[place]));
            held.push(Held { name: task.name(), position_m, orientation_rad, hold });
        }
        if let (Some(task), Some(errors)) = (set.joint_task(), joint_errors) {
            held.extend(self.held_joints(run, k, task, &errors, names.len()));
        }
        for held in held {
            let new = Episode { begin_s: time_s, ..Episode::default() };
            self.open.entry(held.name.to_owned()).or_insert(new).add(&held, time_s, &names);
        }
    }

    /// Examines a cycle of inverse kinematics, which clips joints: tasks of an arm at rest are held by these joints.
    fn examine_clip(&mut self, run: &Run<'_>, k: usize, time_s: f64) {
        let sets = self.sets.get_or_insert_with(|| task_sets(self.experiment));
        let Some(Some(set)) = sets.get(task_set_at(run, k)) else { return };
        let row = |name: &str| Some(run.tick.signal(name)?.row(k));
        let (Some(q), Some(dq), Some(limited)) = (row(Q), row(DQ), row(LIMITED)) else { return };
        let hold = clipped(self.experiment, q, limited);
        if !hold.is_at_limits() || dq.iter().any(|dq| dq.abs() > MAX_SPEED) {
            return;
        }
        let mut held = Vec::new();
        for task in set.tasks() {
            let errors = errors(run, k, task);
            let [position_m, orientation_rad] = ["m", "rad"].map(|unit| norm_in(unit, task, &errors));
            held.push(Held { name: task.name(), position_m, orientation_rad, hold: hold.clone() });
        }
        if let Some(task) = set.joint_task()
            && let Some(errors) = joint_errors(run, k, task)
        {
            let units = self.experiment.robot().model.joint_units();
            let [position_m, orientation_rad] = ["m", "rad"].map(|unit| {
                let of_unit = errors.iter().zip(&units.position).filter(|(_, own)| **own == unit);
                of_unit.map(|(error, _)| error.abs()).reduce(f64::max)
            });
            held.push(Held { name: task.name(), position_m, orientation_rad, hold });
        }
        for held in held {
            let is_large = held.position_m.is_some_and(|error| error > MIN_CLIPPED_M)
                || held.orientation_rad.is_some_and(|error| error > MIN_CLIPPED_RAD);
            if is_large {
                let new = Episode { begin_s: time_s, ..Episode::default() };
                self.open.entry(held.name.to_owned()).or_insert(new).add(&held, time_s, &[]);
            }
        }
    }

    /// Joints of a task of all joints that are held, together.
    fn held_joints<'b>(
        &self,
        run: &Run<'_>,
        k: usize,
        task: &'b dyn JointTask,
        errors: &[f64],
        above: usize,
    ) -> Option<Held<'b>> {
        let dq = run.tick.signal(DQ)?.row(k);
        let gains = |joint: usize| task.gains(joint, self.state.inertia(joint));
        let wanted: Vec<f64> = (errors.iter().enumerate())
            .map(|(joint, error)| gains(joint).map_or(0.0, |gains| gains.stiffness_per_s2 * error))
            .collect();
        let damping: Vec<f64> = (dq.iter().enumerate())
            .map(|(joint, dq)| gains(joint).map_or(0.0, |gains| gains.damping_per_s * dq))
            .collect();
        let mut all =
            Held { name: task.name(), position_m: None, orientation_rad: None, hold: Hold::default() };
        let mut is_held = false;
        let units = self.experiment.robot().model.joint_units();
        for (joint, hold) in self.state.of_joints(&wanted, &damping, above).into_iter().enumerate() {
            let Some(hold) = hold else { continue };
            is_held = true;
            let error = errors[joint].abs();
            let largest =
                if units.position[joint] == "m" { &mut all.position_m } else { &mut all.orientation_rad };
            *largest = Some(largest.map_or(error, |before| before.max(error)));
            all.hold.merge(hold);
        }
        is_held.then_some(all)
    }
}

/// Index of the task set of a cycle.
pub(super) fn task_set_at(run: &Run<'_>, k: usize) -> usize {
    match run.tick.signal(TASK_SET) {
        Some(number) => number.row(k)[0] as usize,
        None => {
            let since_start_s = run.tick.time_s[k] - run.start_s + run.same_s;
            run.experiment.task().events.iter().filter(|event| event.time_s <= since_start_s).count()
        }
    }
}

/// Updates the state of the arm to that of a cycle; returns false if the log lacks a signal.
pub(super) fn update_state(state: &mut HeldState<'_>, run: &Run<'_>, k: usize) -> bool {
    let row = |name: &str| Some(run.tick.signal(name)?.row(k));
    let (Some(q), Some(dq), Some(command)) = (row(Q), row(DQ), row(COMMAND)) else { return false };
    let is = |name: &str, joint: usize, bit: u8| {
        row(name).is_some_and(|values| values[joint].is_finite() && values[joint] as u8 & bit != 0)
    };
    let joints = 0..q.len();
    let saturated: Vec<bool> = joints.clone().map(|joint| is(TORQUE_SATURATED, joint, 1)).collect();
    // A saturated torque of a joint at rest contains no friction compensation.
    let clamped = row(TORQUE_DESIRED).unwrap_or(command);
    let torque: Vec<f64> =
        joints.clone().map(|joint| if saturated[joint] { clamped[joint] } else { command[joint] }).collect();
    let at_torque: Vec<bool> =
        joints.clone().map(|joint| saturated[joint] || is(LIMITED, joint, 2)).collect();
    let at_acceleration: Vec<bool> = joints.map(|joint| is(LIMITED, joint, 1)).collect();
    state.update(&Cycle { q, dq, torque: &torque, at_torque: &at_torque, at_acceleration: &at_acceleration })
}

/// Task sets of an experiment, in order of time.
pub(super) fn task_sets(experiment: &Experiment) -> Vec<Option<TaskSet>> {
    let file = &experiment.task().file;
    let events = experiment.task().events.iter().map(|event| (&event.priority, &event.task));
    let sets = std::iter::once((&file.priority, &file.task)).chain(events);
    let mut found: Vec<Option<TaskSet>> = Vec::new();
    for (priority, tasks) in sets {
        let before = found.last().and_then(Option::as_ref);
        let set = experiment.task_set(priority, tasks, before);
        found.push(set);
    }
    found
}

/// Errors of the rows of a task that follow a reference.
pub(super) fn errors(run: &Run<'_>, k: usize, task: &dyn Task) -> RowErrors {
    let mut errors = NO_ERRORS;
    let signal = |name: &str| run.tick.signal(&signal_names::of(task.name(), name));
    let Some(error) = signal(ERROR) else { return errors };
    let modes = signal(MODES);
    for (row, name) in task.row_names().iter().enumerate().take(errors.len()) {
        let Some(place) = error.elements().iter().position(|element| element == name) else { continue };
        let follows = match modes {
            Some(modes) => modes.row(k)[place] == AxisMode::Motion.code(),
            None => task.follows_reference(row),
        };
        errors[row] = Some(error.row(k)[place]).filter(|error| follows && error.is_finite());
    }
    errors
}

/// Errors of a task of all joints, zero for small ones; `None` if all are small.
pub(super) fn joint_errors(run: &Run<'_>, k: usize, task: &dyn JointTask) -> Option<Vec<f64>> {
    let error = run.tick.signal(&signal_names::of(task.name(), ERROR))?;
    let least = |unit: &String| if unit == "m" { MIN_POSITION_M } else { MIN_ORIENTATION_RAD };
    let large = error.row(k).iter().zip(error.units());
    let large: Vec<f64> =
        large.map(|(&error, unit)| if error.abs() > least(unit) { error } else { 0.0 }).collect();
    large.iter().any(|error| *error != 0.0).then_some(large)
}

impl Episode {
    fn add(&mut self, held: &Held<'_>, time_s: f64, names: &[&str]) {
        self.last_s = time_s;
        let grows = widen(&mut self.position_m, held.position_m)
            | widen(&mut self.orientation_rad, held.orientation_rad);
        self.counts.add(&held.hold, grows);
        for &place in &held.hold.overridden_by {
            *self.overridden_by.entry(names[place].to_owned()).or_default() += 1;
        }
    }

    /// Returns the interval, if it is long enough and its cause is known; `lasts` is true if it lasts until the end of the
    /// run.
    fn finish(self, task: String, start_s: f64, lasts: bool, experiment: &Experiment) -> Option<Finding> {
        let joints = experiment.robot().model.joints();
        let names: Vec<&str> = joints.iter().map(|joint| joint.name.as_str()).collect();
        let [position_limits, speed_limits, torque_limits] = self.counts.limits(&names);
        let overridden = self.overridden_by.iter().filter(|(_, count)| self.counts.is_often(**count));
        let causes = Causes {
            position_limits,
            speed_limits,
            torque_limits,
            kept_distances: pair_names(experiment, &self.counts.pairs()),
            singular_along: self.counts.singular_along(),
            overridden_by: overridden.map(|(name, _)| name.clone()).collect(),
            friction: Vec::new(),
        };
        if self.last_s - self.begin_s < MIN_DURATION_S || causes.is_empty() {
            return None;
        }
        let goal = Finding::of(Code::GoalNotReached, Place::Task(task), String::new())
            .with("begin_s", Some(self.begin_s - start_s))
            .with("end_s", (!lasts).then_some(self.last_s - start_s))
            .with("position_m", self.position_m)
            .with("orientation_rad", self.orientation_rad);
        Some(goal_not_reached(Finding { causes, ..goal }))
    }
}

/// Replaces a value by a larger one; returns true if it did.
fn widen(largest: &mut Option<f64>, value: Option<f64>) -> bool {
    let grows = value.is_some_and(|value| largest.is_none_or(|largest| value > largest));
    if grows {
        *largest = value;
    }
    grows
}
