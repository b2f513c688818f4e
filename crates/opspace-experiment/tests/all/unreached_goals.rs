//! Goals that a run does not reach: the cause, the interval, and the way back.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use nalgebra::Vector3;
use opspace_backend::{Backend, CommandKind, GroundTruth, Sample};
use opspace_control::CartesianTarget;
use opspace_experiment::{Code, Experiment, Files, Finding, Progress, RunOptions, Summary};
use opspace_log::Recording;
use opspace_model::{Data, frame_placement, kinematics};
use std::io::Cursor;
use std::path::Path;

/// Tolerance of the end of an interval, s: the goal is reached again with a lag.
const LAG_S: f64 = 0.3;

/// Difference of a final error from that of a run whose reference never was away, without friction, m and rad.
const SAME: f64 = 1e-4;

/// Largest final error with friction that is partly compensated, m and rad.
const STICKING: f64 = 5e-3;

const NO_FRICTION: &str =
    "{ coulomb_nm = 0.0, static_nm = 0.0, stribeck_rad_per_s = 0.06, viscous_nms_per_rad = 0.0 }";

fn experiment(task: &str, settings: &[&str]) -> Experiment {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../tasks/{task}.toml"));
    let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
    let options = RunOptions { backend: CommandKind::Torque, ..RunOptions::default() };
    Experiment::load(Files::Disk, &path, None, options, &settings).unwrap()
}

/// Log and summary of a run.
fn run(experiment: &Experiment) -> (Recording, Summary) {
    let result = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
    let recording = Recording::from_bytes(&result.sink.into_inner()).unwrap();
    let summary = experiment.summary(&recording, &result.record, None);
    assert_eq!(summary.faulted, None);
    (recording, summary)
}

/// Largest error of the flange at the end of a run, m and rad.
fn final_error(recording: &Recording) -> f64 {
    let tick = recording.channel("tick").unwrap();
    tick.signal("flange.error").unwrap().row(tick.len() - 1).iter().fold(0.0, |m: f64, e| m.max(e.abs()))
}

/// Findings with a code.
fn coded(summary: &Summary, code: Code) -> Vec<&Finding> {
    summary.findings.of(code).collect()
}

fn only(summary: &Summary) -> &Finding {
    let goals = coded(summary, Code::GoalNotReached);
    let [goal] = goals[..] else { panic!("{goals:?}") };
    goal
}

/// Waypoints of the flange: at `offset_m` from 1 s to 2 s, and back at 3 s.
fn there_and_back(offset_m: [f64; 3]) -> String {
    format!(
        "task.flange.cartesian.reference={{ waypoints = [{{time_s=1.0, position={{offset_m={offset_m:?}}}}}, \
         {{time_s=2.0, position={{offset_m={offset_m:?}}}}}, {{time_s=3.0, position={{offset_m=[0.0,0.0,0.0]}}}}] }}"
    )
}

/// A pose in front of the Panda's base, which its joint2 cannot reach.
const BEHIND_M: [f64; 3] = [-0.35, 0.0, -0.2];

/// Checks runs that reach their goals, are compliant, press against a wall, pass singularities, and stick in friction with
/// errors of millimetres.
#[test]
fn reached_goals_have_no_note() {
    for (task, settings) in [
        (
            "panda-tracking",
            &["friction_compensation.gain=0.0", "task.flange.cartesian.gains.frequency_rad_per_s=8.0"][..],
        ),
        ("panda-tracking", &["duration_s=3.0"]),
        ("ur5e-wrist", &[]),
        ("compliant-x", &["duration_s=3.0"]),
        ("press-wall", &["duration_s=3.0"]),
    ] {
        let (_, summary) = run(&experiment(task, settings));
        assert_eq!(summary.findings.of(Code::GoalNotReached).count(), 0, "{task}");
    }
}

/// Compared: the joints that a note names with the one joint at its limit in the log, its interval with that of the
/// waypoints, and the error at the end with that of an arm that stayed.
#[test]
fn position_limits_are_named_and_left_again() {
    let of = |offset_m: [f64; 3]| {
        let mut settings = vec!["event=[]".to_owned(), "duration_s=5.0".to_owned(), there_and_back(offset_m)];
        settings.push("friction_compensation.gain=0.0".to_owned());
        settings.extend((1..=7).map(|joint| format!("robot.joint.joint{joint}.friction={NO_FRICTION}")));
        run(&experiment("panda-goals", &settings.iter().map(String::as_str).collect::<Vec<_>>()))
    };
    let (recording, summary) = of(BEHIND_M);
    let goal = only(&summary);
    assert_eq!(goal.causes.position_limits, ["joint2"], "{goal}");
    assert_eq!(
        (&goal.causes.torque_limits[..], goal.causes.singular_along.as_ref()),
        (&[][..], None),
        "{goal}"
    );
    assert!(
        goal.number("begin_s").unwrap() < 1.2 && (2.0..3.0 + LAG_S).contains(&goal.number("end_s").unwrap()),
        "{goal}"
    );
    let tick = recording.channel("tick").unwrap();
    let at_limit = |k: usize| tick.signal("q").unwrap().row(k)[1] < -1.7628 + 0.011;
    let middle = tick.time_s.partition_point(|&t| t < tick.time_s[0] + 1.9);
    assert!(at_limit(middle) && !at_limit(tick.len() - 1));
    let away = tick.signal("flange.error").unwrap().row(middle);
    let away = away[..3].iter().map(|e| e * e).sum::<f64>().sqrt();
    assert!(
        goal.number("position_m").unwrap() >= away && goal.number("position_m").unwrap() < 1.5 * away,
        "{goal}: {away}"
    );
    let (stayed, none) = of([0.0; 3]);
    assert_eq!(none.findings.of(Code::GoalNotReached).count(), 0);
    assert!(final_error(&recording) < final_error(&stayed) + SAME, "{}", final_error(&recording));
    let text = goal.to_string();
    assert!(
        text.contains("'flange': goal not reachable within limits")
            && text.contains("position limits of joint2")
    );
}

/// Checks a goal that an event withdraws, and one that stays until the end.
#[test]
fn goal_of_an_event_ends_the_note() {
    let away = format!("task.flange.cartesian.reference.goal.position.offset_m={BEHIND_M:?}");
    let back = "event=[{time_s=2.5, set=[\"task.flange.cartesian.reference.goal.position.offset_m=[0.0,0.0,0.0]\"]}]";
    let (recording, summary) = run(&experiment("panda-goals", &[&away, back]));
    let goal = only(&summary);
    assert!((2.5..3.5).contains(&goal.number("end_s").unwrap()), "{goal}");
    assert!(final_error(&recording) < STICKING, "{}", final_error(&recording));
    let (_, summary) = run(&experiment("panda-goals", &[&away, "event=[]", "duration_s=3.0"]));
    assert_eq!(only(&summary).number("end_s"), None);
}

/// Checks an arm without position limits in its way: the direction has the large components of the error, no joint is
/// named, and the arm returns.
#[test]
fn reach_is_named_without_joints() {
    let (recording, summary) = run(&experiment("ur5e-out-of-reach", &[]));
    let goal = only(&summary);
    let along = goal.causes.singular_along.as_ref().unwrap();
    assert!(along.contains(" x") && along.contains(" z"), "{goal}");
    let joints = [&goal.causes.position_limits, &goal.causes.speed_limits, &goal.causes.torque_limits];
    assert!(joints.iter().all(|joints| joints.is_empty()), "{goal}");
    assert!(
        goal.number("begin_s").unwrap() < 2.2 && (3.0..5.0).contains(&goal.number("end_s").unwrap()),
        "{goal}"
    );
    assert!(final_error(&recording) < STICKING, "{}", final_error(&recording));
}

/// Checks an arm whose joint 2 is just too weak to lift it from a stretched posture.
#[test]
fn torque_limits_are_named() {
    let waypoints = "task.flange.cartesian.reference={ waypoints = [{time_s=2.5, position={offset_m=[0.25,0.0,-0.1]}}, \
                     {time_s=6.0, position={offset_m=[0.25,0.0,0.0]}}] }";
    let settings = ["event=[]", "limits.torque_fraction=0.296", waypoints, "duration_s=7.0"];
    let (_, summary) = run(&experiment("panda-goals", &settings));
    let goal = coded(&summary, Code::GoalNotReached)[0];
    assert_eq!(goal.causes.torque_limits, ["joint2"], "{goal}");
    assert_eq!(goal.causes.position_limits, [""; 0], "{goal}");
}

/// Checks a task of one joint and one of all joints, below a task that uses them: they are overridden, and not held by
/// friction.
#[test]
fn task_of_higher_priority_is_named() {
    for joints in ["joints = [\"joint4\"], ", ""] {
        let rest = format!(
            "task.rest={{ joint-tracking = {{ {joints}gains = {{ frequency_rad_per_s = 10.0, damping_ratio = 1.0 }}, reference \
             = {{ point-to-point = {{ goal = {{ offset_rad = {{ joint4 = 0.3 }} }}, duration_s = 1.0 }} }} }} }}"
        );
        let settings = ["event=[]", "duration_s=3.0", &there_and_back([0.0; 3]), &rest];
        let (_, summary) = run(&experiment("panda-goals", &settings));
        let goal = only(&summary);
        assert_eq!(
            (goal.task().unwrap(), &goal.causes.overridden_by[..]),
            ("rest", &["flange".to_owned()][..])
        );
        assert!(
            goal.number("end_s").is_none() && goal.to_string().contains("overridden by task 'flange'"),
            "{goal}"
        );
        assert_eq!(summary.findings.failures().count(), 0, "{joints}");
    }
}

/// A circle of the flange in the y-z plane, with a radius in m.
fn circle(radius_m: f64, frequency_hz: f64) -> String {
    let wave = |phase_rad: f64, offset_m: f64| {
        format!(
            "[{{ amplitude_m = {radius_m}, frequency_hz = {frequency_hz}, phase_rad = {phase_rad}, offset_m = {offset_m} }}]"
        )
    };
    let (y, z) = (wave(0.0, 0.0), wave(std::f64::consts::FRAC_PI_2, -radius_m));
    format!("task.flange.cartesian.reference={{ sinusoid = {{ y = {y}, z = {z} }} }}")
}

/// Compared: the limits that hold a circle of the Panda back with those in the note, and its error with that of the metrics. A
/// slow circle has no note.
#[test]
fn limited_moving_reference_has_a_note() {
    let of = |frequency_hz: f64, setting: &str| {
        let settings = ["event=[]", "duration_s=4.0", &circle(0.12, frequency_hz), setting];
        run(&experiment("panda-goals", &settings)).1
    };
    let slow = of(0.3, "limits.velocity_fraction=1.0");
    assert_eq!(slow.findings.iter().count(), 0);
    let fast = of(1.0, "limits.velocity_fraction=0.2");
    let [reference] = coded(&fast, Code::ReferenceLimited)[..] else { panic!("{:?}", fast.findings) };
    assert_eq!(reference.task(), Some("flange"));
    assert!(
        !reference.causes.speed_limits.is_empty() && reference.causes.position_limits.is_empty(),
        "{reference}"
    );
    assert!(
        reference.number("share").unwrap() > 0.2 && reference.number("begin_s").unwrap() < 0.5,
        "{reference}"
    );
    let largest_m = fast.tasks["flange"].pose.position_max_m.unwrap();
    let noted_m = reference.number("position_m").unwrap();
    assert!(noted_m > 0.02 && (noted_m / largest_m - 1.0).abs() < 0.2, "{reference}: {largest_m} m");
    let text = reference.to_string();
    assert!(
        text.starts_with("task 'flange': moving reference not followed within limits, from ")
            && text.contains(" mm")
            && text.contains("speed or acceleration limits of "),
        "{text}"
    );
    let weak = of(1.0, "limits.torque_fraction=0.31");
    let [reference] = coded(&weak, Code::ReferenceLimited)[..] else { panic!("{:?}", weak.findings) };
    assert!(reference.causes.torque_limits.contains(&"joint4".to_owned()), "{reference}");
    // A motion that is over before the arm has begun.
    let jump = "task.flange.cartesian.reference={ point-to-point = { position = { offset_m = [0.0, 0.2, 0.0] }, duration_s = 0.05 } }";
    let (_, jump) = run(&experiment("panda-goals", &["event=[]", "duration_s=3.0", jump]));
    let [reference] = coded(&jump, Code::ReferenceLimited)[..] else { panic!("{:?}", jump.findings) };
    assert!(
        reference.number("position_m").unwrap() > 0.1 && reference.number("share").unwrap() < 0.03,
        "{reference}"
    );
}

/// Checks a circle that leaves the reach of the arm: no limits, but the direction.
#[test]
fn moving_reference_out_of_reach_has_a_note() {
    let settings = ["event=[]", "duration_s=6.0", &circle(0.8, 0.1)];
    let (_, summary) = run(&experiment("ur5e-out-of-reach", &settings));
    let [reference] = coded(&summary, Code::ReferenceLimited)[..] else { panic!("{:?}", summary.findings) };
    assert!(
        reference.causes.singular_along.is_some() && reference.number("position_m").unwrap() > 0.05,
        "{reference}"
    );
}

/// Checks a streamed pose that goes beyond the reach of the arm and returns.
#[test]
fn streamed_goal_ends_the_note() {
    let streamed = "task.flange.cartesian.reference={ streamed = { timeout_s = 0.1 } }";
    let experiment = experiment("panda-goals", &["event=[]", "duration_s=5.0", streamed]);
    let mut arm = experiment.simulated_arm().unwrap();
    let (capabilities, truth) = (arm.capabilities().clone(), arm.ground_truth().map(GroundTruth::layouts));
    let model = &experiment.robot().model;
    let mut home = None;
    let body = |run: &mut opspace_loop::Run<'_>| {
        let mut flange = CartesianTarget::of(run.targets(), "flange").unwrap();
        let mut sample = Sample::new(&capabilities);
        while !run.is_over() {
            arm.read(&mut sample).unwrap();
            let (begin_s, home) = *home.get_or_insert_with(|| {
                let mut data = Data::new(model);
                kinematics(model, &mut data, &sample.q, &[0.0; 7]);
                (sample.time_s, frame_placement(model, &data, model.frame_id("flange").unwrap()).translation)
            });
            // Towards the base within 1 s, and back from 2.5 s on.
            let time_s = sample.time_s - begin_s;
            let share = time_s.min(1.0) - (time_s - 2.5).clamp(0.0, 1.0);
            let target = home + Vector3::from(BEHIND_M) * share;
            flange.position(target.into()).unwrap();
            flange.write(run.targets(), sample.time_s).unwrap();
            if let Some(command) = run.cycle(&sample) {
                arm.write(command).unwrap();
            }
        }
        arm.stop();
    };
    let progress = Progress::default();
    let result = experiment.run_with(&capabilities, truth, Cursor::new(Vec::new()), &progress, body).unwrap();
    let recording = Recording::from_bytes(&result.sink.into_inner()).unwrap();
    let summary = experiment.summary(&recording, &result.record, None);
    let goal = only(&summary);
    assert_eq!(goal.causes.position_limits, ["joint2"], "{goal}");
    assert!((2.5..3.9).contains(&goal.number("end_s").unwrap()), "{goal}");
    assert!(final_error(&recording) < STICKING, "{}", final_error(&recording));
}
