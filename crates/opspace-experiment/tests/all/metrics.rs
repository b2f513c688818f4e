//! Metrics of synthetic logs, against values computed by hand.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use nalgebra::Vector3;
use opspace_backend::{CommandKind, Layout, Signal};
use opspace_experiment::evaluate::metrics::{evaluate, metrics, timing};
use opspace_experiment::{ControllerKind, Experiment, Files, RunOptions};
use opspace_log::{Channel, Header, Pace, Recording, record};
use opspace_model::{Data, frame_placement, kinematics};
use std::io::Cursor;
use std::path::Path;

/// Relative rounding error of sums of several thousand numbers.
const ROUNDING: f64 = 1e-12;

const Q: [f64; 4] = [-0.45, -0.35, 0.25, -1.35];
const XYZ: [&str; 3] = ["x", "y", "z"];

fn experiment(task: &str) -> Experiment {
    let path = format!("tasks/{task}.toml");
    Experiment::load(Files::Embedded, Path::new(&path), None, RunOptions::default(), &[]).unwrap()
}

fn hand(experiment: &Experiment, q: &[f64]) -> Vector3<f64> {
    let model = &experiment.robot().model;
    let mut data = Data::new(model);
    kinematics(model, &mut data, q, &[0.0; 4]);
    frame_placement(model, &data, model.frame_id("hand").unwrap()).translation
}

/// Builds a log of 8 s at 1 kHz with 5 servo ticks per row; functions of the row index give the contents of the rows.
/// The second number of `tick` is the computing time, ns, of the channel `timing`.
fn log(
    experiment: &Experiment,
    tick: impl Fn(usize) -> Vec<f64>,
    truth: impl Fn(usize) -> Vec<f64>,
    servo: impl Fn(usize) -> Vec<f64>,
) -> Recording {
    log_at(experiment, [0.0; 4], tick, truth, servo)
}

/// Builds a log like [`log`], with joints that move at the velocities `dq` (rad/s).
fn log_at(
    experiment: &Experiment,
    dq: [f64; 4],
    tick: impl Fn(usize) -> Vec<f64>,
    truth: impl Fn(usize) -> Vec<f64>,
    servo: impl Fn(usize) -> Vec<f64>,
) -> Recording {
    let joints: Vec<&str> = experiment.robot().model.joints().iter().map(|j| j.name.as_str()).collect();
    let layout = |name: &str, signals| Layout { channel: name.to_owned(), signals };
    let channels = [
        layout("tick", vec![Signal::scalar("phase", "1"), Signal::new("hand.reference", "m", &XYZ)]),
        layout("timing", vec![Signal::scalar("tick_time", "ns")]),
        layout(
            "truth",
            vec![
                Signal::new("q", "rad", &joints),
                Signal::new("operator.force", "N", &XYZ),
                Signal::new("dq", "rad/s", &joints),
            ],
        ),
        layout(
            "servo",
            vec![Signal::new("torque_desired", "Nm", &joints), Signal::new("motor_torque", "Nm", &joints)],
        ),
    ]
    .map(|layout| Channel { layout, rate_hz: 1000.0 });
    let sink = Cursor::new(Vec::new());
    let (mut recorder, writer) = record(sink, Header::default(), channels.to_vec(), Pace::Simulated).unwrap();
    for k in 0..8000 {
        let t = k as f64 * 1e-3;
        let tick = tick(k);
        recorder.push(0, t, &[&tick[..1], &tick[2..]].concat());
        recorder.push(1, t, &tick[1..2]);
        recorder.push(2, t, &[truth(k), dq.to_vec()].concat());
        for s in 5 * k..5 * k + 5 {
            recorder.push(3, s as f64 * 2e-4, &servo(s));
        }
    }
    drop(recorder);
    let (_, sink) = writer.finish().unwrap();
    Recording::from_bytes(sink.get_ref()).unwrap()
}

/// True if two numbers are equal except for rounding errors.
fn near(a: Option<f64>, b: f64) -> bool {
    a.is_some_and(|a| (a - b).abs() <= ROUNDING * b.abs().max(1.0))
}

/// Compared: the error over y and z only (x is compliant) between true position and reference, and a square wave of
/// known height. Rows before the end of settling are ignored.
#[test]
fn position_error_counts_motion_axes_after_settling() {
    let experiment = experiment("compliant-x");
    let home = hand(&experiment, &Q);
    let tick = |k: usize| {
        // The reference is off by 7 mm in x, by 3 mm with alternating sign in y and by 4 mm in z, and by 1 m in y
        // during settling.
        let far = if k < 1500 { 1.0 } else { 0.0 };
        let sign = if k.is_multiple_of(2) { 1.0 } else { -1.0 };
        let reference = home + Vector3::new(0.007, 0.003 * sign + far, 0.004);
        vec![1.0, 100.0, reference.x, reference.y, reference.z]
    };
    let truth = |k: usize| [&Q[..], &[3.0, 100.0, if k.is_multiple_of(2) { 0.0 } else { 1.0 }]].concat();
    let recording = log(&experiment, tick, truth, |_| vec![1.0; 8]);
    // Each motion axis has an error of its own, and each axis a range of motion: the hand is at rest.
    let axes = evaluate(&experiment, &recording).tasks["hand"].axes.clone();
    for (name, expected) in [("y_rms_m", 0.003), ("y_max_m", 0.003), ("z_rms_m", 0.004), ("x_range_m", 0.0)] {
        assert!(near(axes.get(name).copied(), expected), "{name}: {axes:?}");
    }
    assert!(axes.keys().all(|name| name != "x_rms_m" && !name.starts_with('r')), "{axes:?}");
    let metrics = metrics(&experiment, &recording);
    assert!(near(metrics.pose.position_rms_m, 0.005), "{metrics:?}");
    assert!(near(metrics.pose.position_max_m, 0.005), "{metrics:?}");
    // The hand reports only x: its force there is 3 N, independent of y and z, and it does not move.
    assert!(near(metrics.hand_force_rms_n, 3.0), "{metrics:?}");
    assert!(near(metrics.hand_motion_rms_m, 0.0), "{metrics:?}");
    assert_eq!(
        (metrics.pose.orientation_rms_rad, metrics.joint_rms_rad, metrics.contact.force_rms_n),
        (None, None, None)
    );
}

/// Compared: the hand's motion, and the displacement from the start in x of two postures.
#[test]
fn hand_motion_is_displacement_from_start() {
    let experiment = experiment("compliant-x");
    let other = [-0.40, -0.35, 0.25, -1.30];
    let moved = (hand(&experiment, &other) - hand(&experiment, &Q)).x.abs();
    let q = |k: usize| if k < 1000 { Q } else { other };
    let recording = log(
        &experiment,
        |_| vec![1.0, 100.0, 0.0, 0.0, 0.0],
        |k| [&q(k)[..], &[0.0; 3]].concat(),
        |_| vec![1.0; 8],
    );
    assert!(near(metrics(&experiment, &recording).hand_motion_rms_m, moved));
}

/// Compared: ranges of motion, and the differences of two postures by the kinematics, along axes that are turned by a third of a turn
/// about the diagonal of the world's: they are the world's in another order. The posture before settling counts only without settling.
#[test]
fn range_of_motion_is_along_the_axes_of_the_task_after_settling() {
    let other = [-0.40, -0.35, 0.25, -1.30];
    for (settle_s, moves) in [("settle_s=0.5", true), ("settle_s=1.5", false)] {
        let settings = [
            settle_s,
            "task.hand.cartesian.axes_frame={ rpy_rad = [1.5707963267948966, 1.5707963267948966, 0.0] }",
        ]
        .map(str::to_owned);
        let path = Path::new("tasks/compliant-x.toml");
        let experiment =
            Experiment::load(Files::Embedded, path, None, RunOptions::default(), &settings).unwrap();
        let moved = hand(&experiment, &other) - hand(&experiment, &Q);
        let recording = log(
            &experiment,
            |_| vec![1.0, 100.0, 0.0, 0.0, 0.0],
            |k| [&if k < 1000 { Q } else { other }[..], &[0.0; 3]].concat(),
            |_| vec![1.0; 8],
        );
        let axes = evaluate(&experiment, &recording).tasks["hand"].axes.clone();
        for (name, world) in [("x_range_m", moved.z), ("y_range_m", moved.x), ("z_range_m", moved.y)] {
            let expected = if moves { world.abs() } else { 0.0 };
            assert!(near(axes.get(name).copied(), expected), "{name}: {axes:?}, {moved}");
        }
    }
}

/// Compared: displacement and work over two axes, one of which is compliant all the time and the other until 2 s and from
/// 4 s on, and those of four postures by the kinematics: each axis counts from where it became compliant, and its work
/// while it is.
#[test]
fn compliance_counts_from_where_the_axis_became_compliant() {
    const FORCE_N: [f64; 3] = [3.0, 2.0, 100.0];
    let events = "event=[{ time_s = 2.0, set = [\"task.hand.cartesian.axes.x=motion\"] }, \
                  { time_s = 4.0, set = [\"task.hand.cartesian.axes.x=compliant\"] }]";
    let settings = [events, "settle_s=0.0", "task.hand.cartesian.axes.y=compliant"].map(str::to_owned);
    let path = Path::new("tasks/compliant-x.toml");
    let experiment = Experiment::load(Files::Embedded, path, None, RunOptions::default(), &settings).unwrap();
    // The elbow moves within one row at 1 s, at the second event and at 6 s.
    let q = |k: usize| {
        let steps = [1000, 4000, 6000].into_iter().filter(|step| k >= *step).count();
        [Q[0], Q[1], Q[2], Q[3] + 0.1 * steps as f64]
    };
    let truth = |k: usize| [&q(k)[..], &FORCE_N].concat();
    let recording = log(&experiment, |_| vec![1.0, 100.0, 0.0, 0.0, 0.0], truth, |_| vec![1.0; 8]);
    let [a, b, c, d] = [0, 1000, 4000, 6000].map(|k| hand(&experiment, &q(k)));
    let squares = [
        (1.0, 0.0, 0.0),
        (1.0, b.x - a.x, b.y - a.y),
        (2.0, 0.0, b.y - a.y),
        (2.0, 0.0, c.y - a.y),
        (2.0, d.x - c.x, d.y - a.y),
    ]
    .map(|(seconds, x, y): (f64, f64, f64)| seconds * (x * x + y * y));
    let work = FORCE_N[0] * ((b.x - a.x) + (d.x - c.x)) + FORCE_N[1] * (d.y - a.y);
    let compliance = metrics(&experiment, &recording).compliance;
    assert!(
        near(compliance.compliant_motion_rms_m, (squares.iter().sum::<f64>() / 8.0).sqrt()),
        "{compliance:?}"
    );
    assert!(near(compliance.compliant_work_j, work), "{compliance:?} for {work} J");
}

/// Compared: work on a task relative to a link, and force times path in the axes of the link: forces are logged in those of
/// the world.
#[test]
fn work_relative_to_a_link_is_in_its_axes() {
    let settings = ["settle_s=0.0", "task.hand.cartesian.relative_to=\"shoulder_1\""].map(str::to_owned);
    let path = Path::new("tasks/compliant-x.toml");
    let experiment = Experiment::load(Files::Embedded, path, None, RunOptions::default(), &settings).unwrap();
    let force = Vector3::new(3.0, 2.0, 1.0);
    let q = |k: usize| if k < 1000 { Q } else { [Q[0], Q[1], Q[2], Q[3] + 0.1] };
    let truth = |k: usize| [&q(k)[..], force.as_slice()].concat();
    let recording = log(&experiment, |_| vec![1.0, 100.0, 0.0, 0.0, 0.0], truth, |_| vec![1.0; 8]);
    let model = &experiment.robot().model;
    let mut data = Data::new(model);
    kinematics(model, &mut data, &Q, &[0.0; 4]);
    let link = frame_placement(model, &data, model.frame_id("shoulder_1").unwrap()).rotation;
    let path_m = hand(&experiment, &q(1000)) - hand(&experiment, &Q);
    let work = link.tr_mul(&force).x * link.tr_mul(&path_m).x;
    let found = metrics(&experiment, &recording).compliance.compliant_work_j;
    assert!(near(found, work), "{found:?} for {work} J");
}

/// Compared: the three torque errors, and rms, mean and first value of a pattern that repeats in every interval,
/// relative to the desired torque over joints of different size.
#[test]
fn torque_errors_match_a_known_pattern() {
    let experiment = experiment("cartesian-tracking");
    let pattern = [0.1, 0.2, 0.3, -0.1, 0.5];
    let desired = [2.0, 1.0, 0.5, 0.0];
    let servo = |s: usize| {
        let motor = desired.map(|d| d + pattern[s % 5]);
        [desired, motor].concat()
    };
    let recording = log(&experiment, |_| vec![1.0; 5], |_| vec![0.0; 7], servo);
    let metrics = metrics(&experiment, &recording);
    let size = desired.iter().map(|d| d * d).sum::<f64>().sqrt();
    let rms = (pattern.iter().map(|p| p * p).sum::<f64>() / 5.0).sqrt();
    // All four joints have the same error.
    assert!(near(metrics.torque_error_servo, 2.0 * rms / size), "{metrics:?}");
    assert!(near(metrics.torque_error_interval, 2.0 * 0.2 / size), "{metrics:?}");
    assert!(near(metrics.torque_error_tick, 2.0 * 0.1 / size), "{metrics:?}");
}

/// Compared: the hold ripple in the presence of a constant error, and a sawtooth 1.2 times as high as that of
/// constant speeds without a current loop.
#[test]
fn hold_ripple_is_relative_to_predicted_ripple() {
    let hold_ripple = |options: RunOptions, settings: &[&str]| {
        let settings: Vec<String> = settings.iter().map(|&s| s.to_owned()).collect();
        let path = Path::new("tasks/cartesian-tracking.toml");
        let experiment = Experiment::load(Files::Embedded, path, None, options, &settings).unwrap();
        let speed = [0.5, -0.2, 0.1, 1.0];
        let stiffness = [94.6, 89.9, 30.4, 30.3].map(|kv| 50.265 * kv);
        let servo = |s: usize| {
            let sawtooth = |j: usize| -1.2 * stiffness[j] * speed[j] * 2e-4 * ((s % 5) as f64 - 2.0);
            let motor: [f64; 4] = std::array::from_fn(|j| 3.0 + sawtooth(j));
            [[2.0; 4], motor].concat()
        };
        let recording = log_at(&experiment, speed, |_| vec![1.0; 5], |_| vec![0.0; 7], servo);
        metrics(&experiment, &recording).hold_ripple
    };
    // At 1 kHz the current loop reduces the sawtooth by this factor (computed by a recursion in another language).
    let ripple = hold_ripple(RunOptions::default(), &[]).unwrap();
    assert!((ripple * 0.534_703_767_082 / 1.2 - 1.0).abs() < 1e-11, "{ripple}");
    // A servo that is stiffer than its nominal value causes more ripple, so that the same ripple is a smaller
    // multiple of it.
    let stiffer = hold_ripple(RunOptions::default(), &["robot.simulated.true_over_nominal.kp=1.5"]);
    assert!(near(stiffer, ripple / 1.5), "{stiffer:?}");
    let torque = RunOptions { backend: CommandKind::Torque, ..RunOptions::default() };
    let ik = RunOptions { controller: ControllerKind::Ik, ..RunOptions::default() };
    assert_eq!((hold_ripple(torque, &[]), hold_ripple(ik, &[])), (None, None));
    assert_eq!(hold_ripple(RunOptions::default(), &["robot.profile.a-med.servo_ticks_per_cycle=1"]), None);
}

/// A run without desired torque has no torque error instead of a meaningless number.
#[test]
fn missing_desired_torque_gives_no_torque_error() {
    let experiment = experiment("cartesian-tracking");
    let recording =
        log(&experiment, |_| vec![1.0; 5], |_| vec![0.0; 7], |_| [[f64::NAN; 4], [1.0; 4]].concat());
    let metrics = metrics(&experiment, &recording);
    assert_eq!(
        (metrics.torque_error_servo, metrics.torque_error_interval, metrics.torque_error_tick),
        (None, None, None)
    );
}

/// Compared: quantiles of computing times, and those of the numbers 1 to 8000; cycles before control are ignored.
#[test]
fn computing_times_count_controlled_cycles() {
    let experiment = experiment("cartesian-tracking");
    let tick = |k: usize| {
        let resting = k < 100;
        vec![if resting { 0.0 } else { 1.0 }, if resting { 1e9 } else { k as f64 }, 0.0, 0.0, 0.0]
    };
    let recording = log(&experiment, tick, |_| vec![0.0; 7], |_| vec![1.0; 8]);
    let timing = timing(&recording, Some(3.0));
    assert_eq!(timing.realtime_factor, Some(3.0));
    // Three digits.
    assert!((timing.tick_ns_max - 7999.0).abs() <= 8.0, "{timing:?}");
    assert!((timing.tick_ns_median - 4050.0).abs() <= 5.0, "{timing:?}");
    assert!((timing.tick_ns_p99 - 7920.0).abs() <= 8.0, "{timing:?}");
}
