//! Rigid-body kinematics and dynamics from URDF.
//!
//! ```
//! use opspace_model::{Data, Model, crba, forward_kinematics, gravity};
//!
//! // A rod of 2 kg that turns about the y axis, its centre of mass 0.5 m from the hinge.
//! let urdf = r#"<robot name="pendulum">
//!   <link name="base"/>
//!   <joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint>
//!   <link name="rod"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>
//!     <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
//! </robot>"#;
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! forward_kinematics(&model, &mut data, &[0.0]);
//! crba(&model, &mut data);
//! gravity(&model, &mut data);
//!
//! // By hand: M = m l² + I, and the torque that holds the rod level is −m g l.
//! assert!((data.mass_matrix[(0, 0)] - (2.0 * 0.5 * 0.5 + 0.1)).abs() < 1e-12);
//! assert!((data.gravity[0] + 2.0 * 9.81 * 0.5).abs() < 1e-12);
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```
//!
//! A [`Model`] describes the robot. [`Data`] holds the results and intermediate values for that model and is allocated
//! once. The algorithms are functions of both, one per file, with the names of the textbook (Featherstone, *Rigid Body
//! Dynamics Algorithms*, "RBDA"). No algorithm allocates; reading a URDF, and building a model or its
//! collision geometry do.
//!
//! | wanted | here | in Pinocchio |
//! |---|---|---|
//! | poses, velocities | [`forward_kinematics()`], [`kinematics()`] | `forwardKinematics` |
//! | Jacobians and their rates | [`jacobian`] | `getFrameJacobian`, `getFrameJacobianTimeVariation` |
//! | M q̈ + C q̇ + g, C q̇ + g, g | [`rnea()`], [`bias`], [`gravity`] | `rnea`, `nonLinearEffects`, `computeGeneralizedGravity` |
//! | M, its factor, M⁻¹ x, M⁻¹ | [`crba()`], [`cholesky()`], [`MassMatrixFactor::solve`], [`mass_matrix_inverse`] | `crba`, `cholesky::decompose`, `cholesky::solve`, `computeMinverse` |
//! | q̈ | [`aba()`] | `aba` |
//! | C | [`coriolis()`] | `computeCoriolisMatrix` |
//! | M q̇ and Cᵀ q̇ | [`generalized_momentum`] | – |
//! | derivatives in q, q̇ | [`rnea_derivatives`], [`aba_derivatives`] | `computeRNEADerivatives`, `computeABADerivatives` |
//! | momentum, centre of mass, energy | [`centroidal`], [`com_jacobian`], [`energy`] | `ccrba`, `jacobianCenterOfMass`, `computeKineticEnergy` |
//! | linear in the inertial parameters | [`torque_regressor`] | `computeJointTorqueRegressor` |
//! | Λ, J̄, N | [`OperationalSpace`] | – |
//! | q ⊕ v, q₁ ⊖ q₀ | [`integrate`], [`difference`] | `integrate`, `difference` |
//! | locked joints | [`Model::with_locked_joints`] | `buildReducedModel` |
//! | distances of links, with derivatives | [`collision`] | `computeDistances` |
//! | many states at once | `batch`, with feature `simd` | – |
//!
//! Conventions: SI units; rad and Nm mean m and N for prismatic joints. Frames and data must belong to the model that
//! they are passed with. Linear rows precede angular rows. [`frame_jacobian`] is in world axes at the origin of the
//! frame. The root link is fixed to the world unless [`UrdfOptions`] select a floating base. A continuous joint has one
//! coordinate.

#![forbid(unsafe_code)]

pub mod aba;
#[cfg(feature = "simd")]
pub mod batch;
pub mod centroidal;
pub mod cholesky;
pub mod collision;
pub mod configuration;
pub mod coriolis;
pub mod crba;
pub mod data;
pub mod derivatives;
pub mod energy;
pub mod files;
pub mod jacobian;
pub mod kinematics;
pub mod model;
pub mod momentum;
mod name_list;
pub mod operational_space;
mod partial_inverse;
pub mod postures;
pub mod real;
pub mod reduce;
pub mod regressor;
pub mod rnea;
pub mod spatial;
pub mod urdf;
pub mod warnings;

pub use aba::{aba, aba_external};
pub use centroidal::{centroidal_map, centroidal_momentum};
pub use cholesky::{MassMatrixFactor, cholesky, mass_matrix_inverse};
pub use configuration::{difference, integrate, neutral};
pub use coriolis::coriolis;
pub use crba::crba;
pub use data::Data;
pub use derivatives::{aba_derivatives, rnea_derivatives};
pub use energy::{center_of_mass, com_bias_acceleration, com_velocity, kinetic_energy, potential_energy};
pub use jacobian::{
    com_jacobian, frame_jacobian, frame_jacobian_rate, local_jacobian, local_jacobian_rate, point_jacobian,
    relative_jacobian, world_jacobian, world_jacobian_rate,
};
pub use kinematics::{
    forward_kinematics, frame_bias_acceleration, frame_placement, frame_velocity, kinematics,
};
pub use model::{
    Body, Frame, FrameId, Joint, JointKind, JointUnits, Limits, Model, UnknownFrame, UnknownJoint,
};
pub use momentum::generalized_momentum;
pub use operational_space::{Inversion, OperationalSpace};
pub use postures::Postures;
pub use real::Real;
pub use reduce::{MimicConstraint, ReduceError};
pub use regressor::{inertial_parameters, torque_regressor};
pub use rnea::{bias, gravity, rnea, rnea_external};
pub use spatial::{Force, Inertia, Motion, Placement, SpatialInertia, principal_moments};
pub use urdf::{
    JointDynamics, MasslessJoint, ParsedUrdf, UrdfChanges, UrdfError, UrdfErrorKind, UrdfJoint, UrdfOptions,
    UrdfWarning, UrdfWarningKind, urdf_joints,
};
pub use warnings::{ModelWarning, model_warnings};

/// Computes the state quantities of a control cycle at `q` (nq; rad, m) and `dq` (n; rad/s, m/s): kinematics, M and its
/// factor, bias and gravity.
///
/// Returns `false` if the mass matrix is not positive definite, for example because a body has no inertia or `q` is not
/// finite. With lanes, one such state is enough. The factor is then unusable.
///
/// # Panics
/// If `q` is shorter than nq or `dq` than n.
#[must_use]
pub fn update<T: Real>(model: &Model<T>, data: &mut Data<T>, q: &[T], dq: &[T]) -> bool {
    kinematics(model, data, q, dq);
    crba::bodies(model, data);
    rnea::bias_of_bodies(model, data);
    crba::compose(model, data);
    crba::mass_matrix(model, data);
    rnea::gravity_of_composites(model, data);
    cholesky(data)
}

/// Code examples of the README, compiled and run as doctests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
