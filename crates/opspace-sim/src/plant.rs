//! Interface between the simulation and a physics engine.
//!
//! A plant contains rigid bodies and contacts only. Everything local to a joint (motor, friction, end stop, brake,
//! encoder) belongs to the [drivetrain](crate::drivetrain), which is the same for any engine. A rotor on a rigid gear
//! is part of the plant's mass matrix; a rotor on an elastic gear is a state of its drivetrain.

use crate::environment::EnvironmentObject;
use crate::external::ExternalForce;
use crate::held_object::HeldObject;
pub use crate::plant_object::{PlantFrame, PlantGrip, PlantObject};
use nalgebra::Vector3;
use opspace_model::collision::Capsule;
use opspace_model::{Force, FrameId, Model};
use std::fmt;
use std::path::PathBuf;
use thiserror::Error;

/// Rigid bodies of any number of arms, and the environment objects that act on them.
pub trait Plant {
    /// True joint positions of all joints, one arm after the other, rad or m.
    fn q(&self) -> &[f64];

    /// True joint velocities, in the order of [`q`](Self::q), rad/s or m/s.
    fn dq(&self) -> &[f64];

    /// Advances by `dt_s` (s) from the time `time_s` (s after the start of control). `torques`, in the order of
    /// [`q`](Self::q), are those of the drives on the links during the step.
    fn step(&mut self, time_s: f64, dt_s: f64, torques: &[JointTorque]);

    /// Writes the velocities, in the order of [`q`](Self::q) (rad/s, m/s), to which [`step`](Self::step) with the same arguments would
    /// lead. It is called before that step, with other torques again if they depend on the velocities. Returns false if the
    /// plant does not know; joints with torques that bend sharply are then less accurate.
    fn end_velocities(&mut self, time_s: f64, dt_s: f64, torques: &[JointTorque], dq: &mut [f64]) -> bool {
        let _ = (time_s, dt_s, torques, dq);
        false
    }

    /// Returns the wrench (N, Nm) of the last step's contacts and external force on the body of `frame`. It acts on the
    /// robot, is expressed in the frame's axes and refers to the frame's origin.
    fn contact_wrench(&mut self, frame: PlantFrame) -> Force;

    /// Force of a contact on an arm during the last step, world axes (N). Contacts are ordered as
    /// [`PlantArm::contacts`], followed by the arm's couplings in the order of [`PlantConfig::couplings`], and by its frames
    /// that hold objects, in the order of [`PlantConfig::objects`] and [`PlantObject::hands`].
    fn contact_force(&self, arm: usize, contact: usize) -> Vector3<f64>;

    /// Moment of a contact on an arm during the last step about the contact's point, world axes (Nm): zero except for the
    /// frames that hold objects. Contacts are ordered as in [`contact_force`](Self::contact_force).
    fn contact_moment(&self, arm: usize, contact: usize) -> Vector3<f64>;

    /// Work that the force of a contact has done on an arm since the start of control, J. Contacts are ordered as in
    /// [`contact_force`](Self::contact_force).
    fn contact_work(&self, arm: usize, contact: usize) -> f64;

    /// Environment object of an arm, in the order of [`PlantArm::contacts`], with its state after the last step; `None`
    /// for any other contact.
    fn environment_object(&self, arm: usize, contact: usize) -> Option<&EnvironmentObject>;

    /// Object that arms hold, in the order of [`PlantConfig::objects`], with its state after the last step.
    fn held_object(&self, object: usize) -> &HeldObject;

    /// Sets the external force on an arm from the next step on; `None` removes it.
    fn push(&mut self, arm: usize, force: Option<ExternalForce>);

    /// External force on an arm during the last step, world axes (N).
    fn external_force(&self, arm: usize) -> Vector3<f64>;
}

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

/// Physics engine in place of the library's plant. Threads that run simulations side by side share it.
pub trait PhysicsEngine: fmt::Debug + Send + Sync {
    /// Name in files and on the command line, for example `mujoco`.
    fn name(&self) -> &str;

    /// Version of the engine.
    fn version(&self) -> &str;

    /// Scene of the user that is simulated with the arms, if any.
    fn scene(&self) -> Option<&Scene>;

    /// Builds the plant of a simulation.
    ///
    /// # Errors
    /// Parts or a scene that the engine cannot simulate.
    fn build(&self, parts: PlantConfig) -> Result<Box<dyn Plant>, PlantError>;
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
