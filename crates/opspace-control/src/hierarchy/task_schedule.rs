//! The active task set and the scheduled ones: gains, goals, axis modes and tasks can change during a run.

use crate::context::ControlContext;
use crate::controller::ControlInput;
use crate::error::{ControlError, Reason};
use crate::hierarchy::contact_condition::{AwaitedContact, ContactCondition};
use crate::hierarchy::priority_level::{Group, PriorityLevel};
use crate::hierarchy::task_hierarchy::TaskHierarchy;
use crate::hierarchy::task_parameters::TaskSetParameters;
use crate::hierarchy::task_set::TaskSet;
use crate::targets::{AllowedInputs, Targets};
use crate::tasks::joint_task::JointTask;
use crate::tasks::task::TaskSignals;
use opspace_backend::signal_names::TASK_SET;
use opspace_backend::{Observable, Signal, SignalRecorder};
use opspace_model::Model;

/// Tolerance of switching times, s: a task set is activated up to this time early, because clocks that sum up periods
/// have rounding errors.
const EARLY_S: f64 = 5e-10;

/// All task sets of a controller, identified by numbers, and the active one.
pub(crate) struct TaskSchedule {
    /// Never empty; the first one is active at the start.
    sets: Vec<TaskSet>,
    in_force: usize,
    /// Scheduled sets, in descending order of time.
    scheduled: Vec<Scheduled>,
    /// True if a contact can activate a set.
    awaits_contact: bool,
    /// Number of the set that the schedule selects.
    due: usize,
    /// Number of the set that the targets request.
    requested: Option<usize>,
    recorded: RecordedSignals,
    /// Fixed once the controller has started.
    slots: Vec<Slot>,
    /// All values "as configured". The layout is fixed once the controller has started.
    targets: Targets,
    /// True if sets can be chosen by number even if no task has inputs.
    numbered: bool,
    started: bool,
}

/// A scheduled set.
struct Scheduled {
    /// Latest time, s after the start.
    at_s: f64,
    /// Contact that activates it earlier.
    contact: Option<AwaitedContact>,
    number: usize,
}

/// A group of a task's signals in the log, independent of the active task set.
#[derive(Clone, Debug)]
struct Slot {
    name: String,
    kind: &'static str,
    of_all_joints: bool,
    group: Group,
    signals: Vec<Signal>,
}

/// Kind of any task of all joints: what limits take from it has one signal.
const ALL_JOINTS: &str = "a task of all joints";

/// Signals of the tasks that a controller records in the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RecordedSignals {
    /// References, motion and sensed forces.
    Motion,
    /// References, motion, sensed forces and task forces.
    Forces,
}

impl TaskSchedule {
    pub(crate) fn new(current: TaskSet, recorded: RecordedSignals) -> Self {
        let mut new = Self {
            sets: vec![current],
            in_force: 0,
            scheduled: Vec::new(),
            awaits_contact: false,
            due: 0,
            requested: None,
            recorded,
            slots: Vec::new(),
            targets: Targets::none(),
            numbered: false,
            started: false,
        };
        new.lay_out();
        new
    }

    /// Adds the recorded signals of the last set, and determines the layout of the streamed inputs.
    fn lay_out(&mut self) {
        if !self.started {
            if let Some(last) = self.sets.last() {
                add_slots(&mut self.slots, self.recorded, &last.0);
            }
            self.targets = targets(&self.sets, self.numbered);
        }
        self.sets.iter_mut().for_each(|set| set.0.bind(&self.targets));
    }

    /// Builds and checks another task set for a later switch.
    pub(crate) fn prepare(
        &self,
        model: &Model,
        parameters: &TaskSetParameters<'_>,
        context: &ControlContext,
    ) -> Result<TaskSet, ControlError> {
        // The rows of tasks that have started may be others than at the time of their typical mobility.
        let before = self.sets.last().filter(|_| !self.started);
        let prepared = TaskSet::from_parameters(model, parameters, context, before)?;
        self.check(&prepared)?;
        Ok(prepared)
    }

    /// Checks that tasks keep their kind and their signals in another task set.
    pub(crate) fn check(&self, other: &TaskSet) -> Result<(), ControlError> {
        let mut slots = Vec::new();
        add_slots(&mut slots, self.recorded, &other.0);
        for new in slots {
            let changed = |old: &&Slot| {
                let is_other = old.group != new.group || old.of_all_joints != new.of_all_joints;
                let same_signals = is_other || old.signals == new.signals;
                let same_kind = if [old.kind, new.kind].contains(&ALL_JOINTS) {
                    old.of_all_joints == new.of_all_joints
                } else {
                    old.kind == new.kind
                };
                old.name == new.name && !(same_kind && same_signals)
            };
            if let Some(old) = self.slots.iter().find(changed) {
                let reason = Reason::KindChanged { name: old.name.clone(), was: old.kind, is: new.kind };
                return Err(ControlError::new(format!("task.{}", old.name), reason));
            }
        }
        for (name, new, _) in other.0.inputs() {
            let mut known = self.sets.iter().flat_map(|set| set.0.inputs());
            if known.any(|(known, old, _)| known == name && old != new) {
                let reason = Reason::InputsChanged { name: name.to_owned() };
                return Err(ControlError::new(format!("task.{name}"), reason));
            }
        }
        Ok(())
    }

    /// Starts the active task set at the robot's present state.
    pub(crate) fn start(&mut self, input: &ControlInput<'_>) {
        self.started = true;
        self.current_mut().start(input);
    }

    pub(crate) fn current_mut(&mut self) -> &mut TaskHierarchy {
        &mut self.sets[self.in_force].0
    }

    /// The active task set.
    pub(crate) fn current(&self) -> &TaskSet {
        &self.sets[self.in_force]
    }

    /// Number of the active task set.
    pub(crate) fn number(&self) -> usize {
        self.in_force
    }

    /// Streamed targets, with all values "as configured".
    pub(crate) fn targets(&self) -> &Targets {
        &self.targets
    }

    /// Adds a set and returns its number.
    pub(crate) fn add(&mut self, tasks: TaskSet) -> Result<u32, ControlError> {
        self.check(&tasks)?;
        self.numbered = true;
        let number = self.push(tasks);
        Ok(u32::try_from(number).unwrap_or(u32::MAX))
    }

    fn push(&mut self, tasks: TaskSet) -> usize {
        self.sets.push(tasks);
        self.lay_out();
        self.sets.len() - 1
    }

    /// Schedules a set for `time_s`, or for a contact before this time and after the sets that are scheduled before it.
    pub(crate) fn schedule(&mut self, time_s: f64, contact: Option<ContactCondition>, tasks: TaskSet) {
        let number = self.push(tasks);
        self.awaits_contact |= contact.is_some();
        let contact = contact.map(AwaitedContact::new);
        let place = self.scheduled.partition_point(|other| other.at_s > time_s);
        self.scheduled.insert(place, Scheduled { at_s: time_s, contact, number });
    }

    /// Replaces the active task set by `tasks` and returns the replaced set.
    pub(crate) fn switch(&mut self, mut tasks: TaskSet, input: &ControlInput<'_>) -> TaskSet {
        tasks.0.bind(&self.targets);
        let current = &mut self.sets[self.in_force];
        tasks.0.inherit(&mut current.0, input);
        std::mem::swap(current, &mut tasks);
        tasks
    }

    /// Activates the set of this number; does nothing if there is none.
    fn switch_to(&mut self, number: usize, input: &ControlInput<'_>) {
        // Fails if the set is already active or does not exist.
        if let Ok([next, before]) = self.sets.get_disjoint_mut([number, self.in_force]) {
            next.0.inherit(&mut before.0, input);
            self.in_force = number;
        }
    }

    /// Activates the set that the targets request, otherwise the one scheduled for now. A number without a set is
    /// ignored. Allocates nothing.
    pub(crate) fn advance(&mut self, input: &ControlInput<'_>) {
        match input.targets.task_set() {
            None => self.requested = None,
            Some(number) if number < self.sets.len() => self.requested = Some(number),
            Some(_) => {}
        }
        let time_s = input.measurement.time_s;
        while let Some(Scheduled { at_s, contact, number }) = self.scheduled.last_mut() {
            let active = &self.sets[self.in_force].0;
            let touches = contact.as_mut().is_some_and(|contact| contact.is_met(active, time_s));
            if !touches && *at_s > time_s + EARLY_S {
                break;
            }
            let number = *number;
            self.scheduled.pop();
            self.due = number;
            if self.requested.is_none() {
                self.switch_to(number, input);
            }
        }
        let number = self.requested.unwrap_or(self.due);
        if number != self.in_force {
            self.switch_to(number, input);
        }
    }
}

impl Observable for TaskSchedule {
    /// Records NaN for the signals of tasks that are not active.
    fn record(&self, out: &mut SignalRecorder<'_>) {
        for slot in &self.slots {
            let before = out.recorded();
            slot.record(&self.current().0, out);
            if out.recorded() == before {
                out.block(&slot.signals, &[]);
            }
        }
        if self.awaits_contact || !self.targets.row().is_empty() {
            out.scalar(TASK_SET, "1", self.in_force as f64);
        }
    }
}

impl Slot {
    /// Records the signals of the slot's task, if it is active and has them.
    fn record(&self, hierarchy: &TaskHierarchy, out: &mut SignalRecorder<'_>) {
        if self.of_all_joints {
            let joint = hierarchy.joint.as_ref().filter(|task| task.name() == self.name);
            return joint.into_iter().for_each(|task| self.record_joints(&**task, hierarchy, out));
        }
        let is_own = |level: &&PriorityLevel| level.name() == self.name && level.task.kind() == self.kind;
        if let Some(level) = hierarchy.levels.iter().find(is_own) {
            level.record(self.group, out);
        }
    }

    fn record_joints(&self, task: &dyn JointTask, hierarchy: &TaskHierarchy, out: &mut SignalRecorder<'_>) {
        let is_own = task.kind() == self.kind;
        match self.group {
            Group::Motion if is_own => task.record(TaskSignals::Motion, out),
            Group::Target if is_own => task.record(TaskSignals::Target, out),
            // The same signal for all kinds.
            Group::Slack if self.kind == ALL_JOINTS => hierarchy.record_joint_slack(task.name(), out),
            _ => {}
        }
    }
}

/// Adds the slots of the tasks of a hierarchy, without duplicates.
fn add_slots(slots: &mut Vec<Slot>, recorded: RecordedSignals, hierarchy: &TaskHierarchy) {
    let mut add = |name: &str, kind: &'static str, of_all_joints, group: Group| {
        let is_same = |slot: &Slot| {
            slot.of_all_joints == of_all_joints
                && slot.name == name
                && slot.kind == kind
                && slot.group == group
        };
        if slots.iter().any(is_same) {
            return;
        }
        let mut slot = Slot { name: name.to_owned(), kind, of_all_joints, group, signals: Vec::new() };
        slot.signals = SignalRecorder::describe(|out| slot.record(hierarchy, out));
        if !slot.signals.is_empty() {
            slots.push(slot);
        }
    };
    for level in &hierarchy.levels {
        let groups: &[Group] = match recorded {
            RecordedSignals::Motion => &[Group::Motion, Group::Sensed, Group::Target],
            RecordedSignals::Forces => &[
                Group::Motion,
                Group::Force,
                Group::Slack,
                Group::Escape,
                Group::Gains,
                Group::Sensed,
                Group::Target,
            ],
        };
        groups.iter().for_each(|&group| add(level.name(), level.task.kind(), false, group));
    }
    if let Some(task) = &hierarchy.joint {
        let groups: &[Group] = match recorded {
            RecordedSignals::Motion => &[Group::Motion, Group::Target],
            RecordedSignals::Forces => &[Group::Motion, Group::Slack, Group::Target],
        };
        for &group in groups {
            let kind = if group == Group::Slack { ALL_JOINTS } else { task.kind() };
            add(task.name(), kind, true, group);
        }
    }
}

/// Targets of all tasks, without duplicates; all values "as configured".
fn targets(sets: &[TaskSet], numbered: bool) -> Targets {
    let mut tasks: Vec<(&str, Vec<Signal>, AllowedInputs)> = Vec::new();
    for (name, inputs, allowed) in sets.iter().flat_map(|set| set.0.inputs()) {
        match tasks.iter_mut().find(|(known, ..)| *known == name) {
            Some((_, _, known)) => *known = known.union(allowed),
            None => tasks.push((name, inputs, allowed)),
        }
    }
    let inputs = tasks.iter().map(|(name, inputs, _)| (*name, inputs.clone()));
    let mut targets = if numbered { Targets::with_task_sets(inputs) } else { Targets::new(inputs) };
    for (name, _, allowed) in &tasks {
        targets.allow(name, *allowed);
    }
    targets
}
