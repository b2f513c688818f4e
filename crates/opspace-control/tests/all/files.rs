//! Task files with errors: the message of each error and the key that it refers to.

use crate::common::{File, Link, arm, build_error, control_context, four_joints, seven_joints};
use opspace_control::{InverseKinematicsController, OperationalSpaceController, ServoLead, TaskParameters};
use opspace_model::Model;
use schemars::schema_for;
use std::collections::BTreeMap;

const HAND: &str = r#"
priority = ["hand", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "compliant", y = "motion", z = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
force = { sensor = "wrist" }
[task.rest.joint-posture]
frequency_rad_per_s = 6.0
damping_ratio = 0.8
"#;

const FORCE: &str = "force = { sensor = \"wrist\" }\n";

const AXES: &str = r#"axes = { x = "compliant", y = "motion", z = "motion" }"#;

/// Compared: the error of each change to a valid file with the expected key and message.
#[test]
fn errors_name_value_and_choices() {
    let gains = "gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }";
    let cases = [
        (
            ("frame = \"hand\"", "frame = \"hnad\""),
            "task.hand.cartesian.frame",
            "no frame 'hnad'; the frames are: shoulder_pitch, shoulder_roll, shoulder_yaw, elbow, hand, wrist",
        ),
        (
            (r#"["hand", "rest"]"#, r#"["hand", "reset"]"#),
            "priority",
            "no task 'reset'; the tasks are: hand, rest",
        ),
        (
            (r#"["hand", "rest"]"#, r#"["hand"]"#),
            "task.rest",
            "task 'rest' is not in `priority`: add it there, or remove the task",
        ),
        (
            (r#"["hand", "rest"]"#, r#"["hand", "rest", "hand"]"#),
            "priority",
            "task 'hand' is in `priority` twice",
        ),
        (
            (r#"["hand", "rest"]"#, r#"["rest", "hand"]"#),
            "priority",
            "task 'rest' is in joint space and uses all remaining degrees of freedom: it must be last in `priority`, but 'hand' is below it",
        ),
        (
            ("sensor = \"wrist\"", "sensor = \"foot\""),
            "task.hand.cartesian.force.sensor",
            "no force sensor 'foot'; the robot's force sensors are: wrist",
        ),
        (
            (AXES, r#"axes = { x = "free" }"#),
            "task.hand.cartesian.axes",
            "all axes are free: at least one of x, y, z, rx, ry, rz must be `motion`, `compliant` or `force`",
        ),
        (
            (
                AXES,
                r#"axes = { x = "compliant", y = "motion", z = "motion", rx = "motion", ry = "motion", rz = "motion" }"#,
            ),
            "task.hand.cartesian.axes",
            "task 'hand' controls 6 axes, but this arm has only 4 joints",
        ),
        (
            (AXES, r#"axes = { x = "motion" }"#),
            "task.hand.cartesian.force",
            "force feedback needs at least one axis that is `compliant` or `force`",
        ),
        (
            ("sensor = \"wrist\"", "sensor = \"wrist\", integral_limit = 3.0"),
            "task.hand.cartesian.force.integral_limit",
            "only `force` axes use it: remove it, or make an axis `force`",
        ),
        (
            ("sensor = \"wrist\"", "sensor = \"wrist\", target_n = { y = 3.0 }"),
            "task.hand.cartesian.force.target_n",
            "axis y accepts no target force (N): it is not a compliant or force axis of that kind",
        ),
        (
            (gains, "gains = { frequency_rad_per_s = { y = 14.0 }, damping_ratio = 1.0 }"),
            "task.hand.cartesian.gains.frequency_rad_per_s",
            "no value for axis z, which is not free",
        ),
        (
            ("damping_ratio = 0.8", "damping_ratio = { elbow = 0.8 }"),
            "task.rest.joint-posture.damping_ratio",
            "no value for joint 'shoulder_pitch': give one number for all joints, or one per joint",
        ),
        (
            ("damping_ratio = 0.8", "damping_ratio = 0.8\nposture_rad = { ellbow = 1.0 }"),
            "task.rest.joint-posture.posture_rad.ellbow",
            "no joint 'ellbow'; the joints are: shoulder_pitch, shoulder_roll, shoulder_yaw, elbow",
        ),
        (
            ("reference = \"hold\"", "reference.point-to-point = { duration_s = 1.0 }"),
            "task.hand.cartesian.reference.point-to-point",
            "the goal names neither `position` nor `orientation`",
        ),
        (
            ("reference = \"hold\"", "reference.sinusoid.rx = [{ amplitude_rad = 0.1, frequency_hz = 1.0 }]"),
            "task.hand.cartesian.reference",
            "the goal has an orientation, but the axes rx, ry and rz are all free",
        ),
        (
            ("reference = \"hold\"", "reference.waypoints = []"),
            "task.hand.cartesian.reference.waypoints",
            "no waypoint: at least one is needed",
        ),
        (
            (
                "reference = \"hold\"",
                "reference.waypoints = [{ time_s = 2.0, position = { offset_m = [0.0, 0.0, 0.1] } }, { time_s = 1.0 }]",
            ),
            "task.hand.cartesian.reference.waypoints",
            "waypoint 1 at 1 s is not after the previous one at 2 s",
        ),
    ];
    for ((from, to), key, message) in cases {
        assert!(HAND.contains(from), "{from}");
        let error = build_error(&four_joints(), &HAND.replace(from, to));
        assert_eq!((error.key(), error.reason().to_string().as_str()), (key, message));
        assert_eq!(error.to_string(), format!("{key}: {message}"));
    }
}

/// Compared: errors of lists of joints that are empty, repeat a joint, contain an unknown one or are too long, with the
/// expected ones. Without a list, the task has all joints.
#[test]
fn invalid_joint_lists_are_refused() {
    let build = |joints: &str| {
        let text = format!(
            "priority = [\"all\"]\n[task.all.joint-tracking]\n{joints}\nreference = \"hold\"\n\
             gains = {{ frequency_rad_per_s = 6.0, damping_ratio = 1.0 }}"
        );
        let (model, file) = (seven_joints(), File::read(&text));
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
            .map(|_| ())
    };
    let listed =
        "`joints` must name at least one joint, and each only once: omit it for a task of all joints";
    for (joints, message) in [
        ("joints = []", listed),
        (r#"joints = ["j4", "j2", "j4"]"#, listed),
        (r#"joints = ["j8"]"#, "no joint 'j8'; the joints are: j1, j2, j3, j4, j5, j6, j7"),
        (
            r#"joints = ["j1", "j2", "j3", "j4", "j5", "j6", "j7"]"#,
            "a task of selected joints can have at most 6 joints, not 7",
        ),
    ] {
        let error = build(joints).expect_err(joints);
        assert_eq!(error.to_string(), format!("task.all.joint-tracking.joints: {message}"));
    }
    assert_eq!(build(""), Ok(()));
    assert_eq!(build(r#"joints = ["j4", "j2"]"#), Ok(()));
}

/// Compared: the message of serde for each typo with the expected start of it.
#[test]
fn typos_are_refused_by_the_parser() {
    let cases = [
        (
            AXES,
            r#"axes = { x = "stiff" }"#,
            "unknown variant `stiff`, expected one of `motion`, `compliant`, `force`, `free`",
        ),
        (
            AXES,
            r#"axes = { w = "motion" }"#,
            "unknown field `w`, expected one of `x`, `y`, `z`, `rx`, `ry`, `rz`",
        ),
        ("= 14.0", "= -14.0", "expected a number above 0, got -14"),
        (
            "= 14.0",
            "= \"fast\"",
            "invalid type: string \"fast\", expected a number, [x, y, z], [x, y, z, rx, ry, rz], or a table such as { x = 1.0, rz = 2.0 }",
        ),
        (
            "= 14.0",
            "= [1.0, 2.0]",
            "invalid length 2, expected 3 numbers [x, y, z] or 6 [x, y, z, rx, ry, rz]",
        ),
        (
            "= 14.0",
            "= { x = 1.0, u = 2.0 }",
            "unknown variant `u`, expected one of `x`, `y`, `z`, `rx`, `ry`, `rz`",
        ),
        (
            "= 0.8",
            "= true",
            "invalid type: boolean `true`, expected a number for all joints, or a table with one per joint: { shoulder = 1.0, elbow = 2.0 }",
        ),
        ("= 0.8", "= 0.8\nstiffness = 3.0", "unknown field `stiffness`"),
    ];
    for (from, to, message) in cases {
        assert!(HAND.contains(from), "{from}");
        let error = toml::from_str::<File>(&HAND.replacen(from, to, 1)).expect_err(to);
        assert!(error.message().starts_with(message), "{}", error.message());
        let span = error.span().expect("the error knows its place");
        assert!(span.len() < 80, "and not the whole table: {} bytes", span.len());
    }
}

/// Error of a force axis without a force sensor.
#[test]
fn force_axis_without_sensor_is_refused() {
    let text =
        HAND.replace("x = \"compliant\"", "x = \"force\"").replace("force = { sensor = \"wrist\" }\n", "");
    let error = build_error(&four_joints(), &text);
    assert_eq!(error.key(), "task.hand.cartesian.force");
    assert!(error.to_string().contains("a `force` axis needs a sensor and a target"), "{error}");
}

/// A second task whose axes the arm cannot move together with those of the first, because of their number or their
/// rank.
#[test]
fn infeasible_task_axes_are_refused() {
    let second = |frame: &str, axes: &str| {
        let text = HAND.replace(r#""rest"]"#, r#""second", "rest"]"#);
        format!(
            "{text}[task.second.cartesian]\nframe = \"{frame}\"\naxes = {axes}\nreference = \"hold\"\n\
             gains = {{ frequency_rad_per_s = 14.0, damping_ratio = 1.0 }}\n"
        )
    };
    let error = build_error(&four_joints(), &second("elbow", r#"{ x = "motion", y = "motion" }"#));
    assert_eq!(error.key(), "task.second.cartesian.axes");
    assert_eq!(
        error.reason().to_string(),
        "task 'second' controls 2 axes in addition to the 3 of the tasks above it, but this arm has only 4 joints"
    );
    let error = build_error(&seven_joints(), &second("hand", r#"{ x = "motion" }"#));
    assert_eq!(
        error.reason().to_string(),
        "task 'second' controls 1 axes in addition to the 3 of the tasks above it, but this arm can move at most 3 of \
         these 4 at once, in any configuration"
    );
    let model = four_joints();
    let file = File::read(&second("elbow", r#"{ y = "motion" }"#));
    assert!(
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand")).is_ok()
    );
}

/// Five joints: pan about z, three parallel joints about y, and roll about the axis of the hand.
fn five_joints() -> Model {
    let link = |name, axis, origin| Link {
        name,
        axis,
        origin,
        mass: 0.3,
        com: [0.05, 0.0, 0.0],
        inertia: [1e-3; 3],
        limits: [-1.5, 1.5],
        rotor: 0.01,
    };
    let (along, pitch) = ([0.15, 0.0, 0.0], [0.0, 1.0, 0.0]);
    let links = [
        link("pan", [0.0, 0.0, 1.0], [0.0; 3]),
        link("lift", pitch, [0.03, 0.0, 0.1]),
        link("elbow", pitch, along),
        link("wrist", pitch, along),
        link("roll", [1.0, 0.0, 0.0], [0.06, 0.0, 0.0]),
    ];
    arm(&links, &[("hand", 4, [0.1, 0.0, 0.0])], 1.0)
}

/// An arm with fewer than six joints controls every set of axes that it can move at once, also with rotations.
#[test]
fn rotation_axes_of_five_joints_are_accepted() {
    let model = five_joints();
    let context = control_context(&model, "hand");
    let build = |axes: &[&str]| {
        let modes: Vec<String> = axes.iter().map(|axis| format!("{axis} = \"motion\"")).collect();
        let file =
            File::read(&HAND.replace(AXES, &format!("axes = {{ {} }}", modes.join(", "))).replace(FORCE, ""));
        OperationalSpaceController::new(&model, &file.task_set(), &context).map(|_| ())
    };
    let possible: [&[&str]; 8] = [
        &["x", "y", "z", "rx", "ry"],
        &["x", "y", "z", "ry", "rz"],
        &["x", "y", "z", "ry"],
        &["y", "rx", "ry", "rz"],
        &["rx", "ry", "rz"],
        &["x", "z", "ry"],
        &["rx", "ry"],
        &["rz"],
    ];
    for axes in possible {
        build(axes).unwrap_or_else(|error| panic!("{axes:?}: {error}"));
    }
    let error = build(&["x", "y", "z", "rx", "ry", "rz"]).expect_err("six axes");
    assert_eq!(error.reason().to_string(), "task 'hand' controls 6 axes, but this arm has only 5 joints");
}

#[test]
fn inverse_kinematics_needs_motion_and_full_lead() {
    let model = four_joints();
    let robot = control_context(&model, "hand");
    let file = File::read("priority = [\"all\"]\n[task.all.joint-damping]\ndamping_nms_per_rad = 0.0");
    let error =
        InverseKinematicsController::new(&model, &file.task_set(), &robot, None).expect_err("no motion");
    assert!(error.to_string().starts_with("priority: no task of this set has a reference motion"));
    let file = File::read(HAND);
    let lead = ServoLead { kp_per_s: vec![50.0; 4], stiffness_nm_per_rad: vec![1e3; 3] };
    let error = InverseKinematicsController::new(&model, &file.task_set(), &robot, Some(lead))
        .expect_err("three numbers");
    assert_eq!(error.to_string(), "stiffness_nm_per_rad: 3 numbers for 4 joints");
}

#[test]
fn every_schema_key_is_described() {
    fn visit(value: &serde_json::Value, undescribed: &mut Vec<String>) {
        let properties = value.get("properties").and_then(|p| p.as_object());
        for (name, property) in properties.into_iter().flatten() {
            // The axes of a per-axis table and the contents of an enum variant need no description.
            let plain = ["x", "y", "z", "rx", "ry", "rz"].contains(&name.as_str());
            if !plain && property.get("description").is_none() && value.get("description").is_none() {
                undescribed.push(name.clone());
            }
        }
        match value {
            serde_json::Value::Array(list) => list.iter().for_each(|v| visit(v, undescribed)),
            serde_json::Value::Object(map) => map.values().for_each(|v| visit(v, undescribed)),
            _ => {}
        }
    }
    let schema = schema_for!(BTreeMap<String, TaskParameters>);
    let mut undescribed = Vec::new();
    visit(schema.as_value(), &mut undescribed);
    assert!(schema.as_value().to_string().contains("singularity_threshold"));
    assert!(undescribed.is_empty(), "{undescribed:?}");
}
