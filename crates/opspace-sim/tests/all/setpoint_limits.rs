//! Reactions of simulated drives to setpoints beyond their limits.

use crate::common::{arm, parsed, read, servo_rows, setup};
use opspace_backend::signal_names::SETPOINT_LIMITED;
use opspace_backend::{Backend, Command, CommandKind, GroundTruth, TruthRow};
use opspace_sim::fault::SETPOINT_LIMIT;
use opspace_sim::{Key, SimulatedArm, SimulationError};

/// Largest change of a resting setpoint in the first cycle, by the jerk: J T³.
const SMALL_RAD: f64 = 5000.0 * 1e-9;

fn limited_arm(reaction: &str) -> SimulatedArm {
    let mut config = setup(CommandKind::Position, "a-med");
    config.profile.setpoint_limits = Some(parsed(&format!(
        "reaction = \"{reaction}\"\njoint.elbow = {{ velocity_rad_per_s = 2.0, acceleration_rad_per_s2 = 10.0, \
         jerk_rad_per_s3 = 5000.0 }}"
    )));
    arm(config)
}

/// True signal of the last interface cycle.
fn limited(arm: &SimulatedArm) -> Vec<f64> {
    let signals = arm.layouts().truth.signals;
    let begin: usize =
        signals.iter().take_while(|s| s.name.as_str() != SETPOINT_LIMITED).map(|s| s.elements.len()).sum();
    let mut last = Vec::new();
    arm.visit(&mut |row| {
        if let TruthRow::State { row, .. } = row {
            last = row[begin..begin + 4].to_vec();
        }
    });
    last
}

/// Sends setpoints that differ from those of the rest by this in all joints, and reads the next cycle. Returns the mean
/// motor torques of the interval (Nm).
fn send(arm: &mut SimulatedArm, rest: &[f64], by_rad: f64) -> Vec<f64> {
    let setpoints: Vec<f64> = rest.iter().map(|q| q + by_rad).collect();
    arm.write(Command::Position(&setpoints)).expect("they are accepted");
    read(arm);
    let rows = servo_rows(arm);
    (0..4).map(|i| rows.iter().map(|(_, torque)| torque[i]).sum::<f64>() / rows.len() as f64).collect()
}

/// Compared: torque of the elbow under a refused outlier, which keeps the setpoint of the rest, and that of the shoulder,
/// which has no limit. The outlier is refused with the three setpoints after it, whose differences contain it. The first
/// setpoint is accepted; a small one and a missed one are not limited.
#[test]
fn refused_setpoint_leaves_the_last_one() {
    let mut arm = limited_arm("refuse");
    read(&mut arm);
    let rest = arm.true_q().as_slice().to_vec();
    let before = send(&mut arm, &rest, 0.0);
    assert_eq!(limited(&arm), [0.0; 4]);
    let after = send(&mut arm, &rest, 1e-3);
    assert_eq!(limited(&arm), [0.0, 0.0, 0.0, 1.0]);
    assert!((after[0] - before[0]).abs() > 1.0, "{after:?} after {before:?}");
    // The elbow hangs on its setpoint while the others pull at it.
    assert!((after[3] - before[3]).abs() < 0.4, "{after:?} after {before:?}");
    for expected in [1.0, 1.0, 1.0, 0.0] {
        send(&mut arm, &rest, 0.0);
        assert_eq!(limited(&arm), [0.0, 0.0, 0.0, expected]);
    }
    send(&mut arm, &rest, 0.99 * SMALL_RAD);
    assert_eq!(limited(&arm), [0.0; 4], "within the limit");
    // A missed cycle is no violation.
    read(&mut arm);
    assert_eq!(limited(&arm), [0.0; 4]);
    send(&mut arm, &rest, 1e-3);
    assert_eq!(limited(&arm), [0.0, 0.0, 0.0, 1.0]);
}

/// Checks that a step of the elbow's setpoint is limited in each of the 12 cycles after it: at 10 rad/s², 1 mrad takes
/// 14 cycles. The other joints have no limits.
#[test]
fn clamped_step_is_limited_until_it_is_reached() {
    const STEP_RAD: f64 = 1e-3;
    let mut arm = limited_arm("clamp");
    read(&mut arm);
    let rest = arm.true_q().as_slice().to_vec();
    send(&mut arm, &rest, 0.0);
    let mut count = 0.0;
    for _ in 0..12 {
        send(&mut arm, &rest, STEP_RAD);
        assert_eq!(limited(&arm)[..3], [0.0; 3]);
        count += limited(&arm)[3];
    }
    assert_eq!(count, 12.0);
}

/// Checks that a stopping drive reports joint, limit and value, and keeps its last setpoint.
#[test]
fn stopping_drive_names_joint_and_limit() {
    for (by_rad, words) in [
        (0.01, "the setpoint of joint 'elbow' exceeds the drive's velocity limit of 2 rad/s"),
        (1e-3, "the setpoint of joint 'elbow' exceeds the drive's acceleration limit of 10 rad/s²"),
        (6e-6, "the setpoint of joint 'elbow' exceeds the drive's jerk limit of 5000 rad/s³"),
    ] {
        let mut arm = limited_arm("stop");
        read(&mut arm);
        let mut setpoints = arm.true_q();
        arm.write(Command::Position(setpoints.as_slice())).expect("the first one is accepted");
        read(&mut arm);
        setpoints[3] += by_rad;
        let fault = arm.write(Command::Position(setpoints.as_slice())).expect_err("it stops");
        assert_eq!((fault.code, fault.words.as_ref()), (SETPOINT_LIMIT, words));
        arm.stop();
        read(&mut arm);
    }
}

/// Checks that limits don't apply to torques, and that the signal is absent without limits.
#[test]
fn robot_without_limits_has_no_signal() {
    let names = |arm: &SimulatedArm| -> Vec<String> {
        arm.layouts().truth.signals.iter().map(|signal| signal.name.to_string()).collect()
    };
    assert!(names(&limited_arm("clamp")).contains(&SETPOINT_LIMITED.to_owned()));
    assert!(!names(&arm(setup(CommandKind::Position, "a-med"))).contains(&SETPOINT_LIMITED.to_owned()));
}

#[test]
fn unknown_joint_is_refused() {
    let mut config = setup(CommandKind::Position, "a-med");
    let limits = parsed("reaction = \"clamp\"\njoint.elbw = { velocity_rad_per_s = 2.0 }");
    config.profile.setpoint_limits = Some(limits);
    let Err(error) = SimulatedArm::new(config) else { panic!("it is refused") };
    assert!(matches!(error, SimulationError::SetpointLimits { .. }), "{error}");
    let path = ["setpoint_limits", "joint", "elbw"].map(str::to_owned);
    assert_eq!(error.key(), Key::Profile(path.to_vec()));
    assert!(error.to_string().contains("elbow"), "{error}");
}
