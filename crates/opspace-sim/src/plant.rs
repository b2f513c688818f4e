//! Interface between the simulation and a physics engine.
//!
//! A plant consists of rigid bodies and contacts only. Everything local to a joint (motor, friction, end stop, brake,
//! encoder) is the [drivetrain](crate::drivetrain) above it, so that it is the same above any engine. A rotor on a
//! rigid gear is part of the plant's mass matrix; a rotor on an elastic gear is a state of its drivetrain.

use crate::environment::EnvironmentObject;
use crate::external::ExternalForce;
use nalgebra::Vector3;
use opspace_model::{Force, FrameId, Model};

/// Rigid bodies of any number of arms, and the objects that touch them.
pub trait Plant {
    /// True joint positions of all joints, one arm after the other, rad or m.
    fn q(&self) -> &[f64];

    /// True joint velocities, in the order of [`q`](Self::q), rad/s or m/s.
    fn dq(&self) -> &[f64];

    /// Advances by `dt_s` (s) from the time `time_s` (s on the simulation's clock), with `joint_torques` (Nm or N, in
    /// the
    /// order of [`q`](Self::q)) held over the step.
    fn step(&mut self, time_s: f64, dt_s: f64, joint_torques: &[f64]);

    /// The wrench of the last step's contacts and external force on the body of `frame`, at the frame's origin, in its
    /// axes, on the robot (N, Nm).
    fn contact_wrench(&mut self, frame: PlantFrame) -> Force;

    /// The force of a contact on an arm during the last step, world axes (N). Contacts are in the order of
    /// [`PlantArm::contacts`], then the arm's couplings in the order of [`PlantConfig::couplings`].
    fn contact_force(&self, arm: usize, contact: usize) -> Vector3<f64>;

    /// Sets the external force on an arm; it acts from the next step on.
    fn push(&mut self, arm: usize, force: Option<ExternalForce>);

    /// The external force on an arm during the last step, world axes (N).
    fn external_force(&self, arm: usize) -> Vector3<f64>;
}

/// A frame of one of the arms of a plant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlantFrame {
    /// Index of the arm.
    pub arm: usize,
    /// Its frame.
    pub frame: FrameId,
}

/// Parts of a plant.
#[derive(Clone, Debug)]
pub struct PlantConfig {
    /// The arms.
    pub arms: Vec<PlantArm>,
    /// Springs between arms.
    pub couplings: Vec<PlantCoupling>,
}

/// An arm of a plant.
#[derive(Clone, Debug)]
pub struct PlantArm {
    /// The true rigid bodies, with rotors on rigid gears.
    pub model: Model,
    /// Positions at the start, at rest, rad or m (n).
    pub q: Vec<f64>,
    /// Objects of the environment, each with the frame that it touches.
    pub contacts: Vec<(FrameId, EnvironmentObject)>,
}

/// A spring and a damper between the origins of two frames, relaxed at the start: `F = K (d − d₀) + B ḋ` on the first,
/// with d from the first to the second, and −F on the second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlantCoupling {
    /// Frames that it connects.
    pub frames: [PlantFrame; 2],
    /// Stiffness K, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping B, Ns/m.
    pub damping_ns_per_m: f64,
}
