//! Gears and setpoint limits of a robot file, from its keys to diagnostics and metrics.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_backend::CommandKind;
use opspace_experiment::evaluate;
use opspace_experiment::evaluate::metrics::Metrics;
use opspace_experiment::{ControllerKind, Experiment, FileError, Files, Progress, RunOptions};
use opspace_log::Recording;
use opspace_preflight::gear_resonances;
use std::f64::consts::TAU;
use std::io::Cursor;
use std::path::Path;

fn experiment(controller: ControllerKind, settings: &[&str]) -> Result<Experiment, FileError> {
    let options = RunOptions {
        backend: CommandKind::Position,
        controller,
        duration_s: Some(1.0),
        ..RunOptions::default()
    };
    let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/planar-2-link-reach.toml");
    Experiment::load(Files::Disk, &path, None, options, &settings)
}

/// Compared: the frequencies of the elbow of the planar arm, and √(K/J)/2π, √(K (1/J + 1/B))/2π with the inertia J = 1/3
/// of its rod and B = 100² 0.5e-5 kg m² of its rotor; without a declared stiffness there are none.
#[test]
fn declared_gear_has_frequencies_of_two_masses() {
    /// Rounding errors, Hz.
    const TOLERANCE_HZ: f64 = 1e-9;
    assert_eq!(gear_resonances(&experiment(ControllerKind::Osc, &[]).unwrap()), []);
    let gears = gear_resonances(
        &experiment(ControllerKind::Osc, &["robot.joint.elbow.gear_stiffness_nm_per_rad=3000.0"]).unwrap(),
    );
    assert_eq!(gears.len(), 1);
    assert_eq!((gears[0].joint.as_str(), gears[0].stiffness_nm_per_rad), ("elbow", 3000.0));
    let antiresonance = (3000.0_f64 * 3.0).sqrt() / TAU;
    let resonance = (3000.0_f64 * (3.0 + 1.0 / 0.05)).sqrt() / TAU;
    assert!((gears[0].antiresonance_hz - antiresonance).abs() < TOLERANCE_HZ, "{}", gears[0]);
    assert!((gears[0].resonance_hz.unwrap() - resonance).abs() < TOLERANCE_HZ, "{}", gears[0]);
    assert_eq!(
        gears[0].to_string(),
        "gear of joint 'elbow': antiresonance at 15.1 Hz, resonance at 41.8 Hz, at the start"
    );
}

/// Metrics of a run of inverse kinematics.
fn metrics(settings: &[&str]) -> Metrics {
    let experiment = experiment(ControllerKind::Ik, settings).unwrap();
    let log = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap().sink;
    evaluate::metrics::metrics(&experiment, &Recording::from_bytes(&log.into_inner()).unwrap())
}

/// Compared: metrics of a run without limits, and with limits that no setpoint exceeds: the same, and none are counted.
/// With a limit on the jerk that the reference exceeds, the drives limit none either, and the arm moves less closely.
#[test]
fn setpoints_of_inverse_kinematics_keep_limits() {
    let limits = |elbow: &str| {
        format!("robot.profile.default.setpoint_limits={{reaction=\"clamp\",joint={{elbow={{{elbow}}}}}}}")
    };
    let free = metrics(&[]);
    assert_eq!(free.setpoints_limited, None);
    let mut wide =
        metrics(&[&limits("velocity_rad_per_s=1e3,acceleration_rad_per_s2=1e9,jerk_rad_per_s3=1e12")]);
    assert_eq!(wide.setpoints_limited.take(), Some(0));
    assert_eq!(wide, free);
    let narrow = metrics(&[&limits("jerk_rad_per_s3=1.0")]);
    assert_eq!(narrow.setpoints_limited, Some(0));
    let error = |metrics: &Metrics| metrics.pose.position_rms_m.unwrap();
    assert!(error(&narrow) > 1.5 * error(&free), "{} and {}", error(&narrow), error(&free));
}

/// Checks file, line, and key of mistakes.
#[test]
fn mistakes_are_placed_in_the_robot_file() {
    let refused = |setting: &str| experiment(ControllerKind::Osc, &[setting]).unwrap_err();
    let error = refused("robot.profile.default.setpoint_limits={reaction=\"stop\",joint={elbw={}}}");
    assert!(error.help().is_some_and(|help| help.contains("did you mean 'elbow'")), "{error}");
    let error = refused("robot.profile.default.servo.elbow.cascaded.velocity_feed_forward=-0.5");
    assert!(error.message().contains("expected a number from 0 to 1, got -0.5"), "{error}");
    let error = refused("robot.joint.elbow.gear_stiffness_nm_per_rad=0.0");
    assert!(error.message().contains("expected a number above 0"), "{error}");
}
