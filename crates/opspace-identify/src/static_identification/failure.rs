//! Reasons why a servo is not identified statically.

use super::plan::PlanFailure;
use crate::session::AbortReason;
use thiserror::Error;

/// Reason why a servo without a velocity loop is not identified. The subject of each message is the joint.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum StaticFailure {
    /// Posture in which it cannot be moved.
    #[error(transparent)]
    NoPlan(#[from] PlanFailure),
    /// Joint that does not follow its setpoints.
    #[error(
        "it does not follow its setpoints steadily; is it locked, in contact, or is its friction above its torque?"
    )]
    DoesNotFollow,
    /// Gravity that is too small in comparison with friction, and no joint with the same declared gains.
    #[error(
        "gravity changes its torque by {span:.3} Nm only, which does not determine its stiffness at a Coulomb friction of \
         {coulomb:.3} Nm; four times as much is needed, or an identified joint with the same declared gains"
    )]
    TooLittleGravity {
        /// Span of the torque of gravity, Nm (N).
        span: f64,
        /// Coulomb friction, with the declared stiffness if its own is not determined, Nm (N).
        coulomb: f64,
    },
    /// Stiffness that is not the declared one.
    #[error(
        "its stiffness is {ratio:.2} times the declared one, if the masses of the URDF are right: check its gain in the servo, the \
         supply voltage, and the masses. A hung weight of known mass tells stiffness from masses"
    )]
    NotAsDeclared {
        /// Identified over declared stiffness.
        ratio: f64,
    },
    /// Motion that was aborted.
    #[error("its motion was aborted: {0}")]
    Stopped(#[from] AbortReason),
}
