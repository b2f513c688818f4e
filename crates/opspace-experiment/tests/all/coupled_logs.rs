//! Logs of experiments with several robots: each replays alone, all are equal in a second run, and the experiment can be
//! rebuilt from them.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::coupled_common::{CoupledRun, NEAR_TABLE, run, run_in, teleoperation};
use opspace_experiment::run::membership::Membership;
use opspace_experiment::run::replay::replay;
use opspace_experiment::{Experiment, Extensions, Scenario};
use opspace_log::{LogFile, OutcomeRecord, Recording};
use opspace_report::summary_and_page;
use std::fs;

/// A channel with everything that it can have, a clutch, and a bus that loses cycles.
const HARSH: [&str; 7] = [
    NEAR_TABLE,
    "seed=3",
    "channels.net={ delay_s = 0.02, jitter_s = 0.01, loss = 0.1, reordering = true }",
    "couplings.hands.channel=\"net\"",
    "couplings.hands.teleoperation.clutch_open_s=[[0.5, 0.8]]",
    "follower.robot.simulated.bus.lost_cycles_share=0.02",
    "leader.robot.simulated.bus.dropouts=[{ at_s = 1.2, duration_s = 0.1 }]",
];

/// Compared: every number that is recomputed from the inputs in the log of a robot, and the log.
#[test]
fn log_of_each_robot_replays_alone() {
    let CoupledRun { summary, logs } = run(&teleoperation(&HARSH));
    assert!(summary.couplings["hands"].packets_lost.unwrap() > 100.0, "{summary:?}");
    assert!(!summary.holds.is_empty(), "the dropout of the leader held the follower");
    for (name, log) in &logs {
        let experiment = Experiment::of_log(log).unwrap();
        let replayed = replay(&experiment, log).unwrap();
        assert_eq!((replayed.compared, replayed.differing), (replayed.logged, 0), "{name}: {replayed:?}");
        assert!(replayed.logged > 1800 && replayed.unmatched.is_empty(), "{name}: {replayed:?}");
    }
}

/// First row that differs between two logs, without computing times.
fn difference(a: &Recording, b: &Recording) -> Option<String> {
    assert_eq!(a.channels.len(), b.channels.len());
    for (one, other) in a.channels.iter().zip(&b.channels) {
        assert_eq!(one.layout, other.layout);
        let name = &one.layout.channel;
        if name == "timing" {
            continue;
        }
        let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        if bits(&one.time_s) != bits(&other.time_s) {
            return Some(format!("times of {name}"));
        }
        if let Some(k) = (0..one.len()).find(|&k| bits(one.row(k)) != bits(other.row(k))) {
            return Some(format!("row {k} of {name}"));
        }
    }
    None
}

/// Compared: all bits of two runs of the same files, and of runs with different seeds.
#[test]
fn second_run_gives_equal_rows() {
    let [first, second] = [(), ()].map(|()| run(&teleoperation(&HARSH)));
    let other = run(&teleoperation(&[&HARSH[..], &["seed=4"]].concat()));
    for (name, log) in &first.logs {
        assert_eq!(difference(log, &second.logs[name]), None, "{name}");
        assert!(difference(log, &other.logs[name]).is_some(), "{name}: the seed has an effect");
    }
}

/// Compared: the page and the summary that a run wrote, and those of its logs alone, in any order.
#[test]
fn experiment_is_rebuilt_from_its_logs() {
    let folder = tempfile::tempdir().unwrap();
    let experiment = teleoperation(&HARSH);
    let before = run_in(&experiment, folder.path());
    let logs = ["leader", "follower"].map(|name| &before.logs[name]);
    let rebuilt = Scenario::of_logs(&Extensions::default(), &logs).unwrap();
    assert_eq!(rebuilt.source.text(), experiment.source.text());
    assert_eq!(rebuilt.name(), "teleop-wall");
    let files = rebuilt
        .members
        .iter()
        .map(|member| LogFile::open(folder.path().join(&member.name).join("run.mcap")).unwrap());
    let files: Vec<LogFile> = files.collect();
    let summaries = rebuilt.members.iter().zip(&files).map(|(member, log)| {
        member.experiment.summary_of_file(log, &OutcomeRecord::of(log.recording()), None).unwrap()
    });
    let (mut summary, page) = summary_and_page(&rebuilt, &files, summaries.collect()).unwrap();
    for (name, robot) in &mut summary.robots {
        robot.timing.realtime_factor = before.summary.robots[name].timing.realtime_factor;
    }
    assert_eq!(summary, before.summary);
    assert!(page == fs::read_to_string(folder.path().join("report.html")).unwrap(), "the pages differ");
    let own_page = fs::read_to_string(folder.path().join("leader/report.html")).unwrap();
    assert!(own_page.contains("experiment_robot") && own_page.contains("teleop-wall.toml"));
}

/// Checks the refusals: a log that lacks, one that is given twice, logs of two experiments, and one of a task.
#[test]
fn logs_that_do_not_belong_together_are_refused() {
    let short = |seed: &str| run(&teleoperation(&["duration_s=0.2", seed]));
    let (one, other) = (short("seed=1"), short("seed=2"));
    let refused = |logs: &[&Recording]| {
        Scenario::of_logs(&Extensions::default(), logs).expect_err("refused").to_string()
    };
    let (leader, follower) = (&one.logs["leader"], &one.logs["follower"]);
    assert!(refused(&[leader]).contains("0 logs of robot 'follower'"));
    assert!(refused(&[leader, leader, follower]).contains("2 logs of robot 'leader'"));
    assert!(refused(&[leader, &other.logs["follower"]]).contains("another experiment"));
    assert!(refused(&[]).contains("lacks"));
    let mut alone = leader.clone();
    alone.metadata.iter_mut().for_each(|(_, entries)| drop(entries.remove("experiment")));
    assert!(Membership::of_log(&alone).unwrap().is_none());
    assert!(refused(&[&alone, follower]).contains("lacks the experiment"));
    let mut bare = leader.clone();
    bare.attachments.retain(|attachment| attachment.name != "experiment.toml");
    assert!(refused(&[&bare, follower]).contains("experiment.toml"));
}
