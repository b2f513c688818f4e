//! Force axes of inverse kinematics: compared is the motion of an ideal position robot, which is at each setpoint in the
//! next cycle, on spring walls, with the solution of the difference equation of the admittance.

use crate::common::{self, File, Q0, at_state, control_context, four_joints, seven_joints};
use nalgebra::{Matrix3, Rotation3, Vector3};
use opspace_control::{Controller, InverseKinematicsController, orientation};
use opspace_model::{Force, Model, frame_placement};

const PERIOD_S: f64 = 1e-3;

/// Rolls, pitches and yaws the axes of the task, so that world axes in place of task axes fail.
const RPY: [f64; 3] = [0.5, -0.4, 0.7];

const PRESS: &str = r#"
priority = ["hand", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "force" }
axes_frame = { rpy_rad = [0.5, -0.4, 0.7] }
reference = "hold"
gains = { frequency_rad_per_s = 14.142, damping_ratio = 1.0 }
force = { sensor = "wrist", target_n = { z = 20.0 }, ramp_s = 0.0, filter_hz = 1e6, admittance_ns_per_m = 100.0 }
[task.rest.joint-posture]
frequency_rad_per_s = 6.0
damping_ratio = 0.8
"#;

fn build(model: &Model, text: &str) -> Result<InverseKinematicsController, String> {
    let (file, robot) = (File::read(text), control_context(model, "hand"));
    InverseKinematicsController::new(model, &file.task_set(), &robot, None).map_err(|e| e.to_string())
}

/// Runs the controller on an ideal position robot for `steps` cycles; `wrench` is that of the environment on the hand, from
/// its displacement and rotation vector since the start. Visits displacement and rotation vector after each step.
fn run(
    model: &Model,
    text: &str,
    start: &[f64],
    steps: usize,
    wrench: impl Fn(Vector3<f64>, Vector3<f64>) -> Force,
    mut visit: impl FnMut(usize, Vector3<f64>, Vector3<f64>),
) {
    let mut controller = build(model, text).expect("a good file");
    let hand = model.frame_id("hand").expect("hand");
    let rest = vec![0.0; model.n()];
    let (data, mut measurement) = at_state(model, start, &rest, 0.0);
    let home = frame_placement(model, &data, hand);
    measurement.wrenches[0] = wrench(Vector3::zeros(), Vector3::zeros());
    controller.start(&common::input(model, &data, &measurement));
    let mut command = start.to_vec();
    for step in 0..=steps {
        let (data, mut measurement) = at_state(model, &command, &rest, PERIOD_S * step as f64);
        let at = frame_placement(model, &data, hand);
        let moved = at.translation - home.translation;
        let turned = orientation::log(&(at.rotation * home.rotation.transpose()));
        visit(step, moved, turned);
        measurement.wrenches[0] = wrench(moved, turned);
        controller.update(&common::input(model, &data, &measurement), &mut command);
    }
}

/// With a wall of K and the admittance B, the command grows by K T/B of the remaining penetration in each cycle, and the robot is
/// one cycle behind. The other axes hold their position.
#[test]
fn hand_settles_on_spring_wall_with_pole_of_admittance() {
    let model = four_joints();
    let axes: Matrix3<f64> = orientation::from_rpy(RPY);
    let normal: Vector3<f64> = axes.column(2).into();
    for stiffness in [1e3, 5e3, 20e3] {
        let pole = stiffness * PERIOD_S / 100.0;
        // Position of this cycle, and the command that it gets next.
        let (mut x, mut next) = (0.0, 0.0);
        let mut aside = 0.0_f64;
        run(
            &model,
            PRESS,
            &Q0,
            400,
            |moved, _| {
                let mut force = Force::zero();
                force.linear = normal * (-stiffness * normal.dot(&moved));
                force
            },
            |step, moved, _| {
                let along = normal.dot(&moved);
                aside = aside.max((moved - normal * along).norm());
                // Integration of q̇ leaves an error of the order of the curvature, a fraction of the displacement.
                assert!(
                    (along - x).abs() < 0.02 * 20.0 / stiffness,
                    "K {stiffness}, step {step}: {along} {x}"
                );
                (x, next) = (next, next + pole * (-20.0 / stiffness - x));
            },
        );
        assert!(aside < 1e-3 * 20.0 / stiffness, "K {stiffness}: {aside} m aside");
        assert!((x * stiffness + 20.0).abs() < 1.0, "K {stiffness}: {} N after 0.4 s", x * stiffness);
    }
}

/// Moments about a rotated axis: the same with a torsion spring; the rotations about the other axes are held.
#[test]
fn moment_axis_settles_on_torsion_spring() {
    let model = seven_joints();
    let text = PRESS
        .replace(
            r#"axes = { x = "motion", y = "motion", z = "force" }"#,
            r#"axes = { x = "motion", y = "motion", z = "motion", rx = "motion", ry = "force", rz = "motion" }"#,
        )
        .replace("target_n = { z = 20.0 }", "target_nm = { ry = -2.0 }")
        .replace("admittance_ns_per_m = 100.0", "admittance_nms_per_rad = 0.5");
    let axis: Vector3<f64> = orientation::from_rpy(RPY).column(1).into();
    let stiffness = 20.0;
    let (mut turned_by, mut aside) = (0.0, 0.0_f64);
    run(
        &model,
        &text,
        &[0.3, 0.7, -0.4, -1.4, 0.2, 1.1, 0.5],
        600,
        |_, turned| {
            let mut wrench = Force::zero();
            wrench.angular = -turned * stiffness;
            wrench
        },
        |_, moved, turned| {
            turned_by = axis.dot(&turned);
            aside = aside.max((turned - axis * turned_by).norm()).max(moved.norm());
        },
    );
    assert!((turned_by - 0.1).abs() < 1e-6, "{turned_by} rad");
    // Held by a gain of 20/s against the curvature of a motion of 4 rad/s.
    assert!(aside < 2e-3, "{aside}");
}

/// A compliant axis with an admittance yields to a constant force with f/B, and one without holds its reference.
#[test]
fn compliant_axis_yields_only_with_admittance() {
    let model = four_joints();
    let normal: Vector3<f64> = orientation::from_rpy(RPY).column(2).into();
    let text = PRESS.replace("z = \"force\"", "z = \"compliant\"").replace("target_n = { z = 20.0 }, ", "");
    for (text, speed) in [(text.clone(), 0.05), (text.replace(", admittance_ns_per_m = 100.0", ""), 0.0)] {
        let mut along = 0.0;
        run(
            &model,
            &text,
            &Q0,
            200,
            |_, _| {
                let mut force = Force::zero();
                force.linear = normal * 5.0;
                force
            },
            |_, moved, _| along = normal.dot(&moved),
        );
        // 199 periods, as the first command is the start posture.
        assert!((along - 0.199 * speed).abs() < 1e-4, "{along} m at {speed} m/s");
    }
}

/// Until contact, the hand moves at the speed of the approach, and then the admittance settles the force.
#[test]
fn hand_approaches_before_contact() {
    let model = four_joints();
    let normal: Vector3<f64> = orientation::from_rpy(RPY).column(2).into();
    let text = PRESS
        .replace("ramp_s = 0.0", "ramp_s = 0.0, contact = { approach_m_per_s = 0.05, made_above_n = 2.0 }");
    let (gap, stiffness) = (0.01, 5e3);
    let (mut fastest, mut force) = (0.0_f64, 0.0);
    let (mut before, mut at_half) = (0.0, 0.0);
    let wall = |along: f64| (stiffness * (-gap - along)).max(0.0);
    run(
        &model,
        &text,
        &Q0,
        800,
        |moved, _| {
            let mut wrench = Force::zero();
            wrench.linear = normal * wall(normal.dot(&moved));
            wrench
        },
        |step, moved, _| {
            let along = normal.dot(&moved);
            if force == 0.0 {
                fastest = fastest.max((before - along) / PERIOD_S);
            }
            if step == 101 {
                at_half = along;
            }
            (before, force) = (along, wall(along));
        },
    );
    assert!((at_half + 0.005).abs() < 1e-4 && fastest < 0.0501, "{at_half} m, {fastest} m/s");
    assert!((force - 20.0).abs() < 1e-3, "{force} N");
}

/// A robot that does not move: the command stops at the largest allowed lead.
#[test]
fn command_of_blocked_robot_waits_at_its_lead() {
    let model = four_joints();
    let normal: Vector3<f64> = orientation::from_rpy(RPY).column(2).into();
    for (limits, lead_m) in
        [("", 0.02), (", admittance_limits = { lead_m = 0.004, speed_m_per_s = 0.1 }", 0.004)]
    {
        let text = PRESS.replace("= 100.0 }", &format!("= 100.0{limits} }}"));
        let mut controller = build(&model, &text).expect("a good file");
        let (data, measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
        controller.start(&common::input(&model, &data, &measurement));
        let mut command = Q0;
        for _ in 0..500 {
            controller.update(&common::input(&model, &data, &measurement), &mut command);
        }
        let hand = model.frame_id("hand").expect("hand");
        let (ahead, _) = at_state(&model, &command, &[0.0; 4], 0.0);
        let lead = frame_placement(&model, &ahead, hand).translation
            - frame_placement(&model, &data, hand).translation;
        assert!((normal.dot(&lead) + lead_m).abs() < 1e-6, "{} m", normal.dot(&lead));
    }
}

/// Measured forces that are not finite stop the axis for a cycle and leave no trace.
#[test]
fn force_that_is_not_finite_is_ignored() {
    let model = four_joints();
    let mut controller = build(&model, PRESS).expect("a good file");
    let (data, mut measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let mut command = Q0;
    for force in [20.0, f64::NAN, f64::INFINITY, 20.0, 20.0] {
        measurement.wrenches[0].linear =
            Rotation3::from_matrix_unchecked(orientation::from_rpy(RPY)) * Vector3::new(0.0, 0.0, force);
        controller.update(&common::input(&model, &data, &measurement), &mut command);
    }
    assert!(command.iter().zip(Q0).all(|(c, q)| (c - q).abs() < 1e-12), "{command:?}");
}

/// Errors name the key that is missing or has no effect.
#[test]
fn missing_admittance_is_refused() {
    let model = four_joints();
    let at = "task.hand.cartesian.force";
    for (from, to, expected) in [
        (
            ", admittance_ns_per_m = 100.0",
            "",
            format!(
                "{at}.admittance_ns_per_m: inverse kinematics controls the force of axis z by an admittance: give \
                 `admittance_ns_per_m`, or use the controller `osc`"
            ),
        ),
        (
            "admittance_ns_per_m = 100.0",
            "admittance_ns_per_m = { x = 100.0 }",
            format!(
                "{at}.admittance_ns_per_m: axis x accepts no such admittance: it is not a compliant or force axis of that \
                 kind"
            ),
        ),
        (
            "admittance_ns_per_m = 100.0",
            "admittance_limits = { lead_m = 0.1 }",
            format!(
                "{at}.admittance_limits: no axis has an admittance: give `admittance_ns_per_m` or \
                 `admittance_nms_per_rad`, or remove the limits"
            ),
        ),
        (
            "\"wrist\"",
            "\"palm\"",
            format!("{at}.sensor: no force sensor 'palm'; the robot's force sensors are: wrist"),
        ),
    ] {
        assert!(PRESS.contains(from), "{from}");
        let error = build(&model, &PRESS.replace(from, to)).expect_err(to);
        assert_eq!(error, expected);
    }
}
