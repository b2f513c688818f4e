//! Task sets that change while the robot moves: torque steps, references that continue or restart, contents of the log,
//! and allocations.

use crate::common::{
    self, File, Numbers, accelerations, at_state, control_context, frame_acceleration, sampled, seven_joints,
    step,
};
use nalgebra::{DVector, Rotation3, Vector3};
use opspace_backend::{Observable, Signal};
use opspace_control::{ControlContext, Controller, JointLimits, OperationalSpaceController, TaskSet};
use opspace_model::{Model, frame_placement};
use opspace_testing::allocation::{allocations, counted};

#[test]
fn allocation_counter_counts() {
    assert_eq!(allocations(|| drop(std::hint::black_box(vec![0_u8; 16]))), 1);
}

/// Tolerance of an acceleration, relative to its size, at least 1.
const ROUNDING: f64 = 1e-9;

/// Tolerance of the torque rate limit, relative to the torque plus 1: a billionth for each time that a level widens the
/// bounds to include the result of the levels above.
const SLACK: f64 = 1e-8;

/// Control period, s.
const PERIOD_S: f64 = 1e-3;

const START: [f64; 7] = [0.3, 0.7, -0.4, -1.1, 0.2, 0.9, 0.5];

const SINUSOID: &str = "sinusoid = { ramp_s = 0.1, x = [{ amplitude_m = 0.05, frequency_hz = 1.0 }], z = [{ amplitude_m = 0.08, frequency_hz = 0.7 }] }";

/// Task set of `hand` and a joint task below it.
fn hand(axes: &str, reference: &str, law: &str, rest: &str) -> String {
    format!(
        "priority = [\"hand\", \"rest\"]\n\
         [task.hand.cartesian]\nframe = \"hand\"\naxes = {{ {axes} }}\nreference.{reference}\n{law}\n\
         [task.rest]\n{rest}\n"
    )
}

const XYZ: &str = "x = \"motion\", y = \"motion\", z = \"motion\"";
const SOFT_X: &str = "x = \"compliant\", y = \"motion\", z = \"motion\"";
const STEADY: &str = "gains = { frequency_rad_per_s = 12.0, damping_ratio = 1.0 }";
const STIFF: &str = "gains = { frequency_rad_per_s = 30.0, damping_ratio = 0.5 }";
const POSTURE: &str = "joint-posture = { frequency_rad_per_s = 5.0, damping_ratio = 0.8 }";
const DAMPING: &str = "joint-damping = { damping_nms_per_rad = 3.0 }";

fn goal(offset: [f64; 3]) -> String {
    format!(
        "goal = {{ position = {{ offset_m = {offset:?} }}, velocity_m_per_s = 0.5, acceleration_m_per_s2 = 2.0, jerk_m_per_s3 = 20.0 }}"
    )
}

/// Task sets that differ in gains, goals, axis modes, laws, tasks and their order.
fn task_sets() -> Vec<String> {
    let joints = "joint-tracking = { reference.sinusoid.joints.j4 = [{ amplitude_rad = 0.3, frequency_hz = 1.0 }], gains = { frequency_rad_per_s = 12.0, damping_ratio = 1.0 } }";
    let force = "force = { sensor = \"wrist\", target_n = { x = 8.0 } }";
    vec![
        hand(XYZ, SINUSOID, STEADY, POSTURE),
        hand(XYZ, SINUSOID, STIFF, POSTURE),
        hand(XYZ, &goal([0.1, -0.05, 0.05]), STIFF, DAMPING),
        hand(XYZ, &goal([-0.05, 0.1, -0.1]), STEADY, POSTURE),
        hand(SOFT_X, SINUSOID, &format!("{STEADY}\n{force}"), POSTURE),
        hand(
            "x = \"motion\", y = \"motion\", z = \"motion\", rx = \"motion\", ry = \"motion\", rz = \"motion\"",
            SINUSOID,
            STEADY,
            DAMPING,
        ),
        hand(XYZ, SINUSOID, "impedance = { stiffness_n_per_m = 800.0, damping_ratio = 0.7 }", joints),
        format!(
            "priority = [\"upper\", \"elbow\", \"hand\"]\n\
             [task.upper.cartesian]\nframe = \"upper\"\naxes = {{ x = \"motion\" }}\nreference.{SINUSOID}\n{STIFF}\n\
             [task.elbow.joint-tracking]\njoints = [\"j4\"]\nreference = \"hold\"\n{STEADY}\n\
             [task.hand.cartesian]\nframe = \"hand\"\naxes = {{ {XYZ} }}\nreference.{}\n{STEADY}\n",
            goal([0.0, 0.1, 0.0])
        ),
        format!("priority = [\"rest\"]\n[task.rest]\n{joints}"),
    ]
}

fn robot(model: &Model, torque_rate: f64) -> ControlContext {
    let limits = if torque_rate.is_finite() {
        JointLimits { torque: vec![150.0; 7], torque_rate: vec![torque_rate; 7], ..JointLimits::none(7) }
    } else {
        JointLimits::none(7)
    };
    ControlContext { limits, ..control_context(model, "hand") }
}

/// A switch to another task set: its cycle, the number of the set, and true if it is scheduled.
#[derive(Clone, Copy, Debug)]
struct Change {
    tick: usize,
    stack: usize,
    scheduled: bool,
}

/// Simulates the arm under successive task sets. Returns the largest step of a torque (Nm) at the `changes` and in any
/// cycle. No update or switch allocates.
fn run(model: &Model, torque_rate: f64, first: usize, changes: &[Change], ticks: usize) -> [f64; 2] {
    let files: Vec<File> = task_sets().iter().map(|text| File::read(text)).collect();
    let robot = robot(model, torque_rate);
    let mut controller =
        OperationalSpaceController::new(model, &files[first].task_set(), &robot).expect("a good stack");
    let mut prepared: Vec<Option<TaskSet>> = (changes.iter())
        .map(|change| Some(controller.prepare(model, &files[change.stack].task_set()).expect("a good stack")))
        .collect();
    for (change, stack) in changes.iter().zip(&mut prepared).filter(|(change, _)| change.scheduled) {
        controller.schedule(change.tick as f64 * PERIOD_S, stack.take().expect("prepared"));
    }
    let (mut data, mut measurement) = at_state(model, &START, &[0.0; 7], 0.0);
    controller.start(&common::input(model, &data, &measurement));
    // The torque starts from the torques that hold the arm still.
    let mut before = data.gravity.clone();
    let (mut tau, mut steps) = ([0.0; 7], [0.0_f64; 2]);
    for tick in 0..ticks {
        for (change, stack) in changes.iter().zip(&mut prepared).filter(|(change, _)| change.tick == tick) {
            let Some(stack) = stack.take() else { continue };
            let (past, count) =
                counted(|| controller.switch(stack, &common::input(model, &data, &measurement)));
            assert_eq!(count.allocations, 0, "{change:?}");
            drop(past);
        }
        let count = allocations(|| controller.update(&common::input(model, &data, &measurement), &mut tau));
        assert_eq!(count, 0, "tick {tick} of {changes:?}");
        assert!(tau.iter().all(|t| t.is_finite()), "tick {tick} of {changes:?}: {tau:?}");
        let change = changes.iter().any(|change| change.tick == tick);
        for (&tau, before) in tau.iter().zip(before.iter_mut()) {
            let moved = (tau - *before).abs() - SLACK * (1.0 + before.abs());
            steps = [if change { steps[0].max(moved) } else { steps[0] }, steps[1].max(moved)];
            *before = tau;
        }
        let ddq = accelerations(model, &data, &tau);
        step(model, &mut data, &mut measurement, &ddq, PERIOD_S);
        measurement.wrenches[0].linear = Vector3::new(3.0, -2.0, 1.0);
    }
    steps
}

/// Compared: the step of each torque between cycles with the rate limit, for random changes at random times. Without
/// the limit, the same changes cause larger steps.
#[test]
fn task_set_changes_respect_torque_rate() {
    let model = seven_joints();
    let mut numbers = Numbers::new(41);
    let count = task_sets().len();
    let mut jumped = 0;
    for case in 0..30 {
        let rate = numbers.between(100.0, 1000.0);
        let first = case % count;
        let mut changes = [0, 1].map(|part| Change {
            tick: 30 + 100 * part + numbers.below(90),
            stack: numbers.below(count),
            scheduled: numbers.below(2) == 0,
        });
        if changes[0].stack == first {
            changes[0].stack = (first + 1) % count;
        }
        let [_, step] = run(&model, rate, first, &changes, 260);
        assert!(step <= rate * PERIOD_S, "case {case}: {step} Nm in a tick at {rate} Nm/s\n{changes:?}");
        let [step, _] = run(&model, f64::INFINITY, first, &changes, 260);
        jumped += usize::from(step > 2.0 * rate * PERIOD_S);
    }
    assert!(jumped > 15, "only {jumped} of 30 jumped without a limit: the test shows little");
}

/// Returns a controller that was started at `START`.
fn started_controller(model: &Model, text: &str) -> OperationalSpaceController {
    let file = File::read(text);
    let mut controller =
        OperationalSpaceController::new(model, &file.task_set(), &robot(model, f64::INFINITY))
            .unwrap_or_else(|e| panic!("{e}\n{text}"));
    let (data, measurement) = at_state(model, &START, &[0.0; 7], 0.0);
    controller.start(&common::input(model, &data, &measurement));
    controller
}

/// Returns the torques at a time; the state is arbitrary.
fn tick(controller: &mut OperationalSpaceController, model: &Model, time_s: f64) -> [f64; 7] {
    let (data, measurement) = at_state(model, &START.map(|q| q + 0.02), &[0.1; 7], time_s);
    let mut tau = [0.0; 7];
    controller.update(&common::input(model, &data, &measurement), &mut tau);
    tau
}

fn switch(controller: &mut OperationalSpaceController, model: &Model, text: &str, time_s: f64) {
    let (data, measurement) = at_state(model, &START.map(|q| q + 0.02), &[0.1; 7], time_s);
    let stack =
        controller.prepare(model, &File::read(text).task_set()).unwrap_or_else(|e| panic!("{e}\n{text}"));
    controller.switch(stack, &common::input(model, &data, &measurement));
}

const SWINGING: &str = r#"
priority = ["hand", "elbow", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", z = "motion", ry = "motion" }
axes_frame = "task-frame"
reference.sinusoid = { x = [{ amplitude_m = 0.05, frequency_hz = 1.3 }], ry = [{ amplitude_rad = 0.2, frequency_hz = 0.7 }] }
gains = { frequency_rad_per_s = 12.0, damping_ratio = 1.0 }
[task.elbow.joint-tracking]
joints = ["j4", "j2"]
reference.sinusoid.joints.j4 = [{ amplitude_rad = 0.3, frequency_hz = 1.1 }]
gains = { frequency_rad_per_s = 11.0, damping_ratio = 1.0 }
[task.rest.joint-tracking]
reference.sinusoid.joints.j1 = [{ amplitude_rad = 0.2, frequency_hz = 0.9 }]
gains = { frequency_rad_per_s = 10.0, damping_ratio = 1.0 }
"#;

/// Compared: all references in a run whose gains change twice, and then an axis mode, with those in a run without
/// changes, bit for bit.
#[test]
fn gain_changes_do_not_affect_references() {
    let model = seven_joints();
    let other = SWINGING.replace("rad_per_s = 1", "rad_per_s = 2");
    let changes =
        [other.clone(), SWINGING.to_owned(), other.replace("x = \"motion\", z", "x = \"compliant\", z")];
    let mut numbers = Numbers::new(42);
    for case in 0..10 {
        let [mut changing, mut still] = [0; 2].map(|_| started_controller(&model, SWINGING));
        let (mut time_s, mut differ) = (0.0, 0);
        for text in &changes {
            time_s += numbers.between(0.001, 0.5);
            switch(&mut changing, &model, text, time_s);
            for _ in 0..3 {
                let [a, b] = [&mut changing, &mut still].map(|c| tick(c, &model, time_s));
                differ += usize::from(a != b);
                for name in [
                    "hand.reference",
                    "hand.reference_velocity",
                    "hand.reference_orientation",
                    "elbow.reference",
                    "elbow.reference_velocity",
                    "rest.reference",
                    "rest.reference_velocity",
                ] {
                    let [a, b] = [&changing, &still].map(|c| sampled(c, name));
                    let same = a.iter().zip(&b).all(|(a, b)| a.to_bits() == b.to_bits());
                    assert!(same, "case {case}, {name} at {time_s} s: {a:?} against {b:?}");
                }
                time_s += numbers.between(1e-4, 0.1);
            }
        }
        assert!(differ == 6, "two of the three stacks ask for other torques: {differ} of 9 differ");
    }
}

/// Returns the steps of the reference of `task` (m, s) across a change at `time_s`: of its position, its velocity and
/// its acceleration, which is computed by differences on both sides.
fn steps(model: &Model, before: &str, after: &str, task: &str, time_s: f64) -> [f64; 3] {
    const SIDE_S: f64 = 1e-5;
    let mut controller = started_controller(model, before);
    let mut at = |time_s: f64, change: Option<&str>| {
        if let Some(text) = change {
            switch(&mut controller, model, text, time_s);
        }
        tick(&mut controller, model, time_s);
        ["reference", "reference_velocity"]
            .map(|quantity| DVector::from_vec(sampled(&controller, &format!("{task}.{quantity}"))))
    };
    let [_, earlier] = at(time_s - SIDE_S, None);
    let [place, velocity] = at(time_s, None);
    let [new_place, new_velocity] = at(time_s, Some(after));
    let [_, later] = at(time_s + SIDE_S, None);
    let [left, right] = [(&velocity - earlier) / SIDE_S, (later - &new_velocity) / SIDE_S];
    [(new_place - place).amax(), (new_velocity - velocity).amax(), (right - left).amax()]
}

/// A goal that changes during a motion, or follows a sinusoid: position and velocity of the reference are continuous up
/// to rounding, the acceleration up to the change by the jerks (up to 50 m/s³ or rad/s³ on either side) in 0.02 ms. A
/// point-to-point motion instead starts from rest, which shows that the test can fail.
#[test]
fn new_goal_takes_over_the_motion() {
    let model = seven_joints();
    let of_hand = |reference: &str| hand(XYZ, reference, STEADY, POSTURE);
    let of_joints = |reference: &str| {
        format!(
            "priority = [\"hand\"]\n[task.hand.joint-tracking]\nreference.{reference}\n\
             gains = {{ frequency_rad_per_s = 10.0, damping_ratio = 1.0 }}\n"
        )
    };
    let posture = |j2: f64, j5: f64| {
        of_joints(&format!(
            "goal = {{ posture = {{ offset_rad = {{ j2 = {j2:e}, j5 = {j5:e} }} }}, velocity_rad_per_s = 1.0, acceleration_rad_per_s2 = 3.0, jerk_rad_per_s3 = 30.0 }}"
        ))
    };
    let swing = "sinusoid = { ramp_s = 0.1, joints.j2 = [{ amplitude_rad = 0.1, frequency_hz = 1.0 }] }";
    let mut numbers = Numbers::new(43);
    let mut moving = 0;
    for case in 0..40 {
        let mut offset = || {
            let v = numbers.vector3(0.15);
            goal([v.x, v.y, v.z])
        };
        let (a, b) = (offset(), offset());
        let (u, v) = (numbers.next(), numbers.next());
        let time_s = numbers.between(0.12, 0.45);
        for (before, after) in [
            (of_hand(&a), of_hand(&b)),
            (of_hand(SINUSOID), of_hand(&b)),
            (posture(0.5, -0.4), posture(u, v)),
            (of_joints(swing), posture(u, v)),
        ] {
            let [place, velocity, acceleration] = steps(&model, &before, &after, "hand", time_s);
            assert!(
                place < 1e-12 && velocity < 1e-12,
                "case {case}: {place} m, {velocity} m/s\n{before}\n{after}"
            );
            assert!(acceleration < 2.0 * 50.0 * 2e-5, "case {case}: {acceleration} m/s²\n{before}\n{after}");
        }
        let rough =
            of_hand("point-to-point = { position = { offset_m = [0.1, 0.0, 0.0] }, duration_s = 1.0 }");
        let [place, velocity, _] = steps(&model, &of_hand(SINUSOID), &rough, "hand", time_s);
        assert!(place < 1e-12, "case {case}: even that begins where the reference was");
        moving += usize::from(velocity > 0.05);
    }
    assert!(moving > 30, "{moving} of 40 changes were in mid-motion");
}

/// The hand drifts along a compliant axis and about another one. When both are switched back to motion, their reference
/// starts at the hand, at rest. The reference of the other axes continues from its value, although the hand is not
/// there.
#[test]
fn reactivated_axis_starts_at_hand() {
    let model = seven_joints();
    let text = |x: &str, rx: &str| {
        format!(
            "priority = [\"hand\", \"rest\"]\n[task.hand.cartesian]\nframe = \"hand\"\n\
             axes = {{ x = \"{x}\", y = \"motion\", z = \"motion\", rx = \"{rx}\" }}\naxes_frame = {{ rpy_rad = [0.3, -0.5, 0.8] }}\n\
             reference = \"hold\"\n{STEADY}\n[task.rest]\n{POSTURE}\n"
        )
    };
    let hand = model.frame_id("hand").expect("hand");
    let axes = *Rotation3::from_euler_angles(0.3, -0.5, 0.8).matrix();
    let push = axes * Vector3::new(6.0, 3.0, 2.0);
    let mut numbers = Numbers::new(44);
    for case in 0..6 {
        let robot = robot(&model, f64::INFINITY);
        let (soft, stiff) =
            (File::read(&text("compliant", "compliant")), File::read(&text("motion", "motion")));
        let mut controller =
            OperationalSpaceController::new(&model, &soft.task_set(), &robot).expect("a good stack");
        let stack = controller.prepare(&model, &stiff.task_set()).expect("a good stack");
        let (mut data, mut measurement) = at_state(&model, &START, &[0.0; 7], 0.0);
        controller.start(&common::input(&model, &data, &measurement));
        let home = frame_placement(&model, &data, hand);
        let mut tau = [0.0; 7];
        for _ in 0..100 + numbers.below(200) {
            controller.update(&common::input(&model, &data, &measurement), &mut tau);
            let pushed = common::jacobian(&model, &data, "hand").rows(0, 3).tr_mul(&push);
            let total: Vec<f64> = tau.iter().zip(pushed.iter()).map(|(tau, push)| tau + push).collect();
            let ddq = accelerations(&model, &data, &total);
            step(&model, &mut data, &mut measurement, &ddq, PERIOD_S);
        }
        let pose = frame_placement(&model, &data, hand);
        let drift = axes.tr_mul(&(pose.translation - home.translation));
        assert!(drift.x > 2e-3 && drift.y.abs() > 1e-5, "case {case}: the hand has drifted by {drift}");

        controller.switch(stack, &common::input(&model, &data, &measurement));
        controller.update(&common::input(&model, &data, &measurement), &mut tau);
        let reference =
            axes.tr_mul(&(Vector3::from_vec(sampled(&controller, "hand.reference")) - home.translation));
        let off = (reference - Vector3::new(drift.x, 0.0, 0.0)).amax();
        assert!(off < 1e-12, "case {case}: the reference is at {reference}, the hand at {drift}");
        assert!(sampled(&controller, "hand.reference_velocity") == [0.0; 3], "case {case}");
        let [wanted, is] =
            ["hand.reference_orientation", "hand.orientation"].map(|name| sampled(&controller, name));
        assert!(wanted == is, "case {case}: {wanted:?} against {is:?}");
        // Only the damping acts on the axis: its acceleration is −2ζω v.
        let moved = frame_acceleration(&model, &data, "hand", &tau);
        let moved = axes.tr_mul(&moved.fixed_rows::<3>(0)).x;
        let speed = axes.tr_mul(&opspace_model::frame_velocity(&model, &data, hand).linear).x;
        assert!(
            (moved + 24.0 * speed).abs() < ROUNDING * moved.abs().max(1.0),
            "case {case}: {moved} at {speed} m/s"
        );
    }
}

/// Returns all values of a row of the log, by signal.
fn row(controller: &OperationalSpaceController) -> Vec<(String, Vec<f64>)> {
    let signals = controller.signals();
    let mut values = vec![0.0; signals.iter().map(Signal::len).sum()];
    controller.sample(&mut values);
    let mut rest = values.as_slice();
    (signals.into_iter())
        .map(|signal| {
            let (own, others) = rest.split_at(signal.len());
            rest = others;
            (signal.name, own.to_vec())
        })
        .collect()
}

/// The layout of the log is the same before, between and after scheduled task sets. Only the values of active tasks are
/// numbers.
#[test]
fn log_layout_is_fixed_and_inactive_tasks_are_nan() {
    let model = seven_joints();
    let stacks = task_sets();
    let order = [0, 7, 8, 4, 6];
    let files: Vec<File> = order.iter().map(|&stack| File::read(&stacks[stack])).collect();
    let mut controller = OperationalSpaceController::new(&model, &files[0].task_set(), &robot(&model, 500.0))
        .expect("a good stack");
    // Not in chronological order.
    for k in [2, 1, 4, 3] {
        let stack = controller.prepare(&model, &files[k].task_set()).expect("a good stack");
        controller.schedule(k as f64, stack);
    }
    let (data, measurement) = at_state(&model, &START, &[0.0; 7], 0.0);
    let signals = controller.signals();
    controller.start(&common::input(&model, &data, &measurement));
    for (k, file) in files.iter().enumerate() {
        for time_s in [k as f64, k as f64 + 0.9] {
            tick(&mut controller, &model, time_s);
            assert_eq!(controller.signals(), signals, "at {time_s} s");
            for (name, values) in row(&controller) {
                let (task, quantity) = name.split_once('.').unwrap_or((&name, ""));
                let in_force = file.priority.iter().any(|name| name == task)
                    || ["limited", "limits_solver"].contains(&name.as_str());
                let rest_tracks = order[k] == 6 || order[k] == 8;
                let expected = match (task, quantity) {
                    (_, "slack") => in_force,
                    ("rest", _) => in_force && rest_tracks,
                    (_, "sensed_force") => order[k] == 4,
                    _ => in_force,
                };
                let numbers = values.iter().all(|v| v.is_finite());
                let nothing = values.iter().all(|v| v.is_nan());
                assert!(if expected { numbers } else { nothing }, "{name} at {time_s} s: {values:?}");
            }
        }
    }
    // A task set that did not exist when the signals were listed: its tasks are not in the log, and the layout does not
    // change.
    switch(&mut controller, &model, &SWINGING.replace("elbow", "new"), 6.0);
    tick(&mut controller, &model, 6.0);
    assert_eq!(controller.signals(), signals);
    let values = row(&controller);
    let of = |name: &str| values.iter().find(|(other, _)| other == name).expect("a signal").1[0];
    assert!(of("hand.position").is_finite() && of("elbow.error").is_nan());
}

/// Task sets after one another. Compared: the typical mobilities of each, computed alone and with those of the set before, which
/// has the same rows, fewer, or others.
#[test]
fn typical_mobilities_do_not_depend_on_the_set_before() {
    let model = seven_joints();
    let context = robot(&model, f64::INFINITY);
    let sets = task_sets();
    for (before, text) in sets.iter().zip(sets.iter().chain(&sets).skip(1)).chain(sets.iter().zip(&sets)) {
        let build = |text: &str, before: Option<&TaskSet>| {
            TaskSet::from_parameters(&model, &File::read(text).task_set(), &context, before)
                .expect("a good set")
        };
        let (alone, after) = (build(text, None), build(text, Some(&build(before, None))));
        assert!(alone.typical_mobilities().eq(after.typical_mobilities()), "{before}\n{text}");
    }
}
