//! Findings: problems that are predicted before a run, or found in its log.

use crate::codes::Code;
use crate::files::source::{FileError, Source};
use crate::files::toml_path::dotted;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// A problem of a run, with its place, its numbers, its causes and a remedy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Finding {
    /// Kind of the problem.
    pub code: Code,
    /// Place of the problem.
    #[serde(flatten)]
    pub place: Place,
    /// Description of the problem, with the numbers and the causes.
    pub message: String,
    /// Remedy; empty if the page of the code has the only one.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub help: String,
    /// Numbers of the problem, by names that end with their units.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub numbers: BTreeMap<String, f64>,
    /// Causes, as far as they are known.
    #[serde(default, skip_serializing_if = "Causes::is_empty")]
    pub causes: Causes,
    /// Largest deviation of each joint that limits keep from its reference, by name, rad or m.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub deviations: BTreeMap<String, f64>,
}

/// Place of a problem.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Place {
    /// Value in the task file, as a dotted path: `task.hand.cartesian.gains`.
    TaskFile(String),
    /// Value in the robot file.
    RobotFile(String),
    /// Task, by name.
    Task(String),
    /// Joints, by name.
    Joints(Vec<String>),
    /// Run as a whole.
    Run(()),
}

/// Causes that keep a task from its reference.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
#[non_exhaustive]
pub struct Causes {
    /// Joints whose position limits hold the task.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub position_limits: Vec<String>,
    /// Joints whose speed or acceleration limits hold the task.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub speed_limits: Vec<String>,
    /// Joints whose limits of torque or torque rate hold the task.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub torque_limits: Vec<String>,
    /// Pairs of links or obstacles whose kept distances (`[collision]`) hold the task.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub kept_distances: Vec<[String; 2]>,
    /// Direction of the error, if the arm is nearly singular along it: `z`, or `0.71 x - 0.71 rz`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub singular_along: Option<String>,
    /// Tasks of higher priority that hold the task.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub overridden_by: Vec<String>,
    /// Joints whose friction holds the spring of the task.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub friction: Vec<String>,
}

impl Finding {
    /// Creates a finding about a value in the task file.
    #[must_use]
    pub fn new<S: AsRef<str>>(code: Code, key: &[S], message: String, help: String) -> Self {
        let key = dotted(&key.iter().map(|part| part.as_ref().to_owned()).collect::<Vec<_>>());
        Self { help, ..Self::of(code, Place::TaskFile(key), message) }
    }

    /// Creates a finding about a run.
    #[must_use]
    pub fn of(code: Code, place: Place, message: String) -> Self {
        let (help, numbers, causes) = (String::new(), BTreeMap::new(), Causes::default());
        Self { code, place, message, help, numbers, causes, deviations: BTreeMap::new() }
    }

    /// Moves the key from the task file to the robot file.
    #[must_use]
    pub fn of_robot(self) -> Self {
        let place = match self.place {
            Place::TaskFile(key) => Place::RobotFile(key),
            other => other,
        };
        Self { place, ..self }
    }

    /// Adds a number, unless it does not exist.
    pub(crate) fn with(mut self, name: &str, number: Option<f64>) -> Self {
        self.numbers.extend(number.map(|number| (name.to_owned(), number)));
        self
    }

    /// Key of the value at fault; empty if the finding is not about a value.
    #[must_use]
    pub fn key(&self) -> &str {
        match &self.place {
            Place::TaskFile(key) | Place::RobotFile(key) => key,
            _ => "",
        }
    }

    /// Name of the task; `None` if the finding is not about a task.
    #[must_use]
    pub fn task(&self) -> Option<&str> {
        match &self.place {
            Place::Task(name) => Some(name),
            _ => None,
        }
    }

    /// Returns a number by its name.
    #[must_use]
    pub fn number(&self, name: &str) -> Option<f64> {
        self.numbers.get(name).copied()
    }

    /// Returns the finding with its place in a file that has its key.
    #[must_use]
    pub fn placed_in(&self, source: &Source) -> FileError {
        let help = Some(self.help.clone()).filter(|help| !help.is_empty());
        FileError::at_key(source, self.key(), &self.message, help).coded(self.code)
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl Causes {
    /// True if no cause is known.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// True if the tasks of higher priority are the only cause.
    pub(crate) fn is_only_overridden(&self) -> bool {
        Self { overridden_by: Vec::new(), ..self.clone() }.is_empty()
    }

    /// Describes each kind of causes.
    pub(crate) fn texts(&self) -> Vec<String> {
        let limits = [
            ("position limits", &self.position_limits),
            ("speed or acceleration limits", &self.speed_limits),
            ("torque limits", &self.torque_limits),
        ];
        let of_limits = |(kind, joints): (&str, &Vec<String>)| {
            (!joints.is_empty()).then(|| format!("{kind} of {}", joints.join(", ")))
        };
        let mut texts: Vec<String> = limits.into_iter().filter_map(of_limits).collect();
        if !self.kept_distances.is_empty() {
            let pairs = self.kept_distances.iter().map(|[a, b]| format!("{a} and {b}"));
            let pairs = pairs.collect::<Vec<_>>().join(", ");
            texts.push(format!("distance kept between {pairs} (collision.margin_m)"));
        }
        texts.extend(
            self.singular_along
                .iter()
                .map(|along| format!("out of reach: the arm is nearly singular along {along}")),
        );
        if !self.overridden_by.is_empty() {
            let above = self.overridden_by.iter().map(|name| format!("task '{name}'"));
            texts.push(format!("overridden by {}", above.collect::<Vec<_>>().join(", ")));
        }
        texts
    }
}

/// Formats errors over displacements (m) and angles (rad), as far as they exist.
pub(crate) fn errors(position_m: Option<f64>, orientation_rad: Option<f64>) -> String {
    let errors = [(position_m, "mm"), (orientation_rad, "mrad")];
    let text = |(error, unit): (Option<f64>, &str)| Some(format!("{:.1} {unit}", 1e3 * error?));
    errors.into_iter().filter_map(text).collect::<Vec<_>>().join(" and ")
}
