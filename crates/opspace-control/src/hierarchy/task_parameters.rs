//! Parameters of a set of tasks, as given in a task file.

use crate::context::ControlContext;
use crate::error::ControlError;
use crate::limits::joint_limits::LimitParameters;
use crate::tasks::build_task::{BuildTask, BuiltTask, TaskReference};
use crate::tasks::cartesian_parameters::{CartesianParameters, CenterOfMassParameters};
use crate::tasks::joint_parameters::{
    JointDampingParameters, JointPostureParameters, JointTrackingParameters,
};
use crate::tasks::swivel::SwivelParameters;
use crate::tasks::task::Task;
use opspace_backend::quantity::Positive;
use opspace_model::Model;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::any::Any;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

/// Default of the damping of motion that the tasks leave, 1/s. It brakes degrees of freedom that no task controls, which
/// sensor noise would set in motion, and directions close to a singularity in proportion to what their damping takes from
/// the tasks: within a tenth of a second, much slower than the joints of an arm can be controlled.
pub const UNUSED_DAMPING_PER_S: Positive = Positive::literal(10.0);

/// Returns the largest damping of motion that the tasks leave for a control period (s), 1/s: a fifth of the control rate.
/// With the delay of a command, stronger damping would set the arm in motion instead of braking it.
#[must_use]
pub fn largest_unused_damping_per_s(period_s: f64) -> f64 {
    0.2 / period_s
}

/// Declares the built-in kinds of tasks: the variant of [`TaskParameters`], its parameters, and the kind's name in files.
macro_rules! task_kinds {
    ($($(#[doc = $doc:literal])* $kind:ident($parameters:ty) = $name:literal,)*) => {
        /// One task of a file: `[task.NAME.KIND]`.
        #[derive(Clone, Debug, PartialEq, Deserialize)]
        #[cfg_attr(feature = "schema", derive(JsonSchema))]
        #[serde(deny_unknown_fields)]
        #[non_exhaustive]
        pub enum TaskParameters {
            $(
                $(#[doc = $doc])*
                #[serde(rename = $name)]
                $kind($parameters),
            )*
            /// A task of a registered kind.
            #[serde(skip)]
            Registered(RegisteredTask),
        }

        impl TaskParameters {
            /// Names of the built-in kinds.
            pub const KINDS: &[&str] = &[$($name),*];

            /// Kind of the task: the name of its table in a file.
            #[must_use]
            pub fn kind(&self) -> &str {
                match self {
                    $(Self::$kind(_) => $name,)*
                    Self::Registered(task) => task.kind(),
                }
            }

            /// Parameters of the task, whatever its kind.
            fn parameters(&self) -> &dyn BuildTask {
                match self {
                    $(Self::$kind(parameters) => parameters,)*
                    Self::Registered(task) => task,
                }
            }
        }
    };
}

task_kinds! {
    /// A frame follows a reference on some axes and is compliant on others.
    Cartesian(Box<CartesianParameters>) = "cartesian",
    /// The centre of mass follows a reference.
    CenterOfMass(Box<CenterOfMassParameters>) = "center-of-mass",
    /// The swivel angle of the elbow about the line from shoulder to wrist follows a reference.
    Swivel(Box<SwivelParameters>) = "swivel",
    /// The joints follow a reference.
    JointTracking(JointTrackingParameters) = "joint-tracking",
    /// Springs pull the joints to a posture.
    JointPosture(JointPostureParameters) = "joint-posture",
    /// The joints are damped in proportion to their velocity.
    JointDamping(JointDampingParameters) = "joint-damping",
}

impl BuildTask for TaskParameters {
    fn build(&self, name: &str, model: &Model, context: &ControlContext) -> Result<BuiltTask, ControlError> {
        self.parameters().build(name, model, context)
    }

    fn reference(&self) -> Option<TaskReference<'_>> {
        self.parameters().reference()
    }

    fn frequency_key(&self) -> Option<&'static [&'static str]> {
        self.parameters().frequency_key()
    }
}

/// Function that builds a task with a given name for a robot.
type Build = dyn Fn(&str, &Model, &ControlContext) -> Result<Box<dyn Task>, ControlError> + Send + Sync;

/// A task of a registered kind that is not built in, with its constructor.
#[derive(Clone)]
pub struct RegisteredTask {
    kind: String,
    text: String,
    parameters: Option<Arc<dyn Any + Send + Sync>>,
    build: Arc<Build>,
}

impl RegisteredTask {
    /// Creates a task of the given kind. Two tasks of the same kind are equal if the `text`s of their
    /// parameters are equal.
    #[must_use]
    pub fn new(kind: impl Into<String>, text: impl Into<String>, build: Arc<Build>) -> Self {
        Self { kind: kind.into(), text: text.into(), parameters: None, build }
    }

    /// Adds the parameters that were read from the text.
    #[must_use]
    pub fn with_parameters(mut self, parameters: Arc<dyn Any + Send + Sync>) -> Self {
        self.parameters = Some(parameters);
        self
    }

    /// Parameters of the task; `None` if they are of another type, or were not added.
    #[must_use]
    pub fn parameters<P: 'static>(&self) -> Option<&P> {
        self.parameters.as_ref()?.downcast_ref()
    }

    /// Registered kind of the task.
    #[must_use]
    pub fn kind(&self) -> &str {
        &self.kind
    }
}

impl BuildTask for RegisteredTask {
    fn build(&self, name: &str, model: &Model, context: &ControlContext) -> Result<BuiltTask, ControlError> {
        (self.build)(name, model, context).map(BuiltTask::Rows)
    }

    fn frequency_key(&self) -> Option<&'static [&'static str]> {
        None
    }
}

impl PartialEq for RegisteredTask {
    fn eq(&self, other: &Self) -> bool {
        self.kind == other.kind && self.text == other.text
    }
}

impl fmt::Debug for RegisteredTask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}({})", self.kind, self.text)
    }
}

/// Part of the arm's bias forces that the controller compensates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Compensation {
    /// Gravity, Coriolis and centrifugal forces: C q̇ + g.
    #[default]
    Bias,
    /// Gravity g only.
    Gravity,
}

/// Tasks by name and their order of priority.
#[derive(Clone, Copy, Debug)]
pub struct TaskSetParameters<'a> {
    /// Names of the tasks, the highest priority first. A task never disturbs a task above it.
    pub priority: &'a [String],
    /// The tasks by name.
    pub task: &'a BTreeMap<String, TaskParameters>,
    /// Part of the arm's bias forces that is compensated.
    pub compensation: Compensation,
    /// Damping of the motion that the tasks leave, if there is no task of all joints (deceleration per velocity), 1/s.
    pub unused_damping_per_s: Positive,
    /// Enforcement of the robot's limits.
    pub limits: LimitParameters,
}

impl<'a> TaskSetParameters<'a> {
    /// Tasks with the default compensation, damping and limits.
    #[must_use]
    pub fn new(priority: &'a [String], task: &'a BTreeMap<String, TaskParameters>) -> Self {
        Self {
            priority,
            task,
            compensation: Compensation::default(),
            unused_damping_per_s: UNUSED_DAMPING_PER_S,
            limits: LimitParameters::default(),
        }
    }
}
