//! Tests of a velocity robot with servos τ = kv (q̇_d − q̇).

use crate::common::{
    Commanded, KV, LIMITS, PERIOD_S, REST, Received, Record, START, Scripted, VelocityServo, at_rest,
    capabilities, config, drive_robot, gravity_at, gravity_controller,
};
use nalgebra::DVector;
use opspace_backend::{Capabilities, CommandKind, Measured, Sample};
use opspace_control::Controller;
use opspace_loop::{LoopConfig, Phase, RunOutcome};
use std::sync::atomic::AtomicBool;

/// Rounding of a few operations on numbers of order 1.
const ROUNDING: f64 = 1e-12;
/// Rounding of weights over kv, rad/s.
const SETPOINT: f64 = 1e-9;

/// Velocity robot that measures velocities but no motor torques.
fn robot() -> Capabilities {
    let mut robot = capabilities(CommandKind::Velocity).measuring(&[Measured::Velocity]);
    robot.measures_motor_torque = false;
    robot
}

/// Runs a controller for 0.2 s at a measured velocity `dq` (rad/s), with setpoints for servos of `damping` (Nms/rad).
fn run_at_velocity(
    controller: impl Controller + 'static,
    dq: [f64; 2],
    damping: [f64; 2],
    missed: u64,
) -> Record {
    let script = move |cycle: u64, sample: &mut Sample| {
        at_rest(cycle, sample);
        sample.time_s = (cycle + if cycle >= 60 { missed } else { 0 }) as f64 * PERIOD_S;
        sample.dq.as_mut().expect("measured").copy_from_slice(&dq);
    };
    let transformer = Box::new(VelocityServo::new(damping));
    let config = LoopConfig { transformer, ..config(robot(), controller) };
    drive_robot(config, 0.2, &AtomicBool::new(false), Scripted::new(robot(), script))
}

fn velocities(received: &Received) -> &DVector<f64> {
    let Received::Velocities(dq) = received else { panic!("{received:?}") };
    dq
}

/// Compared: setpoints of a transformer with servo gains ten times too low, and the measured velocity plus or minus
/// torque limit over kv, by hand.
#[test]
fn setpoints_are_clamped_around_measured_velocity() {
    let dq = [0.3, -0.2];
    let controller = Commanded::torques(|_, _, tau| tau.copy_from_slice(&[1e6, -1e6]));
    let record = run_at_velocity(controller, dq, KV.map(|kv| kv / 10.0), 0);
    assert_eq!(record.outcome, RunOutcome::Completed);
    let expected = [dq[0] + LIMITS[0] / KV[0], dq[1] - LIMITS[1] / KV[1]];
    // The first 100 commands belong to the torque ramp.
    for received in &record.commands()[100..199] {
        let error = velocities(received) - DVector::from_row_slice(&expected);
        assert!(error.amax() < ROUNDING, "{error}");
    }
    let last = record.rows.len() - 1;
    assert_eq!(record.values(last, "setpoint_clamped"), [1.0, 1.0]);
    assert_eq!(record.values(last, "dq_desired"), velocities(&record.commands()[198]).as_slice());
}

/// Compared: setpoints within reach, and τ/kv + q̇, with τ the weight by hand plus the commanded torque.
#[test]
fn setpoints_within_reach_give_desired_torques() {
    const EXTRA: f64 = 4.0;
    let dq = [0.3, -0.2];
    let record = run_at_velocity(gravity_controller(EXTRA), dq, KV, 0);
    let torque = gravity_at(&START).add_scalar(EXTRA);
    let expected = DVector::from_fn(2, |i, _| torque[i] / KV[i] + dq[i]);
    for received in &record.commands()[100..199] {
        assert!((velocities(received) - &expected).amax() < SETPOINT, "{received:?}");
    }
    assert_eq!(record.values(record.rows.len() - 1, "setpoint_clamped"), [0.0, 0.0]);
}

/// Compared: the signal of the setpoints' rate of change and its unit, and differences of the setpoint signal over the
/// period, during the torque ramp.
#[test]
fn velocity_setpoint_rate_is_an_acceleration() {
    /// Rounding of velocities of order 1 rad/s, divided by the period.
    const ROUNDING_RAD_PER_S2: f64 = 1e-9;
    const ROW: usize = 80;
    let record = run_at_velocity(gravity_controller(4.0), [0.3, -0.2], KV, 0);
    let unit = |name: &str| {
        let signal = record.layout.signals.iter().find(|signal| signal.name == name);
        signal.map(|signal| signal.unit())
    };
    assert_eq!(unit("dq_desired").as_deref(), Some("rad/s"));
    assert_eq!(unit("setpoint_acceleration").as_deref(), Some("rad/s^2"));
    assert_eq!(unit("setpoint_speed"), None);
    let [before, now] = [ROW - 1, ROW].map(|row| record.values(row, "dq_desired"));
    let rate = record.values(ROW, "setpoint_acceleration");
    for joint in 0..2 {
        let expected = (now[joint] - before[joint]) / PERIOD_S;
        assert!((rate[joint] - expected).abs() < ROUNDING_RAD_PER_S2, "{rate:?} for {expected}");
        assert!(expected.abs() > 1e-3, "{expected}: setpoints move");
    }
}

/// Compared: the last command of a run, at rest and at a velocity within reach, and the weight by hand over kv: the
/// servo's damping brakes. The last setpoint of a faster joint is its velocity minus torque limit over kv.
#[test]
fn stop_brakes_and_holds_the_weight() {
    let weight = gravity_at(&START);
    for dq in [[0.0, 0.0], [0.2, -0.1], [1.5, -1.2]] {
        let record = run_at_velocity(gravity_controller(0.0), dq, KV, 0);
        let commands = record.commands();
        let expected = DVector::from_fn(2, |i, _| {
            let reach = LIMITS[i] / KV[i];
            (weight[i] / KV[i]).max(dq[i] - reach).min(dq[i] + reach)
        });
        assert_eq!(commands.len(), 200);
        assert!((velocities(&commands[199]) - expected).amax() < SETPOINT, "{dq:?}: {:?}", commands[199]);
    }
}

/// Compared: the commands after a dropout, and holds during the standstill test, with setpoints of zero in the rows;
/// then the commands that ramp in from the weight, as at the start.
#[test]
fn robot_is_held_after_dropout() {
    const BEFORE: usize = (60 - REST) as usize;
    const STILL: usize = 50;
    let record = run_at_velocity(gravity_controller(3.0), [0.0, 0.0], KV, 20);
    let commands = record.commands();
    assert!(commands[BEFORE..BEFORE + STILL].iter().all(|received| *received == Received::Hold));
    for row in 60..60 + STILL {
        assert_eq!(record.phases()[row], Phase::Held.code());
        assert_eq!(record.values(row, "dq_desired"), [0.0, 0.0]);
    }
    for k in 0..20 {
        let error = velocities(&commands[BEFORE + STILL + k]) - velocities(&commands[k]);
        assert!(error.amax() < SETPOINT, "{k}: {error}");
    }
}
