//! Force axes on an ideal arm and an elastic wall: approach, contact, targets over time, passivity control.

use crate::common::{self, File, at_state, build_error, control_context, jacobian, sampled, seven_joints};
use nalgebra::{DVector, Rotation3, Vector3};
use opspace_control::{Controller, Measurement, OperationalSpaceController};
use opspace_model::{Data, Model, frame_placement, frame_velocity};
use std::collections::VecDeque;

const START: [f64; 7] = [0.3, 0.7, -0.4, -1.4, 0.2, 1.1, 0.5];

/// Steps of the simulation per control period of 1 ms.
const STEPS: usize = 5;

/// An elastic plane and the arm that touches it.
struct Press {
    model: Model,
    controller: OperationalSpaceController,
    data: Data,
    measurement: Measurement,
    /// Outward normal, and distance of the hand from the surface at the start, m.
    normal: Vector3<f64>,
    surface: Vector3<f64>,
    stiffness: f64,
    damping: f64,
    /// Tangential force on the hand, N.
    tangential: Vector3<f64>,
    /// Forces that were sensed but are not reported yet.
    late: VecDeque<Vector3<f64>>,
    cycle: usize,
}

impl Press {
    /// An arm whose hand is `gap_m` in front of a wall with this normal; the sensor is late by `late` cycles.
    fn new(text: &str, normal: Vector3<f64>, gap_m: f64, late: usize) -> Self {
        let model = seven_joints();
        let file = File::read(text);
        let context = control_context(&model, "hand");
        let mut controller =
            OperationalSpaceController::new(&model, &file.task_set(), &context).expect("a good task");
        let (data, measurement) = at_state(&model, &START, &[0.0; 7], 0.0);
        controller.start(&common::input(&model, &data, &measurement));
        let hand = frame_placement(&model, &data, model.frame_id("hand").expect("hand")).translation;
        Self {
            surface: hand - normal * gap_m,
            normal,
            stiffness: 5e3,
            damping: 20.0,
            tangential: Vector3::zeros(),
            late: std::iter::repeat_n(Vector3::zeros(), late).collect(),
            cycle: 0,
            model,
            controller,
            data,
            measurement,
        }
    }

    fn hand(&self) -> Vector3<f64> {
        frame_placement(&self.model, &self.data, self.model.frame_id("hand").expect("hand")).translation
    }

    /// Advances by a control period; returns the force of the wall, N, and the hand's velocity along the normal, m/s.
    fn cycle(&mut self) -> (f64, f64) {
        let hand = self.model.frame_id("hand").expect("hand");
        let mut tau = [0.0; 7];
        let (mut force, mut speed) = (0.0, 0.0);
        for step in 0..STEPS {
            let (q, dq) = (&self.measurement.q, &self.measurement.dq);
            assert!(opspace_model::update(&self.model, &mut self.data, q.as_slice(), dq.as_slice()));
            speed = self.normal.dot(&frame_velocity(&self.model, &self.data, hand).linear);
            let depth = self.normal.dot(&(self.surface - self.hand()));
            force = if depth > 0.0 { (self.stiffness * depth - self.damping * speed).max(0.0) } else { 0.0 };
            let contact = self.normal * force + if force > 0.0 { self.tangential } else { Vector3::zeros() };
            if step == 0 {
                self.late.push_back(contact);
                self.measurement.wrenches[0].linear = self.late.pop_front().expect("one was added");
                self.measurement.time_s = 1e-3 * self.cycle as f64;
                self.controller.update(&common::input(&self.model, &self.data, &self.measurement), &mut tau);
            }
            let rows = jacobian(&self.model, &self.data, "hand");
            let caused = rows.rows(0, 3).transpose() * contact;
            let total = DVector::from_column_slice(&tau) + caused;
            opspace_model::aba(&self.model, &mut self.data, total.as_slice());
            let dt = 1e-3 / STEPS as f64;
            self.measurement.dq.axpy(dt, &self.data.ddq, 1.0);
            let dq = self.measurement.dq.clone();
            self.measurement.q.axpy(dt, &dq, 1.0);
        }
        self.cycle += 1;
        (force, speed)
    }

    fn run(&mut self, seconds: f64) -> Vec<(f64, f64)> {
        (0..(seconds * 1e3) as usize).map(|_| self.cycle()).collect()
    }

    fn signal(&self, name: &str, axis: usize) -> f64 {
        sampled(&self.controller, &format!("hand.{name}"))[axis]
    }
}

/// Task that presses along z with the parameters `force`, in the axes `axes_frame`.
fn pressing(force: &str, axes_frame: &str) -> String {
    format!(
        r#"
        priority = ["hand", "rest"]
        [task.hand.cartesian]
        frame = "hand"
        axes = {{ x = "motion", y = "motion", z = "force" }}
        axes_frame = {axes_frame}
        reference = "hold"
        gains = {{ frequency_rad_per_s = 14.0, damping_ratio = 1.0 }}
        force = {{ sensor = "wrist"{force} }}
        [task.rest.joint-posture]
        frequency_rad_per_s = 6.0
        damping_ratio = 1.0
        "#
    )
}

/// Mean of the last forces, N, and their largest deviation from it.
fn last(forces: &[(f64, f64)], count: usize) -> (f64, f64) {
    let tail = &forces[forces.len() - count..];
    let mean = tail.iter().map(|(force, _)| force).sum::<f64>() / count as f64;
    (mean, tail.iter().map(|(force, _)| (force - mean).abs()).fold(0.0, f64::max))
}

/// Largest force error of settled contact, N.
const SETTLED_N: f64 = 0.01;

#[test]
fn axis_approaches_presses_and_approaches_again() {
    let text = pressing(", target_n = { z = 15.0 }, contact = { approach_m_per_s = 0.08 }", "\"world\"");
    let mut press = Press::new(&text, Vector3::z(), 0.02, 0);
    let home = press.hand();
    let free = press.run(0.2);
    assert!(free.iter().all(|&(force, _)| force == 0.0), "the wall is 20 mm away");
    assert!((free[199].1 + 0.08).abs() < 2e-3, "{} m/s", free[199].1);
    assert_eq!((press.signal("contact", 2), press.signal("target_force", 2)), (0.0, 0.0));
    let pressed = press.run(1.5);
    let (mean, deviation) = last(&pressed, 200);
    assert!((mean - 15.0).abs() < SETTLED_N && deviation < SETTLED_N, "{mean} N ± {deviation}");
    assert_eq!((press.signal("contact", 2), press.signal("target_force", 2)), (1.0, 15.0));
    assert!(press.signal("contact", 0).is_nan(), "x is a motion axis");
    let away = press.hand() - home;
    assert!(Vector3::new(away.x, away.y, 0.0).norm() < 1e-4, "{away} along the motion axes");
    // The wall recedes.
    press.surface.z -= 0.05;
    press.run(0.2);
    assert_eq!(press.signal("contact", 2), 0.0);
    let (mean, _) = last(&press.run(2.0), 200);
    assert!((mean - 15.0).abs() < SETTLED_N, "{mean} N after the second contact");
}

/// A blocked hand that senses nothing pushes with a bounded force.
#[test]
fn blocked_approach_is_bounded() {
    let text = pressing(", target_n = { z = 15.0 }, contact = { made_above_n = 1e6 }", "\"world\"");
    let mut press = Press::new(&text, Vector3::z(), 0.0, 0);
    let (first, _) = last(&press.run(1.0), 100);
    let (later, deviation) = last(&press.run(1.0), 100);
    assert!(first > 1.0 && later < 1.01 * first && deviation < 0.01 * first, "{first} N, {later} N");
}

/// Compared: the force in axes that are rotated, and the displacement along the other two axes.
#[test]
fn rotated_axes_press_along_their_own_direction() {
    for rpy in [[0.6, -0.3, 1.0], [-1.2, 0.4, 2.0]] {
        let [r, p, y] = rpy;
        let normal = Rotation3::from_euler_angles(r, p, y) * Vector3::z();
        let force = ", target_n = { z = 12.0 }, contact = {}";
        let text = pressing(force, &format!("{{ rpy_rad = [{r}, {p}, {y}] }}"));
        let mut press = Press::new(&text, normal, 0.01, 0);
        let home = press.hand();
        let (mean, deviation) = last(&press.run(2.0), 200);
        assert!((mean - 12.0).abs() < SETTLED_N && deviation < SETTLED_N, "{rpy:?}: {mean} N");
        let away = press.hand() - home;
        let aside = (away - normal * normal.dot(&away)).norm();
        assert!(aside < 1e-4, "{rpy:?}: {aside} m aside");
    }
}

#[test]
fn target_follows_profile_and_ramps_in() {
    let force = ", profile_n = { z = [[0.0, 5.0], [1.0, 5.0], [2.0, 25.0]] }, ramp_s = 0.2";
    let mut press = Press::new(&pressing(force, "\"world\""), Vector3::z(), 0.0, 0);
    press.run(0.101);
    assert!((press.signal("target_force", 2) - 2.5).abs() < 0.05, "half of the ramp");
    let (mean, _) = last(&press.run(0.9), 50);
    assert!((mean - 5.0).abs() < SETTLED_N, "{mean} N");
    press.run(0.5);
    assert!((press.signal("target_force", 2) - 15.0).abs() < 0.05);
    let (mean, _) = last(&press.run(1.5), 100);
    assert!((mean - 25.0).abs() < SETTLED_N, "{mean} N");
}

/// Compared: the displacement along a motion axis by a tangential force, with and without its compensation.
#[test]
fn sensed_tangential_force_is_compensated() {
    let aside = |compensation: &str| {
        let force = format!(", target_n = {{ z = 15.0 }}{compensation}");
        let mut press = Press::new(&pressing(&force, "\"world\""), Vector3::z(), 0.0, 0);
        press.tangential = Vector3::new(4.0, 0.0, 0.0);
        let home = press.hand();
        press.run(1.5);
        (press.hand() - home).x
    };
    let (without, with) = (aside(""), aside(", sensed_compensation = { x = 1.0 }"));
    assert!(without > 2e-3, "the force displaces the hand: {without} m");
    assert!(with.abs() < 0.02 * without, "{with} m of {without} m");
}

/// Compared: forces on an undamped wall with a gain beyond what a late sensor allows. The passivity control reduces the
/// gains until the contact is steady; without it, the hand bounces.
#[test]
fn passivity_control_steadies_a_gain_that_is_too_high() {
    let forces = |passivity: &str| {
        let force = format!(", target_n = {{ z = 15.0 }}, gain = 6.0, damping_per_s = 30.0{passivity}");
        let mut press = Press::new(&pressing(&force, "\"world\""), Vector3::z(), 0.0, 4);
        (press.stiffness, press.damping) = (2e4, 0.0);
        let forces = press.run(3.0);
        let state = ["force_gain_share", "force_energy", "passivity_time"].map(|name| press.signal(name, 2));
        (last(&forces, 500), state)
    };
    let ((_, bouncing), [share, energy_j, active_s]) = forces(", passivity = { enabled = false }");
    assert!(bouncing > 10.0, "{bouncing} N");
    assert!(share == 1.0 && active_s == 0.0 && energy_j > 0.02, "{share} {energy_j} J {active_s} s");
    let ((mean, deviation), [share, energy_j, active_s]) = forces("");
    assert!((mean - 15.0).abs() < 0.5 && deviation < 1.0, "{mean} N ± {deviation}");
    assert!(share < 0.8 && active_s > 0.5 && energy_j < 0.02, "{share} {energy_j} J {active_s} s");
}

/// A stable contact keeps its gains.
#[test]
fn passivity_control_leaves_stable_contact_alone() {
    let text = pressing(", target_n = { z = 15.0 }, contact = {}", "\"world\"");
    let mut press = Press::new(&text, Vector3::z(), 0.02, 1);
    press.run(2.0);
    assert!(press.signal("force_gain_share", 2) > 0.99, "{}", press.signal("force_gain_share", 2));
}

/// A single hard impact reduces the gains, which return.
#[test]
fn gains_return_after_an_impact() {
    let mut press = Press::new(
        &pressing(", target_n = { z = 15.0 }, damping_per_s = 20.0", "\"world\""),
        Vector3::z(),
        0.03,
        3,
    );
    press.stiffness = 2e4;
    let least = (0..1000).map(|_| {
        press.cycle();
        press.signal("force_gain_share", 2)
    });
    let least = least.fold(1.0, f64::min);
    assert!(least < 0.9, "the impact reduces the gains: {least}");
    press.run(3.0);
    assert!(press.signal("force_gain_share", 2) > 0.99, "{}", press.signal("force_gain_share", 2));
}

#[test]
fn errors_name_the_key_of_force_control() {
    let cases = [
        (
            ", profile_n = { x = [[0.0, 1.0]] }",
            "task.hand.cartesian.force.profile_n.x",
            "only `force` axes follow",
        ),
        (
            ", profile_n = { z = [[1.0, 1.0], [1.0, 2.0]] }",
            "task.hand.cartesian.force.profile_n.z",
            "times must increase",
        ),
        (", profile_n = { z = [[nan, 1.0]] }", "task.hand.cartesian.force.profile_n.z", "finite"),
        (", damping_per_s = { x = 3.0 }", "task.hand.cartesian.force.damping_per_s", "z"),
        (", gain = { x = 3.0 }", "task.hand.cartesian.force.gain", "z"),
    ];
    for (force, key, message) in cases {
        let error = build_error(&seven_joints(), &pressing(force, "\"world\""));
        assert!(error.key() == key && error.reason().to_string().contains(message), "{error}");
    }
    let text =
        pressing("", "\"world\"").replace("reference =", "compliant_damping_per_s = 30.0\nreference =");
    let error = build_error(&seven_joints(), &text);
    assert_eq!(error.key(), "task.hand.cartesian.compliant_damping_per_s");
    assert!(error.to_string().contains("`force.damping_per_s`"), "{error}");
}

/// Gain and integral of zero leave the feed-forward alone: whatever is sensed, a hand at rest presses with the target force.
#[test]
fn feed_forward_alone_ignores_the_sensed_force() {
    let text =
        pressing(", target_n = { z = 12.0 }, gain = 0.0, integral_per_s = 0.0, ramp_s = 0.0", "\"world\"");
    let (model, file) = (seven_joints(), File::read(&text));
    let mut controller =
        OperationalSpaceController::new(&model, &file.task_set(), &control_context(&model, "hand"))
            .expect("a good task");
    let (data, mut measurement) = at_state(&model, &START, &[0.0; 7], 0.0);
    controller.start(&common::input(&model, &data, &measurement));
    let mut tau = [0.0; 7];
    for cycle in 0..100 {
        measurement.time_s = 1e-3 * f64::from(cycle);
        measurement.wrenches[0].linear = Vector3::new(0.0, 0.0, f64::from(cycle % 30));
        controller.update(&common::input(&model, &data, &measurement), &mut tau);
        let force = sampled(&controller, "hand.force")[2];
        assert!((force + 12.0).abs() < 1e-9, "cycle {cycle}: {force} N");
    }
}
