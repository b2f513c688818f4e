//! Identification of a position servo by moving its joint: kp, kv, velocity filter, delay, inertia and friction.
//!
//! A joint is excited about its current position by odd random-phase [multisines](excitation) at two amplitudes, small
//! enough for its limits and for its motor; the other joints are held. Setpoints, positions and, where it is measured,
//! motor torque give the [frequency responses](response); these give the [gains] of the servo through the exact model of
//! what happens [between two interface cycles](interval), and a [rational] model of T = y/q_desired. Runs at constant
//! velocity in both directions give [friction]. Known parameters are the structure of the servo, τ = kv [kp (q_desired −
//! y) − w], its rates, and the limits; gains, filter, delay and friction are identified.
//!
//! T does not change when inertia, friction and kv are scaled together: the scale of torque comes from the motor's current,
//! or from the inertia that URDF and rotor give, or is not known; [`TorqueScale`] says which.

#![forbid(unsafe_code)]

pub mod excitation;
pub mod friction;
pub mod gains;
pub mod identification;
pub mod interval;
pub mod joint;
pub mod least_squares;
pub mod rational;
pub mod response;
pub mod session;
mod sweep;

pub use identification::{ExcitationPlan, Identification, KnownParameters, TorqueScale};
pub use joint::identify;
