//! Tests of the torques that a robot receives: ramp and limits.

use crate::common::{
    KINDS, LIMITS, PERIOD_S, Received, START, at_rest, gravity_at, gravity_controller, run, servo_torque,
};
use opspace_backend::CommandKind;
use opspace_loop::RunOutcome;

/// Tolerance far below the holding torques: a setpoint error of 1e-9 rad times the stiffest servo, Nm.
const TORQUE: f64 = 1e-6;

/// Compared: the torques of the first 0.15 s, and the weight by hand plus a ramp of 0.1 s.
#[test]
fn torques_ramp_in_from_gravity_compensation() {
    const EXTRA: f64 = 6.0;
    let weight = gravity_at(&START);
    for kind in KINDS {
        let record = run(kind, gravity_controller(EXTRA), 0.2, at_rest);
        assert_eq!(record.outcome, RunOutcome::Completed);
        for (k, received) in record.commands().iter().take(150).enumerate() {
            let share = (k as f64 * PERIOD_S / 0.1).min(1.0);
            let error = servo_torque(received) - weight.add_scalar(share * EXTRA);
            assert!(error.amax() < TORQUE, "{kind:?}, cycle {k}: {error}");
        }
    }
}

/// Compared: the last torques when much larger torques are commanded, and the limits.
#[test]
fn commanded_torques_are_clamped() {
    let record = run(CommandKind::Torque, gravity_controller(500.0), 0.2, at_rest);
    let Some(Received::Torques(last)) = record.commands().last() else { panic!("{:?}", record.received) };
    assert_eq!(last.as_slice(), LIMITS);
    assert_eq!(record.values(record.rows.len() - 1, "torque_saturated"), [1.0, 1.0]);
}
