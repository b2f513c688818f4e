//! Control cycles whose command is modified by limits do not allocate: active limits, bounds that must be widened,
//! poses from regular to singular and back. The active-set method solves all of them.

use crate::common::{self, File, at_state, control_context, sampled, seven_joints};
use opspace_backend::Observable;
use opspace_control::{ControlInput, Controller, JointLimits, OperationalSpaceController};
use opspace_model::update;
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

/// No allocation in any of 3000 cycles along a path from one pose through the stretched arm, where the hand's rows are
/// dependent, to poses beyond the joints' position limits; also with commands that act late.
#[test]
fn no_limited_cycle_allocates() {
    [0.0, 0.02].into_iter().for_each(|late_s| count_allocations(STACK, late_s));
}

/// No allocation along this path with scaled tasks and weights of axes and joints.
#[test]
fn no_cycle_of_scaled_and_weighted_tasks_allocates() {
    let scaled = STACK.replace("speed_limit", "when_limited = \"scaled\"\nspeed_limit");
    let weighted = scaled.replace("characteristic", "weight = { x = 3.0, rz = 0.2 }\ncharacteristic");
    let posture = weighted.replace("damping_ratio = 0.8\n", "damping_ratio = 0.8\nweight = { j3 = 5.0 }\n");
    assert!(posture.contains("j3") && posture.contains("rz = 0.2"), "{posture}");
    count_allocations(&posture, 0.0);
}

/// Counts the allocations of control cycles along the path, whose commands act late.
fn count_allocations(text: &str, command_delay_s: f64) {
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
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &robot).unwrap_or_else(|e| panic!("{e}"));
    let pose = |u: f64| [0.3, 0.7, -0.4, 0.9, 0.2, -0.8, 0.5].map(|q| 1.3 * q * u);
    let (mut data, mut measurement) = at_state(&model, &pose(0.6), &[0.0; 7], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let mut row = vec![0.0; controller.signals().iter().map(|s| s.len()).sum()];
    let (mut command, mut feedforward_torque) = ([0.0; 7], [0.0; 7]);
    let [mut limited, mut singular, mut beyond] = [0; 3];
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
        singular += usize::from(sampled(&controller, "hand.min_singular_gain") < vec![1.0]);
        beyond += usize::from(measurement.q.amax() > 1.1 || measurement.dq.amax() > 1.5);
    }
    assert!(
        limited > 2000 && singular > 50 && beyond > 500 && beyond < 2800,
        "{limited}, {singular}, {beyond} ticks"
    );
}

#[test]
fn allocation_counter_counts() {
    assert_eq!(allocations(|| drop(std::hint::black_box(vec![0_u8; 16]))), 1);
}
