//! Impedances that vary with time or with the task set: stiffness, forces and energy of a hand that is moved through random
//! poses at rest, so that the springs alone cause the task force.

use crate::common::{self, File, Numbers, at_state, control_context, sampled, seven_joints};
use nalgebra::Vector6;
use opspace_control::{Controller, OperationalSpaceController};
use opspace_model::Model;

const START: [f64; 7] = [0.3, 0.7, -0.4, -1.1, 0.2, 0.9, 0.5];
const PERIOD_S: f64 = 1e-3;

fn text(impedance: &str) -> String {
    format!(
        "priority = [\"hand\", \"rest\"]\n\
         [task.hand.cartesian]\nframe = \"hand\"\naxes = {{ x = \"motion\", y = \"motion\", z = \"motion\", ry = \"motion\" }}\n\
         reference = \"hold\"\nimpedance = {{ {impedance} }}\n\
         [task.rest.joint-posture]\nfrequency_rad_per_s = 4.0\ndamping_ratio = 0.7\n"
    )
}

fn build(model: &Model, impedance: &str) -> Result<OperationalSpaceController, String> {
    let file = File::read(&text(impedance));
    OperationalSpaceController::new(model, &file.task_set(), &control_context(model, "hand"))
        .map_err(|e| e.to_string())
}

fn six_of(controller: &OperationalSpaceController, name: &str) -> Vector6<f64> {
    Vector6::from_column_slice(&sampled(controller, name))
}

/// Joint positions of a smooth random motion.
fn posture(numbers: &[Vec<f64>; 2], time_s: f64) -> Vec<f64> {
    (0..7).map(|j| START[j] + 0.15 * numbers[0][j] * ((3.0 + 2.0 * numbers[1][j]) * time_s).sin()).collect()
}

const PROFILE: &str = "stiffness_n_per_m = 300.0, stiffness_nm_per_rad = 20.0, damping_ratio = 0.7";

/// Compared in every cycle: task force and stiffness times error; the delivered energy, with that of tank and springs at the
/// start. The profile demands more than the tank has.
#[test]
fn delivered_energy_is_bounded_by_tank_and_springs() {
    let model = seven_joints();
    let impedance = format!(
        "{PROFILE}, profile.stiffness_n_per_m = {{ x = [[0.0, 100.0], [0.7, 3000.0], [1.1, 50.0], [1.9, 4000.0]], \
         z = [[0.2, 300.0], [0.5, 2500.0]] }}, profile.stiffness_nm_per_rad = [[0.0, 20.0], [1.0, 200.0]], \
         tank = {{ initial_j = 0.2, capacity_j = 1.0 }}"
    );
    let (mut held_back, mut moved) = (0, 0.0_f64);
    for seed in 0..4 {
        let mut numbers = Numbers::new(seed + 60);
        let shape = [numbers.vector(7, 1.0), numbers.vector(7, 1.0)];
        let mut controller = build(&model, &impedance).unwrap_or_else(|e| panic!("{e}"));
        let (data, measurement) = at_state(&model, &START, &[0.0; 7], 0.0);
        controller.start(&common::input(&model, &data, &measurement));
        let mut torque = [0.0; 7];
        let (mut delivered, mut leaked) = (0.0, 0.0);
        let mut before: Option<[Vector6<f64>; 3]> = None;
        for step in 0..2500 {
            let time_s = PERIOD_S * f64::from(step);
            let (data, measurement) = at_state(&model, &posture(&shape, time_s), &[0.0; 7], time_s);
            controller.update(&common::input(&model, &data, &measurement), &mut torque);
            let [error, force, stiffness] =
                ["hand.error", "hand.force", "hand.stiffness"].map(|name| six_of(&controller, name));
            let [error, force] = [error, force].map(|mut v| {
                [v[3], v[5]] = [0.0; 2];
                v
            });
            let spring = stiffness.component_mul(&error);
            assert!((force - spring).amax() < 1e-6, "seed {seed}, step {step}: {force} {spring}");
            if let Some([e, f, k]) = before {
                delivered -= f.dot(&(error - e));
                leaked += 0.5 * k.dot(&(error - e).component_mul(&(error - e)));
            }
            let stored = 0.5 * spring.dot(&error);
            let [level] = sampled(&controller, "hand.tank")[..] else { panic!("one value") };
            assert!(delivered + stored + level <= 0.2 + 1e-6, "seed {seed}, step {step}");
            assert!(level >= -leaked, "seed {seed}, step {step}: {level} J, {leaked} J leaked");
            moved = moved.max(error.amax());
            before = Some([error, force, stiffness]);
        }
        let last = six_of(&controller, "hand.stiffness");
        held_back += usize::from(last[0] < 3999.0);
    }
    assert!(held_back > 2 && moved > 0.05, "{held_back} of 4 held back, moved by {moved} m");
}

/// Torques of an impedance with a constant profile and a tank, and of the same impedance without them, are equal bit for bit.
#[test]
fn constant_profile_changes_nothing() {
    let model = seven_joints();
    let constant = "profile.stiffness_n_per_m = [[0.0, 300.0]], tank = { initial_j = 0.0 }";
    let mut controllers = [PROFILE.to_owned(), format!("{PROFILE}, {constant}")]
        .map(|keys| build(&model, &keys).expect("valid"));
    let mut numbers = Numbers::new(71);
    let shape = [numbers.vector(7, 1.0), numbers.vector(7, 1.0)];
    let mut torques = [[0.0; 7]; 2];
    for step in 0..200 {
        let time_s = PERIOD_S * f64::from(step);
        let (data, measurement) = at_state(&model, &posture(&shape, time_s), &numbers.vector(7, 0.5), time_s);
        let input = common::input(&model, &data, &measurement);
        for (controller, torque) in controllers.iter_mut().zip(&mut torques) {
            if step == 0 {
                controller.start(&input);
            }
            controller.update(&input, torque);
        }
        assert!(torques[0] == torques[1], "step {step}");
    }
}

/// A task set with a tank takes over the stiffness before and blends into its own within 1 s; without a tank, it changes at
/// once. An equal profile goes on.
#[test]
fn switched_stiffness_is_blended_with_a_tank() {
    let model = seven_joints();
    for (tank, steps_at_once) in [(", tank = { initial_j = 2.0, capacity_j = 5.0 }", false), ("", true)] {
        let stiff = PROFILE.replace("300.0", "900.0");
        let mut controller = build(&model, PROFILE).expect("valid");
        let file = File::read(&text(&format!("{stiff}{tank}")));
        let prepared = controller.prepare(&model, &file.task_set()).expect("the same kind");
        controller.schedule(0.5, prepared);
        let (data, measurement) = at_state(&model, &START, &[0.0; 7], 0.0);
        controller.start(&common::input(&model, &data, &measurement));
        let away: Vec<f64> = START.iter().map(|q| q + 0.05).collect();
        let mut torque = [0.0; 7];
        let (mut before, mut largest) = (None, 0.0_f64);
        let mut forces = [0.0; 2];
        for step in 0..2000 {
            let (data, measurement) = at_state(&model, &away, &[0.0; 7], PERIOD_S * f64::from(step));
            controller.update(&common::input(&model, &data, &measurement), &mut torque);
            let force = six_of(&controller, "hand.force").rows(0, 3).norm();
            if let Some(before) = before {
                largest = largest.max(f64::abs(force - before));
            } else {
                forces[0] = force;
            }
            before = Some(force);
            forces[1] = force;
        }
        assert!((forces[1] / forces[0] - 3.0).abs() < 1e-9, "{forces:?}");
        let whole = forces[1] - forces[0];
        assert_eq!(largest > 0.99 * whole, steps_at_once, "{largest} N of {whole} N at once");
        assert!(steps_at_once || largest < 0.01 * whole, "{largest} N of {whole} N at once");
    }
}

/// Errors name the key.
#[test]
fn invalid_variations_are_refused() {
    let model = seven_joints();
    let at = "task.hand.cartesian.impedance";
    for (keys, expected) in [
        (
            "profile.stiffness_n_per_m = { rx = [[0.0, 1.0]] }",
            format!(
                "{at}.profile.stiffness_n_per_m: axis rx accepts no such profile: it is not a motion axis of that kind"
            ),
        ),
        (
            "profile.damping_ns_per_m = [[0.0, 1.0]]",
            format!(
                "{at}.profile.damping_ns_per_m: `damping_ratio` and a damping are mutually exclusive: remove one"
            ),
        ),
        ("tank = { initial_j = 3.0 }", format!("{at}.tank.initial_j: 3 J is above the capacity of 2 J")),
    ] {
        let error = build(&model, &format!("{PROFILE}, {keys}")).err().expect("invalid");
        assert_eq!(error, expected);
    }
    let shaped = text(&format!("{PROFILE}, inertia_kg = 2.0, inertia_kg_m2 = 0.1, tank = {{}}"))
        .replace("reference =", "force = { sensor = \"wrist\" }\nreference =");
    let file = File::read(&shaped);
    let error = OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
        .err()
        .expect("a desired inertia");
    assert!(
        error.to_string().starts_with(&format!("{at}: a `profile` or a `tank` needs the arm's own inertia"))
    );
}
