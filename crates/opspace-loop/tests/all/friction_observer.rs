//! Tests of the friction observer in the control loop, with a robot at rest whose motors deliver known torques.

use crate::common::{
    Received, START, Scripted, at_rest, capabilities, config, drive_robot, gravity_at, gravity_controller,
};
use nalgebra::DVector;
use opspace_backend::quantity::Positive;
use opspace_backend::{Capabilities, CommandKind, Measured, Sample};
use opspace_loop::{ControlLoop, LoopConfig, LoopError};
use opspace_transformer::FrictionObserver;
use std::sync::atomic::AtomicBool;

const LIMIT_NM: f64 = 3.0;

fn observed(robot: Capabilities) -> LoopConfig {
    let observer = FrictionObserver::new(2, Positive::literal(60.0), Positive::literal(LIMIT_NM));
    LoopConfig { friction_observer: Some(observer), ..config(robot, gravity_controller(0.0)) }
}

/// Torques that the observer has added after 0.4 s, Nm: the arm rests although the motors deliver `extra` (Nm) more than
/// the weight, and the force sensor measures the force `fz` (N).
fn added(extra: [f64; 2], fz: f64, lost: bool) -> DVector<f64> {
    let weight = gravity_at(&START);
    let script = move |cycle: u64, sample: &mut Sample| {
        // One of ten samples is lost.
        at_rest(if lost { cycle + cycle / 9 } else { cycle }, sample);
        if let Some(torque) = &mut sample.motor_torque {
            torque
                .iter_mut()
                .zip(&weight)
                .zip(extra)
                .for_each(|((torque, weight), extra)| *torque = weight + extra);
        }
        // The sensor is tared without the force.
        let begun = cycle > 12;
        sample.wrenches[0] = [0.0, 0.0, if begun { fz } else { 0.0 }, 0.0, 0.0, 0.0];
    };
    let robot = capabilities(CommandKind::Torque);
    let control = observed(robot.clone());
    let record = drive_robot(control, 0.4, &AtomicBool::new(false), Scripted::new(robot, script));
    let Some(Received::Torques(last)) = record.commands().last().cloned() else {
        panic!("{:?}", record.received)
    };
    let added = record.values(record.rows.len() - 1, "friction_observer");
    let error = &last - (gravity_at(&START) + DVector::from_column_slice(added));
    assert!(error.amax() < 1e-9, "the torque of the observer is in the command: {error}");
    DVector::from_column_slice(added)
}

/// Compared: the observer's torques, and the torques of the motors that do not move the arm, by hand; at most the limit,
/// and the same if samples are lost.
#[test]
fn torque_that_friction_takes_is_added() {
    for lost in [false, true] {
        let error = added([1.5, -0.7], 0.0, lost) - DVector::from_vec(vec![1.5, -0.7]);
        assert!(error.amax() < 1e-6, "{error}");
    }
    assert_eq!(added([8.0, -7.0], 0.0, false).as_slice(), [LIMIT_NM, -LIMIT_NM]);
}

/// Compared: the observer's torques while the force sensor measures a force, and zero: the motors balance it.
#[test]
fn measured_contact_is_not_opposed() {
    // A force of 6 N along the sensor's z axis at the elbow, 0.5 m from the shoulder; the upper arm is at 0.4 rad, the sensor
    // at -0.3 rad, so that its lever is 0.5 cos(0.7) m. A force upwards turns the shoulder in the direction of negative q.
    let moment = 6.0 * 0.5 * f64::cos(0.7);
    let balanced = added([moment, 0.0], 6.0, false);
    assert!(balanced.amax() < 1e-6, "{balanced}");
    let unbalanced = added([0.0, 0.0], 6.0, false);
    assert!((unbalanced[0] + moment).abs() < 1e-6, "{unbalanced}, moment {moment}");
}

#[test]
fn friction_observer_without_force_sensor_is_refused() {
    let blind = Capabilities::new(["shoulder", "elbow"], CommandKind::Torque, 1e-3)
        .measuring(&[Measured::MotorCurrent]);
    assert_eq!(ControlLoop::new(observed(blind)).err(), Some(LoopError::NoForceSensor));
}
