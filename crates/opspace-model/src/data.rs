//! Results of the algorithms. They are allocated once and overwritten in every control cycle.
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, update};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! assert!(update(&model, &mut data, &[0.4; 6], &[0.1; 6]));
//! println!("holding it takes {:.1} Nm", data.gravity[1]);
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::cholesky::MassMatrixFactor;
use crate::coriolis::CoriolisFactor;
use crate::derivatives::Rates;
use crate::model::Model;
use crate::real::Real;
use crate::spatial::{Force, Motion, Placement, SpatialInertia};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6xX, Vector3};

/// Results and intermediate values of the algorithms for one model with n joints. The documentation of each field names
/// the function that computes it.
///
/// Body quantities (`placement`, `screw`, `velocity`, ...: index i is body i) are in world axes, and spatial quantities
/// are about one common point, [`origin`](Self::origin). Velocities, forces and inertias of different bodies can
/// therefore be added without a transformation.
#[derive(Clone, Debug)]
pub struct Data<T: Real = f64> {
    /// Joint positions of the last [`forward_kinematics`](crate::forward_kinematics), rad or m (nq).
    pub q: DVector<T>,
    /// Joint velocities of the last [`kinematics`](crate::kinematics()), rad/s or m/s (n).
    pub dq: DVector<T>,
    /// Position in the world of the fixed base or of the floating root, m. Spatial quantities are about this point. By
    /// [`forward_kinematics`](crate::forward_kinematics).
    pub origin: Vector3<T>,
    /// Pose of each body in the world. By [`forward_kinematics`](crate::forward_kinematics).
    pub placement: Vec<Placement<T>>,
    /// S: motion of each body relative to its parent per unit of joint velocity. By
    /// [`forward_kinematics`](crate::forward_kinematics).
    pub screw: Vec<Motion<T>>,
    /// Spatial velocity of each body, m/s and rad/s. By [`kinematics`](crate::kinematics()).
    pub velocity: Vec<Motion<T>>,
    /// Spatial acceleration of each body with q̈ = 0 and without gravity, m/s² and rad/s². By
    /// [`kinematics`](crate::kinematics()).
    pub bias_acceleration: Vec<Motion<T>>,
    /// M(q), full and symmetric (n × n), kg m². By [`crba`](crate::crba()).
    pub mass_matrix: DMatrix<T>,
    /// Factors U and D of M = U D Uᵀ. By [`cholesky`](crate::cholesky()).
    pub mass_matrix_factor: MassMatrixFactor<T>,
    /// M⁻¹(q) (n × n), 1/(kg m²). By [`mass_matrix_inverse`](crate::mass_matrix_inverse).
    pub mass_matrix_inverse: DMatrix<T>,
    /// C(q, q̇) from Christoffel symbols (n × n), Nms/rad. By [`coriolis`](crate::coriolis()).
    pub coriolis_matrix: DMatrix<T>,
    /// Generalised momentum p = M q̇, Nms (n). By [`generalized_momentum`](crate::generalized_momentum).
    pub momentum: DVector<T>,
    /// Gradient of the kinetic energy, Cᵀ q̇, Nm (n). By [`generalized_momentum`](crate::generalized_momentum).
    pub kinetic_energy_gradient: DVector<T>,
    /// C(q, q̇) q̇ + g(q), Nm (n). By [`bias`](crate::bias).
    pub bias: DVector<T>,
    /// g(q), Nm (n). By [`gravity`](crate::gravity).
    pub gravity: DVector<T>,
    /// Joint torques, Nm (n). By [`rnea`](crate::rnea()); [`aba_external`](crate::aba_external) writes τ + Σ Jᵀ f here.
    pub torque: DVector<T>,
    /// Joint accelerations, rad/s² (n). By [`aba`](crate::aba()).
    pub ddq: DVector<T>,
    /// Centroidal map A (6 × n): linear and angular momentum about the centre of mass per unit of q̇, kg m and kg m².
    /// By [`centroidal_map`](crate::centroidal_map).
    pub centroidal_map: Matrix6xX<T>,
    /// ∂τ/∂q of inverse dynamics (n × n), Nm/rad. By [`rnea_derivatives`](crate::rnea_derivatives).
    pub torque_by_q: DMatrix<T>,
    /// ∂τ/∂q̇ of inverse dynamics (n × n), Nms/rad. By [`rnea_derivatives`](crate::rnea_derivatives).
    pub torque_by_dq: DMatrix<T>,
    /// ∂q̈/∂q of forward dynamics (n × n), 1/s². By [`aba_derivatives`](crate::aba_derivatives).
    pub ddq_by_q: DMatrix<T>,
    /// ∂q̈/∂q̇ of forward dynamics (n × n), 1/s. By [`aba_derivatives`](crate::aba_derivatives).
    pub ddq_by_dq: DMatrix<T>,

    /// Position of the joint of each body, `ratio` q + `offset`, rad or m.
    pub(crate) angle: Vec<T>,
    pub(crate) sin_cos: Vec<(T, T)>,
    pub(crate) acceleration: Vec<Motion<T>>,
    pub(crate) force: Vec<Force<T>>,
    pub(crate) composite: Vec<SpatialInertia<T>>,
    pub(crate) coriolis_factor: Vec<CoriolisFactor<T>>,
    pub(crate) rates: Vec<Rates<T>>,
    pub(crate) articulated: Vec<ArticulatedInertia<T>>,
    pub(crate) column: Vec<ArticulatedColumn<T>>,
}

/// Articulated-body inertia: the apparent inertia of a subtree with free joints. It is a symmetric 6×6 in three blocks,
/// `[f; n] = [linear, couplingᵀ; coupling, angular] [v; ω]`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ArticulatedInertia<T> {
    pub linear: Matrix3<T>,
    pub coupling: Matrix3<T>,
    pub angular: Matrix3<T>,
}

/// Joint quantities that pass from one recursion of the articulated-body algorithm to the next: U = I S, 1/D, u.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ArticulatedColumn<T> {
    pub force: Force<T>,
    pub inverse_inertia: T,
    pub torque: T,
}

impl<T: Real> Data<T> {
    /// Allocates the results of all algorithms for `model`. All values are zero or the identity until they are
    /// computed.
    #[must_use]
    pub fn new(model: &Model<T>) -> Self {
        let (n, bodies) = (model.n(), model.bodies().len());
        let zero = DVector::zeros(n);
        let square = DMatrix::zeros(n, n);
        let block = Matrix3::zeros();
        let column =
            ArticulatedColumn { force: Force::zero(), inverse_inertia: T::zero(), torque: T::zero() };
        Self {
            q: DVector::zeros(model.nq()),
            dq: zero.clone(),
            origin: Vector3::zeros(),
            placement: vec![Placement::identity(); bodies],
            screw: vec![Motion::zero(); bodies],
            velocity: vec![Motion::zero(); bodies],
            bias_acceleration: vec![Motion::zero(); bodies],
            mass_matrix: square.clone(),
            mass_matrix_factor: MassMatrixFactor::new(model),
            mass_matrix_inverse: square.clone(),
            coriolis_matrix: square.clone(),
            momentum: zero.clone(),
            kinetic_energy_gradient: zero.clone(),
            bias: zero.clone(),
            gravity: zero.clone(),
            torque: zero.clone(),
            ddq: zero,
            centroidal_map: Matrix6xX::zeros(n),
            torque_by_q: square.clone(),
            torque_by_dq: square.clone(),
            ddq_by_q: square.clone(),
            ddq_by_dq: square,
            angle: vec![T::zero(); bodies],
            sin_cos: vec![(T::zero(), T::one()); bodies],
            acceleration: vec![Motion::zero(); bodies],
            force: vec![Force::zero(); bodies],
            composite: vec![SpatialInertia::zero(); bodies],
            coriolis_factor: vec![CoriolisFactor::zero(); bodies],
            rates: vec![Rates::zero(); bodies],
            articulated: vec![ArticulatedInertia { linear: block, coupling: block, angular: block }; bodies],
            column: vec![column; bodies],
        }
    }
}
