//! What the algorithms compute: allocated once, written every tick.

use crate::coriolis::CoriolisFactor;
use crate::model::Model;
use crate::spatial::{Force, Inertia, Motion, Placement};
use nalgebra::{DMatrix, DVector, Matrix3};

/// Scratch and results of the algorithms for one model: n is the number of its joints, and index i is
/// joint i and the body that it carries. Each field names the function that fills it.
#[derive(Clone, Debug)]
pub struct Data {
    /// Joint positions of the last [`kinematics`](crate::kinematics()), rad or m (n).
    pub q: DVector<f64>,
    /// Joint velocities of the last [`kinematics`](crate::kinematics()), rad/s or m/s (n).
    pub dq: DVector<f64>,
    /// Pose of each body in its parent body. By [`kinematics`](crate::kinematics()).
    pub placement_parent: Vec<Placement>,
    /// Pose of each body in the world. By [`kinematics`](crate::kinematics()).
    pub placement_world: Vec<Placement>,
    /// Velocity of each body, in its own frame. By [`kinematics`](crate::kinematics()).
    pub velocity: Vec<Motion>,
    /// Spatial acceleration of each body with q̈ = 0 and without gravity, in its own frame. By
    /// [`kinematics`](crate::kinematics()).
    pub bias_acceleration: Vec<Motion>,
    /// M(q), full and symmetric (n × n), kg m². By [`crba`](crate::crba()).
    pub mass_matrix: DMatrix<f64>,
    /// L of M = L Lᵀ, lower triangle (n × n). By [`update`](crate::update).
    pub mass_matrix_factor: DMatrix<f64>,
    /// C(q, q̇) of Christoffel's symbols (n × n), Nms/rad. By [`coriolis`](crate::coriolis()).
    pub coriolis_matrix: DMatrix<f64>,
    /// C(q, q̇) q̇ + g(q), Nm (n). By [`bias`](crate::bias).
    pub bias: DVector<f64>,
    /// g(q), Nm (n). By [`gravity`](crate::gravity).
    pub gravity: DVector<f64>,
    /// Joint torques, Nm (n). By [`rnea`](crate::rnea()).
    pub torque: DVector<f64>,
    /// Joint accelerations, rad/s² (n). By [`aba`](crate::aba()).
    pub ddq: DVector<f64>,

    pub(crate) acceleration: Vec<Motion>,
    pub(crate) force: Vec<Force>,
    pub(crate) composite: Vec<Inertia>,
    pub(crate) coriolis_factor: Vec<CoriolisFactor>,
    pub(crate) articulated: Vec<ArticulatedInertia>,
    pub(crate) column: Vec<ArticulatedColumn>,
}

/// The inertia of a subtree whose joints are free: a symmetric 6×6 in three blocks,
/// `[f; n] = [linear, couplingᵀ; coupling, angular] [v; ω]`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ArticulatedInertia {
    pub linear: Matrix3<f64>,
    pub coupling: Matrix3<f64>,
    pub angular: Matrix3<f64>,
}

/// What the articulated-body algorithm keeps of a joint between its passes: U = I S, 1/D, u.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ArticulatedColumn {
    pub force: Force,
    pub inverse_inertia: f64,
    pub torque: f64,
}

impl Data {
    /// Room for every algorithm on `model`; all results zero until computed.
    #[must_use]
    pub fn new(model: &Model) -> Self {
        let n = model.n();
        let zero = DVector::zeros(n);
        let block = Matrix3::zeros();
        Self {
            q: zero.clone(),
            dq: zero.clone(),
            placement_parent: vec![Placement::identity(); n],
            placement_world: vec![Placement::identity(); n],
            velocity: vec![Motion::zero(); n],
            bias_acceleration: vec![Motion::zero(); n],
            mass_matrix: DMatrix::zeros(n, n),
            mass_matrix_factor: DMatrix::zeros(n, n),
            coriolis_matrix: DMatrix::zeros(n, n),
            bias: zero.clone(),
            gravity: zero.clone(),
            torque: zero.clone(),
            ddq: zero,
            acceleration: vec![Motion::zero(); n],
            force: vec![Force::zero(); n],
            composite: vec![Inertia::zero(); n],
            coriolis_factor: vec![CoriolisFactor::zero(); n],
            articulated: vec![ArticulatedInertia { linear: block, coupling: block, angular: block }; n],
            column: vec![ArticulatedColumn { force: Force::zero(), inverse_inertia: 0.0, torque: 0.0 }; n],
        }
    }
}
