//! Arm of a shared simulation: what all kinds of robot have.

use crate::engine::Plant;
use crate::external::ExternalForceHandle;
use crate::interface::ArmInterface;
use crate::simulation::Simulation;
use nalgebra::DVector;
use opspace_backend::{Capabilities, DeviceFault, GroundTruth, Sample, TruthLayouts, TruthRow};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Arm of a simulation that its other arms share.
pub(crate) struct SharedArm {
    simulation: Arc<Mutex<Simulation>>,
    index: usize,
    capabilities: Capabilities,
    external: Option<ExternalForceHandle>,
}

impl SharedArm {
    /// Returns the arms of a simulation, in the order of the configuration.
    pub fn all_of(mut simulation: Simulation) -> Vec<Self> {
        let capabilities = std::mem::take(&mut simulation.capabilities);
        let handles: Vec<_> = simulation.arms.iter().map(|arm| arm.external.clone()).collect();
        let simulation = Arc::new(Mutex::new(simulation));
        (capabilities.into_iter().zip(handles).enumerate())
            .map(|(index, (capabilities, external))| Self {
                simulation: Arc::clone(&simulation),
                index,
                capabilities,
                external,
            })
            .collect()
    }

    /// The simulation. After a panic in a step, its arms can still be stopped.
    fn simulation(&self) -> MutexGuard<'_, Simulation> {
        self.simulation.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    pub fn external_force(&self) -> Option<ExternalForceHandle> {
        self.external.clone()
    }

    /// Passes the arm and the plant to `act`.
    pub fn with<T>(&self, act: impl FnOnce(&mut ArmInterface, &dyn Plant) -> T) -> T {
        let Simulation { plant, arms, .. } = &mut *self.simulation();
        act(&mut arms[self.index], &**plant)
    }

    pub fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.simulation().read(self.index, sample)
    }

    pub fn stop(&mut self) {
        self.with(ArmInterface::stop);
    }

    pub fn true_q(&self) -> DVector<f64> {
        self.with(|arm, plant| DVector::from_column_slice(arm.q(plant)))
    }

    pub fn true_dq(&self) -> DVector<f64> {
        self.with(|arm, plant| DVector::from_column_slice(arm.dq(plant)))
    }

    pub fn next_sample_s(&self) -> f64 {
        self.with(|arm, _| arm.next_sample_s())
    }

    pub fn next_sample_cycle(&self) -> u64 {
        self.with(|arm, _| arm.next_sample)
    }
}

impl Drop for SharedArm {
    fn drop(&mut self) {
        self.simulation().arms[self.index].rows.abandon();
    }
}

impl GroundTruth for SharedArm {
    fn layouts(&self) -> TruthLayouts {
        self.simulation().arms[self.index].rows.layouts()
    }

    fn visit(&self, visit: &mut dyn FnMut(TruthRow<'_>)) {
        let simulation = self.simulation();
        let arm = &simulation.arms[self.index];
        arm.rows.visit(&arm.timing, visit);
    }

    fn next_sample_cycle(&self) -> Option<u64> {
        Some(SharedArm::next_sample_cycle(self))
    }
}
