//! Clutch and scales of a teleoperation.

use crate::coupled_common::{largest_step, mean, run, teleoperation};
use opspace_backend::signal_names::{DISPLACEMENT, PORT_FORCE, REFERENCE};

/// Index of z.
const Z: usize = 2;
/// Friction of the arm over the spring of the coupling, m: 4 N / (3 kN/m), rounded up.
const FRICTION_M: f64 = 2e-3;

/// Compared: the follower's motion and force, and those of the leader times their scales. While the clutch is open, the
/// reference stays; afterwards it continues from there.
#[test]
fn clutch_and_scales_are_obeyed() {
    // The operator's 60 mm are 30 mm of the follower, and some of them are lost while the clutch is open: a table 5 mm below.
    let table = "follower.environment.table.point_m=[0.36, 0.0, -0.162]";
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
    // Steady state: positions without what was moved with the open clutch, except the part of a cycle at each of its ends.
    let expected = 0.5 * (at("leader", DISPLACEMENT, 2.9) - moved);
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
