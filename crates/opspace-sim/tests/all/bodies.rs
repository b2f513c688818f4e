//! Tests of environment objects with a mass of their own against closed forms: a mass at a frame, a drawer.

use crate::contacts::{ClosedPath, placed, recorded};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// Duration of a step of the plant, s.
const STEP_S: f64 = 5e-5;

const ZERO: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);

fn mass(damping_ratio: f64, more: &str) -> String {
    format!(
        "[mass]\nframe = 'hand'\nmass_kg = 0.5\nfrequency_hz = 80.0\ndamping_ratio = {damping_ratio}\n{more}"
    )
}

/// Compared: the force on a frame at rest and on one that moves as a sine, and weight and inertia m (g − a); none before
/// the mass is put on and after it is taken off.
#[test]
fn mass_has_weight_and_inertia() {
    let mut object = placed(&mass(0.7, "put_on_s = 1.0\ntaken_off_s = 5.0"));
    let (amplitude, omega) = (0.02, TAU * 1.5);
    let mut held = 0;
    for k in 0..120_000 {
        let t = f64::from(k) * STEP_S;
        let (sine, cosine) = (omega * t).sin_cos();
        let along = Vector3::new(0.6, 0.0, 0.8) * amplitude;
        let force = object.force(t, STEP_S, &(along * sine), &(along * omega * cosine));
        let position = &recorded(&object)[0].1;
        if !(1.0..5.0).contains(&t) {
            assert_eq!(force, ZERO);
            assert!(position.iter().all(|x| x.is_nan()));
        } else if t > 1.2 {
            let expected = (Vector3::new(0.0, 0.0, -9.81) + along * (omega * omega * sine)) * 0.5;
            // (1.5 Hz/80 Hz)² of the inertia force, and its lag 2 ζ 1.5 Hz/80 Hz times (1.5/80)².
            assert!((force - expected).norm() < 1e-3, "{force} for {expected} at {t} s");
            assert!((position[2] - along.z * sine).abs() < 1e-3, "hangs within a millimetre of the frame");
            held += 1;
        }
    }
    assert_eq!(held, 76_000 - 1, "steps under the load");
}

/// Compared: an undamped mass at a free frame of 2 kg over 20 s, and the oscillation of two masses on a spring, whose
/// amplitude and momentum stay.
#[test]
fn undamped_mass_conserves_energy_and_momentum() {
    let mut object = placed(&mass(0.0, ""));
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    // The frame with its own midpoint steps: both fall, and a push sets them in motion relative to each other.
    let (mut x, mut v, mut a) = (ZERO, ZERO, gravity);
    let mut largest = [0.0_f64; 2];
    let steps = 400_000;
    for k in 0..steps {
        let (middle, speed) = (x + v * (0.5 * STEP_S), v + a * (0.5 * STEP_S));
        let force = object.force(f64::from(k) * STEP_S, STEP_S, &middle, &speed);
        let push = if k < 20 { Vector3::new(30.0, 0.0, 10.0) } else { ZERO };
        a = gravity + (force + push) / 2.0;
        x += (v + a * (0.5 * STEP_S)) * STEP_S;
        v += a * STEP_S;
        if let Some(most) =
            [(100, 40_000), (steps - 40_000, steps)].iter().position(|(from, to)| (*from..*to).contains(&k))
        {
            largest[most] = largest[most].max(force.norm());
        }
    }
    // The impulse of 30 N and 10 N over 1 ms moves both: the common velocity is impulse/(2.5 kg).
    let common = Vector3::new(0.03, 0.0, 0.01) / 2.5 + gravity * (f64::from(steps) * STEP_S);
    assert!((v - common).norm() < 0.02, "{v} for {common}");
    assert!(largest[0] > 1.0 && (largest[1] / largest[0] - 1.0).abs() < 1e-3, "{largest:?} N");
}

/// Work of a damped mass on a frame along closed paths: never positive in a steady round.
#[test]
fn masses_and_drawers_create_no_energy() {
    let drawer = |friction: f64, grip: f64| {
        format!(
            "[drawer]\nframe = 'hand'\ndirection = [1.0, 0.0, 0.0]\nmass_kg = 2.0\ntravel_m = 0.03\nfriction_n = {friction}\n\
             closing_stiffness_n_per_m = 100.0\nclosing_force_n = 2.0\ngrip_damping_ns_per_m = {grip}"
        )
    };
    for seed in 0..4 {
        let path = ClosedPath::draw(seed, Vector3::new(0.01, 0.0, 0.0), Vector3::new(0.02, 2e-3, 2e-3));
        for text in [mass(0.3, ""), drawer(0.0, 50.0), drawer(5.0, 50.0), drawer(5.0, 0.0)] {
            let (work, exchanged) = path.work(&mut placed(&text));
            assert!(work < 0.0 && exchanged > 1e-3, "{work} J of {exchanged} J: {text}");
        }
    }
}

/// Compared: the force along a drawer that moves slowly, and closing force, spring, dry friction and stop by hand; the
/// direction across the slide is that of the grip.
#[test]
fn drawer_closes_rubs_and_stops() {
    let mut drawer = placed(
        "[drawer]\nframe = 'hand'\ndirection = [-2.0, 0.0, 0.0]\nmass_kg = 1.0\ntravel_m = 0.2\nopening_m = 0.05\n\
         friction_n = 4.0\nclosing_force_n = 3.0\nclosing_stiffness_n_per_m = 50.0",
    );
    let (mut time, mut now) = (0.0, ZERO);
    let mut pull_to = |x: f64| {
        let (from, to) = (now, Vector3::new(x, 1e-3, 0.0));
        let steps = 40_000;
        let speed = (to - from) / (f64::from(steps) * STEP_S);
        let mut force = ZERO;
        for k in 0..=steps {
            let x = from.lerp(&to, f64::from(k) / f64::from(steps));
            force = drawer.force(time, STEP_S, &x, &speed);
            time += STEP_S;
        }
        now = to;
        (force, recorded(&drawer)[0].1[0])
    };
    // Opened by 0.1 m more: 3 N + 50 N/m opening + 4 N of friction, which the robot feels in +x.
    let (force, opening) = pull_to(-0.1);
    assert!((opening - 0.15).abs() < 2e-3, "{opening} m");
    assert!((force.x - (7.0 + 50.0 * opening)).abs() < 0.05, "{force}");
    assert!((force.y + 10.0).abs() < 0.03, "1 mm across on 10 kN/m, and the damper: {force}");
    // Closed again to an opening of 0.1 m: friction acts the other way.
    let (force, opening) = pull_to(-0.05);
    assert!((force.x - (3.0 + 50.0 * opening - 4.0)).abs() < 0.05, "{force}");
    // Beyond the travel: the stop of 20 kN/m and the grip of 10 kN/m in series, beside the slide's force.
    let (_, opening) = pull_to(-0.16);
    assert!((0.2..0.205).contains(&opening), "{opening} m");
    let (force, opening) = pull_to(-0.17);
    let on_stop = 2e4 * (opening - 0.2);
    assert!(on_stop > 50.0 && (force.x - (on_stop + 7.0 + 50.0 * opening)).abs() < 1.0, "{force} {opening}");
}

/// Compared: the motion of an operator, and reaches that add up; zero force while it lets go, and where it takes hold of
/// the frame again; and the force toward a given point.
#[test]
fn operator_reaches_and_lets_go() {
    let operator = |more: &str| {
        format!(
            "[spring]\nframe = 'hand'\nstiffness_n_per_m = 1.0\ndamping_ns_per_m = 0.0\n{more}\n\
             motion.scripted.reach = [{{ at_s = 1.0, duration_s = 2.0, by_m = [0.1, 0.0, -0.2] }},\n\
             {{ at_s = 4.0, duration_s = 1.0, by_m = [0.0, 0.3, 0.2] }}]"
        )
    };
    let mut hand = placed(&operator("released = [{ at_s = 6.0, until_s = 7.0 }, { at_s = 9.0 }]"));
    let mut at = |t: f64, x: Vector3<f64>| hand.force(t, STEP_S, &x, &ZERO);
    let after = Vector3::new(0.1, 0.3, 0.0);
    for (t, expected) in
        [(0.5, ZERO), (2.0, Vector3::new(0.05, 0.0, -0.1)), (3.5, Vector3::new(0.1, 0.0, -0.2)), (5.5, after)]
    {
        assert!((at(t, ZERO) - expected).norm() < 1e-12, "{} at {t} s", at(t, ZERO));
    }
    let elsewhere = Vector3::new(0.2, -0.1, 0.4);
    assert_eq!(at(6.5, elsewhere), ZERO);
    assert!(at(7.0, elsewhere).norm() < 1e-12, "it takes hold of the frame where that is");
    assert!((at(8.0, ZERO) - elsewhere).norm() < 1e-12);
    assert_eq!(at(10.0, ZERO), ZERO);
    let mut at_point =
        placed(&operator("point_m = [1.0, 0.0, 0.0]\nreleased = [{ at_s = 0.1, until_s = 0.2 }]"));
    let mut at = |t: f64| at_point.force(t, STEP_S, &elsewhere, &ZERO);
    assert!((at(0.0) - (Vector3::x() - elsewhere)).norm() < 1e-12);
    assert_eq!(at(0.15), ZERO);
    assert!((at(5.5) - (Vector3::x() + after - elsewhere)).norm() < 1e-12);
    // The damper acts against the derivative of the motion.
    let damped = operator("").replace("damping_ns_per_m = 0.0", "damping_ns_per_m = 2.0");
    let (mut damped, mut elastic) = (placed(&damped), placed(&operator("")));
    for t in [1.3, 2.2, 4.4] {
        let [before, now, after] = [t - 1e-5, t, t + 1e-5].map(|t| elastic.force(t, STEP_S, &ZERO, &ZERO));
        let expected = now + (after - before) / 2e-5 * 2.0;
        assert!((damped.force(t, STEP_S, &ZERO, &ZERO) - expected).norm() < 1e-6, "at {t} s");
    }
}
