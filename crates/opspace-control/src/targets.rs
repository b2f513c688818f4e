//! Streamed targets of a controller, stored as one row of numbers.
//!
//! The layout is fixed when the controller is built. It has, for each task with inputs, a time stamp and the inputs;
//! and, for the whole controller, a hold request and the number of a task set. NaN means "as configured". Names are
//! resolved once, to handles; writing through a handle checks the values and allocates nothing.
//!
//! ```
//! use opspace_backend::Signal;
//! use opspace_control::Targets;
//!
//! let mut targets = Targets::new([("hand", vec![Signal::new("offset_m", "m", &["x", "y", "z"])])]);
//! let hand = targets.task("hand")?;
//! let offset = targets.input(&hand, "offset_m")?;
//! // The robot's clock says 2.5 s.
//! targets.write(&hand, 2.5, &[(&offset, &[0.1, 0.0, 0.0])])?;
//! assert_eq!(targets.stamp(&hand), Some(2.5));
//! assert_eq!(targets.values(&offset), Some(&[0.1, 0.0, 0.0][..]));
//! # Ok::<(), opspace_control::TargetError>(())
//! ```

use crate::axis_mode::AxisMode;
use opspace_backend::signal_names::TARGET_HOLD;
use opspace_backend::{Layout, Signal};
use std::ops::Range;
use thiserror::Error;

/// Name of the targets' channel.
const CHANNEL: &str = "targets";

/// Inputs of the whole controller: their names, and their positions in the row.
const HOLD: usize = 0;
const TASK_SET: usize = 1;
const GENERAL: [&str; 2] = [TARGET_HOLD, "target.task_set"];

/// A row of streamed targets.
#[derive(Clone, Debug, PartialEq)]
pub struct Targets {
    layout: Layout,
    row: Vec<f64>,
    tasks: Vec<TaskSlots>,
}

/// Positions of a task's inputs in the row.
#[derive(Clone, Debug, PartialEq)]
struct TaskSlots {
    name: String,
    stamp: usize,
    inputs: Vec<(String, Range<usize>)>,
    allowed: AllowedInputs,
}

/// Streamed values that a Cartesian task accepts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AllowedInputs {
    /// Modes that each axis accepts (in the order of [`AXIS_NAMES`](crate::AXIS_NAMES)): motion, compliant, force. All
    /// false for an axis that is not in the task.
    pub modes: [[bool; 3]; 6],
    /// True if frequency and damping ratio can be streamed, i.e. if the task is configured with `gains`.
    pub gains: bool,
}

impl AllowedInputs {
    /// Returns true if the axis of this index can take a mode.
    #[must_use]
    pub fn admits(&self, axis: usize, mode: AxisMode) -> bool {
        AxisMode::IN_TASK.into_iter().zip(self.modes[axis]).any(|(known, allowed)| allowed && known == mode)
    }

    /// Returns the values that at least one of the two accepts.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        let modes = std::array::from_fn(|axis| {
            std::array::from_fn(|mode| self.modes[axis][mode] || other.modes[axis][mode])
        });
        Self { modes, gains: self.gains || other.gains }
    }
}

/// Reason why a robot is asked to hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum HoldCause {
    /// A person or a program asked for it.
    Requested,
    /// The robot of this number, with which this one is coupled, is held or stopped.
    RobotHeld(usize),
    /// Nothing arrives any more from the robot of this number, with which this one is coupled.
    RobotSilent(usize),
}

impl HoldCause {
    /// Number of the cause in targets and logs: 1 requested, 2 + 2k robot k is held, 3 + 2k robot k is silent.
    #[must_use]
    pub fn code(self) -> f64 {
        match self {
            Self::Requested => 1.0,
            Self::RobotHeld(robot) => 2.0 + 2.0 * robot as f64,
            Self::RobotSilent(robot) => 3.0 + 2.0 * robot as f64,
        }
    }

    /// Returns the cause with this number; `None` for 0 and NaN, which ask for no hold.
    #[must_use]
    pub fn from_code(code: f64) -> Option<Self> {
        if !(code >= 1.0 && code.fract() == 0.0) {
            return None;
        }
        let number = code as usize;
        Some(match (number, number % 2) {
            (1, _) => Self::Requested,
            (_, 0) => Self::RobotHeld((number - 2) / 2),
            _ => Self::RobotSilent((number - 3) / 2),
        })
    }
}

/// Streamed inputs of one task in one cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaskTarget<'a> {
    /// Time stamp on the robot's clock, s; `None` before the first target.
    pub stamp_s: Option<f64>,
    /// Values of the task's inputs, in the order in which the task declares them; NaN for a value as configured. Empty
    /// if no task of this name has inputs.
    pub values: &'a [f64],
    /// Current time on the robot's clock, s.
    pub clock_s: f64,
}

impl TaskTarget<'_> {
    /// Returns a target without inputs at the time `clock_s` on the robot's clock, s.
    #[must_use]
    pub const fn none(clock_s: f64) -> Self {
        Self { stamp_s: None, values: &[], clock_s }
    }

    /// Time since the stamp, s; never negative.
    #[must_use]
    pub fn age_s(&self) -> Option<f64> {
        self.stamp_s.map(|stamp_s| (self.clock_s - stamp_s).max(0.0))
    }
}

/// Positions of a task's stamp and inputs in a row; no inputs by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct TargetPlace {
    stamp: usize,
    width: usize,
}

impl TargetPlace {
    /// Returns the task's inputs in `targets`; no inputs if the row has a different layout.
    pub(crate) fn of<'a>(&self, targets: &'a Targets, clock_s: f64) -> TaskTarget<'a> {
        if self.width == 0 {
            return TaskTarget::none(clock_s);
        }
        match targets.row.get(self.stamp..self.stamp + 1 + self.width) {
            Some([stamp_s, values @ ..]) => {
                TaskTarget { stamp_s: (!stamp_s.is_nan()).then_some(*stamp_s), values, clock_s }
            }
            _ => TaskTarget::none(clock_s),
        }
    }
}

/// Handle of a task that has inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TaskHandle(usize);

/// Handle of an input of a task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputHandle {
    task: usize,
    range: Range<usize>,
}

impl InputHandle {
    /// Returns the handle of an input that a task lacks: it has no values.
    pub(crate) fn absent(task: &TaskHandle) -> Self {
        Self { task: task.0, range: 0..0 }
    }

    /// Number of values.
    #[must_use]
    #[expect(clippy::len_without_is_empty, reason = "an input has values")]
    pub fn len(&self) -> usize {
        self.range.len()
    }
}

/// Error: an unknown name or an invalid target.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TargetError {
    /// A task without inputs, or an unknown task.
    #[error(
        "no task '{name}' with inputs; the tasks with inputs are: {}. A task has inputs if its reference is `streamed`; a \
         Cartesian task also with `tunable = true`, for its gains and modes",
        if known.is_empty() { "none".to_owned() } else { known.join(", ") }
    )]
    Task {
        /// Requested name.
        name: String,
        /// Tasks with inputs.
        known: Vec<String>,
    },
    /// An input that the task does not have.
    #[error("task '{task}' has no input '{name}'; its inputs are: {}", known.join(", "))]
    Input {
        /// The task.
        task: String,
        /// Requested name.
        name: String,
        /// Inputs of the task.
        known: Vec<String>,
    },
    /// A reference of the file, which a program cannot replace.
    #[error(
        "the reference of task '{task}' is that of its file, and not `streamed`: it has no input '{name}', only its gains, \
         modes and forces"
    )]
    NotStreamed {
        /// The task.
        task: String,
        /// The input.
        name: &'static str,
    },
    /// A number of values that differs from that of the input.
    #[error("this input has {expected} values, not {found}")]
    Length {
        /// Number of values of the input.
        expected: usize,
        /// Number of given values.
        found: usize,
    },
    /// A value that is infinite, or a time stamp that is not finite.
    #[error("a target must be finite, or NaN for the configured value; got {value}")]
    NotFinite {
        /// The value.
        value: f64,
    },
    /// An input of another task.
    #[error("all inputs of one write must belong to the same task")]
    OtherTask,
    /// A quaternion whose length is not 1.
    #[error(
        "an orientation must be a unit quaternion (w, x, y, z), of length 1 within {tolerance}; its length is {norm}"
    )]
    Quaternion {
        /// Length of the quaternion.
        norm: f64,
        /// Largest deviation from 1.
        tolerance: f64,
    },
    /// An axis that is not in the task, or the mode `free`.
    #[error("axis {axis} cannot be added to task '{task}' or removed from it; its axes are: {}", known.join(", "))]
    Axis {
        /// The task.
        task: String,
        /// The axis.
        axis: &'static str,
        /// Axes of the task.
        known: Vec<&'static str>,
    },
    /// A mode for which the axis is not configured.
    #[error("axis {axis} of task '{task}' cannot be {mode}; it can be: {}", known.join(", "))]
    Mode {
        /// The task.
        task: String,
        /// The axis.
        axis: &'static str,
        /// Requested mode.
        mode: &'static str,
        /// Modes that the axis can take.
        known: Vec<&'static str>,
    },
    /// Gains for a task that is configured with an impedance.
    #[error("task '{task}' has no `gains`: its frequency and damping ratio cannot be streamed")]
    NoGains {
        /// The task.
        task: String,
    },
    /// A gain that is out of its range.
    #[error("{input} of axis {axis} must be {range}, or NaN for the configured one; got {value}")]
    Gain {
        /// The input.
        input: &'static str,
        /// The axis.
        axis: &'static str,
        /// The range.
        range: &'static str,
        /// The value.
        value: f64,
    },
}

impl Targets {
    /// Returns a row of width 0, without inputs.
    #[must_use]
    pub fn none() -> Self {
        let layout = Layout { channel: CHANNEL.to_owned(), signals: Vec::new() };
        Self { layout, row: Vec::new(), tasks: Vec::new() }
    }

    /// Creates a row for these tasks, each with its inputs; all values are as configured. The width is 0 if no task has
    /// an input.
    #[must_use]
    pub fn new<'a>(tasks: impl IntoIterator<Item = (&'a str, Vec<Signal>)>) -> Self {
        Self::build(tasks, false)
    }

    /// Creates a row like [`new`](Self::new), but always with the inputs of the whole controller.
    #[must_use]
    pub fn with_task_sets<'a>(tasks: impl IntoIterator<Item = (&'a str, Vec<Signal>)>) -> Self {
        Self::build(tasks, true)
    }

    fn build<'a>(tasks: impl IntoIterator<Item = (&'a str, Vec<Signal>)>, always: bool) -> Self {
        let mut new = Self::none();
        let mut at = GENERAL.len();
        for (task, inputs) in tasks {
            if inputs.is_empty() {
                continue;
            }
            new.layout.signals.push(Signal::scalar(format!("target.{task}.time_s"), "s"));
            let mut slots = TaskSlots {
                name: task.to_owned(),
                stamp: at,
                inputs: Vec::new(),
                allowed: AllowedInputs::default(),
            };
            at += 1;
            for input in inputs {
                slots.inputs.push((input.name.clone(), at..at + input.len()));
                at += input.len();
                new.layout.signals.push(Signal { name: format!("target.{task}.{}", input.name), ..input });
            }
            new.tasks.push(slots);
        }
        if always || !new.tasks.is_empty() {
            let general = GENERAL.map(|name| Signal::scalar(name, "1"));
            new.layout.signals.splice(0..0, general);
            new.row = vec![f64::NAN; at];
        }
        new
    }

    /// Signals of the row, in its order.
    #[must_use]
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Values of the row.
    #[must_use]
    pub fn row(&self) -> &[f64] {
        &self.row
    }

    /// Replaces all values at once, for example by those of a log or of another thread. Allocates nothing.
    ///
    /// # Panics
    /// Panics if the number of values differs from the layout's width.
    pub fn set_row(&mut self, row: &[f64]) {
        assert_eq!(row.len(), self.row.len(), "one value for each element of the layout");
        self.row.copy_from_slice(row);
    }

    /// Number of tasks that have inputs.
    #[must_use]
    pub fn tasks(&self) -> usize {
        self.tasks.len()
    }

    /// Copies a row from another thread, whose time stamps are counters of writes. If a task's count differs from its
    /// entry in `seen`, its inputs are new: they are copied and stamped with `clock_s`, s on the robot's clock.
    /// Allocates nothing.
    pub fn merge(&mut self, row: &[f64], seen: &mut [f64], clock_s: f64) {
        let general = GENERAL.len().min(row.len());
        let of_robot = self.hold_cause().filter(|cause| *cause != HoldCause::Requested);
        self.row[..general].copy_from_slice(&row[..general]);
        if !self.is_held() {
            // Only the robot itself ends the hold that it caused.
            self.hold_because(of_robot);
        }
        for (task, seen) in self.tasks.iter().zip(seen) {
            let count = row[task.stamp];
            if count.to_bits() == seen.to_bits() {
                continue;
            }
            *seen = count;
            for (_, input) in &task.inputs {
                self.row[input.clone()].copy_from_slice(&row[input.clone()]);
            }
            self.row[task.stamp] = clock_s;
        }
    }

    /// Returns the handle of a task.
    ///
    /// # Errors
    /// A task that has no inputs.
    pub fn task(&self, name: &str) -> Result<TaskHandle, TargetError> {
        let place = self.tasks.iter().position(|task| task.name == name);
        place.map(TaskHandle).ok_or_else(|| TargetError::Task {
            name: name.to_owned(),
            known: self.tasks.iter().map(|task| task.name.clone()).collect(),
        })
    }

    /// Returns the handle of an input of a task.
    ///
    /// # Errors
    /// An input that the task does not have.
    pub fn input(&self, task: &TaskHandle, name: &str) -> Result<InputHandle, TargetError> {
        let slots = &self.tasks[task.0];
        let found = slots.inputs.iter().find(|(input, _)| input == name);
        found.map(|(_, range)| InputHandle { task: task.0, range: range.clone() }).ok_or_else(|| {
            TargetError::Input {
                task: slots.name.clone(),
                name: name.to_owned(),
                known: slots.inputs.iter().map(|(input, _)| input.clone()).collect(),
            }
        })
    }

    /// Positions of a task's inputs; no inputs if the row has none for a task of this name. Allocates nothing.
    pub(crate) fn place(&self, name: &str) -> TargetPlace {
        let slots = self.tasks.iter().find(|slots| slots.name == name);
        slots.map_or_else(TargetPlace::default, |slots| TargetPlace {
            stamp: slots.stamp,
            width: slots.inputs.iter().map(|(_, range)| range.len()).sum(),
        })
    }

    /// Sets the values that a task accepts.
    pub(crate) fn allow(&mut self, name: &str, allowed: AllowedInputs) {
        if let Some(slots) = self.tasks.iter_mut().find(|slots| slots.name == name) {
            slots.allowed = allowed;
        }
    }

    /// Values that a task accepts.
    pub(crate) fn allowed(&self, task: &TaskHandle) -> AllowedInputs {
        self.tasks[task.0].allowed
    }

    /// The name of a task.
    #[must_use]
    pub fn name(&self, task: &TaskHandle) -> &str {
        &self.tasks[task.0].name
    }

    /// Writes inputs of a task and stamps them with `time_s`, s on the robot's clock. Either all inputs change or none.
    /// Allocates nothing unless it fails.
    ///
    /// # Errors
    /// A number of values that differs from that of an input; an infinite value; a time stamp that is not finite;
    /// inputs of another task.
    pub fn write(
        &mut self,
        task: &TaskHandle,
        time_s: f64,
        inputs: &[(&InputHandle, &[f64])],
    ) -> Result<(), TargetError> {
        if !time_s.is_finite() {
            return Err(TargetError::NotFinite { value: time_s });
        }
        for (input, values) in inputs {
            if input.task != task.0 {
                return Err(TargetError::OtherTask);
            }
            if values.len() != input.range.len() {
                return Err(TargetError::Length { expected: input.range.len(), found: values.len() });
            }
            if let Some(&value) = values.iter().find(|value| value.is_infinite()) {
                return Err(TargetError::NotFinite { value });
            }
        }
        for (input, values) in inputs {
            self.row[input.range.clone()].copy_from_slice(values);
        }
        self.row[self.tasks[task.0].stamp] = time_s;
        Ok(())
    }

    /// Time stamp of a task's inputs, s on the robot's clock; `None` before the first target.
    #[must_use]
    pub fn stamp(&self, task: &TaskHandle) -> Option<f64> {
        let time_s = self.row[self.tasks[task.0].stamp];
        (!time_s.is_nan()).then_some(time_s)
    }

    /// Values of an input; `None` if any of them is as configured.
    #[must_use]
    pub fn values(&self, input: &InputHandle) -> Option<&[f64]> {
        let values = &self.row[input.range.clone()];
        values.iter().all(|value| !value.is_nan()).then_some(values)
    }

    /// Requests a hold of the robot, or its end.
    pub fn hold(&mut self, hold: bool) {
        self.hold_because(hold.then_some(HoldCause::Requested));
    }

    /// Requests a hold of the robot for a cause, or its end.
    pub fn hold_because(&mut self, cause: Option<HoldCause>) {
        if let Some(slot) = self.row.get_mut(HOLD) {
            *slot = cause.map_or(0.0, HoldCause::code);
        }
    }

    /// Cause of the hold that is requested, if there is one.
    #[must_use]
    pub fn hold_cause(&self) -> Option<HoldCause> {
        HoldCause::from_code(*self.row.get(HOLD)?)
    }

    /// Returns true if a hold of the robot is requested.
    #[must_use]
    pub fn is_held(&self) -> bool {
        self.hold_cause().is_some()
    }

    /// Requests a prepared task set by its number; the first set has number 0.
    pub fn choose_task_set(&mut self, number: u32) {
        if let Some(slot) = self.row.get_mut(TASK_SET) {
            *slot = f64::from(number);
        }
    }

    /// Number of the requested task set; `None` for the scheduled one.
    #[must_use]
    pub fn task_set(&self) -> Option<usize> {
        // `choose_task_set` writes a whole number. Any other value in a row is ignored.
        let number = *self.row.get(TASK_SET)?;
        (number >= 0.0 && number.fract() == 0.0).then_some(number as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn targets() -> Targets {
        let offset = Signal::new("offset_m", "m", &["x", "y", "z"]);
        Targets::new([
            ("hand", vec![offset, Signal::scalar("grip_n", "N")]),
            ("rest", Vec::new()),
            ("elbow", vec![Signal::scalar("angle_rad", "rad")]),
        ])
    }

    /// Compared: names and width of the layout with the given inputs.
    #[test]
    fn layout_lists_stamps_and_inputs() {
        let names: Vec<String> = targets().layout().signals.iter().map(|s| s.name.clone()).collect();
        assert_eq!(
            names,
            [
                "target.hold",
                "target.task_set",
                "target.hand.time_s",
                "target.hand.offset_m",
                "target.hand.grip_n",
                "target.elbow.time_s",
                "target.elbow.angle_rad",
            ]
        );
        assert_eq!(targets().layout().width(), targets().row().len());
        assert_eq!(Targets::new([("rest", Vec::new())]), Targets::none());
    }

    /// Compared: causes of a hold, and what is read from their numbers.
    #[test]
    fn causes_of_a_hold_have_numbers() {
        for cause in [
            HoldCause::Requested,
            HoldCause::RobotHeld(0),
            HoldCause::RobotSilent(0),
            HoldCause::RobotHeld(3),
            HoldCause::RobotSilent(7),
        ] {
            assert_eq!(HoldCause::from_code(cause.code()), Some(cause));
        }
        for none in [f64::NAN, 0.0, -2.0, 2.5, f64::NEG_INFINITY] {
            assert_eq!(HoldCause::from_code(none), None);
        }
    }

    /// Compared: the row before and after a write that is refused.
    #[test]
    fn refused_write_changes_nothing() {
        let mut targets = targets();
        let (hand, elbow) =
            (targets.task("hand").expect("a known name"), targets.task("elbow").expect("a known name"));
        let [offset, grip] =
            ["offset_m", "grip_n"].map(|name| targets.input(&hand, name).expect("a known name"));
        let before = targets.row().to_vec();
        let good: (&InputHandle, &[f64]) = (&offset, &[1.0, 2.0, 3.0]);
        let refused = [
            targets.write(&hand, 1.0, &[good, (&grip, &[f64::INFINITY])]),
            targets.write(&hand, 1.0, &[good, (&grip, &[1.0, 2.0])]),
            targets.write(&hand, f64::NAN, &[good]),
            targets.write(&elbow, 1.0, &[good]),
        ];
        assert!(refused.iter().all(Result::is_err), "{refused:?}");
        assert!(targets.row().iter().zip(&before).all(|(a, b)| a.to_bits() == b.to_bits()));
        targets.write(&hand, 1.0, &[good, (&grip, &[5.0])]).expect("good values");
        assert_eq!(targets.values(&grip), Some(&[5.0][..]));
    }

    #[test]
    fn unknown_names_list_the_known_ones() {
        let targets = targets();
        let text = targets.task("hnad").expect_err("an unknown name").to_string();
        assert!(text.contains("hand, elbow"), "{text}");
        let hand = targets.task("hand").expect("a known name");
        let text = targets.input(&hand, "pose").expect_err("an unknown name").to_string();
        assert!(text.contains("offset_m, grip_n"), "{text}");
    }
}
