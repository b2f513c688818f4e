//! Parameters of a set of tasks: what a file holds.

use crate::context::ControlContext;
use crate::error::ControlError;
use crate::limits::joint_limits::LimitParameters;
use crate::tasks::cartesian_parameters::{CartesianParameters, CenterOfMassParameters};
use crate::tasks::joint_parameters::{
    JointDampingParameters, JointPostureParameters, JointTrackingParameters,
};
use crate::tasks::swivel::SwivelParameters;
use crate::tasks::task::Task;
use opspace_model::Model;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

/// One task of a file: `[task.NAME.KIND]`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum TaskParameters {
    /// A frame that follows a reference on some axes and is compliant on others.
    Cartesian(Box<CartesianParameters>),
    /// The centre of mass follows a reference.
    CenterOfMass(Box<CenterOfMassParameters>),
    /// The swivel angle of the elbow about the line from shoulder to wrist follows a reference.
    Swivel(Box<SwivelParameters>),
    /// The joints follow a reference.
    JointTracking(JointTrackingParameters),
    /// The joints are pulled to a posture by springs.
    JointPosture(JointPostureParameters),
    /// The joints are braked in proportion to their speed.
    JointDamping(JointDampingParameters),
    /// A task of a kind that was registered.
    #[serde(skip)]
    Registered(RegisteredTask),
}

impl TaskParameters {
    /// Kind of the task: the name of its table in a file.
    #[must_use]
    pub fn kind(&self) -> &str {
        match self {
            Self::Cartesian(_) => "cartesian",
            Self::CenterOfMass(_) => "center-of-mass",
            Self::Swivel(_) => "swivel",
            Self::JointTracking(_) => "joint-tracking",
            Self::JointPosture(_) => "joint-posture",
            Self::JointDamping(_) => "joint-damping",
            Self::Registered(task) => task.kind(),
        }
    }
}

/// Builds a task of a name for a robot.
type Build = dyn Fn(&str, &Model, &ControlContext) -> Result<Box<dyn Task>, ControlError> + Send + Sync;

/// A task of a kind that isn't built in, with what builds it.
#[derive(Clone)]
pub struct RegisteredTask {
    kind: String,
    parameters: String,
    build: Arc<Build>,
}

impl RegisteredTask {
    /// A task of that kind. `parameters` is a text by which two tasks of the kind are compared.
    #[must_use]
    pub fn new(kind: impl Into<String>, parameters: impl Into<String>, build: Arc<Build>) -> Self {
        Self { kind: kind.into(), parameters: parameters.into(), build }
    }

    /// Kind of the task, as it is registered.
    #[must_use]
    pub fn kind(&self) -> &str {
        &self.kind
    }

    /// The task for a robot.
    ///
    /// # Errors
    /// Parameters that don't fit the robot.
    pub fn task(
        &self,
        name: &str,
        model: &Model,
        context: &ControlContext,
    ) -> Result<Box<dyn Task>, ControlError> {
        (self.build)(name, model, context)
    }
}

impl PartialEq for RegisteredTask {
    fn eq(&self, other: &Self) -> bool {
        self.kind == other.kind && self.parameters == other.parameters
    }
}

impl fmt::Debug for RegisteredTask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}({})", self.kind, self.parameters)
    }
}

/// Part of the arm's own forces that the controller compensates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Compensation {
    /// Gravity, Coriolis and centrifugal forces: C q̇ + g.
    #[default]
    Bias,
    /// Gravity alone.
    Gravity,
}

/// Tasks by name and their order.
#[derive(Clone, Copy, Debug)]
pub struct TaskSetParameters<'a> {
    /// Names of the tasks, the most important first. A task never disturbs one above it.
    pub priority: &'a [String],
    /// The tasks by name.
    pub task: &'a BTreeMap<String, TaskParameters>,
    /// Part of the arm's own forces that is compensated.
    pub compensation: Compensation,
    /// Enforcement of the robot's limits.
    pub limits: LimitParameters,
}
