//! Compared: the parameters of a joint of the simulated arm, identified through its interface, and those of the
//! simulation.

use opspace_experiment::Progress;
use opspace_experiment::{Files, RobotDefinition, Source};
use opspace_identify::{ExcitationPlan, TorqueScale};
use opspace_setup::identify::{IdentificationJob, IdentificationResults, Request};
use std::path::Path;

const ROBOT: &str = "robots/asimo-arm";

fn identify(robot: RobotDefinition, request: Request) -> IdentificationResults {
    let identifying = IdentificationJob::new(robot, request).unwrap_or_else(|e| panic!("{e}"));
    let mut arm = identifying.simulated_arm().unwrap_or_else(|e| panic!("{e}"));
    identifying.run(&mut arm, &Progress::default(), |_| {}).unwrap_or_else(|e| panic!("{e}"))
}

fn robot(settings: &[&str]) -> RobotDefinition {
    let settings: Vec<String> = settings.iter().map(|s| (*s).to_owned()).collect();
    RobotDefinition::load(Files::Embedded, Path::new(ROBOT), &settings).unwrap_or_else(|e| panic!("{e}"))
}

/// Request with a shorter excitation than usual.
fn short(profile: &str) -> Request {
    Request {
        profile: Some(profile.to_owned()),
        joint: Some("elbow".to_owned()),
        plan: ExcitationPlan { period_s: 1.0, realisations: 1, speeds: 5, ..ExcitationPlan::default() },
        ..Request::default()
    }
}

struct Bar {
    kp: f64,
    kv: f64,
}

/// Compared: the identified parameters, and those of the plant in the file, independent of the nominal ones: relative
/// errors of kp and kv, and the delay in servo ticks.
#[track_caller]
fn assert_identified(
    profile: &str,
    settings: &[&str],
    delay: u32,
    truth: [f64; 2],
    bar: &Bar,
) -> IdentificationResults {
    let found = identify(robot(settings), short(profile));
    let joint = &found.joints[0];
    assert_eq!(joint.no_torque_mode, None);
    let servo = joint.found.servo.as_ref().expect("a servo");
    let [kp, kv] = truth;
    assert!((servo.kp / kp - 1.0).abs() < bar.kp, "kp {} of {kp}", servo.kp);
    assert!((servo.kv / kv - 1.0).abs() < bar.kv, "kv {} of {kv}", servo.kv);
    assert!(servo.delay.abs_diff(delay) <= 1, "delay {} of {delay}", servo.delay);
    found
}

#[test]
fn fast_servo_is_identified() {
    let bar = Bar { kp: 0.03, kv: 0.03 };
    let found = assert_identified("a-med", &[], 0, [50.265, 30.3], &bar);
    let joint = &found.joints[0].found;
    assert_eq!(joint.scale, TorqueScale::MotorCurrent);
    let friction = joint.servo.as_ref().and_then(|s| s.friction).expect("friction");
    // Coulomb and viscous friction of the plant.
    assert!((friction.coulomb / 1.1 - 1.0).abs() < 0.1, "{friction:?}");
    assert!((friction.viscous / 1.2 - 1.0).abs() < 0.1, "{friction:?}");
    // Inertia according to the model from which the plant is built.
    let trust = joint.fit_quality.as_ref().expect("trust");
    assert!((trust.inertia_over_urdf.expect("a rotor") - 1.0).abs() < 0.1, "{trust:?}");
    assert!(trust.bandwidth_hz > 50.0, "{trust:?}");
}

#[test]
fn slow_servo_with_wrong_nominal_delay_is_identified() {
    let bar = Bar { kp: 0.05, kv: 0.08 };
    let settings = [
        "robot.simulated.true_over_nominal.kp=1.3",
        "robot.simulated.true_over_nominal.kv=0.8",
        "robot.profile.b-soft.delay_servo_ticks=3",
    ];
    assert_identified("b-soft", &settings, 3, [1.3 * 25.133, 0.8 * 15.15], &bar);
}

#[test]
fn interpolating_drive_is_identified() {
    let bar = Bar { kp: 0.03, kv: 0.03 };
    let settings = [
        "robot.interface.setpoints=\"interpolated\"",
        "robot.profile.a-med.delay_servo_ticks=2",
        "robot.profile.a-med.servo.elbow={pid={stiffness_nm_per_rad=1500.0,damping_nms_per_rad=30.0,derivative_filter_hz=500.0}}",
    ];
    let found = assert_identified("a-med", &settings, 2, [50.0, 30.0], &bar);
    assert!(found.servo_toml().contains("elbow = { pid = {"), "{}", found.servo_toml());
}

/// Identification without motor current: the scale comes from the inertia, which is the true one here; kp from the lag at
/// constant speed, and from the declared viscous friction, which is subtracted from kv.
#[test]
fn gains_are_identified_without_current() {
    const KP: f64 = 0.005;
    const KV: f64 = 0.05;
    for wrong in [0.9, 1.1] {
        let kp = format!("robot.simulated.true_over_nominal.kp={wrong}");
        let settings = ["robot.interface.measured=[\"position\"]", kp.as_str()];
        let found = identify(robot(&settings), short("a-med"));
        let joint = &found.joints[0];
        let servo = joint.found.servo.as_ref().expect("a servo");
        assert_eq!(joint.found.scale, TorqueScale::Urdf);
        assert!((servo.kp / (wrong * 50.265) - 1.0).abs() < KP, "{}", servo.kp);
        assert!((servo.kv / 30.3 - 1.0).abs() < KV, "{}", servo.kv);
        let friction = servo.friction.expect("friction");
        assert!((friction.coulomb / 1.1 - 1.0).abs() < KV, "{friction:?}");
        assert!((friction.viscous / 1.2 - 1.0).abs() < KV, "{friction:?}");
        assert!(servo.delay <= 1);
    }
}

/// Compared, for setpoints that are interpolated and act late: the identified gain kp, and the true one.
#[test]
fn kp_of_interpolating_drive_is_identified_without_current() {
    const KP: f64 = 0.01;
    let settings = [
        "robot.interface.measured=[\"position\"]",
        "robot.interface.setpoints=\"interpolated\"",
        "robot.profile.a-med.delay_servo_ticks=2",
    ];
    let found = identify(robot(&settings), short("a-med"));
    let servo = found.joints[0].found.servo.as_ref().expect("a servo");
    assert_eq!(servo.delay, 2);
    assert!((servo.kp / 50.265 - 1.0).abs() < KP, "{}", servo.kp);
}

#[test]
fn only_ratios_are_written_without_current_and_rotor() {
    let settings = ["robot.interface.measured=[\"position\"]", "robot.joint.elbow.rotor.inertia_kg_m2=0.0"];
    let found = identify(robot(&settings), short("a-med"));
    let joint = &found.joints[0];
    assert_eq!(joint.found.scale, TorqueScale::Unknown);
    assert!(joint.no_torque_mode.as_ref().is_some_and(|r| r.contains("only ratios")));
    assert!(!found.is_complete());
    assert_eq!(found.robot_toml("arm.urdf").expect("it can be edited"), None);
    let section = found.servo_toml();
    assert!(section.contains("kv over inertia") && !section.contains("kv_nms_per_rad"), "{section}");
}

#[test]
fn immobile_joint_is_refused_with_reason() {
    // Its static friction exceeds the torque of its motor.
    let settings = ["robot.simulated.true_over_nominal.friction=40.0"];
    let found = identify(robot(&settings), short("a-med"));
    let joint = &found.joints[0];
    let reason = joint.no_torque_mode.as_ref().expect("it is refused");
    assert!(reason.contains("does not follow") || reason.contains("within the limits"), "{reason}");
    assert_eq!(found.robot_toml("arm.urdf").expect("it can be edited"), None);
}

/// Refusal of a servo that is declared as cascaded gains although its velocity loop has integral action.
#[test]
fn wrongly_declared_servo_is_refused() {
    let settings = [
        "robot.simulated.servo.elbow={cascaded={kp_per_s=50.0,kv_nms_per_rad=30.0,velocity_filter_hz=600.0,velocity_integral_time_s=0.03}}",
    ];
    let found = identify(robot(&settings), short("a-med"));
    let reason = found.joints[0].no_torque_mode.as_ref().expect("it is refused");
    assert!(reason.contains("no cascaded servo fits"), "{reason}");
}

/// Compared: the written robot file and the original file: its plant is the original one, and its nominal parameters
/// are the identified ones.
#[test]
fn written_robot_keeps_plant_and_identified_parameters() {
    const ROUNDING: f64 = 1e-3;
    let found = identify(robot(&[]), short("a-med"));
    let text = found.robot_toml(&found.urdf_name()).expect("it can be edited").expect("it is complete");
    let urdf = Source::new(found.urdf_name(), found.urdf());
    let written = RobotDefinition::from_sources(Source::new("robot.toml", text), urdf)
        .unwrap_or_else(|e| panic!("{e}"));
    let before = robot(&[]);
    let (name, profile) = written.profile(None).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(name, "a-med");
    let servo = found.joints[0].found.servo.as_ref().expect("a servo");
    let believed = profile.servo["elbow"].gains(profile.servo_period_s());
    assert!((believed.damping / servo.kv - 1.0).abs() < ROUNDING);
    assert!((believed.position_loop() / servo.kp - 1.0).abs() < ROUNDING);
    let simulated = written.file.simulated.as_ref().expect("a plant");
    assert_eq!(simulated.servo["elbow"], before.file.profile["a-med"].servo["elbow"]);
    assert_eq!(simulated.delay_servo_ticks, Some(0));
    let (true_friction, old) = (&simulated.friction["elbow"], &before.file.joint["elbow"].friction);
    assert_eq!(true_friction.coulomb_nm.get(), old.coulomb_nm.get());
    let new = written.file.joint["elbow"].friction.coulomb_nm.get();
    let measured = servo.friction.expect("friction").coulomb;
    assert!((new / measured - 1.0).abs() < ROUNDING);
}

#[test]
fn unsupported_servo_structure_is_refused_at_its_line() {
    let settings = ["robot.profile.a-med.servo.elbow.cascaded.velocity_integral_time_s=0.1"];
    let error =
        IdentificationJob::new(robot(&settings), Request::default()).map(|_| ()).expect_err("an integral");
    assert!(error.message().contains("integral") && error.message().contains("elbow"), "{error}");
}
