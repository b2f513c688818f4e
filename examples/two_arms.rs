//! Two arms on one clock: the joints of the second follow those of the first, 20 ms late, with jitter and loss. Each log is
//! replayed alone.
//!
//! `cargo run --release -p opspace --example two_arms` writes to `runs/leader` and `runs/follower`.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

use opspace::backend::{Backend, GroundTruth, TICK};
use opspace::control_loop::{ChannelParameters, Driven, Link, Run, Timeline, drive_together};
use opspace::experiment::{Choice, Experiment, Files, Progress, RunError};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let load = |task: &str| {
        let choice = Choice { duration_s: Some(4.0), ..Choice::default() };
        Experiment::load(Files::Disk, task.as_ref(), None, choice, &[])
    };
    let leader = load("tasks/joint-tracking.toml")?;
    let follower = load("examples/tasks/follower.toml")?;
    let (mut first, mut second) = (leader.simulated_arm()?, follower.simulated_arm()?);
    let capabilities = [&first, &second].map(|arm| arm.capabilities().clone());
    let truths = [&first, &second].map(|arm| arm.ground_truth().map(GroundTruth::layouts));
    let [leader_truth, follower_truth] = truths;
    let progress = Progress::default();
    let mut timeline = Timeline::new(&[1000, 1000])?;
    let parameters =
        ChannelParameters { delay_s: 0.02, jitter_s: 0.005, loss: 0.05, reordering: false, seed: 1 };

    // Both logs are written while both arms run.
    common::record("follower", &follower, |follower_file| {
        let mut follower_result = None;
        let recorded = common::record("leader", &leader, |leader_file| {
            let (leading, mut leader_log) =
                leader.open(&capabilities[0], leader_truth, leader_file, &progress)?;
            let (following, mut follower_log) =
                follower.open(&capabilities[1], follower_truth, follower_file, &progress)?;
            let row = Run::layouts(&leading, None).swap_remove(TICK);
            let to = (1, &following.targets(), "joints");
            let link = Link::new(&timeline, (0, &row), to, &[("q", "q"), ("dq", "dq")], parameters);
            let mut links = [link.expect("both arms have four joints")];
            let mut leading = Run::new(leading, leader.duration_s(), &mut leader_log);
            let mut following = Run::new(following, follower.duration_s(), &mut follower_log);
            let mut robots = [
                Driven { backend: &mut first, run: &mut leading },
                Driven { backend: &mut second, run: &mut following },
            ];
            drive_together(&mut robots, &mut links, &mut timeline);
            let outcomes = [leading.finish(), following.finish()];
            let [leader_outcome, follower_outcome] = outcomes;
            follower_result = Some(follower_log.close(&follower, follower_outcome));
            leader_log.close(&leader, leader_outcome)
        });
        recorded.map_err(|error| RunError::Incomplete { what: error.to_string() })?;
        follower_result.expect("the leader was recorded, so was the follower")
    })
}
