//! Repeated simulation of a log: files and seed give the robot and its environment, and the logged targets, stop requests and external
//! forces are its inputs.

use crate::run::error::RunError;
use crate::run::execute::{Progress, RunResult};
use crate::run::experiment::Experiment;
use opspace_backend::signal_names::EXTERNAL_CHANNEL;
use opspace_backend::{Backend, GroundTruth};
use opspace_log::{LoggedTargets, Recording};
use opspace_loop::{Run, drive_with};
use opspace_sim::{ArmConfig, external};
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::Ordering;

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
        let mut run = Run::new(control, self.duration_s(), &mut log)
            .with_stop_request(Arc::clone(&progress.interrupt))
            .with_abort_request(Arc::clone(&progress.abort));
        let targets = run.targets();
        let mut logged = LoggedTargets::new(recording, targets.layout(), targets.row())?;
        let mut before = |run: &mut Run<'_>| {
            let Some((row, stop_requested)) = logged.next_row() else { return false };
            run.targets().set_row(row);
            if stop_requested {
                progress.interrupt.store(true, Ordering::Relaxed);
            }
            true
        };
        progress.driving(|| drive_with(&mut arm, &mut run, &mut before));
        let outcome = run.finish();
        log.close(self, outcome)
    }
}
