//! Runs of experiments with several robots, with their logs in memory.

use opspace_backend::signal_names;
use opspace_experiment::RunSummary;
use opspace_experiment::run::result_files::ResultFolder;
use opspace_experiment::{Extensions, Files, Progress, Scenario};
use opspace_log::Recording;
use opspace_report::run_in_folder;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Operator who lowers the hand by 60 mm from 0.3 to 1 s.
pub const LOWERED: &str = "leader.environment.operator.spring.motion.scripted={ reach = [{ at_s = 0.3, duration_s = 0.7, \
                           by_m = [0.0, 0.0, -0.06] }] }";
/// Table of the follower, 30 mm below its hand.
pub const NEAR_TABLE: &str = "follower.environment.table.point_m=[0.36, 0.0, -0.187]";
/// Table that the follower does not reach.
pub const NO_TABLE: &str = "follower.environment.table.point_m=[0.36, 0.0, -0.5]";

/// Speed of the follower's reference after a resume, m/s: the operator's spring of 500 N/m accelerates a leader of 1 kg, which
/// was held while he moved on by up to 40 mm, to 0.9 m/s.
pub const REFERENCE_M_PER_S: f64 = 1.0;
/// Largest step of the force that is commanded to the leader in a cycle, N: it fades in. A reflected controller force contains
/// that of a damper of 60 Ns/m, here for a change of the velocity by 0.1 m/s.
pub const LEADER_STEP_N: f64 = 6.0;
/// Speed of a joint that an arm has when it is moved by the operator, rad/s; the limit is 8.
pub const CALM_RAD_PER_S: f64 = 3.0;
/// Store of the passivity control, J.
pub const STORE_J: f64 = 0.05;
/// Cycle, s.
pub const PERIOD_S: f64 = 1e-3;

/// Run of an experiment, with the logs of its robots by name.
pub struct CoupledRun {
    pub summary: RunSummary,
    pub logs: BTreeMap<String, Recording>,
}

impl CoupledRun {
    /// Time (s after the start of control) and values of a signal of the task `hand` in each cycle between two times.
    pub fn hand(&self, robot: &str, quantity: &str, from_s: f64, until_s: f64) -> Vec<(f64, Vec<f64>)> {
        self.signal(robot, "tick", &signal_names::of("hand", quantity), from_s, until_s)
    }

    /// Time (s after the start of control) and values of a signal in each row between two times.
    pub fn signal(
        &self,
        robot: &str,
        channel: &str,
        signal: &str,
        from_s: f64,
        until_s: f64,
    ) -> Vec<(f64, Vec<f64>)> {
        let channel = self.logs[robot].channel(channel).unwrap_or_else(|| panic!("no {channel}"));
        let column = channel.signal(signal).unwrap_or_else(|| panic!("no {signal}"));
        let rows = channel.time_s.iter().zip(column.rows());
        let within = rows.filter(|(time_s, _)| (from_s..until_s).contains(*time_s));
        within.map(|(time_s, row)| (*time_s, row.to_vec())).collect()
    }
}

/// Largest distance of successive values.
pub fn largest_step(rows: &[(f64, Vec<f64>)]) -> f64 {
    let steps = rows.windows(2).map(|pair| {
        let differences = pair[0].1.iter().zip(&pair[1].1).map(|(a, b)| (a - b).powi(2));
        differences.sum::<f64>().sqrt()
    });
    steps.fold(0.0, f64::max)
}

/// Mean of an element over all rows.
pub fn mean(rows: &[(f64, Vec<f64>)], element: usize) -> f64 {
    rows.iter().map(|(_, row)| row[element]).sum::<f64>() / rows.len() as f64
}

pub fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)
}

pub fn load(path: &Path, settings: &[&str]) -> Scenario {
    let settings: Vec<String> = settings.iter().map(|setting| (*setting).to_owned()).collect();
    Scenario::load_robots(&Extensions::default(), Files::Disk, path, &settings, &[])
        .unwrap_or_else(|error| panic!("{error}"))
}

/// Teleoperation of two arms: the operator lowers the hand to a table or not, within two seconds.
pub fn teleoperation(settings: &[&str]) -> Scenario {
    let own = ["expect={}", "settle_s=0.1", "duration_s=2.0", LOWERED];
    load(&project("tasks/experiments/teleop-wall.toml"), &[&own[..], settings].concat())
}

/// Runs an experiment in a folder, which is removed afterwards.
pub fn run(experiment: &Scenario) -> CoupledRun {
    let folder = tempfile::tempdir().unwrap_or_else(|error| panic!("{error}"));
    run_in(experiment, folder.path())
}

pub fn run_in(experiment: &Scenario, folder: &Path) -> CoupledRun {
    let results = ResultFolder::open(folder).unwrap_or_else(|error| panic!("{error}"));
    let summary =
        run_in_folder(experiment, &results, &Progress::default()).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(summary.not_saved, Vec::<String>::new());
    let names = experiment.members.iter().map(|member| member.name.clone());
    let read = |name: &str| {
        Recording::read(folder.join(name).join("run.mcap")).unwrap_or_else(|error| panic!("{error}"))
    };
    CoupledRun { summary, logs: names.map(|name| (name.clone(), read(&name))).collect() }
}
