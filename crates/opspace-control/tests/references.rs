//! References: velocities and accelerations against central differences of the poses and velocities, and
//! poses against the shapes that the file asks for.

mod common;

use common::{File, Q0, at_state, facts, four_joints};
use nalgebra::{Matrix3, Rotation3, Vector3};
use opspace_control::{
    CartesianReference, Controller, Observable, OperationalSpaceController, Row, Trajectory,
};
use opspace_control::{orientation, ramp::minimum_jerk};
use opspace_model::Placement;
use serde::Deserialize;

#[derive(Deserialize)]
struct Only {
    reference: CartesianReference,
}

fn start() -> Placement {
    Placement::from_rpy([0.4, -0.7, 1.9], [0.3, -0.2, 0.6])
}

fn axes() -> Matrix3<f64> {
    *Rotation3::from_euler_angles(0.2, 0.5, -0.8).matrix()
}

fn trajectory(text: &str) -> Trajectory {
    let file: Only = toml::from_str(text).unwrap_or_else(|e| panic!("{e}"));
    let mut trajectory = Trajectory::new(&file.reference, axes());
    trajectory.start(start());
    trajectory
}

const REFERENCES: [&str; 4] = [
    r#"reference = "hold""#,
    "[reference.point-to-point]
     position = { absolute_m = [0.1, 0.2, 0.5] }
     orientation = { offset_rpy_rad = [1.0, -0.5, 2.0] }
     start_s = 0.3
     duration_s = 1.1",
    "[reference.sinusoid]
     x = [{ amplitude_m = 0.1, frequency_hz = 0.5 }, { amplitude_m = 0.03, frequency_hz = 1.5, phase_rad = 1.0 }]
     z = [{ amplitude_m = 0.08, frequency_hz = 0.5, phase_rad = -1.5707963267948966, offset_m = 0.08 }]
     rx = [{ amplitude_rad = 0.9, frequency_hz = 0.4 }]
     rz = [{ amplitude_rad = 1.2, frequency_hz = 0.3, offset_rad = 0.2 }]
     ramp_s = 0.9",
    "[[reference.waypoints]]
     time_s = 0.5
     position = { offset_m = [0.1, 0.0, 0.0] }
     [[reference.waypoints]]
     time_s = 1.2
     orientation = { absolute_rpy_rad = [0.0, 0.3, -2.5] }
     [[reference.waypoints]]
     time_s = 1.9
     position = { absolute_m = [0.0, 0.1, 0.4] }
     orientation = { offset_rpy_rad = [0.0, 0.0, 0.0] }",
];

#[test]
fn velocities_and_accelerations_are_derivatives() {
    let h = 1e-5;
    // h² times a third derivative of up to 2e3, and rounding over h.
    let tolerance = 2e-7;
    for text in REFERENCES {
        let trajectory = trajectory(text);
        for k in 1..43 {
            let t = 0.05 * f64::from(k) + 0.013;
            let [before, now, after] = [t - h, t, t + h].map(|t| trajectory.at(t));
            let per = 1.0 / (2.0 * h);
            let linear = (after.placement.translation - before.placement.translation) * per;
            let turn = after.placement.rotation * before.placement.rotation.transpose();
            let angular = orientation::log(&turn) * per;
            assert!((now.velocity.linear - linear).norm() < tolerance, "{text}\nat {t}");
            assert!((now.velocity.angular - angular).norm() < tolerance, "{text}\nat {t}");
            let linear = (after.velocity.linear - before.velocity.linear) * per;
            let angular = (after.velocity.angular - before.velocity.angular) * per;
            assert!((now.acceleration.linear - linear).norm() < tolerance, "{text}\nat {t}");
            assert!((now.acceleration.angular - angular).norm() < tolerance, "{text}\nat {t}");
        }
    }
}

/// Pose, velocity and acceleration at time 0 against the start's, at rest.
#[test]
fn every_reference_begins_at_the_start_pose_at_rest() {
    for text in REFERENCES {
        let target = trajectory(text).at(0.0);
        assert!((target.placement.translation - start().translation).norm() < 1e-15, "{text}");
        assert!((target.placement.rotation - start().rotation).norm() < 1e-14, "{text}");
        assert!(target.velocity.linear.norm() + target.velocity.angular.norm() == 0.0, "{text}");
        assert!(target.acceleration.linear.norm() + target.acceleration.angular.norm() == 0.0, "{text}");
    }
}

#[test]
fn goals_are_reached_on_time() {
    let point = trajectory(REFERENCES[1]);
    let turned = axes() * orientation::from_rpy([1.0, -0.5, 2.0]) * axes().transpose() * start().rotation;
    for t in [1.4, 5.0] {
        let end = point.at(t).placement;
        assert!((end.translation - Vector3::new(0.1, 0.2, 0.5)).norm() < 1e-15);
        assert!((end.rotation - turned).norm() < 1e-14);
    }
    let list = trajectory(REFERENCES[3]);
    let first = list.at(0.5).placement;
    let place = start().translation + axes() * Vector3::new(0.1, 0.0, 0.0);
    assert!((first.translation - place).norm() < 1e-15 && (first.rotation - start().rotation).norm() < 1e-14);
    let second = list.at(1.2).placement;
    assert!((second.translation - place).norm() < 1e-15);
    assert!((second.rotation - orientation::from_rpy([0.0, 0.3, -2.5])).norm() < 1e-14);
    let third = list.at(9.0).placement;
    assert!((third.translation - Vector3::new(0.0, 0.1, 0.4)).norm() < 1e-15);
    assert!((third.rotation - start().rotation).norm() < 1e-14);
}

/// The ramp against central differences and its ends.
#[test]
fn the_ramp_is_smooth() {
    let h = 1e-5;
    for k in 1..20 {
        let t = 0.1 * f64::from(k);
        let [before, now, after] = [t - h, t, t + h].map(|t| minimum_jerk(t, 2.0));
        assert!((now[1] - (after[0] - before[0]) / (2.0 * h)).abs() < 1e-9);
        assert!((now[2] - (after[1] - before[1]) / (2.0 * h)).abs() < 1e-9);
    }
    assert!(minimum_jerk(0.0, 2.0) == [0.0; 3] && minimum_jerk(2.0, 2.0) == [1.0, 0.0, 0.0]);
    assert!((minimum_jerk(1.0, 2.0)[0] - 0.5).abs() < 1e-15);
}

/// The joint references, seen through the signals of their task: reference velocity against central
/// differences, and the goals.
#[test]
fn joint_references_move_and_arrive() {
    let references = [
        ("\"hold\"", Q0),
        (
            "{ point-to-point = { goal = { absolute_rad = { elbow = -1.0 } }, start_s = 0.2, duration_s = 1.0 } }",
            [Q0[0], Q0[1], Q0[2], -1.0],
        ),
        (
            "{ waypoints = [{ time_s = 0.7, goal = { offset_rad = { elbow = 0.2, shoulder_yaw = 0.1 } } }, { time_s = 1.5, goal = { absolute_rad = { shoulder_yaw = 0.0 } } }] }",
            [Q0[0], Q0[1], 0.0, Q0[3] + 0.2],
        ),
    ];
    for (reference, end) in references {
        let text = format!(
            "priority = [\"all\"]\n[task.all.joint-tracking]\nreference = {reference}\n\
             gains = {{ frequency_rad_per_s = {{ shoulder_pitch = 10, shoulder_roll = 10.0, shoulder_yaw = 9.0, elbow = 8.0 }}, damping_ratio = 1 }}"
        );
        let model = four_joints();
        let file = File::read(&text);
        let mut controller = OperationalSpaceController::new(&model, &file.stack(), &facts(&model, "hand"))
            .unwrap_or_else(|e| panic!("{e}"));
        let (data, measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
        controller.start(&model, &data, &measurement);
        let mut at = |time_s: f64| {
            let mut measurement = measurement.clone();
            measurement.time_s = time_s;
            controller.update(&model, &data, &measurement, &mut [0.0; 4]);
            let mut row = [0.0; 12];
            controller.sample(&mut Row::new(&mut row));
            row
        };
        let h = 1e-5;
        for k in 0..40 {
            let t = 0.05 * f64::from(k) + 0.013;
            let [before, now, after] = [t - h, t, t + h].map(&mut at);
            for i in 0..4 {
                let rate = (after[i] - before[i]) / (2.0 * h);
                assert!((now[4 + i] - rate).abs() < 1e-8, "{reference}, joint {i} at {t}");
                assert!((now[8 + i] - (now[i] - Q0[i])).abs() < 1e-15, "{reference}, error of joint {i}");
            }
        }
        let last = at(3.0);
        for i in 0..4 {
            assert!((last[i] - end[i]).abs() < 1e-15, "{reference}: joint {i} ends at {}", last[i]);
        }
    }
}
