//! Behaviour of a task that rests in a singular pose, away from its goal.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Behaviour of a task that rests in a singular pose because its error is along a direction that the arm has lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum SingularEscape {
    /// The arm stays there.
    #[default]
    None,
    /// The arm moves in the null space, at up to 0.5 rad/s of its fastest joint, in the direction that leads nearer to the
    /// goal; it stays there if no direction does. Tasks of higher priority are not affected, those of lower priority are.
    NullspaceStep,
}
