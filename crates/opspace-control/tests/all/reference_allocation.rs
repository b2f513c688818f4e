//! References do not allocate when they start or are evaluated, since a task can change within the control loop.

use crate::common::{self, File, Q0, at_state, control_context, four_joints};
use nalgebra::Vector3;
use opspace_control::{
    CartesianReference, Controller, OperationalSpaceController, Target, Trajectory, recorded,
};
use opspace_model::{Motion, Placement};
use opspace_testing::allocation::allocations;
use serde::Deserialize;

#[test]
fn allocation_counter_counts() {
    assert!(allocations(|| drop(std::hint::black_box(vec![0_u8; 16]))) == 1);
}

#[derive(Deserialize)]
struct Only {
    reference: CartesianReference,
}

const LIMITS: &str = "velocity_m_per_s = 0.5, acceleration_m_per_s2 = 2.0, jerk_m_per_s3 = 20.0";

#[test]
fn cartesian_references_do_not_allocate() {
    let references = [
        r#""hold""#.to_owned(),
        "{ point-to-point = { position = { offset_m = [0.1, 0.0, 0.0] }, duration_s = 1.0 } }".to_owned(),
        "{ sinusoid = { x = [{ amplitude_m = 0.1, frequency_hz = 1.0 }] } }".to_owned(),
        "{ waypoints = [{ time_s = 1.0, position = { offset_m = [0.1, 0.0, 0.0] } }, \
         { time_s = 2.0, orientation = { offset_rpy_rad = [0.1, 0.0, 0.0] } }] }"
            .to_owned(),
        format!("{{ goal = {{ position = {{ offset_m = [0.1, 0.2, 0.0] }}, {LIMITS} }} }}"),
        // Limits of very different magnitudes, for which no motion within the limits is found.
        "{ goal = { position = { absolute_m = [0.7, 0.0, 0.0] }, velocity_m_per_s = 2.5e-9, \
         acceleration_m_per_s2 = 4e-8, jerk_m_per_s3 = 1e-6 } }"
            .to_owned(),
        "{ path = { speed_m_per_s = 0.2, acceleration_m_per_s2 = 1.0, jerk_m_per_s3 = 20.0, \
         corner_radius_m = 0.02, segments = [{ line = { to_m = [0.1, 0.0, 0.0] } }, \
         { arc = { via_m = [0.1, 0.1, 0.0], to_m = [0.0, 0.1, 0.0] } }] } }"
            .to_owned(),
        r#"{ recorded = { file = "a.csv" } }"#.to_owned(),
        r#"{ recorded = { file = "a.csv", relative = false } }"#.to_owned(),
    ];
    let mut moving = Target::at_rest(Placement::from_rpy([0.4, -0.7, 1.9], [0.3, -0.2, 0.6]));
    let home = moving.placement;
    moving.velocity = Motion { linear: Vector3::new(0.1, -0.2, 0.3), angular: Vector3::new(0.3, 0.2, -0.1) };
    moving.acceleration = moving.velocity;
    for reference in references {
        let mut file: Only =
            toml::from_str(&format!("reference = {reference}")).unwrap_or_else(|e| panic!("{e}"));
        if let CartesianReference::Recorded(path) = &mut file.reference {
            let text = "time_s,x_m,y_m,z_m\n0,0,0,0\n1,0.1,0,0\n2,0,0.1,0";
            path.samples = recorded::parse(text).unwrap_or_else(|e| panic!("{e}"));
        }
        let mut trajectory = Trajectory::new(&file.reference);
        for from in [Target::at_rest(home), moving] {
            let mut target = from;
            let count = allocations(|| {
                trajectory.start(&home, &from, &nalgebra::Matrix3::identity());
                for time_s in [0.0, 0.4, 1.5, 20.0] {
                    target = trajectory.at(time_s);
                }
            });
            assert_eq!(count, 0, "{reference}");
            assert!(target.placement.translation.iter().all(|x| x.is_finite()), "{reference}");
        }
    }
}

/// Joint references do not allocate when their task starts with the controller.
#[test]
fn joint_reference_start_does_not_allocate() {
    let model = four_joints();
    for reference in [
        r#""hold""#,
        "{ point-to-point = { goal = { absolute_rad = { elbow = -1.0 } }, duration_s = 1.0 } }",
        "{ sinusoid = { joints = { elbow = [{ amplitude_rad = 0.1, frequency_hz = 1.0 }] } } }",
        "{ waypoints = [{ time_s = 1.0, goal = { offset_rad = { elbow = 0.1 } } }, \
         { time_s = 2.0, goal = { offset_rad = { elbow = 0.0 } } }] }",
        "{ goal = { posture = { offset_rad = { elbow = 0.1 } }, velocity_rad_per_s = 1.0, \
         acceleration_rad_per_s2 = 2.0, jerk_rad_per_s3 = 20.0 } }",
    ] {
        let text = format!(
            "priority = [\"all\"]\n[task.all.joint-tracking]\nreference = {reference}\n\
             gains = {{ frequency_rad_per_s = 6.0, damping_ratio = 1.0 }}"
        );
        let file = File::read(&text);
        let mut controller =
            OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
                .unwrap_or_else(|e| panic!("{e}"));
        let (data, measurement) = at_state(&model, &Q0, &[0.3; 4], 0.0);
        let input = common::input(&model, &data, &measurement);
        let count = allocations(|| controller.start(&input));
        assert_eq!(count, 0, "{reference}");
    }
}
