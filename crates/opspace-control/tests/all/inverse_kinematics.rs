//! The inverse kinematics baseline. Compared: forward kinematics of the streamed joint positions with the reference,
//! and the servo lead with its formula.

use crate::common::{self, File, Numbers, Q0, at_state, control_context, four_joints, seven_joints};
use nalgebra::Vector3;
use opspace_backend::{CommandKind, Observable};
use opspace_control::{Controller, InverseKinematicsController, ServoLead, orientation};
use opspace_model::{Data, Model, frame_placement, gravity, kinematics};
use std::f64::consts::PI;

const LISSAJOUS: &str = r#"
priority = ["hand", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "compliant", z = "motion" }
gains = { frequency_rad_per_s = 14.142, damping_ratio = 1.0 }
[task.hand.cartesian.reference.sinusoid]
x = [{ amplitude_m = 0.05, frequency_hz = 1.0 }]
y = [{ amplitude_m = 0.10, frequency_hz = 0.5 }]
z = [{ amplitude_m = 0.08, frequency_hz = 0.5, phase_rad = -1.5707963267948966, offset_m = 0.08 }]
[task.rest.joint-posture]
frequency_rad_per_s = 6.0
damping_ratio = 0.8
"#;

fn values(controller: &InverseKinematicsController, name: &str) -> Vec<f64> {
    let signals = controller.signals();
    let mut row = vec![0.0; signals.iter().map(|s| s.len()).sum()];
    controller.sample(&mut row);
    let place = signals.iter().position(|s| s.name == name).expect("the signal exists");
    let first: usize = signals[..place].iter().map(|s| s.len()).sum();
    row[first..first + signals[place].len()].to_vec()
}

fn placed(model: &Model, q: &[f64]) -> Data {
    let mut data = Data::new(model);
    kinematics(model, &mut data, q, &vec![0.0; q.len()]);
    gravity(model, &mut data);
    data
}

#[test]
fn streamed_positions_follow_reference_with_servo_lead() {
    let model = four_joints();
    let file = File::read(LISSAJOUS);
    let robot = control_context(&model, "hand");
    let lead =
        ServoLead { kp_per_s: vec![50.3; 4], stiffness_nm_per_rad: vec![4756.0, 4522.0, 1529.0, 1524.0] };
    let build = |lead| {
        InverseKinematicsController::new(&model, &file.task_set(), &robot, lead).expect("a good stack")
    };
    let (mut plain, mut led) = (build(None), build(Some(lead.clone())));
    assert_eq!(plain.command_kind(), CommandKind::Position);
    let (data, mut measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    plain.start(&common::input(&model, &data, &measurement));
    led.start(&common::input(&model, &data, &measurement));
    let hand = model.frame_id("hand").expect("hand");
    let start = frame_placement(&model, &data, hand).translation;
    let (mut streamed, mut ahead) = ([0.0; 4], [0.0; 4]);
    let mut worst = 0.0_f64;
    for tick in 0..4000 {
        let t = 1e-3 * f64::from(tick);
        measurement.time_s = t;
        plain.update(&common::input(&model, &data, &measurement), &mut streamed);
        led.update(&common::input(&model, &data, &measurement), &mut ahead);
        if tick == 0 {
            assert!(streamed == Q0, "the first command is the measured posture");
        }
        let at = placed(&model, &streamed);
        let dq = values(&led, "ik.dq");
        for i in 0..4 {
            let expected = streamed[i] + dq[i] / 50.3 + at.gravity[i] / lead.stiffness_nm_per_rad[i];
            assert!((ahead[i] - expected).abs() < 1e-14, "joint {i} at {t} s");
        }
        if t >= 1.0 {
            let w = PI * t;
            let figure = Vector3::new(0.05 * (2.0 * w).sin(), 0.10 * w.sin(), 0.08 * (1.0 - w.cos()));
            worst = worst.max((frame_placement(&model, &at, hand).translation - start - figure).norm());
        }
    }
    // The error of explicit Euler is T ẍ/2 divided by the error gain: 1e-3 · 2 / 2 / 20.
    assert!(worst < 1e-4, "{worst} m");
}

/// Orientation and position on seven joints, for a robot that compensates gravity itself: no sag is compensated.
#[test]
fn pose_is_reached() {
    let model = seven_joints();
    let file = File::read(
        r#"
        priority = ["hand", "rest"]
        [task.hand.cartesian]
        frame = "hand"
        axes = { x = "motion", y = "motion", z = "motion", rx = "motion", ry = "motion", rz = "motion" }
        gains = { frequency_rad_per_s = 14.142, damping_ratio = 1.0 }
        reference.point-to-point = { position = { offset_m = [0.05, -0.04, -0.06] }, orientation = { offset_rpy_rad = [0.3, 0.2, -0.4] }, duration_s = 1.0 }
        [task.rest.joint-posture]
        frequency_rad_per_s = 6.0
        damping_ratio = 0.8
        "#,
    );
    let mut robot = control_context(&model, "hand");
    robot.gravity_by_robot = true;
    let lead = ServoLead { kp_per_s: vec![50.0; 7], stiffness_nm_per_rad: vec![1e3; 7] };
    let mut controller =
        InverseKinematicsController::new(&model, &file.task_set(), &robot, Some(lead)).expect("a good stack");
    let q = [0.3, 0.7, -0.4, -1.4, 0.2, 1.1, 0.5];
    let (data, mut measurement) = at_state(&model, &q, &[0.0; 7], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let mut command = [0.0; 7];
    for tick in 0..3000 {
        measurement.time_s = 1e-3 * f64::from(tick);
        controller.update(&common::input(&model, &data, &measurement), &mut command);
    }
    let hand = model.frame_id("hand").expect("hand");
    let [from, to] =
        [frame_placement(&model, &data, hand), frame_placement(&model, &placed(&model, &command), hand)];
    assert!((to.translation - from.translation - Vector3::new(0.05, -0.04, -0.06)).norm() < 1e-6);
    let turn = to.rotation * from.rotation.transpose() * orientation::from_rpy([0.3, 0.2, -0.4]).transpose();
    assert!(orientation::log(&turn).norm() < 1e-6);
}

/// Random goals, most of them out of reach: no joint exceeds its limits of position and speed on the way, and the arm comes to rest.
#[test]
fn arm_comes_to_rest_at_goals_out_of_reach() {
    let mut numbers = Numbers::new(19);
    for case in 0..60 {
        let model = if case % 2 == 0 { seven_joints() } else { four_joints() };
        let n = model.n();
        let rotations =
            if case % 4 == 0 { ", rx = \"motion\", ry = \"motion\", rz = \"motion\"" } else { "" };
        let offset: Vec<f64> = (0..3).map(|_| numbers.next()).collect();
        let file = File::read(&format!(
            r#"
            priority = ["hand", "rest"]
            [task.hand.cartesian]
            frame = "hand"
            axes = {{ x = "motion", y = "motion", z = "motion"{rotations} }}
            gains = {{ frequency_rad_per_s = 14.142, damping_ratio = 1.0 }}
            reference.point-to-point = {{ position = {{ offset_m = {offset:?} }}, duration_s = 1.0 }}
            [task.rest.joint-posture]
            frequency_rad_per_s = 6.0
            damping_ratio = 0.8
            "#
        ));
        let mut robot = control_context(&model, "hand");
        robot.limits.velocity = vec![2.0; n];
        robot.limits.lower = vec![-2.5; n];
        robot.limits.upper = vec![2.5; n];
        let mut controller =
            InverseKinematicsController::new(&model, &file.task_set(), &robot, None).expect("a good stack");
        let q = [0.3, 0.7, -0.4, -1.4, 0.2, 1.1, 0.5];
        let (data, mut measurement) = at_state(&model, &q[..n], &vec![0.0; n], 0.0);
        controller.start(&common::input(&model, &data, &measurement));
        let (mut command, mut before) = (vec![0.0; n], q[..n].to_vec());
        for tick in 0..20_000 {
            measurement.time_s = 1e-3 * f64::from(tick);
            controller.update(&common::input(&model, &data, &measurement), &mut command);
            let speed = command.iter().zip(&before).map(|(a, b)| 1e3 * (a - b).abs()).fold(0.0, f64::max);
            // 90 % of the speed limit and 0.01 rad from the ends of the ranges; at the end, rounding.
            let most = if tick < 19_000 { 1.8 + 1e-9 } else { 1e-6 };
            assert!(tick == 0 || speed <= most, "case {case}, tick {tick}: {speed} rad/s");
            assert!(command.iter().all(|q| q.abs() <= 2.49), "case {case}, tick {tick}: {command:?}");
            before.copy_from_slice(&command);
        }
    }
}

/// While the hand holds its position, the elbow moves until the posture desires no motion in the null space of the
/// hand: the remaining difference to the posture has no component in the kernel of J.
#[test]
fn posture_task_does_not_move_the_hand() {
    let model = four_joints();
    let text =
        LISSAJOUS.replace("damping_ratio = 0.8", "damping_ratio = 0.8\nposture_rad = { shoulder_yaw = 0.7 }");
    let begin = text.find("[task.hand.cartesian.reference").expect("there");
    let end = text.find("[task.rest").expect("there");
    let text = text.replace(&text[begin..end], "").replace("gains =", "reference = \"hold\"\ngains =");
    let file = File::read(&text);
    let mut controller =
        InverseKinematicsController::new(&model, &file.task_set(), &control_context(&model, "hand"), None)
            .expect("a good stack");
    let (data, measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let mut q = [0.0; 4];
    for _ in 0..20_000 {
        controller.update(&common::input(&model, &data, &measurement), &mut q);
    }
    let hand = model.frame_id("hand").expect("hand");
    let at = placed(&model, &q);
    let [from, to] = [&data, &at].map(|data| frame_placement(&model, data, hand).translation);
    assert!((to - from).norm() < 1e-9, "the hand stays");
    assert!(q[2] > Q0[2] + 0.05, "the shoulder turns to {}", q[2]);
    let j = common::jacobian(&model, &at, "hand").rows(0, 3).into_owned();
    let kernel = nalgebra::DMatrix::identity(4, 4) - j.clone().pseudo_inverse(1e-9).expect("finite") * j;
    let left = nalgebra::DVector::from_fn(4, |i, _| if i == 2 { 0.7 - q[i] } else { Q0[i] - q[i] });
    assert!((kernel * left).norm() < 1e-6, "the posture is as near as it gets");
}

/// Two tasks that move simultaneously: the second one compensates the effect of the first one.
#[test]
fn lower_task_follows_its_reference() {
    let model = four_joints();
    let text = LISSAJOUS.replace(r#"["hand", "rest"]"#, r#"["hand", "elbow"]"#);
    let end = text.find("[task.rest").expect("there");
    let text = format!(
        "{}[task.elbow.cartesian]\nframe = \"elbow\"\naxes = {{ y = \"motion\" }}\nreference = \"hold\"\n\
         gains = {{ frequency_rad_per_s = 14.0, damping_ratio = 1.0 }}\n",
        &text[..end]
    )
    .replace("0.05", "0.02")
    .replace("0.10", "0.02")
    .replace("0.08", "0.02");
    let file = File::read(&text);
    let mut controller =
        InverseKinematicsController::new(&model, &file.task_set(), &control_context(&model, "hand"), None)
            .expect("a good stack");
    let (data, mut measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let elbow = model.frame_id("elbow").expect("elbow");
    let start = frame_placement(&model, &data, elbow).translation.y;
    let mut q = [0.0; 4];
    for tick in 0..3000 {
        measurement.time_s = 1e-3 * f64::from(tick);
        controller.update(&common::input(&model, &data, &measurement), &mut q);
        let off = frame_placement(&model, &placed(&model, &q), elbow).translation.y - start;
        // Error of explicit Euler, as above.
        assert!(off.abs() < 1e-4, "{off} m at {} s", measurement.time_s);
    }
}

#[test]
fn joint_references_are_streamed_unchanged() {
    let model = four_joints();
    let file = File::read(
        r#"
        priority = ["all"]
        [task.all.joint-tracking]
        gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
        reference.sinusoid.joints.elbow = [{ amplitude_rad = 0.4, frequency_hz = 0.7 }]
        "#,
    );
    let (data, mut measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    for lead in [false, true] {
        let servo = lead.then(|| ServoLead { kp_per_s: vec![50.0; 4], stiffness_nm_per_rad: vec![1e3; 4] });
        let mut controller = InverseKinematicsController::new(
            &model,
            &file.task_set(),
            &control_context(&model, "hand"),
            servo,
        )
        .expect("a good stack");
        measurement.time_s = 0.0;
        controller.start(&common::input(&model, &data, &measurement));
        measurement.time_s = 1.9;
        let mut command = [0.0; 4];
        controller.update(&common::input(&model, &data, &measurement), &mut command);
        let omega = 2.0 * PI * 0.7;
        let mut q = Q0;
        q[3] += 0.4 * (omega * 1.9).sin();
        if lead {
            let sag = placed(&model, &q).gravity;
            q[3] += 0.4 * omega * (omega * 1.9).cos() / 50.0;
            for i in 0..4 {
                q[i] += sag[i] / 1e3;
            }
        }
        for i in 0..4 {
            assert!((command[i] - q[i]).abs() < 1e-14, "joint {i}: {} for {}", command[i], q[i]);
        }
    }
}

/// A joint whose reference is too fast, and joints that rest. Compared: speed and acceleration of the commands with their
/// limits, and the commands at the end with the reference.
#[test]
fn joint_references_are_followed_within_limits() {
    /// Rounding of differences of positions, rad/s and rad/s².
    const ROUNDING: [f64; 2] = [1e-9, 1e-6];
    /// Largest distance beyond the reference, rad.
    const OVERSHOOT_RAD: f64 = 1e-6;
    /// Declared acceleration, rad/s².
    const ACCELERATION: f64 = 6.0;
    let model = four_joints();
    let file = File::read(
        r#"
        priority = ["all"]
        [task.all.joint-tracking]
        gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
        reference.point-to-point = { goal = { offset_rad = { elbow = 0.9 } }, duration_s = 0.3 }
        "#,
    );
    let mut robot = control_context(&model, "hand");
    robot.limits.velocity = vec![2.0; 4];
    robot.limits.acceleration = vec![ACCELERATION; 4];
    let mut controller =
        InverseKinematicsController::new(&model, &file.task_set(), &robot, None).expect("a good stack");
    let (data, mut measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let (mut command, mut before, mut speed_before) = ([0.0; 4], Q0, 0.0);
    let mut fastest = 0.0_f64;
    for tick in 0..3000 {
        measurement.time_s = 1e-3 * f64::from(tick);
        controller.update(&common::input(&model, &data, &measurement), &mut command);
        assert_eq!(command[..3], Q0[..3], "joints that rest stay where they are");
        let speed = (command[3] - before[3]) / 1e-3;
        assert!(speed.abs() <= 0.9 * 2.0 + ROUNDING[0], "tick {tick}: {speed} rad/s");
        let acceleration = (speed - speed_before) / 1e-3;
        assert!(acceleration.abs() <= ACCELERATION + ROUNDING[1], "tick {tick}: {acceleration} rad/s²");
        assert!(command[3] <= Q0[3] + 0.9 + OVERSHOOT_RAD, "tick {tick}: no overshoot");
        (before, speed_before, fastest) = (command, speed, fastest.max(speed));
    }
    assert!(fastest > 1.5, "the limits are used: {fastest} rad/s");
    assert_eq!(command[3], Q0[3] + 0.9, "the reference is reached exactly");
}
