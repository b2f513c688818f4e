//! Simulated arm that accepts positions or velocities, as a [`Backend`]: a multirate servo.
//!
//! Its drives close their loops at servo rate, several times per interface cycle. The setpoints written at cycle k take effect
//! `delay` servo ticks later and act until the next ones take effect.

use crate::shared_arm::SharedArm;
use opspace_backend::{Backend, Capabilities, Command, DeviceFault, GroundTruth, Sample};

/// Simulated robot with position or velocity servos. The table of the [crate] describes its behaviour without commands.
pub struct ServoArm(pub(crate) SharedArm);

impl Backend for ServoArm {
    fn capabilities(&self) -> &Capabilities {
        self.0.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.0.read(sample)
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        self.0.with(|arm, plant| arm.write_setpoints(plant, command))
    }

    fn stop(&mut self) {
        self.0.stop();
    }

    fn ground_truth(&self) -> Option<&dyn GroundTruth> {
        Some(&self.0)
    }
}
