//! A published scenario of operational-space control near singularities, without limits: a UR10 that starts with its
//! wrist exactly singular is given a goal in a single step.
//!
//! Source: isaac-sim/IsaacLab, pull request 7063, "Add singularity handling to the operational space controller": the
//! tutorial `run_osc.py` (goals and gains) with a UR10 (its default posture), 500 steps of 10 ms for each goal. It reports
//! the distance from the goal, the joint torques and the joint speeds, for an inverse without (`inv`) and with
//! (`cond_clamp`) a bounded condition number:
//!
//! | goal | `inv` | `cond_clamp` |
//! |---|---|---|
//! | 0 | 0.5744 m, 1.27e4 Nm | 0.5019 m, 2.45 Nm |
//! | 1 | 0.5034 m | 0.5019 m |
//! | 2 | 0.3547 m (at most 1.5452 m), 34.7 rad/s | 0.2478 m (at most 0.2591 m), 3.14 rad/s |
//!
//! Here all six axes follow the goal: the tilted wall of the tutorial and the force on it are left out. Masses and
//! inertias of the arm are similar, not equal, and gravity is compensated exactly, as there.

use crate::common::{File, at_state, control_context};
use crate::out_of_reach::{Motion, ur10_like};
use nalgebra::Vector3;
use opspace_control::{JointLimits, OperationalSpaceController};
use opspace_model::frame_placement;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// Posture at the start, rad.
const START: [f64; 6] = [0.0, -1.712, 1.712, 0.0, 0.0, 0.0];

/// Positions of the goals in the axes of the arm, which are rotated by π about z, m; and their gains, 1/s².
const GOALS: [([f64; 3], f64); 3] =
    [([-0.6, -0.15, 0.3], 360.0), ([-0.6, 0.3, 0.3], 420.0), ([-0.8, 0.0, 0.5], 320.0)];

/// Orientation of the goals: roll, pitch and yaw, rad.
const ORIENTATION: [f64; 3] = [-FRAC_PI_4, 0.0, -FRAC_PI_2];

/// Duration of a reference that jumps: less than a control period, s.
const JUMP_S: f64 = 1e-9;

/// Duration of the motion to each goal, s.
const DURATION_S: f64 = 5.0;

/// Figures of the motion to a goal.
#[derive(Debug)]
struct Figures {
    /// Distance from the goal at the start, m.
    first_m: f64,
    /// Largest distance from the goal, m.
    most_m: f64,
    /// Distance from the goal at the end, m.
    last_m: f64,
    /// Largest torque of a joint besides gravity, Nm.
    torque_nm: f64,
    /// Highest speed of a joint, rad/s.
    speed: f64,
}

/// Moves to a goal with a control period, a duration of the reference's motion and more keys of the task, within `limits`
/// if there are some. The error is the time at which the torques or the motion are no longer finite, s.
fn figures(
    place: usize,
    period_s: f64,
    duration_s: f64,
    more: &str,
    limits: Option<JointLimits>,
) -> Result<Figures, f64> {
    let model = ur10_like();
    let (position, stiffness) = GOALS[place];
    let text = format!(
        "priority = [\"hand\"]\nlimits = {{ enforce = {} }}\n[task.hand.cartesian]\nframe = \"hand\"\naxes = {{ x = \
         \"motion\", y = \"motion\", z = \"motion\", rx = \"motion\", ry = \"motion\", rz = \"motion\" }}\n\
         reference.point-to-point = {{ position = {{ absolute_m = {position:?} }}, orientation = {{ absolute_rpy_rad = \
         {ORIENTATION:?} }}, duration_s = {duration_s:?} }}\n\
         gains = {{ frequency_rad_per_s = {:?}, damping_ratio = 1.0 }}\n{more}\n",
        limits.is_some(),
        f64::sqrt(stiffness)
    );
    let mut context = control_context(&model, "hand");
    context.period_s = period_s;
    context.limits = limits.unwrap_or(context.limits);
    let mut controller = OperationalSpaceController::new(&model, &File::read(&text).task_set(), &context)
        .expect("a good stack");
    let mut motion = Motion::new(&model, &START);
    motion.period_s = period_s;
    let hand = model.frame_id("hand").expect("hand");
    let mut tau = [0.0; 6];
    let mut figures = Figures { first_m: 0.0, most_m: 0.0, last_m: 0.0, torque_nm: 0.0, speed: 0.0 };
    while motion.time_s < DURATION_S {
        let (data, _) = at_state(&model, &motion.q, &motion.dq, motion.time_s);
        let distance = (frame_placement(&model, &data, hand).translation - Vector3::from(position)).norm();
        if motion.time_s == 0.0 {
            figures.first_m = distance;
        }
        figures.most_m = figures.most_m.max(distance);
        figures.last_m = distance;
        if !motion.cycle(&model, &mut controller, &mut tau) {
            return Err(motion.time_s);
        }
        let torques = tau.iter().zip(&data.gravity).map(|(torque, gravity)| (torque - gravity).abs());
        figures.torque_nm = torques.fold(figures.torque_nm, f64::max);
        figures.speed = figures.speed.max(motion.speed());
    }
    Ok(figures)
}

/// Limits of a UR10 by its data sheet: 120 and 180 °/s; 330, 150 and 56 Nm.
fn limits() -> JointLimits {
    JointLimits {
        velocity: vec![PI / 1.5, PI / 1.5, PI, PI, PI, PI],
        torque: vec![330.0, 330.0, 150.0, 56.0, 56.0, 56.0],
        ..JointLimits::none(6)
    }
}

/// Distance from a goal that counts as reached, m: 0.25 m and more are published.
const REACHED_M: f64 = 1e-9;

const FINITE: &str = "the motion is finite";

/// Time after which the motion without damping is not finite, s: measured 1 ms.
const A_FEW_CYCLES_S: f64 = 0.01;

/// Compared: distance, torque and speed at a jump of the goal with the published ones of `inv`. Measured: 4.9, 8.8 and 3.6 kNm; 21, 46 and
/// 20 rad/s. Critically damped gains alone need 24 rad/s to turn a wrist by π.
#[test]
fn goals_are_reached_without_limits() {
    for goal in 0..GOALS.len() {
        let ours = figures(goal, 1e-3, JUMP_S, "", None).expect(FINITE);
        assert!(ours.last_m < REACHED_M && ours.most_m <= ours.first_m, "goal {goal}: {ours:?}");
        assert!(ours.torque_nm < 1.27e4 && ours.speed < 50.0, "goal {goal}: {ours:?}");
    }
}

/// Compared: the motion to the first goal without and with damping: without it, the motion is not finite after a few
/// cycles.
#[test]
fn undamped_inverse_gets_out_of_control() {
    let end_s = |more| figures(0, 1e-3, JUMP_S, more, None).err();
    let lost_s = end_s("singularities = \"plain\"");
    assert!(lost_s.is_some_and(|time_s| time_s < A_FEW_CYCLES_S), "without damping: {lost_s:?} s");
    assert_eq!(end_s(""), None);
}

/// Checks a smooth motion of one second, with the control period of the publication as well. Measured: at most 571 Nm and
/// 15 rad/s.
#[test]
fn smooth_motions_leave_the_singular_posture() {
    for (goal, period_s) in [(0, 1e-3), (1, 1e-3), (2, 1e-3), (0, 1e-2), (1, 1e-2), (2, 1e-2)] {
        let ours = figures(goal, period_s, 1.0, "", None).expect(FINITE);
        assert!(ours.last_m < REACHED_M && ours.most_m <= ours.first_m, "goal {goal}: {ours:?}");
        assert!(ours.torque_nm < 700.0 && ours.speed < 20.0, "goal {goal}: {ours:?}");
    }
}

/// Compared: the speed at a jump of the goal with the limit of the robot, at both control periods.
#[test]
fn goals_are_reached_within_limits() {
    for (goal, period_s) in [(0, 1e-3), (1, 1e-3), (2, 1e-3), (0, 1e-2), (1, 1e-2), (2, 1e-2)] {
        let ours = figures(goal, period_s, JUMP_S, "", Some(limits())).expect(FINITE);
        assert!(ours.last_m < REACHED_M && ours.speed < PI, "goal {goal}: {ours:?}");
    }
}
