//! Parts of a plant: arms, couplings, objects and scenes.

use crate::environment::EnvironmentObject;
pub use crate::plant_object::{PlantFrame, PlantGrip, PlantObject};
use opspace_model::collision::Capsule;
use opspace_model::{FrameId, Model};
use std::path::PathBuf;
use thiserror::Error;

/// Torque of a drive on its link during a step: `torque − inertia q̈`, with the acceleration q̈ of the joint in the step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointTorque {
    /// Torque on a link that does not accelerate, Nm (N).
    pub torque: f64,
    /// Inertia by which the drivetrain resists the acceleration of the link, in addition to the rotor's, kg m² (kg).
    pub inertia: f64,
}

impl From<f64> for JointTorque {
    /// Torque (Nm, N) that does not depend on the acceleration.
    fn from(torque: f64) -> Self {
        Self { torque, inertia: 0.0 }
    }
}

/// File with objects that a physics engine simulates with the arms.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Scene {
    /// Path of the file, as the user wrote it.
    pub path: PathBuf,
    /// Contents of the file.
    pub text: String,
}

/// Error of a physics engine that cannot build a plant.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("{message}")]
pub struct PlantError {
    /// Description of the cause.
    pub message: String,
    /// File that causes it; `None` for the robot.
    pub file: Option<PathBuf>,
}

/// Parts of a plant.
#[derive(Clone, Debug)]
pub struct PlantConfig {
    /// Arms, in the order of their indices.
    pub arms: Vec<PlantArm>,
    /// Springs between arms.
    pub couplings: Vec<PlantCoupling>,
    /// Objects that arms hold.
    pub objects: Vec<PlantObject>,
    /// Duration of each step, s.
    pub step_s: f64,
}

/// Arm of a plant.
#[derive(Clone, Debug)]
pub struct PlantArm {
    /// True rigid bodies, including rotors on rigid gears.
    pub model: Model,
    /// Start positions, at rest (n; rad or m).
    pub q: Vec<f64>,
    /// Environment objects, each with the frame on which it acts.
    pub contacts: Vec<(FrameId, EnvironmentObject)>,
    /// Collision geometry, for engines that simulate contacts of bodies: capsules, each in the axes of a frame.
    pub capsules: Vec<(FrameId, Capsule)>,
    /// Frames whose contact wrench is read.
    pub sensors: Vec<FrameId>,
}

impl PlantArm {
    /// Returns an arm at rest at `q` (n; rad or m), without environment, collision geometry and sensors.
    #[must_use]
    pub fn new(model: Model, q: Vec<f64>) -> Self {
        Self { model, q, contacts: Vec::new(), capsules: Vec::new(), sensors: Vec::new() }
    }
}

/// Spring and damper between the origins of two frames, relaxed at the start. The force on the first frame is
/// `F = K (d − d₀) + B ḋ`, with d the vector from the first frame to the second; the force on the second is −F.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantCoupling {
    /// Connected frames.
    pub frames: [PlantFrame; 2],
    /// Stiffness K, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping B, Ns/m.
    pub damping_ns_per_m: f64,
}
