//! Interface between the simulation and a physics engine.
//!
//! A plant contains rigid bodies and contacts only. Everything local to a joint (motor, friction, end stop, brake,
//! encoder) belongs to the [drivetrain](crate::drivetrain), which is the same for any engine. A rotor on a rigid gear
//! is part of the plant's mass matrix; a rotor on an elastic gear is a state of its drivetrain.

use crate::environment::EnvironmentObject;
use crate::external::ExternalForce;
use nalgebra::Vector3;
use opspace_model::{Force, FrameId, Model};

/// Rigid bodies of any number of arms, and the environment objects that act on them.
pub trait Plant {
    /// True joint positions of all joints, one arm after the other, rad or m.
    fn q(&self) -> &[f64];

    /// True joint velocities, in the order of [`q`](Self::q), rad/s or m/s.
    fn dq(&self) -> &[f64];

    /// Advances by `dt_s` (s) from the time `time_s` (s on the simulation's clock). `joint_torques` (Nm or N, in the
    /// order of [`q`](Self::q)) are constant over the step.
    fn step(&mut self, time_s: f64, dt_s: f64, joint_torques: &[f64]);

    /// Returns the wrench (N, Nm) of the last step's contacts and external force on the body of `frame`. It acts on the
    /// robot, is expressed in the frame's axes and refers to the frame's origin.
    fn contact_wrench(&mut self, frame: PlantFrame) -> Force;

    /// Force of a contact on an arm during the last step, world axes (N). Contacts are ordered as
    /// [`PlantArm::contacts`], followed by the arm's couplings in the order of [`PlantConfig::couplings`].
    fn contact_force(&self, arm: usize, contact: usize) -> Vector3<f64>;

    /// Sets the external force on an arm from the next step on; `None` removes it.
    fn push(&mut self, arm: usize, force: Option<ExternalForce>);

    /// External force on an arm during the last step, world axes (N).
    fn external_force(&self, arm: usize) -> Vector3<f64>;
}

/// Frame of an arm of a plant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlantFrame {
    /// Index of the arm.
    pub arm: usize,
    /// Frame of that arm's model.
    pub frame: FrameId,
}

/// Parts of a plant.
#[derive(Clone, Debug)]
pub struct PlantConfig {
    /// Arms, in the order of their indices.
    pub arms: Vec<PlantArm>,
    /// Springs between arms.
    pub couplings: Vec<PlantCoupling>,
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
