//! What will go wrong when a task runs on its robot, found before anything moves.
//!
//! What can't be built at all is an error of [`Experiment::new`]. What is found here can be run, but not with the
//! success that its author hopes for; every finding says the number that is wrong and what to do about it. One file
//! a kind:
//!
//! | file | finds |
//! |---|---|
//! | `goals` | references that the arm can't reach, or not within its joints' ranges |
//! | `speeds` | references faster than the joints or the task's own speed limit |
//! | `stability` | gains too high for the rate, the delay and the servo |
//! | `limits` | limits that contradict each other, the start posture or the arm's weight |
//! | `freedom` | a start at a singularity; freedom that nothing damps |
//! | `servo_gain` | position or velocity loops that may hardly have more gain than is believed |
//! | `times` | events and references that the run is too short for |
//!
//! The robot is the believed one, at the task's start posture, its tasks followed without error.

mod followed;
mod freedom;
mod goals;
mod limits;
mod motion;
mod servo_gain;
mod speeds;
mod stability;
mod times;

use crate::files::source::FileError;
use crate::files::toml_path::dotted;
use crate::run::experiment::{ControllerKind, Experiment};
use followed::Followed;
use motion::{Motion, motions};
use opspace_control::{ControlInput, Measurement, Targets, TaskParameters, TaskSet};
use opspace_model::{Data, Model, update};
pub use servo_gain::{GainMargin, ServoLoop, gain_margin};
use std::collections::BTreeMap;

/// Something that will go wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Which value it is about, as a dotted path into its file: `task.hand.cartesian.gains`.
    pub key: String,
    /// What is wrong, with the numbers.
    pub message: String,
    /// What to do about it.
    pub help: String,
    file: File,
}

/// The file in which a finding's key stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum File {
    Task,
    Robot,
}

impl Finding {
    fn new<S: AsRef<str>>(key: &[S], message: String, help: String) -> Self {
        let key = dotted(&key.iter().map(|part| part.as_ref().to_owned()).collect::<Vec<_>>());
        Self { key, message, help, file: File::Task }
    }

    fn of_robot(self) -> Self {
        Self { file: File::Robot, ..self }
    }

    /// With its place in the files of the experiment in which it was found.
    #[must_use]
    pub fn placed(&self, experiment: &Experiment) -> FileError {
        let source = match self.file {
            File::Task => &experiment.task().source,
            File::Robot => &experiment.robot().source,
        };
        FileError::at_key(source, self.key.as_str(), &self.message, Some(self.help.clone()))
    }
}

/// The kind of a task, as its table in a file is named.
fn kind(task: &TaskParameters) -> &str {
    match task {
        TaskParameters::Cartesian(_) => "cartesian",
        TaskParameters::CenterOfMass(_) => "center-of-mass",
        TaskParameters::Swivel(_) => "swivel",
        TaskParameters::JointTracking(_) => "joint-tracking",
        TaskParameters::JointPosture(_) => "joint-posture",
        TaskParameters::JointDamping(_) => "joint-damping",
        TaskParameters::Registered(task) => task.kind(),
    }
}

/// Controller input whose clock counts from the start of control.
fn input<'a>(
    model: &'a Model,
    data: &'a Data,
    measurement: &'a Measurement,
    feedforward_torque: &'a [f64],
    targets: &'a Targets,
) -> ControlInput<'a> {
    ControlInput { model, data, measurement, feedforward_torque, targets, clock_s: measurement.time_s }
}

/// Everything that will go wrong, as far as it can be told without running; empty for most. What a [`GainMargin`] finds
/// comes from itself.
#[must_use]
pub fn findings(experiment: &Experiment) -> Vec<Finding> {
    let Some(case) = Case::new(experiment) else {
        return Vec::new();
    };
    let followed = Followed::new(&case);
    let mut found = limits::of_start(&case);
    found.extend(freedom::singular_start(&case));
    if experiment.choice().controller == ControllerKind::Osc {
        found.extend(freedom::undamped(&case));
        found.extend(stability::stiff_gains(&case));
    }
    found.extend(limits::of_postures(&case, &followed));
    let out_of_reach = goals::out_of_reach(&case, &followed);
    // What can't be reached asks for any speed and any torque on the way.
    if out_of_reach.is_empty() {
        found.extend(speeds::of_joints(&case, &followed));
        found.extend(limits::on_the_way(&case, &followed));
    }
    found.extend(out_of_reach);
    found.extend(speeds::of_tasks(&case, &followed));
    found.extend(times::too_short(&case, &followed));
    found
}

/// Tasks that don't tell what [`findings`] needs: what is said of them is incomplete.
#[must_use]
pub fn not_checked(experiment: &Experiment) -> Vec<Finding> {
    let torques = experiment.choice().controller == ControllerKind::Osc;
    let case = Case::new(experiment).filter(|_| torques);
    case.map_or_else(Vec::new, |case| stability::not_checked(&case))
}

/// An experiment at its start.
struct Case<'a> {
    experiment: &'a Experiment,
    model: &'a Model,
    /// rad or m (n).
    start: Vec<f64>,
    /// At the start, at rest.
    data: Data,
    /// Those that come into force while it runs, in the order of time.
    stacks: Vec<InForce<'a>>,
}

/// The tasks that are in force for a while.
struct InForce<'a> {
    from_s: f64,
    priority: &'a [String],
    task: &'a BTreeMap<String, TaskParameters>,
    /// The tasks themselves, not started.
    tasks: TaskSet,
    /// Of the tasks that lead a frame or the centre of mass, in the order of priority.
    motions: Vec<Motion<'a>>,
}

impl<'a> Case<'a> {
    fn new(experiment: &'a Experiment) -> Option<Self> {
        let (model, task) = (&experiment.robot().model, experiment.task());
        let start = experiment.start().ok()?;
        let mut data = Data::new(model);
        if !update(model, &mut data, &start, &vec![0.0; model.n()]) {
            return None;
        }
        let first = (0.0, task.file.priority.as_slice(), &task.file.task);
        let later = task.events.iter().map(|event| (event.time_s, event.priority.as_slice(), &event.task));
        let stacks = std::iter::once(first)
            .chain(later.filter(|(from_s, ..)| *from_s < experiment.duration_s()))
            .map(|(from_s, priority, task)| {
                let tasks = experiment.task_set(priority, task)?;
                Some(InForce { from_s, priority, task, tasks, motions: motions(priority, task, model) })
            })
            .collect::<Option<_>>()?;
        Some(Self { experiment, model, start, data, stacks })
    }

    /// Where a value of a task stands: in the task itself, or in the last event that changed it before the stack
    /// came into force.
    fn key(&self, stack: usize, name: &str, rest: &[&str]) -> Vec<String> {
        let changed =
            (1..=stack).rev().find(|&k| self.stacks[k].task.get(name) != self.stacks[k - 1].task.get(name));
        match changed {
            Some(stack) => vec!["event".to_owned(), (stack - 1).to_string(), "set".to_owned()],
            None => ["task", name].iter().chain(rest).map(|&part| part.to_owned()).collect(),
        }
    }

    /// Where the reference of a task stands.
    fn reference_key(&self, stack: usize, name: &str) -> Vec<String> {
        let kind = self.stacks[stack].task.get(name).map_or("", kind);
        self.key(stack, name, &[kind, "reference"])
    }

    /// From when on a task's reference of that stack is followed, s: its own event's time, or that of an earlier
    /// one since which it hasn't changed.
    fn begin_s(&self, stack: usize, same: impl Fn(&InForce<'_>) -> bool) -> f64 {
        let first = (0..=stack).rev().take_while(|&k| same(&self.stacks[k])).last();
        self.stacks[first.unwrap_or(stack)].from_s
    }

    /// The range in which a joint is kept, rad or m.
    fn range(&self, joint: usize) -> (f64, f64) {
        let limits = &self.model.joints()[joint].limits;
        let margin = self.margin();
        (limits.lower + margin, limits.upper - margin)
    }

    /// How far joints are kept from their ends, rad or m.
    fn margin(&self) -> f64 {
        let limits = &self.experiment.task().file.limits;
        if limits.enforce { limits.position_margin_rad.get() } else { 0.0 }
    }

    fn joint(&self, joint: usize) -> &str {
        &self.model.joints()[joint].name
    }
}

/// Three digits, no more zeros than they need: `8.35`, `40`, `-0.12`, `1.2e-9`.
fn short(number: f64) -> String {
    let text = format!("{number:.2e}");
    let Some((digits, Ok(exponent))) = text.split_once('e').map(|(d, e)| (d, e.parse::<i32>())) else {
        return text;
    };
    if digits.trim_start_matches('-') == "0.00" {
        return "0".to_owned();
    }
    let trimmed = |text: &str| match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text.to_owned(),
    };
    match exponent {
        -4..=4 => trimmed(&format!("{number:.*}", usize::try_from(2 - exponent).unwrap_or(0))),
        _ => format!("{}e{exponent}", trimmed(digits)),
    }
}
