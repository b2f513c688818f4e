//! The mass matrix, by the composite-rigid-body algorithm.
//!
//! RBDA table 6.2; in Pinocchio `crba`.

use crate::data::Data;
use crate::model::Model;

/// M(q) with the rotors' inertias on its diagonal, into [`Data::mass_matrix`] (n × n, full, kg m²). Needs
/// [`kinematics`](crate::kinematics()).
///
/// Column i is the torque of every joint while joint i alone accelerates at 1 rad/s²: it moves only its
/// subtree, as one rigid body, and only its ancestors feel it.
pub fn crba(model: &Model, data: &mut Data) {
    data.mass_matrix.fill(0.0);
    for (composite, joint) in data.composite.iter_mut().zip(&model.joints) {
        *composite = joint.inertia;
    }
    for i in (0..model.n()).rev() {
        let joint = &model.joints[i];
        if let Some(p) = joint.parent {
            let carried = data.placement_parent[i].act_inertia(&data.composite[i]);
            data.composite[p] = data.composite[p] + carried;
        }
        let mut force = data.composite[i].apply(&joint.kind.motion(1.0));
        data.mass_matrix[(i, i)] = joint.kind.project(&force) + joint.rotor_inertia;
        let mut j = i;
        while let Some(p) = model.joints[j].parent {
            force = data.placement_parent[j].act_force(&force);
            j = p;
            let entry = model.joints[j].kind.project(&force);
            data.mass_matrix[(i, j)] = entry;
            data.mass_matrix[(j, i)] = entry;
        }
    }
}
