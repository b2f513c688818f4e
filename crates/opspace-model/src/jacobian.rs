//! The world-aligned Jacobian: how a frame moves when the joints do.
//!
//! In Pinocchio `getFrameJacobian` with `LOCAL_WORLD_ALIGNED`.

use crate::data::Data;
use crate::kinematics::frame_placement;
use crate::model::{FrameId, JointKind, Model};
use nalgebra::Matrix6xX;

/// J (6 × n) with J q̇ = [`frame_velocity`](crate::frame_velocity): world axes, at the frame's origin,
/// linear rows first. A revolute joint's column is `[z × (p − o); z]`, a prismatic one's `[z; 0]`, with z
/// its axis and o its origin. Needs [`kinematics`](crate::kinematics()).
///
/// # Panics
/// If `jacobian` doesn't have n columns.
pub fn frame_jacobian(model: &Model, data: &Data, frame: FrameId, jacobian: &mut Matrix6xX<f64>) {
    assert_eq!(jacobian.ncols(), model.n(), "one Jacobian column a joint");
    let p = frame_placement(model, data, frame).translation;
    jacobian.fill(0.0);
    for i in model.support(frame) {
        let body = &data.placement_world[i];
        let z = body.rotation.column(2).into_owned();
        let mut column = jacobian.column_mut(i);
        match model.joints[i].kind {
            JointKind::Prismatic => column.fixed_rows_mut::<3>(0).copy_from(&z),
            JointKind::Revolute | JointKind::Continuous => {
                column.fixed_rows_mut::<3>(0).copy_from(&z.cross(&(p - body.translation)));
                column.fixed_rows_mut::<3>(3).copy_from(&z);
            }
        }
    }
}
