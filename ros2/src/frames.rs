//! Frames in which targets are stated: those of the URDF, and static ones of `/tf_static` that hang on them.

use crate::messages::{Pose, Quaternion, TfMessage, TransformStamped, Vector3};
use nalgebra::UnitQuaternion;
use opspace_model::{FrameId, Model, Placement};
use std::collections::HashMap;

/// Name of the world's frame.
pub const WORLD: &str = "world";

/// Largest number of static frames between a frame and the robot.
const LONGEST_CHAIN: usize = 100;

/// Largest deviation of a quaternion's length from 1.
const QUATERNION_TOLERANCE: f64 = 1e-3;

/// Frame by its placement in a frame of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameRef {
    /// Frame of the model, which may move; `None` is the world.
    pub frame: Option<FrameId>,
    /// Placement in it.
    pub offset: Placement,
}

impl FrameRef {
    /// The world's frame.
    #[must_use]
    pub fn world() -> Self {
        Self { frame: None, offset: Placement::identity() }
    }
}

/// Frames by name.
#[derive(Clone, Debug)]
pub struct Frames {
    model: Model,
    fixed: HashMap<String, (String, Placement)>,
}

impl Frames {
    /// Returns the frames of a model.
    #[must_use]
    pub fn new(model: Model) -> Self {
        Self { model, fixed: HashMap::new() }
    }

    /// Adds static frames; one with wrong numbers is left out.
    pub fn add(&mut self, message: &TfMessage) {
        for TransformStamped { header, child_frame_id, transform } in &message.transforms {
            if let Some(placement) = placement(transform.translation, transform.rotation) {
                let parent = plain(&header.frame_id).to_owned();
                self.fixed.insert(plain(child_frame_id).to_owned(), (parent, placement));
            }
        }
    }

    /// Finds a frame by its name; an empty name is the world.
    ///
    /// # Errors
    /// A frame that neither the URDF nor a static frame has, in words.
    pub fn find(&self, name: &str) -> Result<FrameRef, String> {
        let mut offset = Placement::identity();
        let mut at = plain(name);
        for _ in 0..LONGEST_CHAIN {
            if let Ok(frame) = self.model.frame_id(at) {
                return Ok(FrameRef { frame: Some(frame), offset });
            }
            if at.is_empty() || at == WORLD {
                return Ok(FrameRef { frame: None, offset });
            }
            let Some((parent, placement)) = self.fixed.get(at) else { break };
            offset = *placement * offset;
            at = parent;
        }
        Err(format!("frame '{name}' is none of the URDF, and no static frame leads to one"))
    }
}

/// Placement of a translation and a rotation; `None` for numbers that are not finite, or a quaternion whose length is not 1.
#[must_use]
pub fn placement(translation: Vector3, rotation: Quaternion) -> Option<Placement> {
    let quaternion = nalgebra::Quaternion::new(rotation.w, rotation.x, rotation.y, rotation.z);
    let position: [f64; 3] = translation.into();
    // False for NaN.
    let is_unit = (quaternion.norm() - 1.0).abs() <= QUATERNION_TOLERANCE;
    if !is_unit || position.iter().any(|value| !value.is_finite()) {
        return None;
    }
    let rotation = UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix();
    Some(Placement { rotation: *rotation.matrix(), translation: position.into() })
}

/// Pose of a position (m) and a quaternion w, x, y, z.
#[must_use]
pub fn pose(position: &[f64], quaternion: &[f64]) -> Pose {
    let (&[x, y, z], &[qw, qx, qy, qz]) = (position, quaternion) else { return Pose::default() };
    Pose { position: [x, y, z].into(), orientation: Quaternion { x: qx, y: qy, z: qz, w: qw } }
}

/// Name without the slash that old programs put before it.
fn plain(name: &str) -> &str {
    name.strip_prefix('/').unwrap_or(name)
}
