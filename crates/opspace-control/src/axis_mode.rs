//! Mode of an axis of a task.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Mode of an axis of a task.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum AxisMode {
    /// Follows the reference.
    Motion,
    /// Compliant: a force (zero, if none is set) is commanded instead of a position; tasks below cannot use the axis. It stays
    /// where it is pushed to: for an axis that yields and comes back, use `motion` with a spring (`impedance`).
    Compliant,
    /// Force control: as `compliant`, with an integral of the force error that removes the error caused by friction and
    /// by an inertia that differs from the model.
    Force,
    /// Not in the task: tasks below can use the axis.
    #[default]
    Free,
}

impl AxisMode {
    /// Modes of an axis that is in a task, in the order of their codes.
    pub const IN_TASK: [Self; 3] = [Self::Motion, Self::Compliant, Self::Force];

    /// Number of the mode in targets and signals: 0 motion, 1 compliant, 2 force, 3 free.
    #[must_use]
    pub fn code(self) -> f64 {
        match self {
            Self::Motion => 0.0,
            Self::Compliant => 1.0,
            Self::Force => 2.0,
            Self::Free => 3.0,
        }
    }

    /// Returns the mode with this code, for an axis in a task.
    #[must_use]
    pub fn from_code(code: f64) -> Option<Self> {
        Self::IN_TASK.into_iter().find(|mode| mode.code() == code)
    }

    /// Name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Motion => "motion",
            Self::Compliant => "compliant",
            Self::Force => "force",
            Self::Free => "free",
        }
    }
}
