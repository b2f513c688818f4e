//! Characteristic length of a task, and the reach of a frame.

use crate::tasks::controlled_frame::ControlledFrame;
use opspace_model::{FrameId, JointKind, Model};

/// Characteristic length that scales a task's rotations to displacements, m: the reach of the controlled frame.
#[must_use]
pub fn characteristic_length(model: &Model, controlled: ControlledFrame) -> f64 {
    match controlled {
        ControlledFrame::Frame(frame) | ControlledFrame::Relative { frame, .. } => reach(model, frame),
        // The centre of mass does not rotate.
        ControlledFrame::CenterOfMass => 1.0,
    }
}

/// Upper bound of a frame's distance from the first joint that moves it, m: the sum of the distances between
/// consecutive joints and of the strokes of prismatic joints; 1 m if the sum is zero.
#[must_use]
pub fn reach(model: &Model, frame: FrameId) -> f64 {
    let mut sum = model.frame(frame).placement.translation.norm();
    for i in model.ancestors(frame) {
        let body = &model.bodies()[i];
        if body.parent.is_some() {
            sum += body.origin.translation.norm();
        }
        if body.kind == JointKind::Prismatic {
            let (lower, upper) = model.joints()[body.joint].limits.range(body.kind);
            sum += lower.abs().max(upper.abs());
        }
    }
    if sum > 0.0 { sum } else { 1.0 }
}
