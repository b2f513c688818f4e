//! Simulated arm that accepts torques, as a [`Backend`]: they go straight to its motors.
//!
//! The torques written at cycle k take effect `delay` servo ticks later and act until the next ones take effect.

use crate::shared_arm::SharedArm;
use opspace_backend::{Backend, Capabilities, Command, DeviceFault, GroundTruth, Sample};

/// Simulated torque robot. The table of the [crate] describes its behaviour without commands.
pub struct TorqueArm(pub(crate) SharedArm);

impl Backend for TorqueArm {
    fn capabilities(&self) -> &Capabilities {
        self.0.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.0.read(sample)
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        self.0.with(|arm, plant| arm.write_torques(plant, command))
    }

    fn stop(&mut self) {
        self.0.stop();
    }

    fn ground_truth(&self) -> Option<&dyn GroundTruth> {
        Some(&self.0)
    }
}
