//! Plant of the library: rigid bodies simulated with the articulated-body algorithm and midpoint steps.

use crate::engine::{PhysicsEngine, Plant};
use crate::plant::{JointTorque, PlantConfig, PlantError, Scene};
use crate::plant_arms::PlantArms;

/// Plant of any number of arms. Joint torques and contact forces are constant over a step, the latter those in its middle;
/// the rigid bodies are integrated to second order.
pub struct RigidPlant {
    arms: PlantArms,
}

impl RigidPlant {
    /// Returns the plant at rest at its start.
    ///
    /// # Panics
    /// If the number of start positions differs from the number of joints, or a coupling names an arm that doesn't
    /// exist.
    #[must_use]
    pub fn new(config: PlantConfig) -> Self {
        Self { arms: PlantArms::new(config) }
    }
}

/// Engine that builds the library's own plant.
#[derive(Clone, Copy, Debug, Default)]
pub struct RigidEngine;

impl RigidEngine {
    /// Name in results, logs and on the command line.
    pub const NAME: &'static str = "own";
}

impl PhysicsEngine for RigidEngine {
    fn name(&self) -> &str {
        Self::NAME
    }

    fn version(&self) -> &str {
        env!("CARGO_PKG_VERSION")
    }

    fn scene(&self) -> Option<&Scene> {
        None
    }

    fn build(&self, parts: PlantConfig) -> Result<Box<dyn Plant>, PlantError> {
        Ok(Box::new(RigidPlant::new(parts)))
    }
}

impl Plant for RigidPlant {
    fn arms(&self) -> &PlantArms {
        &self.arms
    }

    fn arms_mut(&mut self) -> &mut PlantArms {
        &mut self.arms
    }

    fn step(&mut self, time_s: f64, dt_s: f64, torques: &[JointTorque]) {
        self.arms.begin_step(time_s, dt_s, torques);
        self.arms.end_step_rigid(dt_s);
    }

    fn end_velocities(&mut self, time_s: f64, dt_s: f64, torques: &[JointTorque], dq: &mut [f64]) -> bool {
        self.arms.begin_step(time_s, dt_s, torques);
        self.arms.end_velocities_rigid(dt_s, dq);
        true
    }
}
