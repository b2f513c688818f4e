//! Forces that are estimated from motor current.

use crate::cli_common::{opspace, project, scratch};
use crate::common;
use opspace_backend::CommandKind;
use opspace_backend::signal_names::{TICK_CHANNEL, TRUTH_CHANNEL};
use opspace_experiment::{Experiment, FileError, Files, RunOptions};
use std::path::Path;

/// Error of the estimated normal force of a hand that moves with 0.1 m/s on a table of 10 kN/m, from 2 s on, rms, N. The
/// force is controlled by a real sensor.
fn normal_error(backend: CommandKind, settings: &[&str]) -> f64 {
    let task = [
        "axes={x=\"motion\",y=\"motion\",z=\"force\"}",
        "force={sensor=\"wrist\",target_n={z=20.0}}",
        "reference={sinusoid={ramp_s=1.0,x=[{amplitude_m=0.05,frequency_hz=0.318}],y=[{amplitude_m=0.05,frequency_hz=0.318,phase_rad=1.5708,offset_m=-0.05}]}}",
    ];
    let mut all: Vec<String> = task.iter().map(|setting| format!("task.hand.cartesian.{setting}")).collect();
    all.push(
        "environment={table={wall={frame=\"hand\",point_m=[0.3,0.0,-0.21],normal=[0.0,0.0,1.0],stiffness_n_per_m=10000.0,damping_ns_per_m=50.0}}}"
            .to_owned(),
    );
    all.push("robot.estimated_force.joints.frame=\"hand\"".to_owned());
    all.extend(settings.iter().map(|&setting| setting.to_owned()));
    let options = RunOptions { backend, duration_s: Some(4.0), ..RunOptions::default() };
    let path = Path::new("tasks/cartesian-tracking.toml");
    let loaded: Result<Experiment, FileError> = Experiment::load(Files::Embedded, path, None, options, &all);
    let run = common::run(&loaded.unwrap_or_else(|e| panic!("{e}")));
    let (estimate, truth) =
        (run.signal(TICK_CHANNEL, "joints.wrench"), run.signal(TRUTH_CHANNEL, "table.force"));
    let times = |channel: &str| run.channel(channel).time_s.clone();
    let (ticks, truths) = (times(TICK_CHANNEL), times(TRUTH_CHANNEL));
    let (mut squares, mut count, mut pressed) = (0.0, 0.0, 0.0);
    for (k, time_s) in ticks.iter().enumerate().filter(|(_, time_s)| **time_s > ticks[0] + 2.2) {
        let Some(at) = truths.iter().position(|t| (t - time_s).abs() < 1e-6) else { continue };
        squares += (estimate.row(k)[2] - truth.row(at)[2]).powi(2);
        pressed += truth.row(at)[2];
        count += 1.0;
    }
    assert!(count > 1000.0 && (pressed / count - 20.0_f64).abs() < 1.0, "{} N", pressed / count);
    f64::sqrt(squares / count)
}

/// Compared: the estimated and the true normal force; with the exact friction, and with 30 % more and less of it, as a
/// position and as a torque robot.
#[test]
fn normal_force_of_a_sliding_hand_is_estimated() {
    for backend in [CommandKind::Position, CommandKind::Torque] {
        let exact = normal_error(backend, &[]);
        assert!(exact < 1.0, "{backend:?}: {exact} N");
    }
    for factor in ["0.7", "1.3"] {
        let friction = format!("robot.simulated.true_over_nominal.friction={factor}");
        let error = normal_error(CommandKind::Position, &[&friction]);
        assert!(error < 2.5, "friction times {factor}: {error} N");
    }
}

#[test]
fn robot_without_sensor_controls_force() {
    let folder = scratch();
    let (task, out) = (project("tasks/panda-press.toml"), folder.path().join("run"));
    opspace(folder.path(), &["run", &task, "--out", "run", "--quiet"]).exits(0);
    let summary = std::fs::read_to_string(out.join("summary.json")).unwrap_or_default();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap_or_default();
    let metric = |name: &str| summary["metrics"][name].as_f64().unwrap_or(f64::NAN);
    assert!(metric("force_rms_n") < 2.0, "{} N", metric("force_rms_n"));
    assert!(metric("in_contact_fraction") == 1.0, "{}", metric("in_contact_fraction"));
    assert!(
        metric("estimate_rms_n") > 0.0 && metric("estimate_rms_n") < 4.0,
        "{} N",
        metric("estimate_rms_n")
    );
}

#[test]
fn check_states_the_smallest_force() {
    let task = project("tasks/panda-press.toml");
    let folder = scratch();
    let ran = opspace(folder.path(), &["check", &task]).exits(0);
    assert!(
        ran.stdout.contains("estimated force 'contact', at the start, in x, y, z: static friction hides"),
        "{}",
        ran.stdout
    );
}
