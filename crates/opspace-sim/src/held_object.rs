//! Rigid object that hands of one or more arms hold.
//!
//! The object is a free rigid body with mass, inertia and weight. A grip connects it to the frame of an arm by springs and
//! dampers, relaxed when the grip begins: three for the position, and three for the orientation if they are given, so that a
//! single hand can hold an object away from its centre without swinging. Force and moment of a grip act on the frame's origin,
//! and with opposite sign on the object at the same point: momentum and, without damping, energy are conserved.
//!
//! [`CouplingConfig`](crate::CouplingConfig) is the limit of an object without mass and of two grips in series. It has no
//! state, and an explicit step cannot compute that limit from a mass: the two are separate.

mod object;
mod parameters;

pub(crate) use object::HandMotion;
pub use object::HeldObject;
pub use parameters::{GripParameters, HeldObjectConfig, HeldObjectParameters};
