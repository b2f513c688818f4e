//! Contact of robots whose commands act late: what is said of it before a run, and simulated runs.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::project;
use opspace_experiment::evaluate::metrics::metrics;
use opspace_experiment::{Code, Experiment, Files, Finding, Progress, RunOptions};
use opspace_log::Recording;
use opspace_loop::RunOutcome;
use opspace_preflight::{diagnostics, not_checked, refusals};
use std::io::Cursor;

/// Force errors, of 20 N, of a contact that is stable and of one that oscillates, rms, N.
const STABLE_N: f64 = 1.0;
const OSCILLATES_N: f64 = 4.0;

/// Task that presses, with a delay in servo ticks and further settings.
fn pressing(task: &str, profile: &str, ticks: u32, settings: &[&str]) -> Experiment {
    let delay = format!("robot.profile.{profile}.delay_servo_ticks={ticks}");
    let settings: Vec<String> = settings
        .iter()
        .map(|&setting| setting.to_owned())
        .chain([delay, "duration_s=5.5".to_owned()])
        .collect();
    let options = RunOptions { profile: Some(profile.to_owned()), ..RunOptions::default() };
    Experiment::load(Files::Disk, &project(task), None, options, &settings).unwrap()
}

fn ur5e(ticks: u32, settings: &[&str]) -> Experiment {
    pressing("tasks/ur5e-press.toml", "rtde-500hz", ticks, settings)
}

fn table(ticks: u32, settings: &[&str]) -> Experiment {
    pressing("tasks/press-table.toml", "b-soft", ticks, settings)
}

fn oscillation(found: &[Finding]) -> Option<&Finding> {
    found.iter().find(|finding| finding.code == Code::ContactOscillation)
}

/// Error of the pressing force in a simulated run, rms, N; infinite if the run was stopped.
fn force_error_n(experiment: &Experiment) -> f64 {
    let finished = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
    if finished.outcome != RunOutcome::Completed {
        return f64::INFINITY;
    }
    let recording = Recording::from_bytes(finished.sink.get_ref()).unwrap();
    metrics(experiment, &recording).contact.force_rms_n.unwrap()
}

/// Compared: diagnostics, and forces of runs: of two arms with several delays, on the table of the task and on a stiffer one.
#[test]
fn late_contact_that_oscillates_is_found() {
    let stiff = "environment.board.wall.stiffness_n_per_m=30000";
    for (name, experiment, oscillates) in [
        ("UR5e, 24 ms", ur5e(60, &[]), false),
        ("UR5e, 40 ms", ur5e(100, &[]), true),
        ("UR5e, 24 ms, stiff", ur5e(60, &[stiff]), true),
        ("b-soft, 15 ms", table(15, &[]), false),
        ("b-soft, 24 ms", table(24, &[]), true),
    ] {
        let (found, error_n) = (diagnostics(&experiment), force_error_n(&experiment));
        assert_eq!(oscillation(&found).is_some(), oscillates, "{name}: {found:?}");
        let bounds = if oscillates { OSCILLATES_N..=f64::INFINITY } else { 0.0..=STABLE_N };
        assert!(bounds.contains(&error_n), "{name}: {error_n} N");
    }
}

/// Compared: the force with the gain of the message, and the stable one; a contact for which no gain is small enough says so.
#[test]
fn smaller_gain_of_the_message_ends_the_oscillation() {
    let found = diagnostics(&ur5e(90, &[]));
    let help = &oscillation(&found).unwrap().help;
    assert!(help.starts_with("try `gain = 0.12` and `integral_per_s = 2.5`"), "{help}");
    let force = "task.flange.cartesian.force";
    let gains = [format!("{force}.gain=0.12"), format!("{force}.integral_per_s=2.5")];
    let error_n = force_error_n(&ur5e(90, &gains.each_ref().map(String::as_str)));
    assert!(error_n < STABLE_N, "{error_n} N");
    let found = diagnostics(&table(40, &[]));
    assert!(
        oscillation(&found).unwrap().help.starts_with("a smaller gain leaves too little margin"),
        "{found:?}"
    );
}

/// Compared: a contact that is unstable is refused on a real robot, and one that oscillates is not; what is listed if the surface is
/// not known.
#[test]
fn unstable_late_contact_is_refused_and_unknown_one_is_listed() {
    assert!(oscillation(&refusals(&ur5e(100, &[]))).is_none());
    assert!(oscillation(&refusals(&table(40, &[]))).is_some());
    assert!(oscillation(&refusals(&table(0, &[]))).is_none());
    let unknown = |ticks| {
        let listed = not_checked(&ur5e(ticks, &["environment={}"]));
        listed.into_iter().find(|finding| finding.code == Code::UnknownContact)
    };
    assert_eq!(unknown(0), None);
    let message = unknown(100).unwrap().message;
    assert!(
        message.contains("commands act 40 ms late it oscillates on objects that are stiffer than"),
        "{message}"
    );
    // The stated surface takes the place of the environment.
    let stated =
        "task.flange.cartesian.force.surface={ stiffness_n_per_m = 10000.0, damping_ns_per_m = 50.0 }";
    assert_eq!(not_checked(&ur5e(100, &["environment={}", stated])), []);
    assert!(oscillation(&diagnostics(&ur5e(100, &["environment={}", stated]))).is_some());
}
