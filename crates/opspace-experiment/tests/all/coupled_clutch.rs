//! Clutch and scales of a teleoperation.

use crate::coupled_common::{largest_step, mean, run, teleoperation};
use opspace_backend::signal_names::{DISPLACEMENT, PORT_FORCE, REFERENCE};

/// Index of z.
const Z: usize = 2;
/// Time over which a follower fades in, s.
const FADE_S: f64 = 0.1;
/// Friction of the arm over the spring of the coupling, m: 4 N / (3 kN/m), rounded up.
const FRICTION_M: f64 = 2e-3;

/// Compared: the follower's motion and force, and those of the leader times their scales. While the clutch is open, the
/// reference stays; afterwards it continues from there, and fades in.
#[test]
fn clutch_and_scales_are_obeyed() {
    // The operator's 60 mm are 30 mm of the follower, and some of them are lost while the clutch is open: a table 3 mm below.
    let table = "follower.environment.table.point_m=[0.36, 0.0, -0.160]";
    let (open_s, closed_s) = (0.5, 0.7);
    let run = run(&teleoperation(&[
        table,
        "duration_s=3.0",
        "couplings.hands.teleoperation.scale={ position = 0.5, force = 2.0 }",
        "couplings.hands.teleoperation.clutch_open_s=[[0.5, 0.7]]",
    ]));
    assert!(!run.summary.has_failed(), "{:?}", run.summary.failures());
    let at = |robot: &str, signal: &str, time_s: f64| {
        run.hand(robot, signal, time_s - 5e-4, time_s + 5e-4)[0].1[Z]
    };
    // Open: the leader moves on by more than a centimetre, the follower stays within its friction.
    let moved = at("leader", DISPLACEMENT, closed_s) - at("leader", DISPLACEMENT, open_s);
    assert!(moved < -0.01, "{moved} m");
    let open = run.hand("follower", REFERENCE, open_s + 2e-3, closed_s);
    assert_eq!(largest_step(&open), 0.0, "the reference stays");
    let stays = at("follower", DISPLACEMENT, closed_s) - at("follower", DISPLACEMENT, open_s + 0.1);
    assert!(stays.abs() < FRICTION_M, "{stays} m");
    // Closed: no step beyond the speed of the operator, 1.875 · 60 mm / 0.7 s · 0.5, doubled.
    let step = largest_step(&run.hand("follower", REFERENCE, closed_s - 5e-3, 3.0));
    assert!(step < 2.0 * 0.5 * 1.875 * 0.06 / 0.7 * 1e-3, "{step} m in a cycle");
    // While the follower fades in, it takes a share of the leader's steps that grows to 1.
    let steps = run.hand("leader", DISPLACEMENT, closed_s, closed_s + FADE_S);
    let shares =
        steps.windows(2).map(|pair| (1.0 - (pair[1].0 - closed_s) / FADE_S, pair[1].1[Z] - pair[0].1[Z]));
    let slip: f64 = shares.map(|(left, step)| left * step).sum();
    assert!(slip < -1e-3, "{slip} m");
    // Steady state: positions without what was moved with the open clutch, except the part of a cycle at each of its ends.
    let expected = 0.5 * (at("leader", DISPLACEMENT, 2.9) - moved - slip);
    let reference = at("follower", REFERENCE, 2.9);
    assert!((reference - expected).abs() < 3e-4, "{reference} m for {expected} m");
    let follows = at("follower", DISPLACEMENT, 2.9) - reference;
    let force = mean(&run.hand("follower", PORT_FORCE, 2.5, 3.0), Z);
    assert!(force > 2.0, "the follower presses on the table: {force} N");
    // The spring of the coupling is pressed by the force of the table.
    let pressed = force / 3000.0;
    assert!((follows - pressed).abs() < FRICTION_M, "{follows} m for {pressed} m");
    // Forces: both are sampled means of half a second; tremor and delay damping have no mean.
    let felt = mean(&run.hand("leader", PORT_FORCE, 2.5, 3.0), Z);
    assert!((felt / (2.0 * force) - 1.0).abs() < 0.05, "{felt} N for {force} N");
}

/// Distance of a follower of waves from where its leader was before the delay, m: the waves carry velocities and forces, and the
/// friction of the arm has a force. With the waves from before the clutch opened it was 8 mm.
const WAVES_M: f64 = 5e-3;

/// Compared: the follower's reference after the clutch has closed, and the leader's displacement before the delay without that
/// with the open clutch, which is more than twice the tolerance.
#[test]
fn waves_of_the_open_clutch_are_not_made_up_for() {
    let run = run(&teleoperation(&[
        "follower.environment.table.point_m=[0.36, 0.0, -5.0]",
        "duration_s=3.0",
        "channels.net={ delay_s = 0.02 }",
        "couplings.hands.channel=\"net\"",
        "couplings.hands.teleoperation={ reflect = { waves = { impedance_ns_per_m = 100.0 } }, damping_ns_per_m = 20.0, \
         clutch_open_s = [[0.5, 0.7]] }",
    ]));
    assert!(!run.summary.has_failed(), "{:?}", run.summary.failures());
    let at = |robot: &str, signal: &str, time_s: f64| {
        run.hand(robot, signal, time_s - 5e-4, time_s + 5e-4)[0].1[Z]
    };
    let moved = at("leader", DISPLACEMENT, 0.7) - at("leader", DISPLACEMENT, 0.5);
    assert!(moved < -2.0 * WAVES_M, "{moved} m");
    for k in 0..22 {
        let time_s = 0.8 + 0.1 * f64::from(k);
        let expected = at("leader", DISPLACEMENT, time_s - 0.02) - moved;
        let reference = at("follower", REFERENCE, time_s);
        assert!((reference - expected).abs() < WAVES_M, "{time_s} s: {reference} m for {expected} m");
    }
}
