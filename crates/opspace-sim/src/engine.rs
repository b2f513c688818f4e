//! Interface between the simulation and a physics engine.
//!
//! A plant contains rigid bodies and contacts only. Everything local to a joint (motor, friction, end stop, brake,
//! encoder) belongs to the [drivetrain](crate::drivetrain), which is the same for any engine. A rotor on a rigid gear
//! is part of the plant's mass matrix; a rotor on an elastic gear is a state of its drivetrain.

use crate::environment::EnvironmentObject;
use crate::external::ExternalForce;
use crate::held_object::HeldObject;
use crate::plant::{JointTorque, PlantConfig, PlantError, PlantFrame, Scene};
use crate::plant_arms::PlantArms;
use nalgebra::Vector3;
use opspace_model::Force;
use std::fmt;

/// Rigid bodies of any number of arms, and the environment objects that act on them.
///
/// An engine advances the [`PlantArms`] that it has, and inherits the methods that ask them.
pub trait Plant: Send {
    /// Joint states, environment and contacts of the arms.
    fn arms(&self) -> &PlantArms;

    /// Joint states, environment and contacts of the arms, to be changed.
    fn arms_mut(&mut self) -> &mut PlantArms;

    /// True joint positions of all joints, one arm after the other, rad or m.
    fn q(&self) -> &[f64] {
        self.arms().q()
    }

    /// True joint velocities, in the order of [`q`](Self::q), rad/s or m/s.
    fn dq(&self) -> &[f64] {
        self.arms().dq()
    }

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
    /// robot, is expressed in the frame's axes and refers to the frame's origin. An engine with contacts of its own adds theirs.
    fn contact_wrench(&mut self, frame: PlantFrame) -> Force {
        self.arms().contact_wrench(frame)
    }

    /// Force of a contact on an arm during the last step, world axes (N). Contacts are ordered as
    /// [`PlantArm::contacts`](crate::PlantArm::contacts), followed by the arm's couplings in the order of [`PlantConfig::couplings`], and by its frames
    /// that hold objects, in the order of [`PlantConfig::objects`] and [`PlantObject::hands`](crate::PlantObject::hands).
    fn contact_force(&self, arm: usize, contact: usize) -> Vector3<f64> {
        self.arms().contact_force(arm, contact)
    }

    /// Moment of a contact on an arm during the last step about the contact's point, world axes (Nm): zero except for the
    /// frames that hold objects. Contacts are ordered as in [`contact_force`](Self::contact_force).
    fn contact_moment(&self, arm: usize, contact: usize) -> Vector3<f64> {
        self.arms().contact_moment(arm, contact)
    }

    /// Work that the force of a contact has done on an arm since the start of control, J. Contacts are ordered as in
    /// [`contact_force`](Self::contact_force).
    fn contact_work(&self, arm: usize, contact: usize) -> f64 {
        self.arms().contact_work(arm, contact)
    }

    /// Environment object of an arm, in the order of [`PlantArm::contacts`](crate::PlantArm::contacts), with its state after the last step; `None`
    /// for any other contact.
    fn environment_object(&self, arm: usize, contact: usize) -> Option<&EnvironmentObject> {
        self.arms().environment_object(arm, contact)
    }

    /// Object that arms hold, in the order of [`PlantConfig::objects`], with its state after the last step.
    fn held_object(&self, object: usize) -> &HeldObject {
        self.arms().held_object(object)
    }

    /// Sets the external force on an arm from the next step on; `None` removes it.
    fn push(&mut self, arm: usize, force: Option<ExternalForce>) {
        self.arms_mut().push(arm, force);
    }

    /// External force on an arm during the last step, world axes (N).
    fn external_force(&self, arm: usize) -> Vector3<f64> {
        self.arms().external_force(arm)
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
