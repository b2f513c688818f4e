//! Forward dynamics by the articulated-body algorithm.
//!
//! RBDA table 7.1; in Pinocchio `aba`.
//!
//! ```
//! # let urdf = include_str!("../urdf/ur5e.urdf");
//! use opspace_model::{Data, Model, aba, kinematics, rnea};
//!
//! let model = Model::from_urdf(urdf)?.model;
//! let mut data = Data::new(&model);
//! kinematics(&model, &mut data, &[0.1; 6], &[0.5; 6]);
//! rnea(&model, &mut data, &[1.0; 6]);
//! let torque = data.torque.clone();
//! aba(&model, &mut data, torque.as_slice());
//! assert!(data.ddq.iter().all(|ddq| (ddq - 1.0).abs() < 1e-10));
//! # Ok::<(), opspace_model::UrdfError>(())
//! ```

use crate::cholesky::cholesky;
use crate::crba::{bodies, crba};
use crate::data::{ArticulatedColumn, ArticulatedInertia, Data};
use crate::jacobian::{add_external, screw_rate};
use crate::model::{FrameId, Model};
use crate::real::Real;
use crate::rnea::bias;
use crate::spatial::{Force, Motion, SpatialInertia, apply, apply_transposed, skew};
use nalgebra::{DVector, Matrix3, Vector3};

/// Computes q̈ = M⁻¹ (τ − C q̇ − g) for the joint torques `tau` (n; Nm) into [`Data::ddq`] (rad/s²). Needs
/// [`kinematics`](crate::kinematics()). The result is not finite if the bodies moved by a joint have no inertia in its
/// direction.
///
/// With mimic constraints, q̈ is computed from the mass matrix instead. The mass matrix, its factor and the bias in
/// `data` are then updated as well.
///
/// # Panics
/// If `tau` is shorter than the number of joints.
pub fn aba<T: Real>(model: &Model<T>, data: &mut Data<T>, tau: &[T]) {
    let tau = &tau[..model.n()];
    if model.has_mimic_constraints() {
        solve_mass_matrix(model, data, tau);
        return;
    }
    bodies(model, data);
    let Data { composite, velocity, articulated, force, .. } = data;
    let rigid = composite.iter().zip(velocity.iter());
    for ((articulated, force), (inertia, v)) in articulated.iter_mut().zip(force.iter_mut()).zip(rigid) {
        articulated.set_rigid(inertia);
        *force = v.cross_force(&inertia.apply(v));
    }
    for (i, body) in model.bodies.iter().enumerate().rev() {
        let screw = &data.screw[i];
        let articulated = &data.articulated[i];
        let column = articulated.apply(screw);
        let inverse_inertia = T::one() / (screw.dot(&column) + model.rotor_inertia[i]);
        let torque = tau[i] - screw.dot(&data.force[i]);
        data.column[i] = ArticulatedColumn { force: column, inverse_inertia, torque };
        if let Some(p) = body.parent {
            // The force on the parent is I_a c + p + U u/D, with I_a = I − U Uᵀ/D.
            let c = velocity_product(data, i);
            let joint_response = (torque - c.dot(&column)) * inverse_inertia;
            let force = data.force[i] + articulated.apply(&c) + column * joint_response;
            data.force[p] += force;
            let (before, from) = data.articulated.split_at_mut(i);
            before[p].add_projected(&from[0], &column, inverse_inertia);
        }
    }
    // Gravity is modelled as an upward acceleration of the base.
    let base = Motion { linear: -model.gravity, angular: Vector3::zeros() };
    for (i, body) in model.bodies.iter().enumerate() {
        let inherited = body.parent.map_or(base, |p| data.acceleration[p]) + velocity_product(data, i);
        let column = &data.column[i];
        let ddq = column.inverse_inertia * (column.torque - inherited.dot(&column.force));
        data.ddq[i] = ddq;
        data.acceleration[i] = inherited + data.screw[i] * ddq;
    }
}

/// Computes q̈ = M⁻¹ (τ − C q̇ − g + Σ Jᵀ f): [`aba`] with wrenches f that act on the robot at frames (N, Nm; in world
/// axes, at the origin of each frame). [`Data::torque`] then contains τ + Σ Jᵀ f.
///
/// # Panics
/// As [`aba`].
pub fn aba_external<T: Real>(
    model: &Model<T>,
    data: &mut Data<T>,
    tau: &[T],
    wrenches: &[(FrameId, Force<T>)],
) {
    data.torque.copy_from_slice(&tau[..model.n()]);
    for (frame, wrench) in wrenches {
        add_external(model, data, *frame, wrench);
    }
    // Moved out of `data` while it is borrowed.
    let torque = std::mem::replace(&mut data.torque, DVector::zeros(0));
    aba(model, data, torque.as_slice());
    data.torque = torque;
}

/// Computes the forward dynamics of a model with mimic constraints, by factorization of the mass matrix.
fn solve_mass_matrix<T: Real>(model: &Model<T>, data: &mut Data<T>, tau: &[T]) {
    crba(model, data);
    bias(model, data);
    if !cholesky(data) {
        data.ddq.fill(T::splat(f64::NAN));
        return;
    }
    for ((ddq, &tau), &bias) in data.ddq.iter_mut().zip(tau).zip(&data.bias) {
        *ddq = tau - bias;
    }
    data.mass_matrix_factor.solve(data.ddq.as_mut_slice());
}

/// Returns the velocity product v × S q̇: the part of the body's acceleration that is due to the velocity of its joint.
#[inline(always)]
fn velocity_product<T: Real>(data: &Data<T>, i: usize) -> Motion<T> {
    screw_rate(data, i) * data.dq[i]
}

impl<T: Real> ArticulatedInertia<T> {
    #[inline(always)]
    fn set_rigid(&mut self, inertia: &SpatialInertia<T>) {
        self.linear = Matrix3::from_diagonal_element(inertia.mass);
        self.coupling = skew(&inertia.first_moment);
        self.angular = inertia.second_moment;
    }

    #[inline(always)]
    fn apply(&self, m: &Motion<T>) -> Force<T> {
        Force {
            linear: apply(&self.linear, &m.linear) + apply_transposed(&self.coupling, &m.angular),
            angular: apply(&self.coupling, &m.linear) + apply(&self.angular, &m.angular),
        }
    }

    /// Adds I − U Uᵀ/D of `other`: its apparent inertia across the free joint.
    #[inline(always)]
    fn add_projected(&mut self, other: &Self, u: &Force<T>, inverse_inertia: T) {
        let scaled = *u * inverse_inertia;
        for c in 0..3 {
            for r in 0..3 {
                self.linear[(r, c)] += other.linear[(r, c)] - u.linear[r] * scaled.linear[c];
                self.coupling[(r, c)] += other.coupling[(r, c)] - u.angular[r] * scaled.linear[c];
                self.angular[(r, c)] += other.angular[(r, c)] - u.angular[r] * scaled.angular[c];
            }
        }
    }
}
