//! Metrics of single tasks and joints, failures that no metric shows, and expectations.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_backend::{CommandKind, Layout, Signal};
use opspace_control::{AXIS_NAMES, AxisMode};
use opspace_experiment::evaluate::metrics::evaluate;
use opspace_experiment::evaluate::notes::final_notes;
use opspace_experiment::{Code, Experiment, Files, Progress, RunOptions, Summary};
use opspace_log::{ChannelData, OutcomeRecord, Recording};
use opspace_loop::Phase;
use opspace_model::{Data, frame_placement, kinematics};
use std::f64::consts::TAU;
use std::io::Cursor;
use std::path::Path;

/// Relative difference of two sums of some thousand numbers.
const ROUNDING: f64 = 1e-9;

/// Relative error of the rms of a line of a spectrum: its side lobes within the window.
const LEAKAGE: f64 = 1e-3;

/// Chatter of a constant torque, Nm: rounding in its spectrum.
const SILENCE_NM: f64 = 1e-6;

/// Relative difference of a motion by measured positions and by true ones.
const MEASURED: f64 = 1e-2;

/// Error of each joint of a log, rad.
const OFFSET_RAD: f64 = 0.02;

pub fn experiment(task: &str, settings: &[&str]) -> Experiment {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../tasks/{task}.toml"));
    let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
    Experiment::load(Files::Disk, &path, None, RunOptions::default(), &settings).unwrap()
}

fn run(experiment: &Experiment) -> (Recording, Summary) {
    let result = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
    let recording = Recording::from_bytes(&result.sink.into_inner()).unwrap();
    let summary = experiment.summary(&recording, &result.record, None);
    (recording, summary)
}

/// An event on contact takes place when contact has lasted, at the latest at its time, and after the event before it.
#[test]
fn event_waits_for_contact_and_not_beyond_its_time() {
    let changes = |settings: &[&str]| {
        let (recording, _) = run(&experiment("draw-letter", settings));
        let tick = recording.channel("tick").unwrap();
        let set = tick.signal("task_set").unwrap();
        let contact = tick.signal("draw.contact").unwrap();
        let start = (0..tick.len()).find(|&k| set.row(k)[0].is_finite()).unwrap();
        let times: Vec<f64> = (start + 1..tick.len())
            .filter(|&k| set.row(k)[0] != set.row(k - 1)[0])
            .map(|k| tick.time_s[k])
            .collect();
        let made = (start..tick.len()).find(|&k| contact.row(k)[2] == 1.0).map(|k| tick.time_s[k]);
        (times, made)
    };
    let (times, made) = changes(&["duration_s=4.0"]);
    let made = made.unwrap();
    let within = 6e-3;
    assert!((times[0] - 1.2).abs() < within, "{times:?}");
    assert!((times[1] - (made + 0.3)).abs() < within && times[1] < 2.4, "{times:?} after {made}");
    // The paper is out of reach before the time of the event.
    let (times, made) = changes(&["duration_s=4.0", "environment.paper.wall.point_m=[0.36, 0.0, -0.3]"]);
    assert!(made.is_none_or(|made| made > 2.5));
    assert!((times[1] - 2.5).abs() < within, "{times:?}");
}

/// The pen is lifted and put down again: without the time in which the force settles, the approach counts.
#[test]
fn force_settles_anew_when_a_task_begins_again() {
    let error_n = |settle_s: &str| {
        let settings = [settle_s, "duration_s=9.5"];
        run(&experiment("draw-letter", &settings)).1.metrics.contact.force_rms_n.unwrap()
    };
    let (settled, unsettled) = (error_n("settle_s=1.0"), error_n("settle_s=0.01"));
    assert!(settled < 0.1 && unsettled > 0.5, "{settled} {unsettled}");
}

/// Compared: the metrics of a force task, and the force of its wall in the log, computed here.
#[test]
fn force_task_is_judged_by_the_true_contact_force() {
    let experiment = experiment("press-wall", &[]);
    let (recording, summary) = run(&experiment);
    let truth = recording.channel("truth").unwrap();
    let force = truth.signal("board.force").unwrap();
    let forces: Vec<(f64, f64)> = (0..truth.len()).map(|k| (truth.time_s[k], force.row(k)[0])).collect();
    let tick = recording.channel("tick").unwrap();
    let phase = tick.signal("phase").unwrap();
    let first = (0..tick.len()).find(|&k| phase.row(k)[0] != Phase::Rest.code()).unwrap();
    let start_s = tick.time_s[first];
    let settled =
        || forces.iter().filter(|(time_s, _)| *time_s >= start_s + 2.0 - 1e-4).map(|(_, force)| force);
    let rms = (settled().map(|force| (force + 10.0).powi(2)).sum::<f64>() / settled().count() as f64).sqrt();
    let metrics = &summary.metrics;
    assert!((metrics.contact.force_rms_n.unwrap() / rms - 1.0).abs() < ROUNDING, "{rms} in {metrics:?}");
    let (begin_s, _) = *forces.iter().find(|(_, force)| force.abs() > 0.1).unwrap();
    assert!(
        (metrics.contact.contact_begin_s.unwrap() - (begin_s - start_s)).abs() < ROUNDING,
        "{begin_s}: {metrics:?}"
    );
    let peak = forces.iter().filter(|(time_s, _)| (begin_s..=begin_s + 1.0).contains(time_s));
    let peak = peak.map(|(_, force)| force.abs()).fold(0.0, f64::max);
    assert!((metrics.contact.contact_peak_n.unwrap() / peak - 1.0).abs() < ROUNDING, "{peak}: {metrics:?}");
    assert!(metrics.contact.in_contact_fraction.unwrap() > 0.9, "{metrics:?}");
    let end_s = forces.last().unwrap().0;
    let last = || forces.iter().filter(|(time_s, _)| *time_s >= end_s - 0.5).map(|(_, force)| force);
    let final_n = (last().map(|force| (force + 10.0).powi(2)).sum::<f64>() / last().count() as f64).sqrt();
    assert!(
        (metrics.contact.force_final_n.unwrap() / final_n - 1.0).abs() < ROUNDING,
        "{final_n}: {metrics:?}"
    );
    assert_eq!(summary.tasks["hand"].contact.force_rms_n, metrics.contact.force_rms_n);
    assert_eq!(summary.findings.failures().count(), 0, "{:?}", summary.findings);
}

/// Compared: losses of contact by the sensor with the `contact` signal of the log, in a run in which a push lifts the hand off.
#[test]
fn losses_of_contact_are_those_of_the_sensor_too() {
    let lift = "environment.lift={ pushes = { frame = \"hand\", push = [\
                { at_s = 2.0, duration_s = 0.3, force_n = [0.0, 0.0, 40.0] }, { at_s = 3.0, duration_s = 0.3, force_n = [0.0, 0.0, 40.0] }] } }";
    let (recording, summary) = run(&experiment("cookbook/press", &[lift, "duration_s=4.0", "event=[]"]));
    let tick = recording.channel("tick").unwrap();
    let contact = tick.signal("hand.contact").unwrap();
    let lost = (1..tick.len()).filter(|&k| contact.row(k - 1)[2] == 1.0 && contact.row(k)[2] == 0.0).count();
    let found = &summary.tasks["hand"].contact;
    assert_eq!((lost, found.sensed_contact_losses, found.contact_losses), (2, Some(2), Some(2)));
}

/// A sensor that is tared while the hand touches a wall has this force as its zero: a note says so.
#[test]
fn sensor_tared_in_contact_is_noted() {
    let (_, summary) = run(&experiment(
        "press-wall",
        &["environment.board.wall.point_m=[0.36, 0.0, 0.0]", "duration_s=4.0"],
    ));
    let note = final_notes(&summary).pop().unwrap();
    assert!(note.starts_with("task 'hand': the true force is 1") && note.contains("tared"), "{note}");
    let (_, summary) = run(&experiment("press-wall", &["duration_s=4.0"]));
    assert!(final_notes(&summary).is_empty());
}

/// Checks a wall that the robot does not reach, and a force task without any object to touch: no error against a target
/// is not a success.
#[test]
fn force_task_without_contact_is_a_failure() {
    for setting in ["environment.board.wall.point_m=[0.9, 0.0, 0.0]", "environment={}"] {
        let (_, summary) = run(&experiment("press-wall", &[setting, "duration_s=3.0"]));
        assert_eq!(summary.metrics.contact.in_contact_fraction, Some(0.0), "{setting}");
        assert_eq!(
            (summary.metrics.contact.contact_begin_s, summary.metrics.contact.contact_peak_n),
            (None, None)
        );
        let never = summary.findings.of(Code::NeverTouched);
        let never = never.into_iter().any(|failure| failure.message.contains("'hand' never touched"));
        assert!(never, "{setting}: {:?}", summary.findings);
    }
}

/// A force task without contact is a failure too if none of its time is in the statistics; one with a target of zero is none.
#[test]
fn force_task_without_contact_is_a_failure_without_statistics() {
    let far = "environment.board.wall.point_m=[0.9, 0.0, 0.0]";
    let rest = "priority=[\"rest\"]";
    let late =
        |time_s: f64| format!("event=[{{ time_s = {time_s:?}, set = ['priority=[\"hand\", \"rest\"]'] }}]");
    let (begins, too_late) = (late(2.5), late(3.5));
    for (settings, fails) in [
        (&[far, "duration_s=4.0", "settle_s=3.0", rest, &begins][..], true),
        (&[far, "duration_s=4.0", "settle_s=3.0", rest, &too_late], false),
        (&[far, "duration_s=3.0", "task.hand.cartesian.force.target_n.x=0.0"], false),
    ] {
        let (_, summary) = run(&experiment("press-wall", settings));
        assert_eq!(
            summary.findings.of(Code::NeverTouched).next().is_some(),
            fails,
            "{settings:?}: {:?}",
            summary.findings
        );
    }
}

/// Compared: displacement and work over the compliant axis, and those of an operator whose force is in the log.
#[test]
fn compliant_task_has_displacement_and_work() {
    let experiment = experiment("compliant-x", &[]);
    let (_, summary) = run(&experiment);
    let hand = &summary.tasks["hand"];
    // The operator reports x, the compliant axis: both are displacements of the hand along it.
    let (ours, operator) =
        (hand.compliance.compliant_motion_rms_m.unwrap(), summary.metrics.hand_motion_rms_m.unwrap());
    assert!((ours / operator - 1.0).abs() < ROUNDING, "{ours} and {operator}");
    // At most force times path, and the damping of the axis takes energy from the operator.
    let work = hand.compliance.compliant_work_j.unwrap();
    assert!(work > 0.0 && work < 10.0, "{work} J");
}

/// Compared: the compliant motion of a streamed task, and the displacement since its mode became compliant, by the
/// kinematics; cycles in which the robot missed the controller do not begin it anew.
#[test]
fn streamed_mode_begins_the_displacement() {
    let reference = "task.hand.cartesian.reference={ streamed = { timeout_s = 0.1 } }";
    let experiment = experiment("cartesian-tracking", &["settle_s=0.5", reference]);
    let model = &experiment.robot().model;
    let joints: Vec<&str> = model.joints().iter().map(|joint| joint.name.as_str()).collect();
    // The elbow moves by 0.1 rad at 0.5 s, 2 s and 3 s; x is compliant from 1 s on.
    let q = |t: f64| {
        let steps = [0.5, 2.0, 3.0].into_iter().filter(|step_s| t >= *step_s).count();
        [-0.45, -0.35, 0.25, -1.35 + 0.1 * steps as f64]
    };
    let times = || (0..4000).map(|k| f64::from(k) * 1e-3);
    let channel = |name: &str, signals, rows: Vec<(f64, Vec<f64>)>| ChannelData {
        layout: Layout { channel: name.to_owned(), signals },
        time_s: rows.iter().map(|(t, _)| *t).collect(),
        rows: rows.into_iter().flat_map(|(_, row)| row).collect(),
    };
    let tick = times().filter(|t| !(2.5..2.6).contains(t)).map(|t| {
        let x = if t >= 1.0 { AxisMode::Compliant } else { AxisMode::Motion };
        (t, vec![1.0, x.code(), 0.0, 0.0, 3.0, 3.0, 3.0])
    });
    let modes = Signal::new("hand.modes", "1", &AXIS_NAMES);
    let recording = Recording {
        channels: vec![
            channel("tick", vec![Signal::scalar("phase", "1"), modes], tick.collect()),
            channel(
                "truth",
                vec![Signal::new("q", "rad", &joints)],
                times().map(|t| (t, q(t).to_vec())).collect(),
            ),
        ],
        ..Recording::default()
    };
    let x = |t: f64| {
        let mut data = Data::new(model);
        kinematics(model, &mut data, &q(t), &[0.0; 4]);
        frame_placement(model, &data, model.frame_id("hand").unwrap()).translation.x
    };
    let squares = [1.0, 2.0, 3.0].map(|t| (x(t) - x(1.0)).powi(2));
    let expected = (squares.iter().sum::<f64>() / 3.0).sqrt();
    let found = evaluate(&experiment, &recording).metrics.compliance.compliant_motion_rms_m.unwrap();
    assert!((found / expected - 1.0).abs() < ROUNDING, "{found} m for {expected} m");
}

/// A log of a joint task with one row per ms, by functions of time.
fn joint_log(
    experiment: &Experiment,
    q: impl Fn(f64) -> f64,
    reference: impl Fn(f64) -> f64,
    desired: impl Fn(usize, f64) -> f64,
) -> Recording {
    let joints: Vec<&str> =
        experiment.robot().model.joints().iter().map(|joint| joint.name.as_str()).collect();
    let n = joints.len();
    let time_s: Vec<f64> = (0..8000).map(|k| f64::from(k) * 1e-3).collect();
    let row = |t: f64| {
        let all = |value: f64| vec![value; n];
        let torques: Vec<f64> = (0..n).map(|j| desired(j, t)).collect();
        [vec![1.0], all(q(t)), all(reference(t)), torques].concat()
    };
    let signals = vec![
        Signal::scalar("phase", "1"),
        Signal::new("q", "rad", &joints),
        Signal::new("joints.reference", "rad", &joints),
        Signal::new("torque_desired", "Nm", &joints),
    ];
    let rows = time_s.iter().flat_map(|&t| row(t)).collect();
    let tick = ChannelData { layout: Layout { channel: "tick".to_owned(), signals }, time_s, rows };
    Recording { channels: vec![tick], ..Recording::default() }
}

/// Compared: the error of each joint, and the offset with which the log was made; and the torque of one joint with a line
/// at 15 Hz.
#[test]
fn joints_have_errors_and_chatter_of_their_own() {
    let experiment = experiment("joint-tracking", &[]);
    let wave = |t: f64| (0.5 * TAU * t).sin();
    let chatter = |j: usize, t: f64| if j == 1 { 3.0 + 0.8 * (15.0 * TAU * t).sin() } else { 3.0 };
    let recording = joint_log(&experiment, |t| wave(t) + OFFSET_RAD, wave, chatter);
    let found = evaluate(&experiment, &recording);
    let errors = &found.tasks["joints"].elements;
    assert_eq!(errors.len(), 4);
    for error in errors {
        assert!(
            (error.rms - OFFSET_RAD).abs() < ROUNDING && (error.max - OFFSET_RAD).abs() < ROUNDING,
            "{error:?}"
        );
    }
    assert!((found.metrics.joint_rms_rad.unwrap() - OFFSET_RAD).abs() < ROUNDING);
    let names: Vec<&str> =
        experiment.robot().model.joints().iter().map(|joint| joint.name.as_str()).collect();
    let noisy = &found.joints[names[1]];
    assert!((noisy.torque_chatter_rms_nm.unwrap() / (0.8 / 2f64.sqrt()) - 1.0).abs() < LEAKAGE, "{noisy:?}");
    assert!((noisy.torque_chatter_hz.unwrap() - 15.0).abs() < 0.2, "{noisy:?}");
    assert!(found.joints[names[0]].torque_chatter_rms_nm.unwrap() < SILENCE_NM);
    assert_eq!(found.metrics.torque_chatter_hz, noisy.torque_chatter_hz, "the joint with the most");
}

/// Checks joints that stand still while their reference moves, and those that follow it.
#[test]
fn joints_held_by_friction_are_a_failure() {
    let experiment = experiment("joint-tracking", &[]);
    let wave = |t: f64| 0.2 * (0.5 * TAU * t).sin();
    let failures = |q: &dyn Fn(f64) -> f64| {
        let recording = joint_log(&experiment, q, wave, |_, _| 1.0);
        let summary = experiment.summary(&recording, &OutcomeRecord::default(), None);
        summary.findings.failures().map(ToString::to_string).collect::<Vec<_>>()
    };
    let held = failures(&|_| 0.1);
    assert!(
        held[0].starts_with("the reference moves, but not joint '") && held[0].contains("friction"),
        "{held:?}"
    );
    assert!(failures(&wave).is_empty());
}

/// Joints whose references rest far from zero are not held by friction, although the log has zeros before control.
#[test]
fn joints_with_resting_references_are_no_failure() {
    let one = "task.joints.joint-tracking.reference={ sinusoid = { joints = { elbow = [{ amplitude_rad = 0.2, frequency_hz = 0.5 }] } } }";
    let (recording, summary) = run(&experiment("joint-tracking", &[one, "duration_s=3.0"]));
    let reference = recording.channel("tick").unwrap().signal("joints.reference").unwrap().row(1500).to_vec();
    assert!(reference.iter().filter(|q| q.abs() > 0.1).count() >= 2, "{reference:?}");
    assert_eq!(summary.findings.failures().count(), 0, "{:?}", summary.findings);
}

/// Checks a task of one joint: the log has references of the others too, which the joints need not follow.
#[test]
fn joints_beside_the_task_are_no_failure() {
    let options = RunOptions { backend: CommandKind::Torque, ..RunOptions::default() };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/panda-levels.toml");
    let experiment = Experiment::load(Files::Disk, &path, None, options, &[]).unwrap();
    let (_, summary) = run(&experiment);
    assert_eq!(summary.findings.failures().count(), 0, "{:?}", summary.findings);
    assert!(summary.tasks.values().any(|task| task.elements.len() == 1), "{:?}", summary.tasks);
}

/// Checks expectations that are met and missed, of the run, a task and a joint, and of a metric that the run lacks.
#[test]
fn missed_expectations_are_listed() {
    let expect = |text: &str| experiment("cartesian-tracking", &["duration_s=2.0", text]);
    let missed = |text: &str| run(&expect(text)).1.missed_expectations;
    assert_eq!(
        missed("expect={ position_rms_m = { at_most = 0.1 }, \"hand.position_max_m\" = { at_most = 0.1 } }"),
        [""; 0]
    );
    let found = missed(
        "expect={ position_rms_m = { at_most = 1e-9 }, \"elbow.torque_chatter_rms_nm\" = { at_least = 1e3 } }",
    );
    assert!(found.len() == 2 && found.iter().all(|text| text.contains("expected at")), "{found:?}");
    let found =
        missed("expect={ \"hand.x_max_m\" = { at_most = 0.1 }, \"hand.y_range_m\" = { at_least = 1.0 } }");
    assert!(found.len() == 1 && found[0].starts_with("hand.y_range_m is "), "{found:?}");
    let found = missed("expect={ in_contact_fraction = { at_least = 0.5 } }");
    assert!(found.len() == 1 && found[0].contains("does not exist in this run"), "{found:?}");
}

/// Checks expectations of unknown metrics, tasks and joints, and without a bound.
#[test]
fn unknown_expectations_are_refused() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/cartesian-tracking.toml");
    let refused = |text: &str| {
        let settings = [text.to_owned()];
        let error = Experiment::load(Files::Disk, &path, None, RunOptions::default(), &settings).unwrap_err();
        format!("{error} {}", error.help().unwrap_or_default())
    };
    for (text, said) in [
        ("expect={ position_rms = { at_most = 1.0 } }", "position_rms_m"),
        ("expect={ \"hnad.position_rms_m\" = { at_most = 1.0 } }", "did you mean 'hand'"),
        ("expect={ \"hand.positon_max_m\" = { at_most = 1.0 } }", "did you mean 'position_max_m'"),
        ("expect={ \"hand.elements\" = { at_most = 1.0 } }", "of a Cartesian task"),
        ("expect={ \"hand.y_rms\" = { at_most = 1.0 } }", "did you mean 'y_rms_m'"),
        ("expect={ \"hand.rx_rms_rad\" = { at_most = 1.0 } }", "rx is never a motion axis of task 'hand'"),
        ("expect={ y_rms_m = { at_most = 1.0 } }", "write \"TASK.y_rms_m\""),
        ("expect={ \"elbow.torque_chatter\" = { at_most = 1.0 } }", "torque_chatter_rms_nm"),
        ("expect={ position_rms_m = {} }", "at_most"),
        ("expect={ position_rms_m = { atmost = 1.0 } }", "at_most"),
    ] {
        let found = refused(text);
        assert!(found.contains(said), "{text}: {found}");
    }
}

/// Compared: the compliant motion of a task with one axis that is compliant between two events, and the motion along that
/// axis in the log since the first event; the tracking error, and that of an experiment in which the axis stays a motion axis.
#[test]
fn axes_are_those_of_the_task_set_in_force() {
    let events = "event=[{ time_s = 0.3, set = [\"task.hand.cartesian.axes.x=compliant\"] }, \
                  { time_s = 0.7, set = [\"task.hand.cartesian.axes.x=motion\"] }]";
    let load = |events: &str| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/cartesian-tracking.toml");
        let options = RunOptions { duration_s: Some(1.0), ..RunOptions::default() };
        let settings = ["settle_s=0.0", events].map(str::to_owned);
        Experiment::load(Files::Disk, &path, None, options, &settings).unwrap()
    };
    let experiment = load(events);
    let (recording, summary) = run(&experiment);
    let tick = recording.tick().unwrap();
    let position = tick.signal("hand.position").unwrap();
    let phase = tick.signal("phase").unwrap();
    let first = (0..tick.len()).find(|&k| phase.row(k)[0] == Phase::Control.code()).unwrap();
    let start_s = tick.time_s[first];
    let within = |k: &usize| (0.3 - 1e-6..0.7 - 1e-6).contains(&(tick.time_s[*k] - start_s));
    let start = position.row((first..tick.len()).find(within).unwrap())[0];
    let squares: Vec<f64> =
        (first..tick.len()).filter(within).map(|k| (position.row(k)[0] - start).powi(2)).collect();
    let expected = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    let task = &summary.tasks["hand"];
    let found = task.compliance.compliant_motion_rms_m.unwrap();
    // The log has the measured position, the metric uses the true one.
    assert!((found / expected - 1.0).abs() < MEASURED, "{found} m for {expected} m");

    let as_motion = evaluate(&load("seed=1"), &recording);
    let [with, without] = [task.pose, as_motion.tasks["hand"].pose].map(|pose| pose.position_rms_m.unwrap());
    assert!(with < 0.5 * without, "{with} m with the axes in force, {without} m with those at the start");
}
