//! Static identification of a position servo without a velocity loop: stiffness and friction from the weight of the arm.
//!
//! A servo of stiffness K holds the torque of gravity by an offset between setpoint and position. While the joint moves
//! slowly, friction has a certain sign (P: of its motion):
//!
//! ```text
//! K (q_d − q) = g(q) + P (F + b |q̇|)
//! ```
//!
//! The joint [sweeps](sweep) its range in both directions, at several speeds, so that each of some 20 postures is passed from
//! both sides. The mean of both offsets over g(q) has the slope 1/K; half of their difference is friction. Offsets are means
//! over many counts of the encoder and many steps of the setpoint, whose rounding cancels; nothing depends on how a joint comes
//! to rest, or on the friction that it has there. A [plan] chooses posture and range beforehand. The [fit] has, in
//! addition, errors of the posture: encoders whose zero is wrong, and backlash, which displaces a link towards its load.
//!
//! With gravity alone, stiffness and masses are identified up to a common factor: the masses are those of the URDF. A second
//! measurement with a hung weight of known mass separates them.

pub mod evaluation;
pub mod failure;
pub mod fit;
pub mod parameters;
pub mod plan;
pub mod sweep;

pub use evaluation::{
    Evaluation, HungWeight, LEAST_SPAN, StaticServo, add_hung_weight, evaluate, take_stiffness,
};
pub use failure::StaticFailure;
pub use parameters::StaticParameters;
