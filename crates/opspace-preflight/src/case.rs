//! Experiment in its start posture, with its successive task sets.

use super::motion::{Motion, motions};
use opspace_control::{TaskParameters, TaskSet};
use opspace_experiment::run::experiment::Experiment;
use opspace_experiment::run::rollout::RolloutCase;
use opspace_model::{Data, Model, update};
use std::collections::BTreeMap;

/// Experiment in its start posture.
pub(super) struct PreflightCase<'a> {
    pub(super) experiment: &'a Experiment,
    pub(super) model: &'a Model,
    /// Joint positions at the start, rad or m (n).
    pub(super) start: Vec<f64>,
    /// Kinematics and dynamics at the start, at rest.
    pub(super) data: Data,
    /// Task sets of the run, in order of time.
    pub(super) task_sets: Vec<ActiveTasks<'a>>,
}

/// Task set that is active from one event to the next.
pub(super) struct ActiveTasks<'a> {
    pub(super) from_s: f64,
    pub(super) priority: &'a [String],
    pub(super) task: &'a BTreeMap<String, TaskParameters>,
    /// Tasks of the set, before their start.
    pub(super) tasks: TaskSet,
    /// Tasks that control a frame or the centre of mass, in the order of priority.
    pub(super) motions: Vec<Motion<'a>>,
}

impl<'a> PreflightCase<'a> {
    pub(super) fn new(experiment: &'a Experiment) -> Option<Self> {
        let (model, task) = (&experiment.robot().model, experiment.task());
        let start = experiment.start().ok()?;
        let mut data = Data::new(model);
        if !update(model, &mut data, &start, &vec![0.0; model.n()]) {
            return None;
        }
        let first = (0.0, task.file.priority.as_slice(), &task.file.task);
        let later = task.events.iter().map(|event| (event.time_s, event.priority.as_slice(), &event.task));
        let in_time = later.filter(|(from_s, ..)| *from_s < experiment.duration_s());
        let mut task_sets: Vec<ActiveTasks<'_>> = Vec::new();
        for (from_s, priority, task) in std::iter::once(first).chain(in_time) {
            let tasks = experiment.task_set(priority, task, task_sets.last().map(|set| &set.tasks))?;
            task_sets.push(ActiveTasks {
                from_s,
                priority,
                task,
                tasks,
                motions: motions(priority, task, model),
            });
        }
        Some(Self { experiment, model, start, data, task_sets })
    }

    /// Run whose references are rolled out.
    pub(super) fn rollout(&self) -> RolloutCase<'_> {
        self.experiment.rollout_case(&self.start)
    }

    /// Key of a value of a task in task set `stack`: in the task itself, or in the last event up to this set that
    /// changed the task.
    pub(super) fn key(&self, stack: usize, name: &str, rest: &[&str]) -> Vec<String> {
        let parameters = |set: usize| self.task_sets[set].task.get(name);
        let changed = (1..=stack)
            .rev()
            .find(|&k| parameters(k - 1).is_some_and(|before| parameters(k) != Some(before)));
        match changed {
            Some(stack) => vec!["event".to_owned(), (stack - 1).to_string(), "set".to_owned()],
            None => ["task", name].iter().chain(rest).map(|&part| part.to_owned()).collect(),
        }
    }

    /// Key of a task's reference.
    pub(super) fn reference_key(&self, stack: usize, name: &str) -> Vec<String> {
        let kind = self.task_sets[stack].task.get(name).map_or("", TaskParameters::kind);
        self.key(stack, name, &[kind, "reference"])
    }

    /// Start time of a task's reference in task set `stack`, s: the time of the earliest event since which the
    /// reference has not changed.
    pub(super) fn begin_s(&self, stack: usize, same: impl Fn(&ActiveTasks<'_>) -> bool) -> f64 {
        let first = (0..=stack).rev().take_while(|&k| same(&self.task_sets[k])).last();
        self.task_sets[first.unwrap_or(stack)].from_s
    }

    /// Allowed range of a joint (lower, upper), rad or m.
    pub(super) fn range(&self, joint: usize) -> (f64, f64) {
        let limits = &self.model.joints()[joint].limits;
        let margin = self.margin();
        (limits.lower + margin, limits.upper - margin)
    }

    /// Margin between the allowed range of a joint and its position limits, rad or m.
    pub(super) fn margin(&self) -> f64 {
        let limits = &self.experiment.task().file.limits;
        if limits.enforce { limits.position_margin_rad.get() } else { 0.0 }
    }

    pub(super) fn joint(&self, joint: usize) -> &str {
        &self.model.joints()[joint].name
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use opspace_experiment::run::rollout::Rollout;
    use opspace_experiment::{Files, RunOptions};
    use std::path::Path;

    /// Compared: poses by forward kinematics of the joint positions, and the reference, along a motion out and back.
    /// Joints that follow velocities without feedback would miss the reference by 1.4 mm.
    #[test]
    fn joints_follow_the_reference() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/ur5e-reach.toml");
        let experiment =
            Experiment::load(Files::Disk, &path, None, RunOptions::default(), &[]).expect("a task");
        let case = PreflightCase::new(&experiment).expect("a start");
        let followed = Rollout::new(&case.rollout());
        assert!(followed.instants.len() > 1000);
        let farthest = followed.instants.iter().map(|i| i.tasks[0].error.norm()).fold(0.0, f64::max);
        assert!(farthest < 3e-4, "{farthest} m");
        let ways = followed.instants.iter().map(|i| (i.q[0] - case.start[0]).abs()).fold(0.0, f64::max);
        assert!(ways > 0.1, "it goes somewhere: {ways} rad");
    }
}
