//! Simulated arm as a [`Backend`].
//!
//! At interface cycle k the sensors are read. The command written then takes effect `delay` servo ticks later and acts
//! until the next one takes effect. Between two cycles, and in cycles that the [bus](crate::bus) loses, only the arm's
//! own drives control it.

use crate::config::{ArmConfig, SimulationConfig};
use crate::error::SimulationError;
use crate::external::ExternalForceHandle;
use crate::plant::PhysicsEngine;
use crate::simulation::Simulation;
use nalgebra::DVector;
use opspace_backend::{
    Backend, Capabilities, Command, DeviceFault, GroundTruth, Sample, TruthLayouts, TruthRow,
};
use std::cell::RefCell;
use std::rc::Rc;

/// Simulated robot that accepts positions, velocities or torques. The table of the [crate] describes its behaviour
/// without commands.
pub struct SimulatedArm {
    simulation: Rc<RefCell<Simulation>>,
    index: usize,
    capabilities: Capabilities,
    external: Option<ExternalForceHandle>,
}

impl Simulation {
    /// Returns the arms, in the order of the configuration. They share the simulation.
    #[must_use]
    pub fn into_arms(mut self) -> Vec<SimulatedArm> {
        let capabilities = std::mem::take(&mut self.capabilities);
        let handles: Vec<_> = self.arms.iter().map(|arm| arm.external.clone()).collect();
        let simulation = Rc::new(RefCell::new(self));
        (capabilities.into_iter().zip(handles).enumerate())
            .map(|(index, (capabilities, external))| {
                SimulatedArm::of(Rc::clone(&simulation), index, capabilities, external)
            })
            .collect()
    }
}

impl SimulatedArm {
    /// Returns an arm in a simulation of its own, at rest at its start position, holding itself.
    ///
    /// # Errors
    /// If parameters contradict each other; the error names the key.
    pub fn new(config: ArmConfig) -> Result<Self, SimulationError> {
        let config = SimulationConfig { arms: vec![config], ..SimulationConfig::default() };
        Simulation::new(config)?.into_arms().pop().ok_or(SimulationError::NoArm)
    }

    /// Returns an arm like [`new`](Self::new), simulated by another physics engine.
    ///
    /// # Errors
    /// As [`new`](Self::new), or if the engine cannot simulate the arm.
    pub fn on_engine(config: ArmConfig, engine: &dyn PhysicsEngine) -> Result<Self, SimulationError> {
        let config = SimulationConfig { arms: vec![config], ..SimulationConfig::default() };
        let simulation = Simulation::with_plant(config, |parts| engine.build(parts))?;
        simulation.into_arms().pop().ok_or(SimulationError::NoArm)
    }

    pub(crate) fn of(
        simulation: Rc<RefCell<Simulation>>,
        index: usize,
        capabilities: Capabilities,
        external: Option<ExternalForceHandle>,
    ) -> Self {
        Self { simulation, index, capabilities, external }
    }

    /// True joint positions, rad or m (n).
    #[must_use]
    pub fn true_q(&self) -> DVector<f64> {
        let simulation = self.simulation.borrow();
        DVector::from_column_slice(simulation.arms[self.index].q(&*simulation.plant))
    }

    /// True joint velocities, rad/s or m/s (n).
    #[must_use]
    pub fn true_dq(&self) -> DVector<f64> {
        let simulation = self.simulation.borrow();
        DVector::from_column_slice(simulation.arms[self.index].dq(&*simulation.plant))
    }

    /// Time of the next sample on the robot's clock, s: the time of the next interface cycle that the bus does not
    /// lose. Read the arms of one simulation in the order of these times.
    #[must_use]
    pub fn next_sample_s(&self) -> f64 {
        self.simulation.borrow().arms[self.index].next_sample_s()
    }

    /// Number of the interface cycle of the next sample; the first cycle is 0. Cycles with lower numbers have no
    /// sample: a program that schedules the cycles of several arms by its own clock must skip them.
    #[must_use]
    pub fn next_sample_cycle(&self) -> u64 {
        self.simulation.borrow().arms[self.index].next_sample
    }

    /// Handle for external forces on this arm; `None` unless [`ArmConfig::external_forces`] is set.
    #[must_use]
    pub fn external_force(&self) -> Option<ExternalForceHandle> {
        self.external.clone()
    }
}

impl Drop for SimulatedArm {
    fn drop(&mut self) {
        if let Ok(mut simulation) = self.simulation.try_borrow_mut() {
            simulation.arms[self.index].rows.abandon();
        }
    }
}

impl Backend for SimulatedArm {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.simulation.borrow_mut().read(self.index, sample)
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        let Simulation { plant, arms, .. } = &mut *self.simulation.borrow_mut();
        arms[self.index].write(&**plant, command)
    }

    fn stop(&mut self) {
        let Simulation { plant, arms, .. } = &mut *self.simulation.borrow_mut();
        arms[self.index].stop(&**plant);
    }

    fn ground_truth(&self) -> Option<&dyn GroundTruth> {
        Some(self)
    }
}

impl GroundTruth for SimulatedArm {
    fn layouts(&self) -> TruthLayouts {
        self.simulation.borrow().arms[self.index].rows.layouts()
    }

    fn visit(&self, visit: &mut dyn FnMut(TruthRow<'_>)) {
        let arm = &self.simulation.borrow().arms[self.index];
        arm.rows.visit(&arm.timing, visit);
    }

    fn next_sample_cycle(&self) -> Option<u64> {
        Some(SimulatedArm::next_sample_cycle(self))
    }
}
