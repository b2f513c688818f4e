//! Transformers, servo sections and results of velocity robots.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_backend::CommandKind;
use opspace_experiment::metrics::columns::default_columns;
use opspace_experiment::{
    Experiment, FileError, Files, Progress, RobotDefinition, RunOptions, Source, TaskDefinition,
};
use opspace_log::Recording;
use opspace_report::document::{RunSection, page};
use opspace_transformer::{ServoParameters, TransformerName};
use std::io::Cursor;
use std::path::Path;

const ROBOT: &str = "robots/asimo-arm/robot.toml";

/// Reads the ASIMO-like arm with settings, as a robot that cannot be simulated.
fn robot(settings: &[&str]) -> Result<RobotDefinition, FileError> {
    let settings: Vec<String> = settings.iter().map(|setting| format!("robot.{setting}")).collect();
    let mut robot = RobotDefinition::load(Files::Embedded, Path::new(ROBOT), &settings)?;
    robot.file.simulated = None;
    Ok(robot)
}

fn on_robot(
    robot: RobotDefinition,
    backend: CommandKind,
    transformer: Option<&str>,
) -> Result<Experiment, FileError> {
    let task = TaskDefinition::load(Files::Embedded, Path::new("tasks/cartesian-tracking.toml"), &[])?;
    let transformer = transformer.map(|name| TransformerName::from(name.to_owned()));
    Experiment::new(robot, task, RunOptions { backend, transformer, ..RunOptions::default() }, Vec::new())
}

fn experiment(transformer: Option<&str>, settings: &[&str]) -> Result<Experiment, FileError> {
    on_robot(robot(settings)?, CommandKind::Velocity, transformer)
}

/// Reads the robot file with a section removed or replaced, and the URDF.
fn edited(from: &str, to: &str) -> Result<RobotDefinition, FileError> {
    let arm = robot(&[])?;
    let text = arm.source.text();
    assert!(text.contains(from), "{from}");
    RobotDefinition::from_sources(Source::new(ROBOT, text.replacen(from, to, 1)), arm.urdf.clone())
}

fn section(text: &str, heading: &str) -> String {
    let from = &text[text.find(heading).unwrap()..];
    from.split_inclusive("\n\n").next().unwrap().to_owned()
}

/// All transformers by name on a velocity robot, and the kind of command that they pass to the control loop.
#[test]
fn velocity_robot_transformers_command_velocities() {
    for (name, setting) in [
        ("paper", "interface.setpoints=held"),
        ("paper+current", "interface.setpoints=held"),
        ("emulation", "interface.setpoints=held"),
        ("emulation+current", "interface.setpoints=interpolated"),
        ("interpolating", "interface.setpoints=interpolated"),
        ("interpolating+current", "interface.setpoints=interpolated"),
    ] {
        let experiment = experiment(Some(name), &[setting]).unwrap();
        assert_eq!(experiment.transformer_name(), Some(TransformerName::from(name)));
        let config = experiment.loop_config().unwrap();
        assert_eq!(config.transformer.takes(), CommandKind::Velocity, "{name}");
        let kv: Vec<f64> = config.servo_gains.iter().map(|gains| gains.damping).collect();
        assert_eq!(kv, [94.6, 89.9, 30.4, 30.3]);
        assert!(config.servo_gains.iter().all(|gains| gains.stiffness == 0.0));
        assert!(config.capabilities.has_brakes);
    }
}

/// The default transformer of a velocity robot, and that of a position robot with the same declarations.
#[test]
fn default_transformer_matches_position_robot() {
    for (settings, expected) in [
        (vec![], "emulation+current"),
        (vec!["interface.measured=[\"position\"]"], "emulation"),
        (vec!["interface.setpoints=interpolated"], "interpolating+current"),
    ] {
        let [velocity, position] = [CommandKind::Velocity, CommandKind::Position]
            .map(|backend| on_robot(robot(&settings).unwrap(), backend, None).unwrap().transformer_name());
        assert_eq!(velocity, position);
        assert_eq!(velocity, Some(TransformerName::from(expected)));
    }
}

/// Messages of the errors for transformers that a velocity robot does not support.
#[test]
fn position_loop_transformers_are_refused() {
    for name in ["identified", "identified+current"] {
        let error = experiment(Some(name), &[]).unwrap_err();
        assert!(error.message().contains(&format!("'{name}'")), "{error}");
        assert!(error.message().contains("position servo, which a velocity robot does not have"), "{error}");
    }
    let integral = "profile.a-med.velocity_servo.elbow.ki_nm_per_rad=500.0";
    let error = experiment(Some("paper+current"), &[integral]).unwrap_err();
    assert!(error.message().contains("the integral of the velocity servo of joint 'elbow'"), "{error}");
    assert!(experiment(Some("emulation"), &[integral]).is_ok());
    let refined = "profile.a-med.adapt_gains={time_s=1.0,max_relative_change=0.3}";
    let error = experiment(None, &[refined]).unwrap_err();
    assert!(error.message().contains("velocity servos cannot be adapted"), "{error}");
}

/// Compared: the velocity servos in the file, and the inner loops of its cascades.
#[test]
fn velocity_servos_are_cascade_inner_loops() {
    let robot = robot(&[]).unwrap();
    for profile in ["a-med", "b-soft"] {
        let profile = robot.profile(Some(profile)).unwrap().1;
        let servos = robot.servos(profile).into_iter().zip(robot.velocity_servos(profile));
        assert_eq!(servos.len(), 4);
        for pair in servos {
            let (ServoParameters::Cascaded(outer), ServoParameters::Velocity(inner)) = pair else {
                panic!("{pair:?}");
            };
            assert_eq!(inner.kv_nms_per_rad, outer.kv_nms_per_rad);
            assert_eq!(inner.velocity_filter_hz, outer.velocity_filter_hz);
            assert_eq!(inner.ki_nm_per_rad.get(), 0.0);
        }
    }
}

/// Errors of profiles that lack servos of a kind or of a joint, or contain them in the wrong section.
#[test]
fn missing_servos_are_named() {
    let text = robot(&[]).unwrap().source.text().to_owned();
    let velocity = section(&text, "[profile.a-med.velocity_servo]");
    let position = section(&text, "[profile.a-med.servo]");

    let mut without = edited(&velocity, "").unwrap();
    without.file.simulated = None;
    assert!(on_robot(without.clone(), CommandKind::Position, None).is_ok());
    let error = on_robot(without, CommandKind::Velocity, None).unwrap_err();
    assert!(error.message().contains("'a-med' has no velocity servos"), "{error}");
    assert!(error.help().unwrap().contains("[profile.a-med.velocity_servo.JOINT]"), "{error}");
    assert!(error.help().unwrap().contains("kv_nms_per_rad"), "{error}");

    let mut without = edited(&position, "").unwrap();
    without.file.simulated = None;
    assert!(on_robot(without.clone(), CommandKind::Velocity, None).is_ok());
    assert!(on_robot(without.clone(), CommandKind::Torque, None).is_ok());
    let error = on_robot(without, CommandKind::Position, None).unwrap_err();
    assert!(error.message().contains("'a-med' has no position servos"), "{error}");

    let one_less = velocity.lines().filter(|line| !line.starts_with("elbow")).collect::<Vec<_>>().join("\n");
    let error = edited(&velocity, &format!("{one_less}\n")).unwrap_err();
    assert!(error.message().contains("joint 'elbow'"), "{error}");
    assert!(error.message().contains("profile.a-med.velocity_servo"), "{error}");

    let cascaded = position.lines().find(|line| line.starts_with("elbow")).unwrap();
    let misplaced = "elbow = { velocity = { kv_nms_per_rad = 30.3, velocity_filter_hz = 600.0 } }";
    let error = edited(cascaded, misplaced).unwrap_err();
    assert!(error.message().contains("'elbow' is a velocity servo"), "{error}");
    assert!(error.help().unwrap().contains("[profile.a-med.velocity_servo.elbow]"), "{error}");
}

/// Compared: metrics and page of a short simulated run, and the setpoint quantity of a velocity robot; its largest
/// setpoint acceleration, and the largest value of the recorded signal.
#[test]
fn report_shows_velocity_setpoints() {
    let options =
        RunOptions { backend: CommandKind::Velocity, duration_s: Some(0.6), ..RunOptions::default() };
    let settings = ["settle_s=0.0".to_owned()];
    let path = Path::new("tasks/gravity-compensation.toml");
    let experiment = Experiment::load(Files::Embedded, path, None, options, &settings).unwrap();
    let finished = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
    let recording = Recording::from_bytes(finished.sink.get_ref()).unwrap();
    let summary = experiment.summary(&recording, &finished.record, None);

    let rates = recording.channel("tick").unwrap().signal("setpoint_acceleration").unwrap();
    let largest =
        rates.rows().flatten().filter(|rate| rate.is_finite()).fold(0.0, |max: f64, v| max.max(v.abs()));
    assert!(largest > 0.0);
    assert_eq!(summary.metrics.setpoint_acceleration_max_rad_per_s2, Some(largest));
    assert_eq!(summary.metrics.setpoint_speed_max_rad_per_s, None);

    let shown = RunSection::new(&experiment, &recording, summary.clone());
    let page = page("Title", "Lead.", &[summary], &default_columns(&[]), &[shown]);
    assert!(page.contains("gravity-compensation: velocity robot, osc through"));
    assert!(page.contains("velocity (rad/s)"), "the figure of the setpoints");
}
