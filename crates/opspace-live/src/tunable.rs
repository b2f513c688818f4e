//! Gains and modes of tasks that a page may change, where they are inputs of the task.

use opspace_control::{AXIS_NAMES, AxisMode, CartesianTarget, TaskParameters};
use opspace_experiment::Experiment;
use opspace_loop::Run;
use serde_json::{Map, Value, json};

/// Task of a robot, as the view shows it.
#[derive(Clone, Debug)]
pub struct ViewedTask {
    /// Name.
    pub name: String,
    /// Frame that it controls, if it is one.
    pub frame: Option<String>,
    /// Configured natural frequency (rad/s) and damping ratio of each axis; NaN for an axis without.
    gains: [[f64; 6]; 2],
    modes: [AxisMode; 6],
    /// True if gains and modes are inputs.
    pub has_inputs: [bool; 2],
}

/// Change of a task, from a page to the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// Number of the robot.
    pub robot: usize,
    /// Number of its task.
    pub task: usize,
    /// Number of the axis.
    pub axis: usize,
    /// New value.
    pub value: NewValue,
}

/// New value of an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NewValue {
    /// Natural frequency, rad/s, and damping ratio.
    Gains([f64; 2]),
    /// Mode.
    Mode(AxisMode),
}

impl ViewedTask {
    /// Returns the tasks of an experiment in its first set; none has inputs before the run begins.
    #[must_use]
    pub fn all(experiment: &Experiment) -> Vec<Self> {
        let task = |(name, parameters): (&String, &TaskParameters)| {
            let TaskParameters::Cartesian(cartesian) = parameters else {
                return Self {
                    name: name.clone(),
                    frame: None,
                    gains: [[f64::NAN; 6]; 2],
                    modes: [AxisMode::Free; 6],
                    has_inputs: [false; 2],
                };
            };
            let gain = |axis: usize| {
                let gains = cartesian.gains.as_ref();
                let frequency = gains.and_then(|gains| gains.frequency_rad_per_s.get(axis));
                let ratio = gains.and_then(|gains| gains.damping_ratio.get(axis));
                [frequency.map_or(f64::NAN, |value| value.get()), ratio.map_or(f64::NAN, |value| value.get())]
            };
            Self {
                name: name.clone(),
                frame: Some(cartesian.frame.clone()),
                gains: [0, 1].map(|which| std::array::from_fn(|axis| gain(axis)[which])),
                modes: cartesian.axes.modes(),
                has_inputs: [false; 2],
            }
        };
        experiment.task().file.task.iter().map(task).collect()
    }

    /// Description for the page.
    #[must_use]
    pub fn json(&self) -> Value {
        let axes = |value: &dyn Fn(usize) -> Option<Value>| {
            let axes = AXIS_NAMES.iter().enumerate();
            let axes: Map<_, _> =
                axes.filter_map(|(axis, name)| Some(((*name).to_owned(), value(axis)?))).collect();
            Value::Object(axes)
        };
        let gains = |axis: usize| {
            let [frequency, ratio] = self.gains.map(|gains| gains[axis]);
            (frequency.is_finite() && self.modes[axis] != AxisMode::Free)
                .then(|| json!({"natural_frequency_rad_per_s": frequency, "damping_ratio": ratio}))
        };
        let modes =
            |axis: usize| (self.modes[axis] != AxisMode::Free).then(|| json!(self.modes[axis].name()));
        let [has_gains, has_modes] = self.has_inputs;
        json!({
            "name": self.name,
            "frame": self.frame,
            "gains": has_gains.then(|| axes(&gains)),
            "modes": has_modes.then(|| axes(&modes)),
        })
    }

    /// Takes over a change that the page asks for.
    ///
    /// # Errors
    /// A value that is no input of the task, or out of its range.
    pub fn change(&mut self, axis: usize, value: NewValue) -> Result<(), String> {
        let [has_gains, has_modes] = self.has_inputs;
        let name = AXIS_NAMES[axis];
        match value {
            NewValue::Gains([frequency, ratio]) if has_gains && frequency > 0.0 && ratio >= 0.0 => {
                if !self.gains[0][axis].is_finite() {
                    return Err(format!("axis {name} of task '{}' has no gains", self.name));
                }
                (self.gains[0][axis], self.gains[1][axis]) = (frequency, ratio);
                Ok(())
            }
            NewValue::Mode(mode) if has_modes && self.modes[axis] != AxisMode::Free => {
                self.modes[axis] = mode;
                Ok(())
            }
            _ => Err(format!("axis {name} of task '{}' does not take this value", self.name)),
        }
    }
}

/// True if the gains of a task are inputs.
fn takes_gains(target: &CartesianTarget) -> bool {
    target.clone().gains([f64::NAN; 6], [f64::NAN; 6]).is_ok()
}

/// True if an axis of a task takes another mode than its own.
fn takes_modes(target: &CartesianTarget, modes: &[AxisMode; 6]) -> bool {
    let mut target = target.clone();
    let others = (0..6).flat_map(|axis| AxisMode::IN_TASK.map(|mode| (axis, mode)));
    let mut others = others.filter(|(axis, mode)| modes[*axis] != *mode);
    others.any(|(axis, mode)| {
        let mut asked = [None; 6];
        asked[axis] = Some(mode);
        target.modes(asked).is_ok()
    })
}

/// Number of an axis by its name.
#[must_use]
pub fn axis(name: &str) -> Option<usize> {
    AXIS_NAMES.iter().position(|known| *known == name)
}

/// Mode of an axis by its name.
#[must_use]
pub fn mode(name: &str) -> Option<AxisMode> {
    AxisMode::IN_TASK.into_iter().find(|mode| mode.name() == name)
}

/// Inputs of the tasks of a run.
#[derive(Debug, Default)]
pub struct TaskInputs(Vec<Option<Inputs>>);

#[derive(Debug)]
struct Inputs {
    target: CartesianTarget,
    gains: [[f64; 6]; 2],
    modes: [Option<AxisMode>; 6],
}

impl TaskInputs {
    /// Returns the inputs of a run for these tasks, and enters into the tasks which inputs they have. It allocates.
    pub fn of(run: &mut Run<'_>, tasks: &mut [ViewedTask]) -> Self {
        let targets = run.targets();
        let mut inputs = Vec::new();
        for task in tasks {
            let target = task.frame.as_ref().and_then(|_| CartesianTarget::of(targets, &task.name).ok());
            inputs.push(target.map(|target| {
                task.has_inputs = [takes_gains(&target), takes_modes(&target, &task.modes)];
                Inputs { target, gains: [[f64::NAN; 6]; 2], modes: [None; 6] }
            }));
        }
        Self(inputs)
    }

    /// Writes a change into the targets of the next cycle. One that the task refuses has no effect.
    pub fn write(&mut self, change: Change, run: &mut Run<'_>) {
        let Some(Some(inputs)) = self.0.get_mut(change.task) else { return };
        let Inputs { target, gains, modes } = inputs;
        let is_good = match change.value {
            NewValue::Gains([frequency, ratio]) => {
                (gains[0][change.axis], gains[1][change.axis]) = (frequency, ratio);
                target.gains(gains[0], gains[1]).is_ok()
            }
            NewValue::Mode(mode) => {
                modes[change.axis] = Some(mode);
                target.modes(*modes).is_ok()
            }
        };
        let clock_s = run.control().clock_s();
        if is_good {
            // A stamp that does not suit the clock is refused, as any other.
            let _ = target.write(run.targets(), clock_s);
        } else if let NewValue::Mode(_) = change.value {
            modes[change.axis] = None;
        }
    }
}
