//! Summary of a run with streamed targets.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_backend::{Backend, GroundTruth, Sample};
use opspace_control::CartesianTarget;
use opspace_experiment::{Experiment, Files, Progress, RunOptions};
use opspace_log::Recording;
use std::io::Cursor;
use std::path::Path;

/// Compared: the number of cycles with a stale target in the summary, and the number of cycles after the first target
/// in which no target was younger than the timeout.
#[test]
fn summary_counts_cycles_with_stale_target() {
    /// Cycles (of 1 ms) in which the target is renewed.
    const RENEWED: [u64; 2] = [300, 700];
    const TIMEOUT_CYCLES: u64 = 100;
    let task = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/tasks/streamed.toml");
    let options = RunOptions { duration_s: Some(1.0), ..RunOptions::default() };
    let experiment = Experiment::load(Files::Disk, &task, None, options, &[]).unwrap();
    let mut arm = experiment.simulated_arm().unwrap();
    let (capabilities, truth) = (arm.capabilities().clone(), arm.ground_truth().map(GroundTruth::layouts));
    let mut cycles = 0;
    let body = |run: &mut opspace_loop::Run<'_>| {
        let mut hand = CartesianTarget::of(run.targets(), "hand").unwrap();
        hand.twist([0.0; 6]).unwrap();
        let mut sample = Sample::new(&capabilities);
        while !run.is_over() {
            arm.read(&mut sample).unwrap();
            if RENEWED.contains(&cycles) {
                hand.write(run.targets(), sample.time_s).unwrap();
            }
            if let Some(command) = run.cycle(&sample) {
                arm.write(command).unwrap();
            }
            cycles += 1;
        }
        arm.stop();
    };
    let progress = Progress::default();
    let result = experiment.run_with(&capabilities, truth, Cursor::new(Vec::new()), &progress, body).unwrap();
    let recording = Recording::from_bytes(&result.sink.into_inner()).unwrap();
    let summary = experiment.summary(&recording, &result.record, None);
    assert_eq!(summary.faulted, None);
    // A target is fresh in the cycle of its time stamp and in the next hundred cycles, except for the rounding of
    // time stamps.
    let fresh = RENEWED.len() as u64 * (TIMEOUT_CYCLES + 1);
    let after_first = cycles - RENEWED[0];
    let stale = summary.stale_target_cycles;
    assert!((after_first - fresh).abs_diff(stale) <= RENEWED.len() as u64, "{stale} of {cycles}");
}
