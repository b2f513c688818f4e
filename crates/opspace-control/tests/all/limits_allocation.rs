//! Control cycles whose command is modified by limits do not allocate: active limits, bounds that must be widened,
//! poses from regular to singular and back. The active-set method solves all of them.

use crate::common::{self, File, at_state, control_context, sampled, seven_joints};
use nalgebra::Vector3;
use opspace_backend::Observable;
use opspace_control::{CollisionLimits, ControlInput, Controller, JointLimits, OperationalSpaceController};
use opspace_model::collision::{
    Capsule, CapsuleSource, CollisionModel, CollisionShape, HalfSpace, LinkCapsule,
};
use opspace_model::{Model, update};
use opspace_testing::allocation::allocations;

const STACK: &str = r#"
priority = ["hand", "upper", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "motion", rz = "compliant" }
reference.sinusoid = { x = [{ amplitude_m = 0.2, frequency_hz = 1.0 }], z = [{ amplitude_m = 0.3, frequency_hz = 0.7 }] }
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0, integral_per_s = 1.0 }
force = { sensor = "wrist" }
speed_limit_m_per_s = 0.3
singularity_threshold = 0.03
characteristic_length_m = 0.4
[task.upper.cartesian]
frame = "upper"
axes = { z = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 12.0, damping_ratio = 1.0 }
[task.rest.joint-posture]
frequency_rad_per_s = 8.0
damping_ratio = 0.8
"#;

/// Distance that the controller keeps, m.
const MARGIN_M: f64 = 0.02;

/// Capsules on three links, and two obstacles: a floor that the arm enters, and a post beside it.
fn collision_limits(model: &Model) -> CollisionLimits {
    let capsule = |link: &str, length_m: f64| LinkCapsule {
        name: link.to_owned(),
        link: link.to_owned(),
        start_m: [0.0; 3],
        end_m: [0.0, 0.0, length_m],
        radius_m: 0.05,
        source: CapsuleSource::User,
    };
    let capsules = [capsule("j2", 0.2), capsule("j4", 0.1), capsule("hand", 0.05)];
    let mut geometry = CollisionModel::new(model, &capsules).expect("links of the model");
    let post =
        Capsule { start_m: Vector3::new(0.4, 0.0, -1.0), end_m: Vector3::new(0.4, 0.0, 1.0), radius_m: 0.1 };
    geometry.add_obstacle("post", CollisionShape::Capsule(post)).expect("a capsule");
    let floor = HalfSpace { normal: Vector3::z(), offset_m: 0.6 };
    geometry.add_obstacle("floor", CollisionShape::HalfSpace(floor)).expect("a half-space");
    CollisionLimits { geometry, margin_m: MARGIN_M }
}

/// No allocation in any of 3000 cycles along a path from one pose through the stretched arm, where the hand's rows are
/// dependent, to poses beyond the joints' position limits; also with commands that act late.
#[test]
fn no_limited_cycle_allocates() {
    [0.0, 0.02].into_iter().for_each(|late_s| check_limited(STACK, late_s));
}

/// No allocation along this path with scaled tasks and weights of axes and joints.
#[test]
fn no_cycle_of_scaled_and_weighted_tasks_allocates() {
    let scaled = STACK.replace("speed_limit", "when_limited = \"scaled\"\nspeed_limit");
    let weighted = scaled.replace("characteristic", "weight = { x = 3.0, rz = 0.2 }\ncharacteristic");
    let posture = weighted.replace("damping_ratio = 0.8\n", "damping_ratio = 0.8\nweight = { j3 = 5.0 }\n");
    assert!(posture.contains("j3") && posture.contains("rz = 0.2"), "{posture}");
    check_limited(&posture, 0.0);
}

/// No allocation along this path with a floor and a post, into which the arm moves.
#[test]
fn no_cycle_with_obstacles_allocates() {
    for command_delay_s in [0.0, 0.02] {
        let [limited, singular, _, near] = count_cycles(STACK, command_delay_s, true);
        assert!(limited > 2000 && singular > 50 && near > 500, "{limited}, {singular}, {near} ticks");
    }
}

/// Checks the control cycles along the path, whose commands act late.
fn check_limited(text: &str, command_delay_s: f64) {
    let [limited, singular, beyond, _] = count_cycles(text, command_delay_s, false);
    assert!(
        limited > 2000 && singular > 50 && beyond > 500 && beyond < 2800,
        "{limited}, {singular}, {beyond} ticks"
    );
}

/// Controls the arm along the path. Returns the numbers of cycles in which it was limited, near a singular pose, beyond
/// its limits, and closer to an obstacle than allowed.
fn count_cycles(text: &str, command_delay_s: f64, with_obstacles: bool) -> [usize; 4] {
    let (model, file) = (seven_joints(), File::read(text));
    let mut robot = control_context(&model, "hand");
    robot.command_delay_s = command_delay_s;
    robot.limits = JointLimits {
        lower: vec![-1.1; 7],
        upper: vec![1.1; 7],
        velocity: vec![1.5; 7],
        acceleration: vec![30.0; 7],
        torque: vec![90.0, 90.0, 40.0, 40.0, 10.0, 10.0, 10.0],
        torque_rate: vec![f64::INFINITY; 7],
    };
    robot.collision = with_obstacles.then(|| collision_limits(&model));
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &robot).unwrap_or_else(|e| panic!("{e}"));
    let pose = |u: f64| [0.3, 0.7, -0.4, 0.9, 0.2, -0.8, 0.5].map(|q| 1.3 * q * u);
    let (mut data, mut measurement) = at_state(&model, &pose(0.6), &[0.0; 7], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let mut row = vec![0.0; controller.signals().iter().map(|s| s.len()).sum()];
    let (mut command, mut feedforward_torque) = ([0.0; 7], [0.0; 7]);
    let [mut limited, mut singular, mut beyond, mut near] = [0; 4];
    for tick in 0..3000 {
        let time_s = 1e-3 * f64::from(tick);
        let angle = 2.0 * time_s;
        measurement.time_s = time_s;
        measurement.q.copy_from_slice(&pose(angle.cos()));
        let speed = pose(-2.0 * angle.sin());
        measurement.dq.copy_from_slice(&speed);
        measurement.wrenches[0].linear.x = 20.0 * (7.0 * time_s).sin();
        feedforward_torque.fill(3.0 * (5.0 * time_s).cos());
        assert!(update(&model, &mut data, measurement.q.as_slice(), measurement.dq.as_slice()));
        let count = allocations(|| {
            let input = common::input(&model, &data, &measurement);
            let input = ControlInput { feedforward_torque: &feedforward_torque, ..input };
            controller.update(&input, &mut command);
            controller.sample(&mut row);
        });
        assert_eq!(count, 0, "at {time_s} s");
        assert!(command.iter().all(|c| c.is_finite()), "at {time_s} s");
        assert!(sampled(&controller, "limits_solver")[0] <= 1.0, "the active set, at {time_s} s");
        limited += usize::from(controller.is_limited());
        near += usize::from(with_obstacles && sampled(&controller, "least_distance") < vec![MARGIN_M]);
        singular += usize::from(sampled(&controller, "hand.min_singular_gain") < vec![1.0]);
        beyond += usize::from(measurement.q.amax() > 1.1 || measurement.dq.amax() > 1.5);
    }
    [limited, singular, beyond, near]
}

#[test]
fn allocation_counter_counts() {
    assert_eq!(allocations(|| drop(std::hint::black_box(vec![0_u8; 16]))), 1);
}
