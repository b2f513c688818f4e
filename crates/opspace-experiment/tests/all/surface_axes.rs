//! Task axes that turn with a surface, on cylinders of other sizes, directions and friction than those of the task files.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use opspace_backend::CommandKind;
use opspace_experiment::{Experiment, Files, Progress, RunOptions};
use opspace_log::Recording;
use std::io::Cursor;
use std::path::Path;

/// Time after which axes and force have settled, s.
const SETTLED_S: f64 = 3.5;

/// Largest error of the true normal force, N rms.
const LARGEST_ERROR_N: f64 = 0.3;

/// Length of the path over which the axes follow the normal, m: the default of the task.
const LENGTH_M: f64 = 0.003;

/// Rms and largest error of the axis, in lags `LENGTH_M`/R of a cylinder of radius R: it lags by one, and by two at a reversal;
/// the encoders add as much, and single readings more.
const ERROR_IN_LAGS: [f64; 2] = [2.0, 6.0];

/// Target force, N.
const TARGET_N: f64 = 15.0;

/// Point below the hand at which every cylinder is touched, m.
const TOUCHED_M: [f64; 3] = [0.365, -0.039, -0.177];

/// The normal axis of the hand's task, and that of the cylinder at the hand, in rows of the log; the rms error of the true
/// normal force.
struct Polished {
    angles_rad: Vec<f64>,
    error_n: f64,
    turned_rad: f64,
}

fn polished(command: CommandKind, axis: [f64; 3], radius_m: f64, friction: f64) -> Polished {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/polish-cylinder.toml");
    let axis = Vector3::from(axis).normalize();
    let point = Vector3::from(TOUCHED_M) - Vector3::z() * radius_m;
    let settings = [
        format!("environment.pipe.cylinder.axis=[{}, {}, {}]", axis.x, axis.y, axis.z),
        format!("environment.pipe.cylinder.point_m=[{}, {}, {}]", point.x, point.y, point.z),
        format!("environment.pipe.cylinder.radius_m={radius_m:?}"),
        format!("environment.pipe.cylinder.friction.coefficient={friction:?}"),
    ];
    let options = RunOptions { backend: command, duration_s: Some(9.0), ..RunOptions::default() };
    let experiment = Experiment::load(Files::Disk, &path, None, options, &settings).unwrap();
    let result = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
    let recording = Recording::from_bytes(&result.sink.into_inner()).unwrap();
    let (tick, truth) = (recording.channel("tick").unwrap(), recording.channel("truth").unwrap());
    let (axes, position) = (tick.signal("hand.axes").unwrap(), tick.signal("hand.position").unwrap());
    let from_s = tick.time_s[0] + SETTLED_S;
    let mut angles_rad = Vec::new();
    let mut turned_rad: f64 = 0.0;
    for k in (0..tick.len()).filter(|&k| tick.time_s[k] >= from_s) {
        let [w, x, y, z] = *axes.row(k) else { panic!("a quaternion") };
        let found = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)) * Vector3::z();
        let from_axis = Vector3::from_column_slice(position.row(k)) - point;
        let normal = (from_axis - axis * axis.dot(&from_axis)).normalize();
        angles_rad.push(found.angle(&normal));
        turned_rad = turned_rad.max(normal.angle(&Vector3::z()));
    }
    let force = truth.signal("pipe.normal_force").unwrap();
    let errors: Vec<f64> = (0..truth.len())
        .filter(|&k| truth.time_s[k] >= from_s)
        .map(|k| (force.row(k)[0] - TARGET_N).powi(2))
        .collect();
    Polished { angles_rad, turned_rad, error_n: (errors.iter().sum::<f64>() / errors.len() as f64).sqrt() }
}

/// The axis lags by the angle `length_m`/R on a cylinder of radius R, and twice at a reversal; the encoders add as much.
#[test]
fn the_axis_of_the_force_follows_the_normal_of_a_cylinder() {
    for (command, axis, radius_m, friction) in [
        (CommandKind::Position, [1.0, 0.3, 0.0], 0.08, 0.4),
        (CommandKind::Torque, [0.2, 1.0, 0.1], 0.15, 0.1),
    ] {
        let Polished { angles_rad, turned_rad, error_n } = polished(command, axis, radius_m, friction);
        let largest = angles_rad.iter().copied().fold(0.0, f64::max);
        let rms = (angles_rad.iter().map(|x| x * x).sum::<f64>() / angles_rad.len() as f64).sqrt();
        assert!(turned_rad > 0.15, "the hand did not go round: {turned_rad}");
        assert!(rms < ERROR_IN_LAGS[0] * LENGTH_M / radius_m, "{rms}");
        assert!(largest < ERROR_IN_LAGS[1] * LENGTH_M / radius_m, "{largest}");
        assert!(error_n < LARGEST_ERROR_N, "{error_n}");
    }
}

/// On axes that do not turn, friction and the slope of the cylinder disturb the force: the test can fail.
#[test]
fn axes_that_do_not_turn_press_worse() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/polish-cylinder.toml");
    let rms_n = |axes: &str| {
        let settings = [format!("task.hand.cartesian.axes_frame={axes}")];
        let options =
            RunOptions { backend: CommandKind::Torque, duration_s: Some(9.0), ..RunOptions::default() };
        let experiment = Experiment::load(Files::Disk, &path, None, options, &settings).unwrap();
        let result = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
        let recording = Recording::from_bytes(&result.sink.into_inner()).unwrap();
        let truth = recording.channel("truth").unwrap();
        let force = truth.signal("pipe.normal_force").unwrap();
        let from_s = truth.time_s[0] + SETTLED_S;
        let rows: Vec<usize> = (0..truth.len()).filter(|&k| truth.time_s[k] >= from_s).collect();
        let squares: f64 = rows.iter().map(|&k| (force.row(k)[0] - TARGET_N).powi(2)).sum();
        (squares / rows.len() as f64).sqrt()
    };
    let (turning, fixed) = (rms_n("{ surface = {} }"), rms_n("world"));
    assert!(fixed > 3.0 * turning, "{fixed} N, {turning} N");
}
