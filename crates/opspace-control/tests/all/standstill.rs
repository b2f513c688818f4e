//! Standstill of a task at a goal that it cannot reach: only there, and only as long as the goal stays.

use crate::common::{File, Numbers, at_state, control_context, input, jacobian, sampled};
use crate::out_of_reach::{Motion, limits_around, ur10_like};
use nalgebra::{DVector, Vector3};
use opspace_control::{ControlContext, JointLimits, OperationalSpaceController};
use opspace_model::{Model, frame_placement};

const START: [f64; 6] = [0.3, -1.2, 1.6, -1.5, 1.5, 0.4];

fn hand(model: &Model, q: &[f64]) -> Vector3<f64> {
    let (data, _) = at_state(model, q, &[0.0; 6], 0.0);
    frame_placement(model, &data, model.frame_id("hand").expect("hand")).translation
}

fn task(reference: &str, settings: &str) -> String {
    format!(
        "priority = [\"hand\"]\n{settings}\n[task.hand.cartesian]\nframe = \"hand\"\naxes = {{ x = \"motion\", y = \
         \"motion\", z = \"motion\", rx = \"motion\", ry = \"motion\", rz = \"motion\" }}\nreference.{reference}\ngains = {{ \
         frequency_rad_per_s = 20.0, damping_ratio = 1.0 }}\n"
    )
}

fn controller(model: &Model, limits: JointLimits, text: &str) -> OperationalSpaceController {
    let context = ControlContext { limits, ..control_context(model, "hand") };
    OperationalSpaceController::new(model, &File::read(text).task_set(), &context).expect("a good task")
}

fn standstill(controller: &OperationalSpaceController) -> f64 {
    sampled(controller, "hand.standstill")[0]
}

/// Goals beyond narrow joint limits, and then back at the start: the arm returns to within 0.01 mm. The task came to a
/// standstill in at least a quarter of the cases: the other arms rest without.
#[test]
fn arm_returns_when_its_goal_does() {
    let model = ur10_like();
    let mut numbers = Numbers::new(5);
    let (cases, mut stood) = (8, 0);
    for case in 0..cases {
        let far: Vec<f64> = numbers.vector(3, 0.8);
        let reference = format!(
            "waypoints = [{{ time_s = 1.0, position = {{ offset_m = {far:?} }} }}, {{ time_s = 5.0, position = {{ offset_m = \
             {far:?} }} }}, {{ time_s = 6.0, position = {{ offset_m = [0.0, 0.0, 0.0] }} }}]"
        );
        let mut controller = controller(&model, limits_around(&START), &task(&reference, ""));
        let (mut motion, mut tau) = (Motion::new(&model, &START), [0.0; 6]);
        let mut highest = 0.0_f64;
        while motion.time_s < 9.0 {
            assert!(motion.cycle(&model, &mut controller, &mut tau));
            highest = highest.max(standstill(&controller));
        }
        let left = (hand(&model, &motion.q) - hand(&model, &START)).norm();
        assert!(left < 1e-5, "case {case}: {left} m away");
        assert_eq!(standstill(&controller), 0.0, "case {case} goes on");
        stood += usize::from(highest == 1.0);
    }
    assert!(stood >= cases / 4, "only {stood} came to a standstill");
}

/// A task set that is left at a standstill and chosen again begins without one.
#[test]
fn standstill_ends_with_its_task_set() {
    let model = ur10_like();
    let far = "point-to-point = { position = { offset_m = [0.6, -0.5, 0.4] }, duration_s = 1.0 }";
    let text = task(far, "limits.standstill_below_m_per_s = 0.1");
    let mut controller = controller(&model, limits_around(&START), &text);
    let other = controller.prepare(&model, &File::read(&text).task_set()).expect("the same tasks");
    let (mut motion, mut tau) = (Motion::new(&model, &START), [0.0; 6]);
    while motion.time_s < 5.0 && standstill(&controller) < 1.0 {
        assert!(motion.cycle(&model, &mut controller, &mut tau));
    }
    assert_eq!(standstill(&controller), 1.0, "the test needs a standstill");
    let (data, measurement) = at_state(&model, &motion.q, &motion.dq, motion.time_s);
    let input = input(&model, &data, &measurement);
    let before = controller.switch(other, &input);
    assert_eq!(standstill(&controller), 0.0);
    controller.switch(before, &input);
    assert_eq!(standstill(&controller), 0.0, "of the cycles before the switch");
}

/// With zero in the file, no task comes to a standstill.
#[test]
fn standstill_can_be_turned_off() {
    let model = ur10_like();
    let far = "point-to-point = { position = { offset_m = [0.6, -0.5, 0.4] }, duration_s = 1.0 }";
    let highest = |settings: &str| {
        let mut controller = controller(&model, limits_around(&START), &task(far, settings));
        let (mut motion, mut tau) = (Motion::new(&model, &START), [0.0; 6]);
        let mut highest = 0.0_f64;
        while motion.time_s < 5.0 {
            assert!(motion.cycle(&model, &mut controller, &mut tau));
            highest = highest.max(standstill(&controller));
        }
        highest
    };
    // A speed that no arm exceeds for long makes every task stop that limits hold back.
    assert_eq!(highest("limits.standstill_below_m_per_s = 0.1"), 1.0);
    assert_eq!(highest("limits.standstill_below_m_per_s = 0.0"), 0.0);
}

/// An arm whose speed limits make it take half a minute to a goal arrives there.
#[test]
fn slow_arm_does_not_stop_before_its_goal() {
    let model = ur10_like();
    let limits = JointLimits { velocity: vec![0.03; 6], ..JointLimits::none(6) };
    let reference = "point-to-point = { position = { offset_m = [-0.2, 0.1, 0.15] }, duration_s = 1.0 }";
    let mut controller = controller(&model, limits, &task(reference, ""));
    let (mut motion, mut tau) = (Motion::new(&model, &START), [0.0; 6]);
    motion.period_s = 4e-3;
    let goal = hand(&model, &START) + Vector3::new(-0.2, 0.1, 0.15);
    let left = |motion: &Motion| (hand(&model, &motion.q) - goal).norm();
    while motion.time_s < 2.0 {
        assert!(motion.cycle(&model, &mut controller, &mut tau));
    }
    assert!(left(&motion) > 0.1, "the limits hold it back");
    while motion.time_s < 40.0 {
        assert!(motion.cycle(&model, &mut controller, &mut tau));
    }
    assert!(left(&motion) < 1e-4, "{} m away", left(&motion));
}

/// An arm whose speed limits let it approach its goal by less than two hundredths of the distance per second arrives there.
#[test]
fn very_slow_arm_does_not_stop_before_its_goal() {
    let model = ur10_like();
    let limits = JointLimits { velocity: vec![0.008; 6], ..JointLimits::none(6) };
    let reference = "point-to-point = { position = { offset_m = [-0.2, 0.1, 0.15] }, duration_s = 1.0 }";
    let mut controller = controller(&model, limits, &task(reference, ""));
    let (mut motion, mut tau) = (Motion::new(&model, &START), [0.0; 6]);
    motion.period_s = 1e-2;
    let goal = hand(&model, &START) + Vector3::new(-0.2, 0.1, 0.15);
    while motion.time_s < 150.0 {
        assert!(motion.cycle(&model, &mut controller, &mut tau));
    }
    let left = (hand(&model, &motion.q) - goal).norm();
    assert!(left < 1e-4, "{left} m away");
}

/// An obstacle that is not in the model holds the hand 5 cm before its goal. It presses for six seconds with the force of
/// its stiffness, and does not stand still.
#[test]
fn contact_is_no_standstill() {
    const STIFFNESS_N_PER_M: f64 = 2e4;
    let model = ur10_like();
    let reference = "point-to-point = { position = { offset_m = [0.0, 0.0, -0.15] }, duration_s = 1.0 }";
    let mut controller = controller(&model, limits_around(&START), &task(reference, ""));
    let (mut motion, mut tau) = (Motion::new(&model, &START), [0.0; 6]);
    let wall = hand(&model, &START).z - 0.1;
    let mut forces = Vec::new();
    for cycle in 0..8000 {
        let depth = (wall - hand(&model, &motion.q).z).max(0.0);
        let (data, _) = at_state(&model, &motion.q, &motion.dq, 0.0);
        let j = jacobian(&model, &data, "hand");
        let speed = (j.row(2) * DVector::from_column_slice(&motion.dq))[0];
        let force = if depth > 0.0 { STIFFNESS_N_PER_M * depth - 200.0 * speed } else { 0.0 };
        let external = j.row(2).transpose() * force;
        assert!(motion.pushed_cycle(&model, &mut controller, &mut tau, external.as_slice()));
        if cycle > 2000 {
            forces.push(force);
        }
        assert_eq!(standstill(&controller), 0.0);
    }
    let (first, last) = (forces[0], forces[forces.len() - 1]);
    assert!(last > 20.0 && (last - first).abs() < 0.05 * last, "{first} N, {last} N");
}
