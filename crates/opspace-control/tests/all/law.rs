//! The torque law, compared with textbook formulas using matrix inverses, and with the motion that forward dynamics
//! (the articulated-body algorithm) computes from its torques.

use crate::common::{
    self, File, Numbers, Q0, accelerations, at_state, control_context, four_joints, frame_acceleration,
    jacobian, seven_joints,
};
use nalgebra::{DMatrix, DVector, Rotation3, Vector3};
use opspace_control::{Controller, OperationalSpaceController};
use opspace_model::{Force, frame_bias_acceleration, frame_placement, frame_velocity};
use std::f64::consts::PI;
use std::sync::OnceLock;

/// Tolerance of a torque (some 10 Nm) or acceleration that is computed in two ways; both invert matrices with condition
/// numbers around 1e3.
const ROUNDING: f64 = 1e-9;

const TRACKING: &str = r#"
priority = ["hand", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "motion" }
gains = { frequency_rad_per_s = 14.142135623730951, damping_ratio = 1.0 }
[task.hand.cartesian.reference.sinusoid]
x = [{ amplitude_m = 0.05, frequency_hz = 1.0 }]
y = [{ amplitude_m = 0.10, frequency_hz = 0.5 }]
z = [{ amplitude_m = 0.08, frequency_hz = 0.5, phase_rad = -1.5707963267948966, offset_m = 0.08 }]
[task.rest.joint-posture]
frequency_rad_per_s = 6.324555320336759
damping_ratio = 0.7905694150420949
"#;

const COMPLIANT: &str = r#"
priority = ["hand", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "compliant", y = "motion", z = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 14.142135623730951, damping_ratio = 1.0 }
force = { sensor = "wrist", filter_hz = 100.0 }
[task.rest.joint-posture]
frequency_rad_per_s = 6.324555320336759
damping_ratio = 0.7905694150420949
"#;

/// Returns the minimum-jerk ramp and its derivatives from the polynomial's coefficients.
fn ramp(u: f64) -> [f64; 3] {
    [
        10.0 * u.powi(3) - 15.0 * u.powi(4) + 6.0 * u.powi(5),
        30.0 * u.powi(2) - 60.0 * u.powi(3) + 30.0 * u.powi(4),
        60.0 * u - 180.0 * u.powi(2) + 120.0 * u.powi(3),
    ]
}

/// Returns Jᵀ F + Nᵀ M (40 (Q0 − q) − 10 q̇) + h with F = Λ (a − J̇ q̇) + `added`, for the hand's position.
fn textbook(
    model: &opspace_model::Model,
    data: &opspace_model::Data,
    acceleration: &DVector<f64>,
    added: &DVector<f64>,
) -> DVector<f64> {
    let hand = model.frame_id("hand").expect("hand");
    let m = &data.mass_matrix;
    let m_inverse = m.clone().try_inverse().expect("M is regular");
    let j = jacobian(model, data, "hand").rows(0, 3).into_owned();
    let lambda = (&j * &m_inverse * j.transpose()).try_inverse().expect("no singularity");
    let j_bar = &m_inverse * j.transpose() * &lambda;
    let n = DMatrix::identity(4, 4) - &j_bar * &j;
    let bias = DVector::from_column_slice(frame_bias_acceleration(model, data, hand).linear.as_slice());
    let q0 = DVector::from_column_slice(&Q0);
    let posture = m * ((q0 - &data.q) * 40.0 - &data.dq * 10.0);
    let force = lambda * (acceleration - bias) + added;
    j.transpose() * force + n.transpose() * posture + &data.bias
}

#[test]
fn tracking_torque_matches_textbook_formula() {
    let model = four_joints();
    let file = File::read(TRACKING);
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
            .expect("a good stack");
    let (data, measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let hand = model.frame_id("hand").expect("hand");
    let start = frame_placement(&model, &data, hand).translation;
    let mut numbers = Numbers::new(1);
    for time_s in [0.0, 0.3, 0.7, 1.0, 2.4] {
        let q: Vec<f64> = Q0.iter().map(|q| q + 0.2 * numbers.next()).collect();
        let dq = numbers.vector(4, 2.0);
        let (data, measurement) = at_state(&model, &q, &dq, time_s);
        let mut tau = [0.0; 4];
        controller.update(&common::input(&model, &data, &measurement), &mut tau);

        let (w, t) = (PI, time_s);
        let [s, ds, dds] = if t < 1.0 { ramp(t) } else { [1.0, 0.0, 0.0] };
        let p = Vector3::new(0.05 * (2.0 * w * t).sin(), 0.10 * (w * t).sin(), 0.08 * (1.0 - (w * t).cos()));
        let v = Vector3::new(
            0.05 * 2.0 * w * (2.0 * w * t).cos(),
            0.10 * w * (w * t).cos(),
            0.08 * w * (w * t).sin(),
        );
        let a = Vector3::new(
            -0.05 * 4.0 * w * w * (2.0 * w * t).sin(),
            -0.10 * w * w * (w * t).sin(),
            0.08 * w * w * (w * t).cos(),
        );
        let x = frame_placement(&model, &data, hand).translation;
        let dx = frame_velocity(&model, &data, hand).linear;
        let wanted = a * s
            + v * (2.0 * ds)
            + p * dds
            + (v * s + p * ds - dx) * (2.0 * 200.0_f64.sqrt())
            + (start + p * s - x) * 200.0;
        let wanted = DVector::from_column_slice(wanted.as_slice());
        let expected = textbook(&model, &data, &wanted, &DVector::zeros(3));
        let difference = (DVector::from_column_slice(&tau) - expected).amax();
        assert!(difference < ROUNDING, "at {time_s} s: off by {difference} Nm");
        let moved = frame_acceleration(&model, &data, "hand", &tau).rows(0, 3) - wanted;
        assert!(moved.amax() < ROUNDING, "at {time_s} s: the hand's acceleration is off by {moved}");
    }
}

#[test]
fn compliant_torque_matches_textbook_formula() {
    let model = four_joints();
    let file = File::read(COMPLIANT);
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "wrist"))
            .expect("a good stack");
    let (data, measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let hand = model.frame_id("hand").expect("hand");
    let start = frame_placement(&model, &data, hand).translation;
    let mut numbers = Numbers::new(2);
    let mut filtered = 0.0;
    for tick in 0..20 {
        let q: Vec<f64> = Q0.iter().map(|q| q + 0.2 * numbers.next()).collect();
        let dq = numbers.vector(4, 2.0);
        let (data, mut measurement) = at_state(&model, &q, &dq, 1e-3 * f64::from(tick));
        let mut force = Force::zero();
        force.linear = Vector3::new(numbers.next(), numbers.next(), numbers.next()) * 10.0;
        measurement.wrenches[0] = force;
        let mut tau = [0.0; 4];
        controller.update(&common::input(&model, &data, &measurement), &mut tau);

        filtered += (1.0 - (-2.0 * PI * 100.0 * 1e-3_f64).exp()) * (force.linear.x - filtered);
        let x = frame_placement(&model, &data, hand).translation;
        let dx = frame_velocity(&model, &data, hand).linear;
        let mut wanted = (start - x) * 200.0 - dx * (2.0 * 200.0_f64.sqrt());
        wanted.x = -2.0 * dx.x;
        let added = DVector::from_vec(vec![2.0 * filtered, 0.0, 0.0]);
        let wanted = DVector::from_column_slice(wanted.as_slice());
        let expected = textbook(&model, &data, &wanted, &added);
        let difference = (DVector::from_column_slice(&tau) - expected).amax();
        assert!(difference < ROUNDING, "tick {tick}: off by {difference} Nm");
    }
}

#[test]
fn joint_tracking_acceleration_and_gravity_compensation_are_exact() {
    let model = four_joints();
    let file = File::read(
        r#"
        priority = ["all"]
        [task.all.joint-tracking]
        gains = { frequency_rad_per_s = 14.142135623730951, damping_ratio = 1.0 }
        reference.sinusoid.joints.elbow = [{ amplitude_rad = 0.4, frequency_hz = 0.7 }]
        "#,
    );
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
            .expect("a good stack");
    let (data, measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let (q, dq, t) = ([-0.3, -0.5, 0.1, -1.0], [0.5, -1.0, 1.5, 0.2], 1.7);
    let (data, measurement) = at_state(&model, &q, &dq, t);
    let mut tau = [0.0; 4];
    controller.update(&common::input(&model, &data, &measurement), &mut tau);
    let omega = 2.0 * PI * 0.7;
    for i in 0..4 {
        let a = if i == 3 { 0.4 } else { 0.0 };
        let wanted = -a * omega * omega * (omega * t).sin()
            + 2.0 * 200.0_f64.sqrt() * (a * omega * (omega * t).cos() - dq[i])
            + 200.0 * (Q0[i] + a * (omega * t).sin() - q[i]);
        let ddq = accelerations(&model, &data, &tau)[i];
        assert!((ddq - wanted).abs() < ROUNDING * wanted.abs().max(1.0), "joint {i}: {ddq} for {wanted}");
    }

    let file = File::read(
        r#"
        priority = ["all"]
        compensation = "gravity"
        [task.all.joint-damping]
        damping_nms_per_rad = 0
        "#,
    );
    for gravity_by_robot in [false, true] {
        let mut robot = control_context(&model, "hand");
        robot.gravity_by_robot = gravity_by_robot;
        let mut controller =
            OperationalSpaceController::new(&model, &file.task_set(), &robot).expect("a good stack");
        controller.start(&common::input(&model, &data, &measurement));
        controller.update(&common::input(&model, &data, &measurement), &mut tau);
        let expected = if gravity_by_robot { [0.0; 4] } else { [0, 1, 2, 3].map(|i| data.gravity[i]) };
        assert!(tau == expected);
    }
}

/// Compared: the angular acceleration from forward dynamics with ω² log + 2ζω ω, computed with nalgebra's logarithm, in
/// task axes that are rotated relative to the world.
#[test]
fn pose_task_produces_desired_acceleration() {
    let model = seven_joints();
    let file = File::read(
        r#"
        priority = ["hand", "rest"]
        [task.hand.cartesian]
        frame = "hand"
        axes = { x = "motion", y = "motion", z = "motion", rx = "motion", ry = "motion", rz = "motion" }
        axes_frame = { rpy_rad = [0.3, -0.2, 0.9] }
        reference = "hold"
        gains = { frequency_rad_per_s = [10.0, 11.0, 12.0, 13.0, 14.0, 15.0], damping_ratio = { x = 0.5, y = 0.6, z = 0.7, rx = 0.8, ry = 0.9, rz = 1.0 } }
        [task.rest.joint-damping]
        damping_nms_per_rad = 3.0
        "#,
    );
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
            .expect("a good stack");
    let hand = model.frame_id("hand").expect("hand");
    let mut numbers = Numbers::new(3);
    let axes = *Rotation3::from_euler_angles(0.3, -0.2, 0.9).matrix();
    let mut regular = 0;
    while regular < 20 {
        let q = numbers.vector(7, 1.2);
        let (data, measurement) = at_state(&model, &q, &[0.0; 7], 0.0);
        controller.start(&common::input(&model, &data, &measurement));
        let start = frame_placement(&model, &data, hand);
        let q: Vec<f64> = q.iter().map(|q| q + 0.2 * numbers.next()).collect();
        let (data, measurement) = at_state(&model, &q, &numbers.vector(7, 1.0), 0.5);
        let mut tau = [0.0; 7];
        controller.update(&common::input(&model, &data, &measurement), &mut tau);
        if signal(&controller, "hand.min_singular_gain") != [1.0] {
            continue;
        }
        regular += 1;

        let pose = frame_placement(&model, &data, hand);
        let velocity = frame_velocity(&model, &data, hand);
        let turn = Rotation3::from_matrix_unchecked(start.rotation * pose.rotation.transpose());
        let error = [start.translation - pose.translation, turn.scaled_axis()].map(|e| axes.transpose() * e);
        let speed = [velocity.linear, velocity.angular].map(|v| axes.transpose() * v);
        let moved = frame_acceleration(&model, &data, "hand", &tau);
        for axis in 0..6 {
            let omega = 10.0 + axis as f64;
            let zeta = 0.5 + 0.1 * axis as f64;
            let (half, i) = (axis / 3, axis % 3);
            let wanted = omega * omega * error[half][i] - 2.0 * zeta * omega * speed[half][i];
            let got = (axes.transpose() * moved.fixed_rows::<3>(3 * half))[i];
            let scale = moved.amax().max(1.0);
            assert!((got - wanted).abs() < ROUNDING * scale, "axis {axis}: {got} for {wanted}");
        }
    }
}

const TWO_LEVELS: &str = r#"
priority = ["hand", "upper", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "motion", rz = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 12.0, damping_ratio = 1.0 }
singularity_threshold = 0.01
[task.upper.cartesian]
frame = "upper"
axes = { x = "motion", z = "motion" }
reference = "hold"
gains = { frequency_rad_per_s = 9.0, damping_ratio = 0.7 }
singularity_threshold = 0.01
[task.rest.joint-posture]
frequency_rad_per_s = 3.0
damping_ratio = 0.7
"#;

/// One state with three task sets: a level affects its own acceleration but not those of the levels above.
#[test]
fn lower_tasks_do_not_accelerate_higher_tasks() {
    let model = seven_joints();
    let robot = control_context(&model, "hand");
    let texts = [
        TWO_LEVELS.to_owned(),
        TWO_LEVELS.replace("frequency_rad_per_s = 3.0", "frequency_rad_per_s = 20.0"),
        TWO_LEVELS.replace("frequency_rad_per_s = 9.0", "frequency_rad_per_s = 30.0"),
    ];
    let mut numbers = Numbers::new(4);
    let mut regular = 0;
    for _ in 0..50 {
        let start = numbers.vector(7, 1.2);
        let q: Vec<f64> = start.iter().map(|q| q + 0.2 * numbers.next()).collect();
        let dq = numbers.vector(7, 1.0);
        let mut shares = Vec::new();
        let [base, posture, upper] = [0, 1, 2].map(|i| {
            let file = File::read(&texts[i]);
            let mut controller =
                OperationalSpaceController::new(&model, &file.task_set(), &robot).expect("a good stack");
            let (data, measurement) = at_state(&model, &start, &[0.0; 7], 0.0);
            controller.start(&common::input(&model, &data, &measurement));
            let (data, measurement) = at_state(&model, &q, &dq, 0.1);
            let mut tau = [0.0; 7];
            controller.update(&common::input(&model, &data, &measurement), &mut tau);
            shares.extend(signal(&controller, "hand.min_singular_gain"));
            shares.extend(signal(&controller, "upper.min_singular_gain"));
            let hand = frame_acceleration(&model, &data, "hand", &tau);
            let upper = frame_acceleration(&model, &data, "upper", &tau);
            [
                DVector::from_vec(vec![hand[0], hand[1], hand[2], hand[5]]),
                DVector::from_vec(vec![upper[0], upper[2]]),
                accelerations(&model, &data, &tau),
            ]
        });
        if shares.iter().any(|&share| share < 1.0) {
            continue;
        }
        regular += 1;
        let far = |a: &DVector<f64>, b: &DVector<f64>| (a - b).amax() / a.amax().max(1.0);
        assert!(far(&base[0], &posture[0]) < ROUNDING, "the posture moves the hand");
        assert!(far(&base[1], &posture[1]) < ROUNDING, "the posture moves the upper arm");
        assert!(far(&base[2], &posture[2]) > 1e-3, "the posture moves something");
        assert!(far(&base[0], &upper[0]) < ROUNDING, "the upper arm moves the hand");
        assert!(far(&base[1], &upper[1]) > 1e-3, "the upper arm moves itself");
    }
    assert!(regular > 25, "only {regular} of 50 states were regular");
}

/// Compared: the second level's acceleration with its own law. The effect of the first level is compensated.
#[test]
fn lower_task_follows_its_law_in_nullspace() {
    let model = seven_joints();
    let file = File::read(TWO_LEVELS);
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
            .expect("a good stack");
    let start = [0.3, 0.7, -0.4, 0.9, 0.2, -0.8, 0.5];
    let (data, measurement) = at_state(&model, &start, &[0.0; 7], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let frame = model.frame_id("upper").expect("upper");
    let goal = frame_placement(&model, &data, frame).translation;
    let q = start.map(|q| q + 0.1 * (7.0 * q).sin());
    let (data, measurement) = at_state(&model, &q, &[0.4, -0.3, 0.2, 0.5, -0.6, 0.1, 0.3], 0.1);
    let mut tau = [0.0; 7];
    controller.update(&common::input(&model, &data, &measurement), &mut tau);
    assert!(signal(&controller, "upper.min_singular_gain") == [1.0]);
    let moved = frame_acceleration(&model, &data, "upper", &tau);
    let velocity = frame_velocity(&model, &data, frame).linear;
    let error = goal - frame_placement(&model, &data, frame).translation;
    let wanted = error * 81.0 - velocity * (2.0 * 0.7 * 9.0);
    for axis in [0, 2] {
        assert!((moved[axis] - wanted[axis]).abs() < ROUNDING * moved.amax(), "axis {axis}");
    }
}

/// The simulated arm follows the Lissajous figure, and no direction is damped.
#[test]
fn arm_follows_its_reference() {
    let model = four_joints();
    let file = File::read(TRACKING);
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
            .expect("a good stack");
    let (mut data, mut measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let (period_s, mut worst) = (1e-3, 0.0_f64);
    let mut tau = [0.0; 4];
    for tick in 0..4000 {
        measurement.time_s = period_s * f64::from(tick);
        let (q, dq) = (measurement.q.as_slice(), measurement.dq.as_slice());
        assert!(opspace_model::update(&model, &mut data, q, dq));
        controller.update(&common::input(&model, &data, &measurement), &mut tau);
        assert!(signal(&controller, "hand.min_singular_gain") == [1.0], "damped at {} s", measurement.time_s);
        let error = signal(&controller, "hand.error");
        worst = worst.max(Vector3::new(error[0], error[1], error[2]).norm());
        opspace_model::aba(&model, &mut data, &tau);
        // Torques are constant over a period; semi-implicit Euler.
        measurement.dq.axpy(period_s, &data.ddq, 1.0);
        let dq = measurement.dq.clone();
        measurement.q.axpy(period_s, &dq, 1.0);
    }
    // Discretisation error: half a period of the largest acceleration (2 m/s²), with a stiffness of 200 1/s².
    assert!(worst < 2e-4, "{worst} m");
    assert!(worst > 0.0);
}

/// Static force regulation: at a stiff wall, the sensed force converges to its target for any gain.
#[test]
fn compliant_axis_settles_on_target_force() {
    let model = four_joints();
    for gain in ["0", "2.0"] {
        let force = format!(
            "force = {{ sensor = \"wrist\", target_n = {{ x = -5.0 }}, gain = {gain}, filter_hz = 100.0 }}"
        );
        let text = COMPLIANT.replace("force = { sensor = \"wrist\", filter_hz = 100.0 }", &force);
        let file = File::read(&text);
        let mut controller =
            OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
                .expect("a good stack");
        let (data, mut measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
        measurement.wrenches[0].linear.x = -5.0;
        controller.start(&common::input(&model, &data, &measurement));
        let mut tau = [0.0; 4];
        controller.update(&common::input(&model, &data, &measurement), &mut tau);
        let wall = jacobian(&model, &data, "hand").row(0).transpose() * -5.0;
        let ddq = accelerations(&model, &data, (DVector::from_column_slice(&tau) + wall).as_slice());
        assert!(ddq.amax() < ROUNDING, "gain {gain}: the arm moves off at {ddq}");
    }
}

/// Presses the hand against a wall of 5 kN/m in x for 4 s (or lets it move without a wall for 0.5 s) with a target of
/// −8 N and unknown joint torques. Returns the sensed force (N) and the hand's speed (m/s). `integral` is inserted into
/// the file's force parameters.
fn pressed_force(mode: &str, integral: &str, wall: bool) -> (f64, f64) {
    const UNKNOWN_NM: [f64; 4] = [0.8, -0.4, 0.3, 0.6];
    let model = four_joints();
    let damping =
        if mode == "force" { ", damping_per_s = 40.0 }" } else { " }\ncompliant_damping_per_s = 40.0" };
    let force = format!(
        "force = {{ sensor = \"wrist\", target_n = {{ x = -8.0 }}, gain = 1.0, filter_hz = 100.0{integral}{damping}"
    );
    let text = COMPLIANT
        .replace("force = { sensor = \"wrist\", filter_hz = 100.0 }", &force)
        .replace("x = \"compliant\"", &format!("x = \"{mode}\""));
    let file = File::read(&text);
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
            .expect("a good stack");
    let (mut data, mut measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let hand = model.frame_id("hand").expect("hand");
    let surface = frame_placement(&model, &data, hand).translation.x;
    let mut tau = [0.0; 4];
    // The simulation step is a tenth of a period, because the wall is stiff; the controller runs at its own rate.
    for step in 0..40_000 {
        assert!(opspace_model::update(
            &model,
            &mut data,
            measurement.q.as_slice(),
            measurement.dq.as_slice()
        ));
        let depth = frame_placement(&model, &data, hand).translation.x - surface;
        let speed = frame_velocity(&model, &data, hand).linear.x;
        let push = if wall && depth > 0.0 { -5e3 * depth - 50.0 * speed } else { 0.0 };
        if step % 10 == 0 {
            measurement.time_s = 1e-4 * f64::from(step);
            measurement.wrenches[0].linear.x = push;
            controller.update(&common::input(&model, &data, &measurement), &mut tau);
        }
        let caused = jacobian(&model, &data, "hand").row(0).transpose() * push;
        let total: Vec<f64> = (0..4).map(|i| tau[i] + UNKNOWN_NM[i] + caused[i]).collect();
        opspace_model::aba(&model, &mut data, &total);
        measurement.dq.axpy(1e-4, &data.ddq, 1.0);
        let dq = measurement.dq.clone();
        measurement.q.axpy(1e-4, &dq, 1.0);
        if !wall && step == 5_000 {
            break;
        }
    }
    (measurement.wrenches[0].linear.x, frame_velocity(&model, &data, hand).linear.x)
}

/// Largest force error with an integral after 4 s, N: several time constants, below the sensor's noise.
const SETTLED_N: f64 = 1e-3;

/// Force of a compliant axis on the wall; two tests share the run.
fn compliant_force() -> f64 {
    static FORCE_N: OnceLock<f64> = OnceLock::new();
    *FORCE_N.get_or_init(|| pressed_force("compliant", "", true).0)
}

/// Compared: the force of a force axis with its target, and with that of a compliant axis under the same disturbance.
#[test]
fn force_axis_removes_error_of_compliant_axis() {
    let compliant = compliant_force();
    let (force, _) = pressed_force("force", "", true);
    assert!((compliant + 8.0).abs() > 0.2, "the disturbance shows: {compliant} N");
    assert!((force + 8.0).abs() < SETTLED_N, "{force} N");
}

/// If the bound of the integral is too small for the disturbance, an error remains; without a wall, the bound limits
/// the hand's drift speed.
#[test]
fn force_axis_integral_is_bounded() {
    let (short, _) = pressed_force("force", ", integral_limit = 0.05", true);
    let compliant = compliant_force();
    assert!((short + 8.0).abs() > 0.1 && (short + 8.0).abs() < (compliant + 8.0).abs(), "{short} N");
    let (_, free) = pressed_force("force", ", integral_per_s = 1000.0", false);
    let (_, without) = pressed_force("force", ", integral_per_s = 1000.0, integral_limit = 0.0", false);
    assert!(free > 1.2 * without && free < 1.7 * without, "{free} m/s, {without} m/s without integral");
}

#[test]
fn joint_damping_brakes_every_joint() {
    let model = four_joints();
    let file = File::read(
        "priority = [\"all\"]\n[task.all.joint-damping.damping_nms_per_rad]\n\
         shoulder_pitch = 1.0\nshoulder_roll = 2.0\nshoulder_yaw = 3.0\nelbow = 4.0",
    );
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
            .expect("a good stack");
    let dq = [0.5, -1.0, 1.5, 0.2];
    let (data, measurement) = at_state(&model, &Q0, &dq, 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let mut tau = [0.0; 4];
    controller.update(&common::input(&model, &data, &measurement), &mut tau);
    for i in 0..4 {
        assert!((tau[i] - (data.bias[i] - (i as f64 + 1.0) * dq[i])).abs() < 1e-14, "joint {i}: {}", tau[i]);
    }
}

/// Compared: the torques and the task force that a sensed moment adds with Jᵀ times the gain and the moment.
#[test]
fn sensed_moment_is_fed_back_on_compliant_axis() {
    let model = seven_joints();
    let file = File::read(
        r#"
        priority = ["hand"]
        [task.hand.cartesian]
        frame = "hand"
        axes = { x = "motion", z = "motion", rx = "motion", ry = "compliant" }
        reference = "hold"
        gains = { frequency_rad_per_s = 10.0, damping_ratio = 1.0 }
        force = { sensor = "wrist", gain = { ry = 3.0 }, target_nm = { ry = 0.5 } }
        characteristic_length_m = 0.4
        "#,
    );
    let start = [0.3, 0.7, -0.4, -1.4, 0.2, 1.1, 0.5];
    let run = |moment: f64| {
        let mut controller =
            OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
                .expect("a good stack");
        let (data, mut measurement) = at_state(&model, &start, &[0.0; 7], 0.0);
        measurement.wrenches[0].angular.y = moment;
        controller.start(&common::input(&model, &data, &measurement));
        let mut tau = [0.0; 7];
        controller.update(&common::input(&model, &data, &measurement), &mut tau);
        let force = DVector::from_vec(signal(&controller, "hand.force"));
        (DVector::from_column_slice(&tau), force, jacobian(&model, &data, "hand").row(4).transpose())
    };
    let (unmoved, no_force, row) = run(0.0);
    let (moved, force, _) = run(2.0);
    assert!((moved - &unmoved - row * 6.0).amax() < 1e-12);
    assert!((force - no_force - DVector::from_vec(vec![0.0, 0.0, 0.0, 0.0, 6.0, 0.0])).amax() < 1e-12);
}

/// Compared: the power of the wrench at the task frame, in the task frame's motion, with that of the wrench at the
/// sensor, in the sensor frame's motion: both frames are on one body.
#[test]
fn wrench_is_shifted_from_sensor_to_task_frame() {
    let model = four_joints();
    let text = COMPLIANT.replace("reference =", "axes_frame = { rpy_rad = [0.3, -0.2, 0.9] }\nreference =");
    let file = File::read(&text);
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "wrist"))
            .expect("a good stack");
    let mut numbers = Numbers::new(6);
    for _ in 0..10 {
        let q: Vec<f64> = Q0.iter().map(|q| q + 0.2 * numbers.next()).collect();
        let (data, mut measurement) = at_state(&model, &q, &numbers.vector(4, 2.0), 0.0);
        let mut random = || Vector3::new(numbers.next(), numbers.next(), numbers.next()) * 10.0;
        measurement.wrenches[0] = Force { linear: random(), angular: random() };
        // The filter is initialised with this wrench, so that it does not change it.
        controller.start(&common::input(&model, &data, &measurement));
        controller.update(&common::input(&model, &data, &measurement), &mut [0.0; 4]);
        let velocity = |name: &str| frame_velocity(&model, &data, model.frame_id(name).expect("frame"));
        let hand = velocity("hand");
        let axes = *Rotation3::from_euler_angles(0.3, -0.2, 0.9).matrix();
        let sensed = DVector::from_vec(signal(&controller, "hand.sensed_force"));
        let power = (axes * sensed.fixed_rows::<3>(0)).dot(&hand.linear)
            + (axes * sensed.fixed_rows::<3>(3)).dot(&hand.angular);
        let expected = velocity("wrist").dot(&measurement.wrenches[0]);
        assert!((power - expected).abs() < 1e-11, "{power} W against {expected} W");
    }
}

fn signal(controller: &OperationalSpaceController, name: &str) -> Vec<f64> {
    use opspace_backend::Observable;
    let signals = controller.signals();
    let mut values = vec![0.0; signals.iter().map(|s| s.len()).sum()];
    controller.sample(&mut values);
    let place = signals.iter().position(|s| s.name == name).expect("the signal exists");
    let first: usize = signals[..place].iter().map(|s| s.len()).sum();
    values[first..first + signals[place].len()].to_vec()
}

/// Joint velocities of the references: the hand's axes move as their references do, an axis without one is at rest, and
/// the joints below follow theirs as far as the hand leaves them. Known are the references' derivatives at two times.
#[test]
fn reference_velocities_follow_the_priorities() {
    const TASKS: &str = r#"
priority = ["hand", "joints"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "compliant", y = "motion", z = "motion" }
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
force = { sensor = "wrist", filter_hz = 100.0 }
[task.hand.cartesian.reference.sinusoid]
y = [{ amplitude_m = 0.10, frequency_hz = 0.5 }]
z = [{ amplitude_m = 0.08, frequency_hz = 0.25 }]
[task.joints.joint-tracking]
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
[task.joints.joint-tracking.reference.sinusoid.joints]
j1 = [{ amplitude_rad = 0.3, frequency_hz = 0.5 }]
"#;
    let model = seven_joints();
    let q = [0.3, -0.5, 0.2, -1.4, 0.4, 1.1, -0.2];
    let (data, mut measurement) = at_state(&model, &q, &[0.2; 7], 0.0);
    measurement.wrenches.push(Force::zero());
    let file = File::read(TASKS);
    let context = control_context(&model, "hand");
    let mut controller = OperationalSpaceController::new(&model, &file.task_set(), &context).expect("tasks");
    controller.start(&common::input(&model, &data, &measurement));
    for time_s in [2.0, 5.0] {
        measurement.time_s = time_s;
        let input = common::input(&model, &data, &measurement);
        controller.update(&input, &mut [0.0; 7]);
        let mut velocity = DVector::from_element(7, f64::NAN);
        assert!(controller.reference_velocity(&input, velocity.as_mut_slice()));
        let hand = jacobian(&model, &data, "hand").rows(0, 3) * &velocity;
        let turn = |hz: f64| 2.0 * PI * hz * (2.0 * PI * hz * time_s).cos();
        let expected = Vector3::new(0.0, 0.10 * turn(0.5), 0.08 * turn(0.25));
        assert!((hand - expected).amax() < ROUNDING, "hand at {time_s} s: {velocity}");
        // In the metric of M, no joint velocity that leaves the hand at rest is closer to the joints' references.
        let mut reference = DVector::zeros(7);
        reference[0] = 0.3 * turn(0.5);
        let momentum = &data.mass_matrix * (&reference - &velocity);
        let j = jacobian(&model, &data, "hand").rows(0, 3).into_owned();
        let idle = DMatrix::identity(7, 7) - j.clone().pseudo_inverse(1e-9).expect("a pseudo-inverse") * &j;
        assert!((idle.transpose() * momentum).amax() < ROUNDING, "joints at {time_s} s: {velocity}");
    }
}
