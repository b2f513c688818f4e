//! A simulated arm whose samples can be changed, and whose commands can be read.

use opspace_backend::{Backend, Capabilities, Command, DeviceFault, GroundTruth, Sample};
use opspace_sim::SimulatedArm;

/// Arm with a function of each sample, which may change it, and one of each command.
pub struct TappedArm<S, C> {
    pub arm: SimulatedArm,
    pub on_sample: S,
    pub on_command: C,
}

impl<S: FnMut(&mut Sample), C: FnMut(Command<'_>)> Backend for TappedArm<S, C> {
    fn capabilities(&self) -> &Capabilities {
        self.arm.capabilities()
    }

    fn read(&mut self, sample: &mut Sample) -> Result<(), DeviceFault> {
        self.arm.read(sample)?;
        (self.on_sample)(sample);
        Ok(())
    }

    fn write(&mut self, command: Command<'_>) -> Result<(), DeviceFault> {
        (self.on_command)(command);
        self.arm.write(command)
    }

    fn stop(&mut self) {
        self.arm.stop();
    }

    fn ground_truth(&self) -> Option<&dyn GroundTruth> {
        self.arm.ground_truth()
    }
}
