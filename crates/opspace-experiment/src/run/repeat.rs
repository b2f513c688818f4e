//! Repeated simulation of a log: files and seed give the robot and its environment, and the logged targets, stop requests and external
//! forces are its inputs.

use crate::run::error::RunError;
use crate::run::execute::{Progress, RunResult};
use crate::run::experiment::Experiment;
use opspace_backend::signal_names::EXTERNAL_CHANNEL;
use opspace_backend::{Backend, GroundTruth};
use opspace_log::Recording;
use opspace_sim::{ArmConfig, external};
use std::io::Write;

impl Experiment {
    /// Simulates a log again, and writes the log of this run to `sink`; `self` is the experiment of the log, on its plant. The same
    /// program gives the same log, except for computing times. The run ends with the log at the latest.
    ///
    /// # Errors
    /// A robot that cannot be simulated; a log without control cycles; a log that cannot be written.
    pub fn repeat<W: Write + Send + 'static>(
        &self,
        recording: &Recording,
        sink: W,
        progress: &Progress,
    ) -> Result<RunResult<W>, RunError> {
        let forces = recording.channel(EXTERNAL_CHANNEL);
        let config = ArmConfig { external_forces: forces.is_some(), ..self.arm_config()? };
        let model = config.model.clone();
        let mut arm = self.simulated_arm_of(config)?;
        if let Some((handle, rows)) = arm.external_force().zip(forces) {
            handle.repeat((0..rows.len()).map(|k| external::decode(rows.row(k), &model)).collect());
        }
        let capabilities = arm.capabilities().clone();
        let truth = arm.ground_truth().map(GroundTruth::layouts);
        let (control, mut log) = self.open(&capabilities, truth, sink, progress)?;
        let outcome = self.drive_on_inputs(&mut arm, control, &mut log, recording, progress)?;
        log.close(self, outcome)
    }
}
