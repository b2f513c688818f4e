//! Tests of the units of signals of a robot with a prismatic joint.

use crate::common::{self, KINDS, PERIOD_S, capabilities, config};
use opspace_backend::{CommandKind, Measured, TICK};
use opspace_control::{
    Compensation, ControlContext, InverseKinematicsController, JointGains, JointReference,
    JointTrackingParameters, LimitParameters, OperationalSpaceController, SelectedJoints, Task,
    TaskParameters, TaskSet,
};
use opspace_loop::{ControlLoop, LoopConfig, Run};
use opspace_model::Model;

const TRACKING: &str = r#"
[joint-tracking]
reference = "hold"
gains = { frequency_rad_per_s = 10.0, damping_ratio = 1.0 }
"#;

/// Returns the arm of the other tests with a prismatic elbow, which slides along the upper arm.
fn slider() -> Model {
    let revolute = r#"name="elbow" type="revolute">"#;
    assert!(common::URDF.contains(revolute));
    let urdf = common::URDF.replace(revolute, r#"name="elbow" type="prismatic">"#);
    let hinge = r#"<origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>"#;
    assert!(urdf.contains(hinge));
    let urdf = urdf.replace(hinge, r#"<origin xyz="0.5 0 0"/><axis xyz="1 0 0"/>"#);
    Model::from_urdf(&urdf).expect("the URDF").model
}

fn tasks(model: &Model, context: &ControlContext) -> TaskSet {
    let tracking: TaskParameters = common::parsed(TRACKING);
    let tasks = TaskSet::builder(model, context).from_parameters("joints", &tracking);
    tasks.expect("a good task").build()
}

/// Returns names and units of the cycle's signals that have one element per joint.
fn units(control: LoopConfig) -> Vec<(String, String)> {
    let control = ControlLoop::new(LoopConfig { model: slider(), ..control }).expect("parts that fit");
    let signals = Run::layouts(&control, None).swap_remove(TICK).signals;
    let joints = ["shoulder", "elbow"];
    let of_joints = signals.into_iter().filter(|signal| signal.elements == joints);
    of_joints.map(|signal| (signal.name, signal.units.join(" "))).collect()
}

fn expected(units: &[(&str, &str)]) -> Vec<(String, String)> {
    units.iter().map(|&(name, unit)| (name.to_owned(), unit.to_owned())).collect()
}

const Q: &str = "rad m";
const DQ: &str = "rad/s m/s";
const TORQUE: &str = "Nm N";

/// Compared: the units in the layout, and those expected for the joints' types.
#[test]
fn torque_controller_logs_a_prismatic_joint_in_metres_and_newtons() {
    let setpoints: [&[(&str, &str)]; 3] = [
        &[("q_desired", Q), ("setpoint_speed", DQ), ("setpoint_clamped", "1 1")],
        &[("dq_desired", DQ), ("setpoint_acceleration", "rad/s^2 m/s^2"), ("setpoint_clamped", "1 1")],
        &[],
    ];
    for (kind, setpoints) in KINDS.into_iter().zip(setpoints) {
        let model = slider();
        let context = ControlContext::new(&model, PERIOD_S);
        let (tasks, limits) = (tasks(&model, &context), LimitParameters::default());
        let controller =
            OperationalSpaceController::from_tasks(&model, tasks, &context, Compensation::Bias, &limits);
        let measured = [Measured::Velocity, Measured::MotorCurrent, Measured::JointTorque];
        let before = [
            ("q", Q),
            ("dq_measured", DQ),
            ("motor_torque", TORQUE),
            ("joint_torque", TORQUE),
            ("dq", DQ),
            ("command", TORQUE),
            ("torque_desired", TORQUE),
            ("torque_saturated", "1 1"),
        ];
        let after = [
            ("joints.reference", Q),
            ("joints.reference_velocity", DQ),
            ("joints.error", Q),
            ("joints.slack", "rad/s² m/s²"),
            ("limited", "1 1"),
        ];
        let by_hand = expected(&[&before[..], setpoints, &after[..]].concat());
        assert_eq!(units(config(capabilities(kind).measuring(&measured), controller)), by_hand, "{kind:?}");
    }
}

/// Compared: the same for position commands.
#[test]
fn position_controller_commands_a_prismatic_joint_in_metres() {
    let model = slider();
    let context = ControlContext::new(&model, PERIOD_S);
    let tasks = tasks(&model, &context);
    let controller =
        InverseKinematicsController::from_tasks(&model, tasks, &context, None).expect("a motion");
    let logged = units(config(capabilities(CommandKind::Position), controller));
    for (name, unit) in [("command", Q), ("ik.q", Q), ("ik.dq", DQ)] {
        let found = logged.iter().find(|(known, _)| known == name);
        assert_eq!(found.map(|(_, unit)| unit.as_str()), Some(unit), "{name}");
    }
}

/// Compared: the unit of the row of each joint, and that of the joint's type.
#[test]
fn rows_of_selected_joints_have_the_units_of_their_joints() {
    let model = slider();
    let gains = JointGains::new(10.0, 1.0).expect("good gains");
    let parameters = JointTrackingParameters::new(JointReference::Hold, gains);
    for (joint, unit) in [("shoulder", "rad"), ("elbow", "m")] {
        let task = SelectedJoints::new("one", &[joint.to_owned()], &parameters, &model).expect("a task");
        assert_eq!(task.row_unit(0), (unit, 1.0), "{joint}");
    }
}
