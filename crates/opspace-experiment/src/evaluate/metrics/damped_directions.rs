//! Directions in which tasks were damped near singular poses, over a whole log.

use super::holds::HeldState;
use super::run_log::Run;
use super::unreached_goals::{task_set_at, task_sets, update_state};
use crate::codes::Code;
use crate::finding::{Finding, Place};
use crate::run::experiment::Experiment;
use opspace_backend::signal_names::{self, MIN_SINGULAR_GAIN};
use opspace_control::TaskSet;
use std::collections::BTreeMap;

/// Time between two examined control cycles, s.
const STEP_S: f64 = 5e-3;

/// Part of the force that is left along a direction which counts as damped.
const DAMPED: f64 = 0.5;

/// Damped directions of a run, while segments of its log arrive.
pub(super) struct DampedDirections<'a> {
    experiment: &'a Experiment,
    state: HeldState<'a>,
    /// Task sets of the run, in order of time. They are built when control begins.
    sets: Option<Vec<Option<TaskSet>>>,
    /// Time before which no cycle is examined, s.
    next_s: f64,
    /// Number of examined cycles.
    cycles: u64,
    found: BTreeMap<String, Damped>,
}

/// Damping of a task.
struct Damped {
    cycles: u64,
    begin_s: f64,
    /// Least part of the force that was left, and its direction.
    least: f64,
    direction: Option<String>,
}

impl<'a> DampedDirections<'a> {
    pub(super) fn new(experiment: &'a Experiment) -> Self {
        let (state, found) = (HeldState::new(experiment), BTreeMap::new());
        Self { experiment, state, sets: None, next_s: f64::NEG_INFINITY, cycles: 0, found }
    }

    /// Adds a segment.
    pub(super) fn add(&mut self, run: &Run<'_>) {
        let tasks = self.experiment.task().tasks_of_the_run().into_iter();
        let signal = |name: &str| run.tick.signal(&signal_names::of(name, MIN_SINGULAR_GAIN));
        let gains: Vec<_> = tasks.filter_map(|(name, _)| Some((name, signal(name)?))).collect();
        for k in run.counted_ticks() {
            let time_s = run.tick.time_s[k];
            if time_s < self.next_s - run.same_s {
                continue;
            }
            self.next_s = time_s + STEP_S;
            self.cycles += 1;
            for (name, gain) in &gains {
                // A task without a priority has none.
                let gain = gain.row(k)[0];
                if gain < DAMPED {
                    self.add_cycle(run, k, name, gain);
                }
            }
        }
    }

    fn add_cycle(&mut self, run: &Run<'_>, k: usize, name: &str, gain: f64) {
        let first = Damped {
            cycles: 0,
            begin_s: run.tick.time_s[k] - run.start_s,
            least: f64::INFINITY,
            direction: None,
        };
        let damped = self.found.entry(name.to_owned()).or_insert(first);
        damped.cycles += 1;
        if gain >= damped.least {
            return;
        }
        damped.least = gain;
        let sets = self.sets.get_or_insert_with(|| task_sets(self.experiment));
        let Some(Some(set)) = sets.get(task_set_at(run, k)) else { return };
        let Some(place) = set.tasks().position(|task| task.name() == name) else { return };
        if update_state(&mut self.state, run, k) {
            damped.direction = self.state.weakest_direction(set, place);
        }
    }

    /// Returns the damped tasks by name.
    pub(super) fn finish(self) -> Vec<Finding> {
        let cycles = self.cycles.max(1) as f64;
        let finding = |(task, damped): (String, Damped)| {
            let share = damped.cycles as f64 / cycles;
            let along = damped.direction.map_or_else(String::new, |direction| format!(" along {direction}"));
            let message = format!(
                "task '{task}': damped near a singular pose, from {:.2} s on in {:.0} % of the time; at worst it retained {:.0} % of \
                 its force{along}",
                damped.begin_s,
                100.0 * share,
                100.0 * damped.least
            );
            Finding::of(Code::DampedDirection, Place::Task(task), message)
                .with("begin_s", Some(damped.begin_s))
                .with("share", Some(share))
                .with("retained", Some(damped.least))
        };
        self.found.into_iter().map(finding).collect()
    }
}
