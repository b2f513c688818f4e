//! Rigid-body kinematics and dynamics from URDF.
//!
//! A [`Model`] is read once and never changes; [`Data`] is scratch for it, allocated once; the algorithms
//! are functions of both, one file each, named as in the textbook (Featherstone, *Rigid Body Dynamics
//! Algorithms*, "RBDA"). No algorithm allocates; reading a URDF and [`samples`] do.
//!
//! Conventions: SI units; world-aligned Jacobians at the frame's origin; linear rows before angular ones;
//! the root link is fixed to the world; a continuous joint has one coordinate.

#![forbid(unsafe_code)]

pub mod aba;
pub mod cholesky;
pub mod coriolis;
pub mod crba;
pub mod data;
pub mod energy;
pub mod jacobian;
pub mod kinematics;
pub mod model;
pub mod operational_space;
pub mod rnea;
pub mod samples;
pub mod spatial;
pub mod urdf;

pub use aba::aba;
pub use cholesky::{cholesky, cholesky_solve};
pub use coriolis::coriolis;
pub use crba::crba;
pub use data::Data;
pub use energy::{center_of_mass, kinetic_energy, potential_energy};
pub use jacobian::frame_jacobian;
pub use kinematics::{frame_bias_acceleration, frame_placement, frame_velocity, kinematics};
pub use model::{Frame, FrameId, Joint, JointKind, Limits, Model, UnknownFrame, UnknownJoint};
pub use operational_space::OperationalSpace;
pub use rnea::{bias, gravity, rnea};
pub use spatial::{Force, Inertia, Motion, Placement};
pub use urdf::{Loaded, UrdfError, UrdfErrorKind, UrdfWarning, UrdfWarningKind};

/// Everything a controller needs of a state, once a tick: kinematics, M and its factor, bias and gravity.
///
/// Returns `false` if the mass matrix is not positive definite (a body without inertia, or a state that is
/// not finite): the factor is then unusable.
///
/// # Panics
/// If `q` or `dq` is shorter than the number of joints.
#[must_use]
pub fn update(model: &Model, data: &mut Data, q: &[f64], dq: &[f64]) -> bool {
    kinematics(model, data, q, dq);
    crba(model, data);
    bias(model, data);
    gravity(model, data);
    cholesky(&data.mass_matrix, &mut data.mass_matrix_factor)
}
