//! Encoders of continuous joints that count within one turn.

use crate::common::{
    Commanded, PERIOD_S, Record, Scripted, URDF, at_rest, capabilities, config, drive_robot,
};
use opspace_backend::{CommandKind, Sample};
use opspace_control::Measurement;
use opspace_loop::{Fault, LoopConfig};
use opspace_model::{Data, Model};
use std::f64::consts::{PI, TAU};
use std::sync::atomic::AtomicBool;

const KIND: CommandKind = CommandKind::Position;

/// Rounding of positions of up to ten radians, and of the velocities and torques that follow from them.
const ROUNDING: f64 = 1e-9;

/// Returns the arm with joints of a kind: with or without limits.
fn arm(kind: &str) -> Model {
    Model::from_urdf(&URDF.replace("revolute", kind)).expect("the URDF").model
}

/// Position of both joints in a cycle, rad: they turn by 4 rad, one each way, after the rest.
fn turning(cycle: u64) -> [f64; 2] {
    let turned = 2.0 * PERIOD_S * cycle as f64;
    [turned, -turned]
}

/// Runs two seconds on a robot that reads `script`; its setpoints are the measured positions.
fn run_script(kind: &str, script: impl FnMut(u64, &mut Sample)) -> Record {
    let command =
        |_: &Data, measurement: &Measurement, q: &mut [f64]| q.copy_from_slice(measurement.q.as_slice());
    let of_loop = config(capabilities(KIND), Commanded { kind: KIND, command });
    let robot = Scripted::new(capabilities(KIND), script);
    let of_loop = LoopConfig { model: arm(kind), ..of_loop };
    drive_robot(of_loop, 2.0, &AtomicBool::new(false), robot)
}

/// Runs two seconds on a robot whose encoders read `encoder` of the true positions.
fn run_with(kind: &str, encoder: impl Fn(f64) -> f64) -> Record {
    run_script(kind, |cycle: u64, sample: &mut Sample| {
        at_rest(cycle, sample);
        sample.q.copy_from_slice(&turning(cycle).map(&encoder));
    })
}

fn largest_difference(first: &Record, second: &Record) -> f64 {
    assert_eq!(first.rows.len(), second.rows.len());
    let values = first.rows.iter().flatten().zip(second.rows.iter().flatten());
    values.filter(|(a, b)| !(a.is_nan() && b.is_nan())).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Compared: all values of the rows, and the setpoints, of robots whose encoders count from 0 to a turn or to half a turn on
/// either side, and of one whose encoders go on. The joints pass 0, half a turn and a turn in both directions.
#[test]
fn encoder_within_a_turn_gives_the_same_rows() {
    let goes_on = run_with("continuous", |q| q + 3.0);
    let q = goes_on.values(goes_on.rows.len() - 1, "q");
    assert!(q[0] > TAU && q[1] < 0.0, "{q:?}");
    for encoder in [|q: f64| (q + 3.0).rem_euclid(TAU), |q: f64| (q + 3.0 + PI).rem_euclid(TAU) - PI] {
        let within = run_with("continuous", encoder);
        let error = largest_difference(&goes_on, &within);
        assert!(error < ROUNDING, "{error}");
        assert_eq!(within.received.len(), goes_on.received.len());
    }
}

/// Compared: rows of a robot whose encoders count within a turn, and rows of a robot that reads the positions of these rows,
/// bit for bit: what a log has is enough for its replay.
#[test]
fn logged_positions_give_the_same_bits() {
    let within = run_with("continuous", |q| (q + 3.0).rem_euclid(TAU));
    let logged: Vec<Vec<f64>> = (0..within.rows.len()).map(|row| within.values(row, "q").to_vec()).collect();
    let replayed = run_script("continuous", |cycle: u64, sample: &mut Sample| {
        at_rest(cycle, sample);
        sample.q.copy_from_slice(&logged[cycle as usize]);
    });
    assert_eq!(within.row_bits(), replayed.row_bits());
}

/// Checks that the encoder of a joint with limits is not unwrapped: a step by a turn is a jump.
#[test]
fn joint_with_limits_is_not_unwrapped() {
    let record = run_with("revolute", |q| if q > 1.0 { q - TAU } else { q });
    assert!(matches!(record.fault(), Fault::PositionJump { joint: 0, .. }), "{:?}", record.fault());
}
