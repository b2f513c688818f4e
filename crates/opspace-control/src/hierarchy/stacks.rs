//! The stack of tasks that is carried out, and those that will be: gains, goals, axis modes and the stack itself can
//! change while a robot runs.

use crate::context::ControlContext;
use crate::controller::ControlInput;
use crate::error::{ControlError, Reason};
use crate::hierarchy::level::RowTask;
use crate::hierarchy::task::{Levels, Stack};
use opspace_backend::{Observable, Row, Signal};
use opspace_model::Model;

/// How early a tick may be for what is scheduled and still be in time: clocks add up periods, and round.
const EARLY_S: f64 = 5e-10;

/// A stack of tasks, built and checked for a robot: ready to be switched to.
#[derive(Clone, Debug)]
pub struct PreparedStack(Levels);

impl PreparedStack {
    /// For the robot that a controller was made for.
    pub(crate) fn new(
        model: &Model,
        stack: &Stack<'_>,
        robot: &ControlContext,
    ) -> Result<Self, ControlError> {
        Levels::new(model, stack, robot).map(Self)
    }

    /// Its tasks.
    pub(crate) fn levels(&self) -> &Levels {
        &self.0
    }
}

/// The stack in force and those to come.
#[derive(Clone, Debug)]
pub(crate) struct Stacks {
    current: Levels,
    /// The next one last.
    scheduled: Vec<(f64, PreparedStack)>,
    /// Kept so that nothing is freed while running.
    past: Vec<PreparedStack>,
    shows: Shows,
    /// Fixed from the start on.
    slots: Vec<Slot>,
    started: bool,
}

/// A task's place in the rows of a log, whichever stack is in force.
#[derive(Clone, Debug)]
struct Slot {
    name: String,
    kind: Kind,
    signals: Vec<Signal>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Motion,
    Force,
    Sensed,
    Joints,
    AllJoints,
}

impl Kind {
    /// Which kind of task has such signals.
    fn task(self) -> &'static str {
        match self {
            Self::Motion | Self::Force | Self::Sensed => "cartesian or center-of-mass",
            Self::Joints => "joint-tracking of some joints",
            Self::AllJoints => "joint-tracking of all joints",
        }
    }
}

/// What of the tasks a controller shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Shows {
    /// References and motion.
    Motion,
    /// Forces as well.
    Forces,
}

impl Stacks {
    pub(crate) fn new(
        model: &Model,
        stack: &Stack<'_>,
        robot: &ControlContext,
        shows: Shows,
    ) -> Result<Self, ControlError> {
        let current = Levels::new(model, stack, robot)?;
        let slots = slots(shows, [&current]);
        Ok(Self { current, scheduled: Vec::new(), past: Vec::new(), shows, slots, started: false })
    }

    /// Another stack, to be switched to.
    pub(crate) fn prepare(
        &self,
        model: &Model,
        stack: &Stack<'_>,
        robot: &ControlContext,
    ) -> Result<PreparedStack, ControlError> {
        let prepared = PreparedStack::new(model, stack, robot)?;
        for new in slots(self.shows, [prepared.levels()]) {
            let is_other = |old: &&Slot| old.name == new.name && old.kind.task() != new.kind.task();
            if let Some(old) = self.slots.iter().find(is_other) {
                let reason =
                    Reason::KindChanged { name: old.name.clone(), was: old.kind.task(), is: new.kind.task() };
                return Err(ControlError::new(format!("task.{}", old.name), reason));
            }
        }
        Ok(prepared)
    }

    /// Begins where the robot is.
    pub(crate) fn start(&mut self, input: &ControlInput<'_>) {
        self.started = true;
        self.current.start(input);
    }

    pub(crate) fn current(&mut self) -> &mut Levels {
        &mut self.current
    }

    /// The stack in force.
    pub(crate) fn in_force(&self) -> &Levels {
        &self.current
    }

    pub(crate) fn schedule(&mut self, time_s: f64, stack: PreparedStack) {
        let place = self.scheduled.partition_point(|(other, _)| *other > time_s);
        self.scheduled.insert(place, (time_s, stack));
        self.past.reserve(self.scheduled.len());
        if self.started {
            return;
        }
        let to_come = self.scheduled.iter().rev().map(|(_, stack)| stack.levels());
        self.slots = slots(self.shows, std::iter::once(&self.current).chain(to_come));
    }

    pub(crate) fn switch(&mut self, mut stack: PreparedStack, input: &ControlInput<'_>) -> PreparedStack {
        stack.0.take_over(&mut self.current, input);
        std::mem::swap(&mut self.current, &mut stack.0);
        stack
    }

    /// Switches to what is scheduled for now.
    pub(crate) fn advance(&mut self, input: &ControlInput<'_>) {
        while self.scheduled.last().is_some_and(|(time_s, _)| *time_s <= input.measurement.time_s + EARLY_S) {
            if let Some((_, stack)) = self.scheduled.pop() {
                let before = self.switch(stack, input);
                self.past.push(before);
            }
        }
    }
}

impl Observable for Stacks {
    fn signals(&self) -> Vec<Signal> {
        self.slots.iter().flat_map(|slot| slot.signals.iter().cloned()).collect()
    }

    fn sample(&self, row: &mut Row<'_>) {
        for slot in &self.slots {
            let level = self.current.rows.iter().find(|level| level.name() == slot.name);
            let joint = self.current.joint.as_ref().filter(|task| task.name() == slot.name);
            match (slot.kind, level.map(|level| (&level.task, level)), joint) {
                (Kind::Motion, Some((RowTask::Cartesian(task), _)), _) => task.sample_motion(row),
                (Kind::Force, Some((RowTask::Cartesian(_), level)), _) => level.sample_force(row),
                (Kind::Sensed, Some((RowTask::Cartesian(task), _)), _) => task.sample_sensed(row),
                (Kind::Joints, Some((RowTask::Joints(task), _)), _) => task.sample(row),
                (Kind::AllJoints, _, Some(task)) if task.is_sampled() => task.sample(row),
                _ => slot.signals.iter().for_each(|signal| row.skip(signal.len())),
            }
        }
    }
}

/// The places of all tasks of some stacks, each name once.
fn slots<'a>(shows: Shows, stacks: impl IntoIterator<Item = &'a Levels>) -> Vec<Slot> {
    let mut slots: Vec<Slot> = Vec::new();
    let mut add = |name: &str, kind: Kind, signals: Vec<Signal>| {
        let known = slots.iter().any(|slot| slot.name == name && slot.kind == kind);
        if !known && !signals.is_empty() {
            slots.push(Slot { name: name.to_owned(), kind, signals });
        }
    };
    for levels in stacks {
        for level in &levels.rows {
            match &level.task {
                RowTask::Joints(task) => add(level.name(), Kind::Joints, task.signals()),
                RowTask::Cartesian(task) => {
                    add(level.name(), Kind::Motion, task.motion_signals());
                    if shows == Shows::Forces {
                        add(level.name(), Kind::Force, level.force_signals());
                        add(level.name(), Kind::Sensed, task.sensed_signal().into_iter().collect());
                    }
                }
            }
        }
        if let Some(task) = &levels.joint {
            add(task.name(), Kind::AllJoints, task.signals());
        }
    }
    slots
}
