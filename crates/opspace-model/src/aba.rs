//! Forward dynamics: the accelerations that torques cause, by the articulated-body algorithm.
//!
//! RBDA table 7.1; in Pinocchio `aba`.

use crate::data::{ArticulatedColumn, ArticulatedInertia, Data};
use crate::model::{JointKind, Model};
use crate::spatial::{Force, Inertia, Motion, Placement};
use nalgebra::{Matrix3, Vector3};

/// q̈ = M⁻¹ (τ − C q̇ − g) under the joint torques `tau` (n; Nm), into [`Data::ddq`] (rad/s²). Needs
/// [`kinematics`](crate::kinematics()). An external wrench f at a frame is τ + Jᵀ f.
///
/// # Panics
/// If `tau` is shorter than the number of joints.
pub fn aba(model: &Model, data: &mut Data, tau: &[f64]) {
    for (i, joint) in model.joints.iter().enumerate() {
        let v = &data.velocity[i];
        data.articulated[i] = ArticulatedInertia::rigid(&joint.inertia);
        data.force[i] = v.cross_force(&joint.inertia.apply(v));
    }
    for i in (0..model.n()).rev() {
        let joint = &model.joints[i];
        let column = data.articulated[i].column(joint.kind);
        let inverse_inertia = 1.0 / (joint.kind.project(&column) + joint.rotor_inertia);
        let torque = tau[i] - joint.kind.project(&data.force[i]);
        data.column[i] = ArticulatedColumn { force: column, inverse_inertia, torque };
        if let Some(p) = joint.parent {
            let beyond = data.articulated[i].without(&column, inverse_inertia);
            let force = data.force[i]
                + beyond.apply(&velocity_product(data, joint.kind, i))
                + column * (torque * inverse_inertia);
            let placement = data.placement_parent[i];
            data.articulated[p].add(&beyond.seen_from(&placement));
            data.force[p] += placement.act_force(&force);
        }
    }
    // Gravity as an upward acceleration of the base.
    let base = Motion { linear: model.base.rotation.tr_mul(&-model.gravity), angular: Vector3::zeros() };
    for (i, joint) in model.joints.iter().enumerate() {
        let parent = joint.parent.map_or(base, |p| data.acceleration[p]);
        let carried =
            data.placement_parent[i].act_inverse_motion(&parent) + velocity_product(data, joint.kind, i);
        let column = &data.column[i];
        let ddq = column.inverse_inertia * (column.torque - carried.dot(&column.force));
        data.ddq[i] = ddq;
        data.acceleration[i] = carried + joint.kind.motion(ddq);
    }
}

/// v × S q̇: what the joint's own speed adds to its body's acceleration.
#[inline]
fn velocity_product(data: &Data, kind: JointKind, i: usize) -> Motion {
    data.velocity[i].cross_motion(&kind.motion(data.dq[i]))
}

/// `x ×` as a matrix.
fn skew(x: &Vector3<f64>) -> Matrix3<f64> {
    x.cross_matrix()
}

impl ArticulatedInertia {
    fn rigid(inertia: &Inertia) -> Self {
        let c = skew(&inertia.com);
        Self {
            linear: Matrix3::from_diagonal_element(inertia.mass),
            coupling: c * inertia.mass,
            angular: inertia.rotational - c * c * inertia.mass,
        }
    }

    /// I S: the force that accelerating the joint by one takes.
    #[inline]
    fn column(&self, kind: JointKind) -> Force {
        match kind {
            JointKind::Prismatic => Force {
                linear: self.linear.column(2).into_owned(),
                angular: self.coupling.column(2).into_owned(),
            },
            JointKind::Revolute | JointKind::Continuous => Force {
                linear: self.coupling.row(2).transpose(),
                angular: self.angular.column(2).into_owned(),
            },
        }
    }

    /// I − U Uᵀ/D: what is left to carry once the joint gives way.
    #[inline]
    fn without(&self, u: &Force, inverse_inertia: f64) -> Self {
        let scaled = *u * inverse_inertia;
        Self {
            linear: self.linear - u.linear * scaled.linear.transpose(),
            coupling: self.coupling - u.angular * scaled.linear.transpose(),
            angular: self.angular - u.angular * scaled.angular.transpose(),
        }
    }

    #[inline]
    fn apply(&self, m: &Motion) -> Force {
        Force {
            linear: self.linear * m.linear + self.coupling.tr_mul(&m.angular),
            angular: self.coupling * m.linear + self.angular * m.angular,
        }
    }

    /// The same inertia in the axes and at the origin of the frame in which `placement` is given.
    #[inline]
    fn seen_from(&self, placement: &Placement) -> Self {
        let r = &placement.rotation;
        let t = skew(&placement.translation);
        let linear = r * self.linear * r.transpose();
        let coupling = r * self.coupling * r.transpose();
        let angular = r * self.angular * r.transpose();
        let moved = coupling + t * linear;
        Self { linear, coupling: moved, angular: angular - coupling * t + t * moved.transpose() }
    }

    #[inline]
    fn add(&mut self, other: &Self) {
        self.linear += other.linear;
        self.coupling += other.coupling;
        self.angular += other.angular;
    }
}
