//! Two arms in one simulation, on one clock. The joints of the second follow those of the first with a delay of 20 ms,
//! jitter and loss, while an elastic band pulls both hands. Each log is replayed alone.
//!
//! `cargo run --release -p opspace --example two_arms` writes to `runs/leader` and `runs/follower`.

#![expect(clippy::print_stdout, reason = "an example shows what it did")]

#[path = "common/mod.rs"]
mod common;

use opspace::backend::quantity::NonNegative;
use opspace::backend::{Backend, GroundTruth, TICK};
use opspace::control_loop::{ChannelParameters, Driven, Link, Run, Timeline, drive_together};
use opspace::experiment::{Experiment, Files, Progress, RunError, RunOptions};
use opspace::log::Recording;
use opspace::sim::{CouplingConfig, Simulation, SimulationConfig};

/// Distance between the bases of the two arms, m.
const APART_M: f64 = 0.6;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let load = |task: &str, settings: &[String]| {
        let options = RunOptions { duration_s: Some(4.0), ..RunOptions::default() };
        Experiment::load(Files::Disk, task.as_ref(), None, options, settings)
    };
    // Both arms are mounted side by side.
    let beside = format!("robot.mount.xyz_m=[0.0, {APART_M:?}, 0.0]");
    let leader = load("tasks/joint-tracking.toml", &[])?;
    let follower = load("examples/tasks/follower.toml", &[beside])?;

    // One plant with both arms, and a band from hand to hand.
    let band = CouplingConfig {
        name: "band".to_owned(),
        first: (0, "hand".to_owned()),
        second: (1, "hand".to_owned()),
        stiffness_n_per_m: NonNegative::literal(100.0),
        damping_ns_per_m: NonNegative::literal(2.0),
    };
    let arms = vec![leader.arm_config()?, follower.arm_config()?];
    let mut arms =
        Simulation::new(SimulationConfig { arms, couplings: vec![band], ..SimulationConfig::default() })?
            .into_arms();
    let [first, second] = &mut arms[..] else { unreachable!("two arms were configured") };

    let (capabilities, truth) = (first.capabilities().clone(), first.layouts());
    let (follower_capabilities, follower_truth) = (second.capabilities().clone(), second.layouts());
    let progress = Progress::default();
    let mut timeline = Timeline::new(&[1000, 1000])?;
    let parameters =
        ChannelParameters { delay_s: 0.02, jitter_s: 0.005, loss: 0.05, seed: 1, ..Default::default() };

    // Both logs are written while both arms run.
    common::record("follower", &follower, |follower_file| {
        let mut follower_result = None;
        let recorded = common::record("leader", &leader, |leader_file| {
            let (leading, mut leader_log) =
                leader.open(&capabilities, Some(truth), leader_file, &progress)?;
            let (following, mut follower_log) =
                follower.open(&follower_capabilities, Some(follower_truth), follower_file, &progress)?;
            let row = Run::layouts(&leading, None).swap_remove(TICK);
            let to = (1, &following.targets(), "joints");
            let link = Link::new(&timeline, (0, &row), to, &[("q", "q"), ("dq", "dq")], parameters);
            let mut links = [link.expect("both arms have four joints")];
            let mut leading = Run::new(leading, leader.duration_s(), &mut leader_log);
            let mut following = Run::new(following, follower.duration_s(), &mut follower_log);
            let mut robots = [
                Driven { backend: first, run: &mut leading },
                Driven { backend: second, run: &mut following },
            ];
            drive_together(&mut robots, &mut links, &mut timeline);
            let outcomes = [leading.finish(), following.finish()];
            let [leader_outcome, follower_outcome] = outcomes;
            follower_result = Some(follower_log.close(&follower, follower_outcome));
            leader_log.close(&leader, leader_outcome)
        });
        recorded.map_err(|error| RunError::Incomplete { what: error.to_string() })?;
        follower_result.expect("the leader was recorded, so was the follower")
    })?;
    println!(
        "largest force of the elastic band: {:.2} N",
        largest_pull(&Recording::read("runs/leader/run.mcap")?)?
    );
    Ok(())
}

/// Largest force of the band on the hand of an arm, N.
fn largest_pull(log: &Recording) -> Result<f64, Box<dyn std::error::Error>> {
    let truth = log.channel("truth").ok_or("a simulation logs its true state")?;
    let force = truth.signal("band.force").ok_or("the band is in the true state")?;
    Ok(force.rows().map(|f| f.iter().map(|f| f * f).sum::<f64>().sqrt()).fold(0.0, f64::max))
}
