//! Tests of the controller's measurement: tared force sensors and joint velocities.

use crate::common::{
    Commanded, KINDS, PERIOD_S, REST, START, Scripted, at_rest, capabilities, config, drive_robot,
    gravity_controller, model, run, servos,
};
use nalgebra::Vector3;
use opspace_backend::{CommandKind, Measured, Sample};
use opspace_loop::LoopConfig;
use opspace_model::{Data, frame_placement, update};
use opspace_transformer::{PaperTransformer, Transformer};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

/// Rounding of a few operations on numbers of order 1.
const ROUNDING: f64 = 1e-12;

/// Compared: the wrench in the row under a pull after a constant reading, which is tared, and the pull rotated by the
/// link's placement, computed independently.
#[test]
fn force_sensors_are_tared_and_rotated_into_world_axes() {
    let bias = Vector3::new(2.0, -1.0, 0.5);
    let pull = Vector3::new(0.0, 0.0, 4.0);
    let script = |cycle: u64, sample: &mut Sample| {
        at_rest(cycle, sample);
        // Noise with zero mean over the cycles at rest.
        let noise = if cycle.is_multiple_of(2) { 0.1 } else { -0.1 };
        let extra = if cycle < REST { Vector3::repeat(noise) } else { pull };
        sample.wrenches[0][..3].copy_from_slice((bias + extra).as_slice());
        sample.wrenches[0][3..].copy_from_slice((0.1 * bias).as_slice());
    };
    let record = run(CommandKind::Torque, gravity_controller(0.0), 0.01, script);
    let model = model();
    let mut data = Data::new(&model);
    assert!(update(&model, &mut data, &START, &[0.0; 2]));
    let axes = frame_placement(&model, &data, model.frame_id("fore").expect("a link")).rotation;
    let wrench = record.values(REST as usize, "wrist.wrench");
    let (force, moment) =
        (Vector3::from_column_slice(&wrench[..3]), Vector3::from_column_slice(&wrench[3..]));
    assert!((force - axes * pull).norm() < ROUNDING, "{force}");
    assert!(moment.norm() < ROUNDING);
    assert!((axes * pull - pull).norm() > 0.1, "the link's axes are not the world's");
    let raw = record.values(REST as usize, "wrist.raw");
    assert_eq!(raw[..3], *(bias + pull).as_slice());
}

/// Velocities that a robot at rest reports as measured, rad/s; they differ from the differences of positions.
const MEASURED: [f64; 2] = [0.3, -0.2];

fn claims_to_move(cycle: u64, sample: &mut Sample) {
    at_rest(cycle, sample);
    sample.dq.as_mut().expect("measured").copy_from_slice(&MEASURED);
}

/// Runs a torque controller on a robot that measures velocities, and checks that the controller receives `expected`
/// (rad/s) in each cycle.
fn check_velocity(kind: CommandKind, transformer: Option<Box<dyn Transformer>>, expected: [f64; 2]) {
    let seen = Arc::new(Mutex::new(Vec::new()));
    let log = Arc::clone(&seen);
    let controller = Commanded::torques(move |data, measurement, tau| {
        tau.copy_from_slice(data.gravity.as_slice());
        let dq = &measurement.dq;
        log.lock().expect("one thread").push(([dq[0], dq[1]], [data.dq[0], data.dq[1]]));
    });
    let capabilities = capabilities(kind).measuring(&[Measured::Velocity]);
    let default = config(capabilities.clone(), controller);
    let config = LoopConfig { transformer: transformer.unwrap_or(default.transformer), ..default };
    let robot = Scripted::new(capabilities, claims_to_move);
    let record = drive_robot(config, 0.05, &AtomicBool::new(false), robot);
    let seen = seen.lock().expect("one thread");
    assert_eq!(seen.len(), 50);
    assert!(seen.iter().all(|pair| *pair == (expected, expected)), "{kind:?}: {:?}", seen[0]);
    for row in 0..record.rows.len() {
        assert_eq!(record.values(row, "dq_measured"), MEASURED);
        assert_eq!(record.values(row, "dq"), expected);
    }
}

/// Compared: the controller's velocity, and the measured one, which differs from the difference of positions.
#[test]
fn measured_velocity_replaces_filtered_difference() {
    for kind in KINDS {
        check_velocity(kind, None, MEASURED);
    }
}

/// Transformer of the paper with a given velocity estimate.
struct Knowing {
    dq: [f64; 2],
    paper: PaperTransformer,
}

impl Transformer for Knowing {
    fn observe(&mut self, _sample: &Sample) -> Option<&[f64]> {
        Some(&self.dq)
    }

    fn transform(&mut self, data: &Data, tau: &[f64], q_desired: &mut [f64]) {
        self.paper.transform(data, tau, q_desired);
    }
}

/// Compared: the controller's velocity, and the transformer's, which differs from the measured one.
#[test]
fn transformer_velocity_replaces_measured_velocity() {
    let known = [0.05, 0.06];
    let transformer = Knowing { dq: known, paper: PaperTransformer::new(servos()) };
    check_velocity(CommandKind::Position, Some(Box::new(transformer)), known);
}

/// Compared: the velocity in the rows of a held robot, and the measured one: the transformer does not estimate the
/// motion of a robot that it does not command.
#[test]
fn held_robot_uses_measured_velocity() {
    let transformer = Knowing { dq: [0.05, 0.06], paper: PaperTransformer::new(servos()) };
    let capabilities = capabilities(CommandKind::Position).measuring(&[Measured::Velocity]);
    let config = LoopConfig {
        transformer: Box::new(transformer),
        ..config(capabilities.clone(), gravity_controller(0.0))
    };
    let robot = Scripted::new(capabilities, |cycle, sample| {
        claims_to_move(cycle, sample);
        sample.time_s += if cycle >= 30 { 10.0 * PERIOD_S } else { 0.0 };
    });
    let record = drive_robot(config, 0.1, &AtomicBool::new(false), robot);
    assert_eq!(record.values(29, "dq"), [0.05, 0.06]);
    // The first cycle after the dropout is observed before the robot is held.
    assert!((31..80).all(|row| record.values(row, "dq") == MEASURED));
    assert_eq!(record.values(81, "dq"), [0.05, 0.06], "it is commanded again");
}
