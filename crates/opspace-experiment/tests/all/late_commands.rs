//! Commands that act several interface cycles after their samples, on each kind of robot.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_backend::CommandKind;
use opspace_experiment::{Experiment, Files, Metrics, Progress, RunOptions};
use opspace_log::Recording;
use opspace_loop::RunOutcome;
use std::io::Cursor;
use std::path::Path;

/// Largest torque error of interval means: of the desired torques' rms.
const TORQUE_ERROR: f64 = 0.08;

/// Largest error of position over the path, m.
const POSITION_M: f64 = 2.5e-3;

/// Largest change of the motion with which the arm yields, over that without delay.
const YIELDING: f64 = 0.1;

/// Largest error of a pressing force, of 20 N, as its rms, N.
const FORCE_N: f64 = 0.6;

/// Tracking of a Cartesian path, or yielding along x.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Motion {
    Tracking,
    Compliance,
}

/// Outcome and metrics of a task on a backend, with settings.
fn run_task(task: &str, backend: CommandKind, profile: &str, settings: &[String]) -> (RunOutcome, Metrics) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../tasks/{task}.toml"));
    let options = RunOptions { backend, profile: Some(profile.to_owned()), ..RunOptions::default() };
    let experiment = Experiment::load(Files::Disk, &path, None, options, settings).unwrap();
    let finished = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
    let log = Recording::from_bytes(finished.sink.get_ref()).unwrap();
    let summary = experiment.summary(&log, &finished.record, None);
    (finished.outcome, summary.metrics)
}

/// Outcome and metrics of a run. A cycle of profile `a-med` takes 1 ms, of `b-soft` 5 ms; both have five servo ticks.
fn run(
    motion: Motion,
    backend: CommandKind,
    profile: &str,
    [declared, actual]: [u32; 2],
) -> (RunOutcome, Metrics) {
    let name = if motion == Motion::Tracking { "cartesian-tracking" } else { "compliant-x" };
    let settings = [
        format!("robot.profile.{profile}.delay_servo_ticks={}", 5 * declared),
        format!("robot.simulated.delay_servo_ticks={}", 5 * actual),
    ];
    run_task(name, backend, profile, &settings)
}

/// Compared: runs with declared delays of several cycles, and those without delay. The torque robot's errors of position grow too,
/// and the arm yields as much.
#[test]
fn declared_delays_of_several_cycles_are_controlled_on_each_kind_of_robot() {
    for backend in [CommandKind::Position, CommandKind::Velocity, CommandKind::Torque] {
        for (profile, cycles) in [("a-med", 3), ("a-med", 8), ("b-soft", 2)] {
            let case = format!("{backend:?}, {profile}, {cycles} cycles");
            let late = {
                let (outcome, metrics) = run(Motion::Tracking, backend, profile, [cycles; 2]);
                assert_eq!(outcome, RunOutcome::Completed, "{case}");
                metrics
            };
            assert!(
                late.torque_error_interval.unwrap() < TORQUE_ERROR,
                "{case}: {:?}",
                late.torque_error_interval
            );
            assert!(
                late.pose.position_rms_m.unwrap() < POSITION_M,
                "{case}: {:?} m",
                late.pose.position_rms_m
            );
        }
        let [before, late] = [0, 3].map(|cycles| {
            let (outcome, metrics) = run(Motion::Compliance, backend, "a-med", [cycles; 2]);
            assert_eq!(outcome, RunOutcome::Completed, "{backend:?}");
            metrics.compliance.compliant_motion_rms_m.unwrap()
        });
        assert!(
            (late / before - 1.0).abs() < YIELDING,
            "{backend:?}: yields by {late} m, without delay by {before} m"
        );
    }
}

/// Compared: torque errors of a position robot whose delay of 15 ms is declared, and of one that declares none.
#[test]
fn delay_that_is_not_declared_shows() {
    let [declared, hidden] = [3, 0].map(|declared| {
        let (outcome, metrics) = run(Motion::Tracking, CommandKind::Position, "b-soft", [declared, 3]);
        (outcome, metrics.torque_error_interval.unwrap())
    });
    assert_eq!(declared.0, RunOutcome::Completed);
    assert!(hidden.0 != RunOutcome::Completed || hidden.1 > 2.0 * declared.1, "{declared:?}, {hidden:?}");
}

/// Compared: the forces of three arms with a declared delay of 12 ms, or 20 ms, and the desired force. The Panda's force is
/// estimated.
#[test]
fn arms_press_with_the_desired_force_although_their_commands_act_late() {
    for (task, profile, ticks) in [
        ("press-table", "b-soft", 12),
        ("ur5e-press", "rtde-500hz", 30),
        ("ur5e-press", "rtde-500hz", 50),
        ("panda-press", "interface-1khz", 60),
    ] {
        let settings =
            [format!("robot.profile.{profile}.delay_servo_ticks={ticks}"), "duration_s=5".to_owned()];
        let (outcome, metrics) = run_task(task, CommandKind::Position, profile, &settings);
        assert_eq!(outcome, RunOutcome::Completed, "{task}, {ticks} servo ticks");
        let force_n = metrics.contact.force_rms_n.unwrap();
        assert!(force_n < FORCE_N, "{task}, {ticks} servo ticks: {force_n} N");
    }
}
