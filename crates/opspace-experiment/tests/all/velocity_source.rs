//! Estimate of the velocities: the choice by kind of robot and transformer, and its effect.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_backend::CommandKind;
use opspace_experiment::{Experiment, FileError, Files, Progress, RunOptions, Scenario};
use opspace_transformer::{TransformerName, VelocitySource};
use std::path::Path;

const SOURCE: &str = "robot.profile.a-med.estimator.velocity";

fn load(
    backend: CommandKind,
    transformer: Option<&str>,
    settings: &[String],
) -> Result<Experiment, FileError> {
    let transformer = transformer.map(|name| TransformerName::from(name.to_owned()));
    let options = RunOptions { backend, transformer, duration_s: Some(2.0), ..RunOptions::default() };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/cartesian-tracking.toml");
    let settings: Vec<String> =
        ["settle_s=1.0".to_owned()].into_iter().chain(settings.iter().cloned()).collect();
    Experiment::load(Files::Disk, &path, None, options, &settings)
}

/// Compared: the estimate that is chosen for each kind of robot, and the documented one; a setting overrides it.
#[test]
fn estimate_is_chosen_by_robot_and_transformer() {
    for (backend, transformer, expected) in [
        (CommandKind::Torque, None, VelocitySource::Observer),
        (CommandKind::Velocity, Some("paper"), VelocitySource::Observer),
        (CommandKind::Position, Some("emulation"), VelocitySource::Observer),
        (CommandKind::Position, Some("paper"), VelocitySource::Filter),
    ] {
        let chosen = load(backend, transformer, &[]).unwrap().velocity_source();
        assert_eq!(chosen, expected, "{backend:?} {transformer:?}");
        for (name, asked) in [("observer", VelocitySource::Observer), ("filter", VelocitySource::Filter)] {
            let set = load(backend, transformer, &[format!("{SOURCE}={name}")]).unwrap();
            assert_eq!(set.velocity_source(), asked, "{backend:?} {transformer:?}");
        }
    }
}

/// Compared: the estimates of a torque robot whose gears are not declared rigid, or have a stiffness, and the filter. On
/// elastic gears, with which the observer of a rigid arm is stopped, the task is completed.
#[test]
fn torque_robot_on_elastic_gears_uses_the_filter() {
    let elastic = "robot.interface.gears=elastic".to_owned();
    let stiffness = "robot.joint.elbow.gear_stiffness_nm_per_rad=9000.0".to_owned();
    for setting in [elastic.clone(), stiffness] {
        let chosen = load(CommandKind::Torque, None, &[setting]).unwrap().velocity_source();
        assert_eq!(chosen, VelocitySource::Filter);
    }
    let stiffness = [32e4, 32e4, 19.2e4, 12.8e4, 8e4, 8e4, 8e4];
    let joints = stiffness.iter().zip(1..).map(|(stiffness, i)| {
        let damping = 1.56e-5 * stiffness;
        format!("joint{i} = {{ stiffness_nm_per_rad = {stiffness:?}, damping_nms_per_rad = {damping:?} }}")
    });
    let gears = format!("robot.simulated.gear={{ {} }}", joints.collect::<Vec<_>>().join(", "));
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/panda-tracking.toml");
    let runs = |declared: &str| {
        let options =
            RunOptions { backend: CommandKind::Torque, duration_s: Some(2.0), ..RunOptions::default() };
        let settings =
            ["settle_s=1.0".to_owned(), gears.clone(), format!("robot.interface.gears={declared}")];
        let experiment = Experiment::load(Files::Disk, &path, None, options, &settings).unwrap();
        let run = Scenario::from(experiment).run_without_logs(&Progress::default()).unwrap();
        run.single().unwrap().clone()
    };
    let (elastic, rigid) = (runs("elastic"), runs("rigid"));
    assert!(elastic.faulted.is_none(), "{:?}", elastic.faulted);
    assert!(rigid.faulted.is_some());
}

/// Compared: tracking errors with the observer and with the filter, whose lag acts against the damping.
#[test]
fn observer_tracks_better_than_the_filter() {
    for (backend, transformer) in [(CommandKind::Torque, None), (CommandKind::Velocity, Some("paper"))] {
        let [observer, filter] = ["observer", "filter"].map(|name| {
            let experiment = load(backend, transformer, &[format!("{SOURCE}={name}")]).unwrap();
            let run = Scenario::from(experiment).run_without_logs(&Progress::default()).unwrap();
            run.single().unwrap().metrics.pose.position_rms_m.unwrap()
        });
        assert!(observer < 0.8 * filter, "{backend:?}: {observer} m, filter {filter} m");
    }
}

/// Compared: the error for a drive whose delay is unknown, and the key that asks for the observer. Without the key, such a
/// drive uses the filter.
#[test]
fn observer_needs_a_known_delay() {
    let folder = tempfile::TempDir::new().unwrap();
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../robots/asimo-arm");
    for entry in std::fs::read_dir(&robots).unwrap().flatten() {
        if entry.path().is_file() {
            std::fs::copy(entry.path(), folder.path().join(entry.file_name())).unwrap();
        }
    }
    let file = folder.path().join("robot.toml");
    let text = std::fs::read_to_string(&file).unwrap().replacen("delay_servo_ticks = 0\n", "", 1);
    let options = || RunOptions {
        backend: CommandKind::Velocity,
        transformer: Some(TransformerName::from("paper")),
        ..RunOptions::default()
    };
    let task = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/cartesian-tracking.toml");
    std::fs::write(&file, &text).unwrap();
    let unknown = Experiment::load(Files::Disk, &task, Some(folder.path()), options(), &[]).unwrap();
    assert_eq!(unknown.velocity_source(), VelocitySource::Filter);
    let asked = text.replacen(
        "{ velocity_filter_hz = 150.0 }",
        "{ velocity = \"observer\", velocity_filter_hz = 150.0 }",
        1,
    );
    std::fs::write(&file, asked).unwrap();
    let error = Experiment::load(Files::Disk, &task, Some(folder.path()), options(), &[]).unwrap_err();
    let text = format!("{error} {}", error.help().unwrap_or_default());
    for words in ["robot.toml:", "the velocity observer needs delay_servo_ticks", "velocity = \"filter\""] {
        assert!(text.contains(words), "'{words}' is not in: {text}");
    }
}
