//! Arm of a simulation, whichever commands it accepts.
//!
//! At interface cycle k the sensors are read. The command written then takes effect `delay` servo ticks later and acts
//! until the next one takes effect. Between two cycles, and in cycles that the [bus](crate::bus) loses, only the arm's
//! own drives control it.

use crate::config::{ArmConfig, SimulationConfig};
use crate::engine::PhysicsEngine;
use crate::error::SimulationError;
use crate::external::ExternalForceHandle;
use crate::servo_arm::ServoArm;
use crate::shared_arm::SharedArm;
use crate::simulation::Simulation;
use crate::torque_arm::TorqueArm;
use nalgebra::DVector;
use opspace_backend::{
    Backend, Capabilities, Command, CommandKind, DeviceFault, GroundTruth, Sample, TruthLayouts, TruthRow,
};

/// Simulated robot, of the kind that its capabilities state. The table of the [crate] describes its behaviour without commands.
pub enum SimulatedArm {
    /// Robot that accepts positions or velocities.
    Servo(ServoArm),
    /// Robot that accepts torques.
    Torque(TorqueArm),
}

impl Simulation {
    /// Returns the arms, in the order of the configuration. They share the simulation.
    #[must_use]
    pub fn into_arms(self) -> Vec<SimulatedArm> {
        let of_kind = |arm: SharedArm| match arm.capabilities().command {
            CommandKind::Torque => SimulatedArm::Torque(TorqueArm(arm)),
            CommandKind::Position | CommandKind::Velocity => SimulatedArm::Servo(ServoArm(arm)),
        };
        SharedArm::all_of(self).into_iter().map(of_kind).collect()
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

    /// True joint positions, rad or m (n).
    #[must_use]
    pub fn true_q(&self) -> DVector<f64> {
        self.shared().true_q()
    }

    /// True joint velocities, rad/s or m/s (n).
    #[must_use]
    pub fn true_dq(&self) -> DVector<f64> {
        self.shared().true_dq()
    }

    /// Time of the next sample on the robot's clock, s: the time of the next interface cycle that the bus does not
    /// lose. Read the arms of one simulation in the order of these times.
    #[must_use]
    pub fn next_sample_s(&self) -> f64 {
        self.shared().next_sample_s()
    }

    /// Number of the interface cycle of the next sample; the first cycle is 0. Cycles with lower numbers have no
    /// sample: a program that schedules the cycles of several arms by its own clock must skip them.
    #[must_use]
    pub fn next_sample_cycle(&self) -> u64 {
        self.shared().next_sample_cycle()
    }

    /// Handle for external forces on this arm; `None` unless [`ArmConfig::external_forces`] is set.
    #[must_use]
    pub fn external_force(&self) -> Option<ExternalForceHandle> {
        self.shared().external_force()
    }

    fn shared(&self) -> &SharedArm {
        match self {
            Self::Servo(ServoArm(arm)) | Self::Torque(TorqueArm(arm)) => arm,
        }
    }

    fn backend(&mut self) -> &mut dyn Backend {
        match self {
            Self::Servo(arm) => arm,
            Self::Torque(arm) => arm,
        }
    }
}

impl Backend for SimulatedArm {
    fn capabilities(&self) -> &Capabilities {
        self.shared().capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.backend().read(sample)
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        self.backend().write(command)
    }

    fn stop(&mut self) {
        self.backend().stop();
    }

    fn ground_truth(&self) -> Option<&dyn GroundTruth> {
        Some(self.shared())
    }
}

impl GroundTruth for SimulatedArm {
    fn layouts(&self) -> TruthLayouts {
        self.shared().layouts()
    }

    fn visit(&self, visit: &mut dyn FnMut(TruthRow<'_>)) {
        self.shared().visit(visit);
    }

    fn next_sample_cycle(&self) -> Option<u64> {
        Some(self.shared().next_sample_cycle())
    }
}
