//! Torques near singular poses: bounded, continuous, exact elsewhere, and independent of the unit of length.

use crate::common::{
    self, File, Numbers, Q0, at_state, control_context, four_joints, four_joints_in, seven_joints_in,
};
use opspace_control::{Controller, OperationalSpaceController};
use opspace_model::Model;

const POSITION: &str = r#"
priority = ["hand", "rest"]
[task.hand.cartesian]
frame = "hand"
axes = { x = "motion", y = "motion", z = "motion" }
reference.point-to-point = { position = { offset_m = [0.1, 0.05, 0.1] }, duration_s = 1.0 }
gains = { frequency_rad_per_s = 14.142, damping_ratio = 1.0 }
singularity_threshold = 0.03
[task.rest.joint-posture]
frequency_rad_per_s = 6.0
damping_ratio = 0.8
"#;

/// Moves the elbow from `from` to `to` (rad) in `steps`, and returns the largest torque and the largest change of a
/// torque between two steps (Nm).
fn elbow_sweep(text: &str, from: f64, to: f64, steps: u32) -> (f64, f64) {
    let model = four_joints();
    let file = File::read(text);
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
            .expect("a good stack");
    let (data, measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let (mut largest, mut jump) = (0.0_f64, 0.0_f64);
    let mut last: Option<[f64; 4]> = None;
    for step in 0..=steps {
        let elbow = from + (to - from) * f64::from(step) / f64::from(steps);
        let (data, measurement) = at_state(&model, &[-0.45, -0.35, 0.25, elbow], &[0.1, 0.0, -0.1, 1.0], 2.0);
        let mut tau = [0.0; 4];
        controller.update(&common::input(&model, &data, &measurement), &mut tau);
        for i in 0..4 {
            largest = largest.max(tau[i].abs());
            jump = jump.max(last.map_or(0.0, |before| (tau[i] - before[i]).abs()));
        }
        last = Some(tau);
    }
    (largest, jump)
}

/// Compared: torques along a path through the straight elbow with those of the same law without damping, and changes
/// per step for two step sizes: a jump would not shrink with the step size. The numbers of steps are odd: in the
/// singular state itself no direction is left in which the law could brake.
#[test]
fn torques_are_bounded_and_continuous_through_singularity() {
    let (largest, coarse) = elbow_sweep(POSITION, -0.3, 0.3, 10_001);
    let (_, fine) = elbow_sweep(POSITION, -0.3, 0.3, 20_001);
    let undamped = POSITION.replace("singularity_threshold = 0.03", "singularity_threshold = 1e-30");
    let (exploding, _) = elbow_sweep(&undamped, -0.3, 0.3, 10_001);
    // Bound √λ_max(M) |a| / √(threshold λ_max(Λ⁻¹)), with |a| up to 70 m/s² on this path.
    assert!(largest < 2000.0, "{largest} Nm");
    assert!(exploding > 1e3 * largest, "without damping only {exploding} Nm: the test shows nothing");
    assert!(coarse < 4.0, "a step of {coarse} Nm");
    assert!((0.45..0.55).contains(&(fine / coarse)), "steps of {coarse} Nm shrink to {fine} Nm");
}

/// Compared: the torque at a pose above the threshold with that for a negligible threshold, bit for bit.
#[test]
fn no_damping_above_singularity_threshold() {
    let model = four_joints();
    let undamped = POSITION.replace("singularity_threshold = 0.03", "singularity_threshold = 1e-300");
    let [damped, undamped] = [POSITION, undamped.as_str()].map(|text| {
        let file = File::read(text);
        let mut controller =
            OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
                .expect("a good stack");
        let (data, measurement) = at_state(&model, &Q0, &[0.0; 4], 0.0);
        controller.start(&common::input(&model, &data, &measurement));
        let (data, measurement) = at_state(&model, &[-0.4, -0.3, 0.3, -1.2], &[0.5; 4], 0.4);
        let mut tau = [0.0; 4];
        controller.update(&common::input(&model, &data, &measurement), &mut tau);
        tau
    });
    assert_eq!(damped.map(f64::to_bits), undamped.map(f64::to_bits));
}

/// Returns the torques at `states` (q, q̇), half a second after a start at `start`.
fn torques(model: &Model, text: &str, start: &[f64], states: &[(Vec<f64>, Vec<f64>)]) -> Vec<Vec<f64>> {
    let file = File::read(text);
    let mut controller =
        OperationalSpaceController::new(model, &file.task_set(), &control_context(model, "hand"))
            .expect("a good stack");
    let (data, measurement) = at_state(model, start, &vec![0.0; start.len()], 0.0);
    controller.start(&common::input(model, &data, &measurement));
    (states.iter())
        .map(|(q, dq)| {
            let (data, measurement) = at_state(model, q, dq, 0.5);
            let mut tau = vec![0.0; q.len()];
            controller.update(&common::input(model, &data, &measurement), &mut tau);
            tau
        })
        .collect()
}

/// Compared: torques of a pose task on an arm given in metres with those on the same arm given in millimetres, at
/// random poses and at one with a straight elbow: torques in kg mm²/s² are a million times those in Nm.
#[test]
fn torques_are_independent_of_length_unit() {
    let text = r#"
    priority = ["hand", "rest"]
    [task.hand.cartesian]
    frame = "hand"
    axes = { x = "motion", y = "motion", z = "motion", rx = "motion", ry = "motion", rz = "motion" }
    reference = "hold"
    gains = { frequency_rad_per_s = 10.0, damping_ratio = 1.0 }
    singularity_threshold = 1.0
    [task.rest.joint-posture]
    frequency_rad_per_s = 6.0
    damping_ratio = 0.8
    "#;
    let mut numbers = Numbers::new(5);
    let mut states: Vec<_> = (0..20).map(|_| (numbers.vector(7, 1.5), numbers.vector(7, 1.0))).collect();
    states.push((vec![0.0; 7], numbers.vector(7, 1.0)));
    let start = numbers.vector(7, 1.0);
    let metres = torques(&seven_joints_in(1.0), text, &start, &states);
    let millimetres = torques(&seven_joints_in(1e3), text, &start, &states);
    for (m, mm) in metres.iter().zip(&millimetres) {
        let size = m.iter().fold(1.0_f64, |a, t| a.max(t.abs()));
        for (m, mm) in m.iter().zip(mm) {
            assert!((m - mm * 1e-6).abs() < 1e-8 * size, "{m} Nm against {} Nm", mm * 1e-6);
        }
    }
    // With a fixed characteristic length, the torques depend on the unit: the test above is able to fail.
    let fixed = text.replace("reference = ", "characteristic_length_m = 1.0\nreference = ");
    let metres = torques(&seven_joints_in(1.0), &fixed, &start, &states);
    let millimetres = torques(&seven_joints_in(1e3), &fixed, &start, &states);
    let differ =
        |(m, mm): (&Vec<f64>, &Vec<f64>)| m.iter().zip(mm).any(|(m, mm)| (m - mm * 1e-6).abs() > 1e-3);
    assert!(metres.iter().zip(&millimetres).any(differ));
}

/// Compared: the reach with the lengths of the links; it is independent of the base's placement.
#[test]
fn reach_is_sum_of_link_lengths() {
    let model = four_joints();
    for (frame, expected) in [("hand", 0.235 + 0.275), ("elbow", 0.235), ("shoulder_roll", 1.0)] {
        let reach = opspace_control::reach(&model, model.frame_id(frame).expect("frame"));
        assert!((reach - expected).abs() < 1e-15, "{frame}: {reach} m");
    }
}

/// The only axis of the second level is used by the first level: with the arm in the x-z plane and the hand fixed, the
/// elbow can move only in y. The torques at this pose and close to it are bounded.
#[test]
fn task_without_freedom_commands_no_torque() {
    let model = four_joints_in(1.0);
    let text = r#"
    priority = ["hand", "swing"]
    [task.hand.cartesian]
    frame = "hand"
    axes = { x = "motion", y = "motion", z = "motion" }
    reference = "hold"
    gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
    [task.swing.cartesian]
    frame = "elbow"
    axes = { x = "motion" }
    reference.point-to-point = { position = { offset_m = [0.1, 0.0, 0.0] }, duration_s = 1.0 }
    gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
    "#;
    let states: Vec<_> = [0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-3, 1e-2]
        .into_iter()
        .map(|aside| (vec![-0.45, aside, -0.7 * aside, -1.35], vec![0.0; 4]))
        .collect();
    for tau in torques(&model, text, &[-0.45, 0.0, 0.0, -1.35], &states) {
        assert!(tau.iter().all(|t| t.abs() < 50.0), "{tau:?}");
    }
}

/// Compared: the fraction that a null-space projector transmits to the task above, along each eigenvector of Λ⁻¹, with
/// its formula: below the threshold 1 minus λ g(λ) of the damping, above it zero.
#[test]
fn nullspace_leak_equals_damping_fraction() {
    let (model, threshold, tolerance) = (seven_joints_in(1.0), 0.2, 1e-10);
    let hand = model.frame_id("hand").expect("hand");
    let mut numbers = Numbers::new(11);
    let (mut damped, mut whole) = (0, 0);
    for _ in 0..60 {
        let (data, _) = at_state(&model, &numbers.vector(7, 1.5), &[0.0; 7], 0.0);
        let mut jacobian = nalgebra::Matrix6xX::zeros(7);
        opspace_model::frame_jacobian(&model, &data, hand, &mut jacobian);
        let position = nalgebra::Matrix3xX::from_fn(7, |r, c| jacobian[(r, c)]);
        let mobility =
            &position * data.mass_matrix.clone().try_inverse().expect("regular") * position.transpose();
        let spectrum = nalgebra::SymmetricEigen::new(mobility);
        let floor = threshold * spectrum.eigenvalues.max();

        let mut space = opspace_model::OperationalSpace::new(7);
        space.update(&data.mass_matrix_factor, &jacobian, 3, threshold);
        let mut above = jacobian.clone();
        above.rows_mut(3, 3).fill(0.0);
        let mut nullspace = nalgebra::DMatrix::zeros(7, 7);
        space.nullspace(&above, &mut nullspace);
        for (&value, direction) in spectrum.eigenvalues.iter().zip(spectrum.eigenvectors.column_iter()) {
            let alone = direction.transpose() * &position;
            let through = &alone * &nullspace;
            let ratio = value / floor;
            let mu = (1.0 - ratio * ratio).max(0.0);
            let share = if ratio < 1.0 { ratio * ratio / (ratio * ratio + mu * mu) } else { 1.0 };
            let off = (through - &alone * (1.0 - share)).amax();
            assert!(off < tolerance * alone.amax().max(1.0), "share {share}: off by {off}");
            if ratio < 1.0 { damped += 1 } else { whole += 1 }
        }
    }
    assert!(damped > 20 && whole > 20, "{damped} damped directions and {whole} whole ones");
}
