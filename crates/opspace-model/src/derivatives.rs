//! First-order derivatives of inverse and forward dynamics with respect to q and q̇.
//!
//! Singh, Russell and Wensing, *Efficient analytical derivatives of rigid-body dynamics using spatial vector
//! algebra*, IEEE Robotics and Automation Letters 7(2), 2022; in Pinocchio `computeRNEADerivatives` and
//! `computeABADerivatives`. With j an ancestor of i, or i itself:
//!
//! ```text
//! Ψ̇_j = v_parent(j) × S_j        Ψ̈_j = a_parent(j) × S_j + v_parent(j) × Ψ̇_j        Ṡ_j = v_j × S_j
//! ∂τ_i/∂q_j = S_iᵀ (2 B_i Ψ̇_j + I_i Ψ̈_j)             ∂τ_i/∂q̇_j = S_iᵀ (2 B_i S_j + I_i (Ψ̇_j + Ṡ_j))
//! ∂τ_j/∂q_i = S_jᵀ (2 B_i Ψ̇_i + I_i Ψ̈_i + S_i ×* f_i)   ∂τ_j/∂q̇_i = S_jᵀ (2 B_i S_i + I_i (Ψ̇_i + Ṡ_i))
//! ```
//!
//! where I_i, B_i and f_i are the sums over the subtree of i, and B are the velocity terms of
//! [`coriolis`](crate::coriolis()). Derivatives with respect to the coordinates of a floating base are along the axes
//! of the base, like q̇.
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, kinematics, rnea_derivatives};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! kinematics(&model, &mut data, &[0.1; 6], &[0.5; 6]);
//! rnea_derivatives(&model, &mut data, &[0.0; 6]);
//! // The first joint turns the arm about the vertical: its angle changes no torque.
//! assert!(data.torque_by_q.column(0).amax() < 1e-12);
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::aba::aba;
use crate::coriolis::composite_factors;
use crate::data::Data;
use crate::jacobian::screw_rate;
use crate::model::{JointKind, Model};
use crate::real::Real;
use crate::rnea::rnea;
use crate::spatial::Motion;
use nalgebra::{DVector, Vector3};

/// Computes ∂τ/∂q and ∂τ/∂q̇ of [`rnea`](crate::rnea()) at `ddq` (n; rad/s²) into [`Data::torque_by_q`] and
/// [`Data::torque_by_dq`]; ∂τ/∂q̈ is the mass matrix. The results of [`rnea`](crate::rnea()) are computed as well.
/// Needs [`kinematics`](crate::kinematics()).
///
/// # Panics
/// If `ddq` is shorter than the number of joints.
pub fn rnea_derivatives<T: Real>(model: &Model<T>, data: &mut Data<T>, ddq: &[T]) {
    // Afterwards `force` contains the forces of the subtrees.
    rnea(model, data, ddq);
    composite_factors(model, data);
    for i in 0..model.bodies.len() {
        data.rates[i] = Rates::of(model, data, i);
    }
    data.torque_by_q.as_mut_slice().fill(T::zero());
    data.torque_by_dq.as_mut_slice().fill(T::zero());
    let two = T::splat(2.0);
    for (i, body) in model.bodies.iter().enumerate() {
        let (inertia, factor, own) = (&data.composite[i], &data.coriolis_factor[i], &data.rates[i]);
        let screw = &data.screw[i];
        let mut by_q = factor.apply(&own.psi_dot) * two + inertia.apply(&own.psi_ddot);
        let by_dq = factor.apply(screw) * two + inertia.apply(&own.velocity);
        // The six bodies of a floating base are one joint: its screws do not rotate the forces of one another.
        if body.kind != JointKind::Floating {
            by_q += screw.cross_force(&data.force[i]);
        }
        let (row_b, row_i) = (factor.apply_transposed(screw) * two, inertia.apply(screw));
        for j in model.ancestry(Some(i)) {
            let (s, ancestor) = (&data.screw[j], &data.rates[j]);
            let (ci, cj) = (body.joint, model.bodies[j].joint);
            data.torque_by_q[(ci, cj)] += ancestor.psi_dot.dot(&row_b) + ancestor.psi_ddot.dot(&row_i);
            data.torque_by_dq[(ci, cj)] += s.dot(&row_b) + ancestor.velocity.dot(&row_i);
            if j != i {
                data.torque_by_q[(cj, ci)] += s.dot(&by_q);
                data.torque_by_dq[(cj, ci)] += s.dot(&by_dq);
            }
        }
    }
}

/// Time derivatives of the screw of a body, in the notation of the module.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rates<T> {
    psi_dot: Motion<T>,
    psi_ddot: Motion<T>,
    /// Ψ̇ + Ṡ.
    velocity: Motion<T>,
}

impl<T: Real> Rates<T> {
    pub fn zero() -> Self {
        Self { psi_dot: Motion::zero(), psi_ddot: Motion::zero(), velocity: Motion::zero() }
    }

    fn of(model: &Model<T>, data: &Data<T>, i: usize) -> Self {
        let body = &model.bodies[i];
        // A floating base moves relative to the world, to which gravity gives an upward acceleration.
        let parent = body.parent.filter(|_| body.kind != JointKind::Floating);
        let (v, a) = match parent {
            Some(p) => (data.velocity[p], data.acceleration[p] + data.bias_acceleration[p]),
            None => (Motion::zero(), Motion { linear: -model.gravity, angular: Vector3::zeros() }),
        };
        let screw = &data.screw[i];
        let psi_dot = v.cross_motion(screw);
        let psi_ddot = a.cross_motion(screw) + v.cross_motion(&psi_dot);
        Self { psi_dot, psi_ddot, velocity: psi_dot + screw_rate(data, i) }
    }
}

/// Computes ∂q̈/∂q and ∂q̈/∂q̇ of [`aba`](crate::aba()) at the torques `tau` (n; Nm) into [`Data::ddq_by_q`] and
/// [`Data::ddq_by_dq`]; ∂q̈/∂τ is M⁻¹. The results of [`aba`](crate::aba()) and [`rnea_derivatives`] are computed as
/// well. Needs [`kinematics`](crate::kinematics()) and [`cholesky`](crate::cholesky()).
///
/// ```text
/// ∂q̈/∂q = −M⁻¹ ∂τ/∂q          ∂q̈/∂q̇ = −M⁻¹ ∂τ/∂q̇
/// ```
///
/// # Panics
/// As [`aba`](crate::aba()).
pub fn aba_derivatives<T: Real>(model: &Model<T>, data: &mut Data<T>, tau: &[T]) {
    aba(model, data, tau);
    // Moved out of `data` while it is borrowed.
    let ddq = std::mem::replace(&mut data.ddq, DVector::zeros(0));
    rnea_derivatives(model, data, ddq.as_slice());
    data.ddq = ddq;
    let both = [(&data.torque_by_q, &mut data.ddq_by_q), (&data.torque_by_dq, &mut data.ddq_by_dq)];
    for (torque, ddq) in both {
        ddq.copy_from(torque);
        ddq.neg_mut();
        data.mass_matrix_factor.solve_matrix(ddq);
    }
}
