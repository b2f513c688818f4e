//! No update allocates: every kind of task, reference and axis mode, in regular and singular poses, for both
//! controllers.

use crate::common::{self, File, Q0, at_state, control_context, four_joints, seven_joints};
use opspace_control::{Controller, InverseKinematicsController, OperationalSpaceController, ServoLead};
use opspace_model::Model;
use opspace_testing::allocation::allocations;

/// Counts allocations in updates and samples at several times, at a start pose and at a singular one.
fn check(model: &Model, controller: &mut dyn Controller, start: &[f64], singular: &[f64]) {
    let n = model.n();
    let (data, measurement) = at_state(model, start, &vec![0.0; n], 0.0);
    controller.start(&common::input(model, &data, &measurement));
    let mut row = vec![0.0; controller.signals().iter().map(|s| s.len()).sum()];
    let mut command = vec![0.0; n];
    for q in [start, singular] {
        for time_s in [0.0, 0.4, 1.5, 20.0] {
            let (data, measurement) = at_state(model, q, &vec![0.3; n], time_s);
            let count = allocations(|| {
                controller.update(&common::input(model, &data, &measurement), &mut command);
                controller.sample(&mut row);
            });
            assert_eq!(count, 0, "at {q:?} and {time_s} s");
            assert!(command.iter().all(|c| c.is_finite()));
        }
    }
}

fn check_both(model: &Model, text: &str, start: &[f64], singular: &[f64]) {
    let (file, robot) = (File::read(text), control_context(model, "hand"));
    let mut torque =
        OperationalSpaceController::new(model, &file.task_set(), &robot).unwrap_or_else(|e| panic!("{e}"));
    check(model, &mut torque, start, singular);
    let n = model.n();
    let lead = ServoLead { kp_per_s: vec![50.0; n], stiffness_nm_per_rad: vec![1e3; n] };
    if let Ok(mut position) = InverseKinematicsController::new(model, &file.task_set(), &robot, Some(lead)) {
        check(model, &mut position, start, singular);
    }
}

#[test]
fn allocation_counter_counts() {
    assert!(allocations(|| drop(std::hint::black_box(vec![0_u8; 16]))) == 1);
}

#[test]
fn cartesian_tasks_allocate_nothing() {
    let references = [
        r#""hold""#,
        "{ point-to-point = { position = { offset_m = [0.1, 0.0, 0.0] }, orientation = { offset_rpy_rad = [0.1, 0.0, 0.0] }, duration_s = 1.0 } }",
        "{ sinusoid = { x = [{ amplitude_m = 0.1, frequency_hz = 1.0 }], ry = [{ amplitude_rad = 0.3, frequency_hz = 1.0 }] } }",
        "{ waypoints = [{ time_s = 1.0, position = { offset_m = [0.1, 0.0, 0.0] } }, { time_s = 2.0, orientation = { offset_rpy_rad = [0.1, 0.0, 0.0] } }] }",
    ];
    let rests = [
        "joint-posture = { frequency_rad_per_s = 6.0, damping_ratio = 0.8 }",
        "joint-damping = { damping_nms_per_rad = 1.0 }",
        r#"joint-tracking = { reference = "hold", gains = { frequency_rad_per_s = 6.0, damping_ratio = 0.8 } }"#,
    ];
    for reference in references {
        for rest in rests {
            let text = format!(
                r#"
                priority = ["hand", "upper", "rest"]
                [task.hand.cartesian]
                frame = "hand"
                axes = {{ x = "motion", y = "compliant", z = "motion", rx = "motion", ry = "compliant" }}
                reference = {reference}
                gains = {{ frequency_rad_per_s = 10.0, damping_ratio = 1.0 }}
                force = {{ sensor = "wrist" }}
                [task.upper.cartesian]
                frame = "upper"
                axes = {{ z = "motion" }}
                reference = "hold"
                gains = {{ frequency_rad_per_s = 10.0, damping_ratio = 1.0 }}
                [task.rest]
                {rest}
                "#
            );
            let start = [0.3, 0.7, -0.4, 0.9, 0.2, -0.8, 0.5];
            check_both(&seven_joints(), &text, &start, &[0.0; 7]);
        }
    }
}

#[test]
fn joint_tasks_allocate_nothing() {
    let references = [
        r#""hold""#,
        "{ point-to-point = { goal = { absolute_rad = { elbow = -1.0 } }, duration_s = 1.0 } }",
        "{ sinusoid = { joints = { elbow = [{ amplitude_rad = 0.1, frequency_hz = 1.0 }] } } }",
        "{ waypoints = [{ time_s = 1.0, goal = { offset_rad = { elbow = 0.1 } } }] }",
    ];
    let tracking = references.map(|reference| {
        format!("joint-tracking = {{ reference = {reference}, gains = {{ frequency_rad_per_s = 6.0, damping_ratio = 1.0 }} }}")
    });
    let others = [
        "joint-posture = { frequency_rad_per_s = 6.0, damping_ratio = 0.8, posture_rad = { elbow = -1.0 } }"
            .to_owned(),
        "joint-damping = { damping_nms_per_rad = 1.0 }".to_owned(),
    ];
    for task in tracking.iter().chain(&others) {
        let text = format!("priority = [\"all\"]\n[task.all]\n{task}");
        check_both(&four_joints(), &text, &Q0, &[0.0; 4]);
    }
}
