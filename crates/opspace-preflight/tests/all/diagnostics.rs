//! Diagnostics before a run: each kind on a file that causes it, and none on the files of the project.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::task_texts::{HAND, PRESS, TIP, table};
use opspace_backend::CommandKind;
use opspace_control::reach;
use opspace_experiment::Progress;
use opspace_experiment::evaluate::metrics::metrics;
use opspace_experiment::{Code, ControllerKind, Experiment, Files, Finding, RunOptions};
use opspace_log::Recording;
use opspace_loop::RunOutcome;
use opspace_model::{Data, frame_placement, kinematics};
use opspace_preflight::diagnostics;
use opspace_preflight::not_checked;
use opspace_transformer::TransformerName;
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A joint task without diagnostics.
const JOINTS: &str = r#"
robot = "ROBOTS/asimo-arm"
duration_s = 2.0
settle_s = 0.5
priority = ["joints"]
start_rad = { elbow = -1.35 }

[task.joints.joint-tracking]
gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }
reference.point-to-point = { goal = { absolute_rad = { elbow = -0.35 } }, duration_s = 1.0 }
"#;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Builds an experiment from the text of a task with changes, each an old and a new part.
fn experiment(task: &str, changes: &[(&str, &str)], options: RunOptions, settings: &[&str]) -> Experiment {
    let folder = TempDir::new().unwrap();
    let mut text = task.replace("ROBOTS", root().join("robots").to_str().unwrap());
    for (old, new) in changes {
        assert!(text.contains(old), "`{old}` is there to be changed");
        text = text.replace(old, new);
    }
    fs::write(folder.path().join("task.toml"), text).unwrap();
    let settings: Vec<String> = settings.iter().map(|&s| s.to_owned()).collect();
    Experiment::load(Files::Disk, &folder.path().join("task.toml"), None, options, &settings).unwrap()
}

/// Returns the only diagnostic that a change causes, and its line.
fn only_diagnostic(task: &str, changes: &[(&str, &str)], settings: &[&str]) -> (Finding, Option<usize>) {
    let experiment = experiment(task, changes, RunOptions::default(), settings);
    let mut found = diagnostics(&experiment);
    assert_eq!(found.len(), 1, "{found:#?}");
    let finding = found.remove(0);
    let placed = finding.placed(&experiment);
    assert_eq!((placed.message(), placed.help()), (&*finding.message, Some(&*finding.help)));
    (finding, placed.line())
}

fn assert_says(finding: &Finding, key: &str, words: &[&str]) {
    assert_eq!(finding.key(), key, "{finding:?}");
    let said = format!("{} {}", finding.message, finding.help);
    for word in words {
        assert!(said.contains(word), "`{word}` in {finding:?}");
    }
}

/// Files of the project that cause diagnostics intentionally, with words of the diagnostics.
const MADE_TO_GO_WRONG: [(&str, &str); 10] = [
    ("panda-out-of-reach", "cannot be reached"),
    ("panda-unreachable", "cannot be reached"),
    ("ur5e-out-of-reach", "cannot be reached"),
    ("ur5e-unreachable", "cannot be reached"),
    ("panda-obstacles", "is in collision: 'link7.2' and 'ball'"),
    ("panda-folded", "is in collision: 'link2' and 'link6'"),
    ("panda-too-fast", "the references move joint"),
    // The path around a singular posture requires high speeds.
    ("ur5e-wrist", "the references move joint"),
    ("ur5e-straight", "it leaves towards a goal"),
    ("ur5e-pulled-straight", "nothing brings 'flange' back along x"),
];

/// Compared: stiffnesses of an impedance that give frequencies of 18 and 800 rad/s with a mass of 1.5 kg, and the message; the
/// proposed stiffness is not reported. The controller holds each torque for 1 ms or more.
#[test]
fn stiffness_that_the_rate_does_not_permit_is_found() {
    let gains = "gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }";
    let found = |stiffness: &str| {
        let spring = format!("impedance = {{ stiffness_n_per_m = {stiffness}, damping_ratio = 0.7 }}");
        diagnostics(&experiment(HAND, &[(gains, &spring)], RunOptions::default(), &[]))
    };
    assert_eq!(found("500.0"), []);
    let [stiff] = &found("1e6")[..] else { panic!("one diagnostic") };
    assert_eq!(stiff.code, Code::GainsTooHigh);
    assert_says(stiff, "task.hand.cartesian.impedance.stiffness_n_per_m", &["= 1e6 along ", "phase margin"]);
    let proposed = stiff.help.split_whitespace().nth(2).unwrap();
    assert_eq!(found(proposed), [], "{}", stiff.help);
}

/// Checks that inverse kinematics reports an impedance and compliant axes, and torque control neither.
#[test]
fn compliance_that_inverse_kinematics_ignores_is_found() {
    let of = |controller: ControllerKind, change: (&str, &str)| {
        let options = RunOptions { controller, ..RunOptions::default() };
        let found = diagnostics(&experiment(HAND, &[change], options, &[]));
        found.into_iter().filter(|found| found.code == Code::IgnoredCompliance).collect::<Vec<_>>()
    };
    let gains = "gains = { frequency_rad_per_s = 14.0, damping_ratio = 1.0 }";
    let spring = (gains, "impedance = { stiffness_n_per_m = 500.0, damping_ratio = 0.7 }");
    let compliant = ("x = \"motion\"", "x = \"compliant\"");
    for controller in [ControllerKind::Ik, ControllerKind::IkLead] {
        let [found] = &of(controller, spring)[..] else { panic!("one diagnostic") };
        assert_says(found, "task.hand.cartesian.impedance", &["its impedance has no effect"]);
        let [found] = &of(controller, compliant)[..] else { panic!("one diagnostic") };
        assert_says(found, "task.hand.cartesian.axes", &["its compliance along x has no effect"]);
        assert_eq!(of(controller, ("duration_s = 2.0", "duration_s = 2.5")), []);
    }
    assert_eq!(of(ControllerKind::Osc, spring), []);
}

/// Checks compliant x with the default transformer of an arm with elastic gears and no motor current, whose gains are known to 30 % or
/// exactly, and with others.
#[test]
fn compliance_that_the_default_transformer_damps_is_found() {
    let of = |settings: &[&str], transformer: Option<TransformerName>| {
        let options = RunOptions { transformer, ..RunOptions::default() };
        let compliant = ("x = \"motion\"", "x = \"compliant\"");
        let found = diagnostics(&experiment(HAND, &[compliant], options, settings));
        found.into_iter().filter(|found| found.code == Code::DampedCompliance).collect::<Vec<_>>()
    };
    let unknown = ["robot.interface.gears=\"elastic\"", "robot.interface.measured=[\"position\"]"];
    let uncertain =
        [&unknown[..], &["robot.profile.a-med.servo.elbow.cascaded.gain_uncertainty=0.3"]].concat();
    let [found] = &of(&uncertain, None)[..] else { panic!("one diagnostic") };
    assert_says(found, "task.hand.cartesian.axes", &["is damped by the servos", "±30 %", "opspace identify"]);
    assert_eq!(of(&unknown, None), [], "gains that are known exactly");
    assert_eq!(of(&[], None), [], "motor current");
    let current = TransformerName::EXTRAPOLATION.with_current(true);
    assert_eq!(of(&uncertain[..1], Some(current)), [], "motor current");
}

/// Checks a motion of 58 mm in 0.2 s from the start on, and the same one half a second later; the torque ramps in over 0.2 s.
#[test]
fn fast_motion_while_the_torque_ramps_in_is_found() {
    let motion = "{ point-to-point = { position = { offset_m = [0.05, 0.0, 0.03] }, duration_s = 0.2 } }";
    let of = |change: (&str, &str), settings: &[&str]| {
        let found = diagnostics(&experiment(HAND, &[change], RunOptions::default(), settings));
        found.into_iter().filter(|found| found.code == Code::MovesDuringRamp).collect::<Vec<_>>()
    };
    let at_once = HAND.lines().find(|line| line.starts_with("reference")).expect("a reference");
    let fast = format!("reference = {motion}");
    let [found] = &of((at_once, &fast), &["robot.safety.torque_ramp_s=0.2"])[..] else {
        panic!("one diagnostic")
    };
    assert_says(
        found,
        "task.hand.cartesian.reference",
        &["first 0.2 s", "safety.torque_ramp_s", "[[event]]"],
    );
    assert_eq!(of((at_once, &fast), &["robot.safety.torque_ramp_s=0.001"]), []);
    let later = format!(
        "reference = \"hold\"\n[[event]]\ntime_s = 0.5\nset = [\"task.hand.cartesian.reference={}\"]\n",
        motion.replace('"', "\\\"")
    );
    assert_eq!(of((at_once, &later), &["robot.safety.torque_ramp_s=0.2"]), []);
}

/// Checks a motion of the tip of 0.1 m at 5 Hz, which needs 37 Nm of the elbow's 20 Nm, and one at 0.5 Hz, which does not.
#[test]
fn references_beyond_torque_limits_are_found() {
    let of = |frequency_hz: f64| {
        let wave =
            format!("reference.sinusoid.x = [{{ amplitude_m = 0.1, frequency_hz = {frequency_hz} }}]\n");
        diagnostics(&experiment(TIP, &[("reference = \"hold\"\n", &wave)], RunOptions::default(), &[]))
    };
    assert!(of(0.5).iter().all(|found| found.code != Code::TorqueAboveLimit));
    let found = of(5.0);
    let found = found.iter().find(|found| found.code == Code::TorqueAboveLimit).expect("a diagnostic");
    assert_says(found, "task.tip.cartesian.reference", &["Nm from joint '", "allowed: "]);
}

/// Checks positions in degrees, of which the message names all joints, and a goal in mm.
#[test]
fn degrees_and_millimetres_are_suspected() {
    let folder = TempDir::new().unwrap();
    let start =
        "start_rad = { shoulder_pitch = -0.45, shoulder_roll = -0.35, shoulder_yaw = 0.25, elbow = -1.35 }";
    let robots = root().join("robots");
    let degrees =
        "start_rad = { shoulder_pitch = -26.0, shoulder_roll = -20.0, shoulder_yaw = 14.0, elbow = -77.0 }";
    let text = HAND.replace("ROBOTS", robots.to_str().unwrap()).replace(start, degrees);
    fs::write(folder.path().join("task.toml"), text).unwrap();
    let file = folder.path().join("task.toml");
    let error = Experiment::load(Files::Disk, &file, None, RunOptions::default(), &[]).unwrap_err();
    for joint in ["shoulder_pitch", "shoulder_roll", "shoulder_yaw"] {
        let is_named = error.message().contains(&format!("'{joint}'"));
        assert!(is_named || error.message().starts_with("-77 "), "{joint}: {}", error.message());
    }
    assert!(error.help().is_some_and(|help| help.contains("degrees")), "{:?}", error.help());
    let far = ("offset_m = [0.05, 0.0, 0.05]", "offset_m = [0.0, 50.0, 0.0]");
    let found = diagnostics(&experiment(HAND, &[far], RunOptions::default(), &[]));
    let found = found.iter().find(|found| found.code == Code::GoalOutOfReach).expect("a diagnostic");
    assert!(found.help.contains("mm"), "{}", found.help);
}

/// The tip of the planar arm starts at z = sin 0.6 + sin 1.8 = 1.538 m and reaches 2 m.
/// Compared: the joint whose position limit the check predicts to hold a task, and the one that holds it in the run. A smaller
/// motion, and one that a redundant arm can make otherwise, have no diagnostic.
#[test]
fn position_limits_on_the_way_are_found() {
    let at = |name: &str, settings: &[&str]| {
        let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
        let options = RunOptions { backend: CommandKind::Torque, ..RunOptions::default() };
        Experiment::load(Files::Disk, &root().join("tasks").join(name), None, options, &settings).unwrap()
    };
    let limits = |experiment: &Experiment| -> Vec<Finding> {
        let found = diagnostics(experiment).into_iter();
        found.filter(|found| found.code == Code::LimitOnTheWay).collect()
    };
    let folded = at("panda-folded.toml", &[]);
    let [found] = &limits(&folded)[..] else { panic!("one diagnostic") };
    assert_says(
        found,
        "task.flange.cartesian.reference",
        &["'flange'", "'joint4'", "lower limit", "opspace model ", "--frame flange --at=0.307,0,0.59,"],
    );
    let result = folded.run(std::io::Cursor::new(Vec::new()), &Progress::default()).unwrap();
    let log = Recording::from_bytes(result.sink.get_ref()).unwrap();
    let summary = folded.summary(&log, &result.record, None);
    let held = summary.findings.of(Code::ReferenceLimited);
    let held = held.into_iter().any(|held| held.causes.position_limits == ["joint4"]);
    assert!(held, "{:?}", summary.findings);
    assert_eq!(limits(&at("panda-tracking.toml", &[])), []);
    assert_eq!(limits(&at("panda-reach.toml", &[])), []);
}

#[test]
fn misplaced_objects_are_found() {
    let wall = |frame: &str, point: &str| {
        format!(
            "reference = \"hold\"\n[environment.table.wall]\nframe = \"{frame}\"\npoint_m = {point}\nnormal = [0.0, 0.0, 2.0]\n\
             stiffness_n_per_m = 10000.0\ndamping_ns_per_m = 50.0\n"
        )
    };
    let with = |object: &str| only_diagnostic(TIP, &[("reference = \"hold\"\n", object)], &[]).0;
    let deep = with(&wall("tip", "[0.0, 0.0, 1.6]"));
    assert_eq!(deep.code, Code::StartInObject);
    assert_says(&deep, "environment.table.wall", &["'tip' starts 0.0615 m deep in 'table'", "615 N"]);
    let far = with(&wall("tip", "[0.0, 0.0, -2.5]"));
    assert_eq!(far.code, Code::ObjectOutOfReach);
    assert_says(
        &far,
        "environment.table.wall",
        &["2.5 m from the first joint", "reaches only 2 m", "0.5 m closer"],
    );
    let cylinder = "reference = \"hold\"\n[environment.post.cylinder]\nframe = \"tip\"\npoint_m = [0.6, 0.0, 1.5]\n\
                    axis = [0.0, 1.0, 0.0]\nradius_m = 0.1\nstiffness_n_per_m = 1000.0\ndamping_ns_per_m = 5.0\n";
    assert_eq!(with(cylinder).code, Code::StartInObject);
    for near in [
        wall("tip", "[0.0, 0.0, 1.5]"),
        wall("tip", "[0.0, 0.0, 1.5]") + "edge = { toward = [1.0, 0.0, 0.0], at_m = 0.5 }\n",
    ] {
        let experiment = experiment(TIP, &[("reference = \"hold\"\n", &near)], RunOptions::default(), &[]);
        assert_eq!(diagnostics(&experiment), []);
    }
    let beyond = wall("tip", "[0.0, 0.0, 1.6]") + "edge = { toward = [1.0, 0.0, 0.0], at_m = 0.5 }\n";
    let beyond = experiment(TIP, &[("reference = \"hold\"\n", &beyond)], RunOptions::default(), &[]);
    assert_eq!(diagnostics(&beyond), [], "the tip is beyond the edge");
}

#[test]
fn project_files_have_no_diagnostics() {
    for task in [HAND, JOINTS, TIP] {
        assert_eq!(diagnostics(&experiment(task, &[], RunOptions::default(), &[])), []);
    }
    let velocity = RunOptions { backend: CommandKind::Velocity, ..RunOptions::default() };
    for task in [HAND, JOINTS] {
        assert_eq!(diagnostics(&experiment(task, &[], velocity.clone(), &[])), []);
    }
    let mut seen = 0;
    for entry in fs::read_dir(root().join("tasks")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|e| e != "toml") {
            continue;
        }
        seen += 1;
        for backend in [CommandKind::Position, CommandKind::Torque] {
            let options = RunOptions { backend, ..RunOptions::default() };
            let found = diagnostics(&Experiment::load(Files::Disk, &path, None, options, &[]).unwrap());
            let stem = path.file_stem().unwrap().to_str().unwrap();
            match MADE_TO_GO_WRONG.iter().find(|(name, _)| *name == stem) {
                None => assert_eq!(found, [], "{}", path.display()),
                Some((_, word)) => {
                    // What is too fast is so at the start, too.
                    // The folded arm meets a joint limit, too.
                    let also = [Code::MovesDuringRamp, Code::LimitOnTheWay];
                    let found: Vec<_> =
                        found.into_iter().filter(|found| !also.contains(&found.code)).collect();
                    assert!(found.len() == 1 && found[0].message.contains(word), "{stem}: {found:?}");
                }
            }
        }
    }
    assert!(seen >= 8);
}

/// Position of the asimo arm's shoulder, and the direction from there to its hand at the start of [`HAND`].
fn shoulder_and_direction() -> ([f64; 3], [f64; 3]) {
    let experiment = experiment(HAND, &[], RunOptions::default(), &[]);
    let model = &experiment.robot().model;
    let mut data = Data::new(model);
    kinematics(model, &mut data, &[-0.45, -0.35, 0.25, -1.35], &[0.0; 4]);
    let hand = frame_placement(model, &data, model.frame_id("hand").unwrap()).translation;
    let shoulder = data.placement[0].translation;
    (shoulder.into(), (hand - shoulder).normalize().into())
}

/// Goal for [`HAND`] at a distance from the shoulder.
fn goal(distance_m: f64) -> String {
    let (shoulder, direction) = shoulder_and_direction();
    let [x, y, z] = [0, 1, 2].map(|i| shoulder[i] + distance_m * direction[i]);
    format!("position = {{ absolute_m = [{x:?}, {y:?}, {z:?}] }}")
}

const OFFSET: &str = "position = { offset_m = [0.05, 0.0, 0.05] }";

/// Compared: the reported distance and the required one; the reported reach and the link lengths of 0.235 m and 0.275
/// m.
#[test]
fn goal_beyond_reach_is_reported() {
    let (found, line) = only_diagnostic(HAND, &[(OFFSET, &goal(0.7))], &[]);
    let key = "task.hand.cartesian.reference";
    assert_says(
        &found,
        key,
        &["0.7 m from joint 'shoulder_pitch'", "'hand' reaches only 0.51 m", "0.19 m closer"],
    );
    assert_eq!(line, Some(1 + HAND.lines().position(|line| line.starts_with("reference")).unwrap()));

    let event = "duration_s = 2.0\n[[event]]\ntime_s = 0.5\nset = [\"task.hand.cartesian.reference={ point-to-point = { \
                 GOAL, duration_s = 1.0 } }\"]\n";
    let text =
        format!("{HAND}{}", event.trim_start_matches("duration_s = 2.0\n").replace("GOAL", &goal(0.7)));
    let (found, _) = only_diagnostic(&text, &[], &[]);
    assert_says(&found, "event.0.set", &["at 1.5 s its reference is 0.7 m from joint 'shoulder_pitch'"]);

    let experiment = experiment(HAND, &[], RunOptions::default(), &[]);
    let model = &experiment.robot().model;
    let links = reach(model, model.frame_id("hand").unwrap());
    assert!((links - 0.51).abs() < 1e-12);
}

/// Compared: the error at a goal near the shoulder, and the triangle of the two links at the elbow's limit, 0.01 rad
/// before -130°.
#[test]
fn goal_beyond_elbow_limit_is_reported() {
    let (upper, lower, bend) = (0.235_f64, 0.275_f64, 2.2689280275926285 - 0.01);
    let nearest = (upper * upper + lower * lower + 2.0 * upper * lower * f64::cos(bend)).sqrt();
    let (found, _) = only_diagnostic(HAND, &[(OFFSET, &goal(0.1))], &[]);
    let missed = format!("misses it by {:.3} m, with joint 'elbow' at the end of its range", nearest - 0.1);
    assert_says(
        &found,
        "task.hand.cartesian.reference",
        &["cannot be reached within the joint ranges", &missed],
    );
    // A goal one centimetre farther away is reached.
    let inside = experiment(HAND, &[(OFFSET, &goal(nearest + 0.01))], RunOptions::default(), &[]);
    assert_eq!(diagnostics(&inside), []);
}

/// Compared: targets of joints and postures, and the elbow range in the URDF, which ends at 0, with a margin of 0.01.
#[test]
fn postures_beyond_joint_limits_are_reported() {
    let (found, _) = only_diagnostic(JOINTS, &[("elbow = -0.35 } }", "elbow = 0.15 } }")], &[]);
    let words =
        ["target for joint 'elbow' is 0.15", "kept between -2.26 and -0.01", "a target of at most -0.01"];
    assert_says(&found, "task.joints.joint-tracking.reference", &words);
    let posture = "[task.rest.joint-posture]\nposture_rad = { elbow = 0.5 }";
    let (found, line) = only_diagnostic(HAND, &[("[task.rest.joint-posture]", posture)], &[]);
    assert_says(&found, "task.rest.joint-posture.posture_rad.elbow", &["joint 'elbow' is 0.5"]);
    assert_eq!(line, Some(1 + HAND.lines().position(|l| l.contains("joint-posture")).unwrap() + 1));
    // Within the range of the URDF, but in the margin if there is one.
    let changes = [("elbow = -0.35 } }", "elbow = -0.005 } }")];
    only_diagnostic(JOINTS, &changes, &[]);
    let without = experiment(JOINTS, &changes, RunOptions::default(), &["limits.enforce=false"]);
    assert_eq!(diagnostics(&without), []);
}

/// Compared: the reported speed, and the peak of a minimum-jerk motion of 1 rad in 0.2 s, which is 1.875 times the
/// mean; 0.9 times 8 rad/s is allowed.
#[test]
fn reference_beyond_joint_speeds_is_reported() {
    let faster = [("elbow = -0.35 } }, duration_s = 1.0", "elbow = -0.35 } }, duration_s = 0.2")];
    let (found, _) = only_diagnostic(JOINTS, &faster, &[]);
    let words =
        ["at 0.1 s", "joint 'elbow' at 9.38 rad/s", "7.2 rad/s, 0.9 of its limit of 8", "1.31 times as long"];
    assert_says(&found, "task.joints.joint-tracking.reference", &words);
    let slower = [("elbow = -0.35 } }, duration_s = 1.0", "elbow = -0.35 } }, duration_s = 0.27")];
    assert_eq!(diagnostics(&experiment(JOINTS, &slower, RunOptions::default(), &[])), []);
}

/// Compared: the joint speeds for a motion of the tip, and the closed form for two links of 1 m: with both at right
/// angles, the shoulder alone moves the tip along z, at 1 rad/s for 1 m/s.
#[test]
fn frame_motion_beyond_joint_speeds_is_reported() {
    let text = TIP.replace(
        "reference = \"hold\"",
        "reference.point-to-point = { position = { offset_m = [0.0, 0.0, 0.01] }, duration_s = 0.002 }",
    );
    let text = text.replace("shoulder = 0.6, elbow = 1.2", "shoulder = 0.0, elbow = 1.5707963267948966");
    let found = diagnostics(&experiment(&text, &[], RunOptions::default(), &[]));
    // It needs more torque than there is, too, and begins at once.
    let codes: Vec<Code> = found.iter().map(|finding| finding.code).collect();
    assert_eq!(codes[..2], [Code::JointTooFast, Code::TorqueAboveLimit], "{found:#?}");
    let found = &found[0];
    // 1.875 times 0.01 m in 0.002 s, except for the rotation of the arm during the motion.
    assert_says(
        found,
        "task.tip.cartesian.reference",
        &["joint 'shoulder' at 9.", "rad/s; allowed: 5.4 rad/s"],
    );
}

/// Compared: reference speeds and the speed limit of the task; the peak of 0.0707 m in 1 s is 0.133 m/s.
#[test]
fn reference_beyond_task_speed_limit_is_reported() {
    let limited =
        |limit: &str| [("frame = \"hand\"", format!("frame = \"hand\"\nspeed_limit_m_per_s = {limit}"))];
    let changes = limited("0.1");
    let (found, _) = only_diagnostic(HAND, &changes.each_ref().map(|(old, new)| (*old, new.as_str())), &[]);
    let words = ["moves at 0.133 m/s", "speed_limit_m_per_s is 0.1", "1.33 times"];
    assert_says(&found, "task.hand.cartesian.speed_limit_m_per_s", &words);
    let changes = limited("0.14");
    let changes = changes.each_ref().map(|(old, new)| (*old, new.as_str()));
    assert_eq!(diagnostics(&experiment(HAND, &changes, RunOptions::default(), &[])), []);
}

/// Rms error of the hand in a simulated run, m; infinite if the run was stopped.
fn tracking(experiment: &Experiment) -> f64 {
    let sink = std::io::Cursor::new(Vec::new());
    let finished = experiment.run(sink, &Progress::default()).unwrap();
    if finished.outcome != RunOutcome::Completed {
        return f64::INFINITY;
    }
    let recording = Recording::from_bytes(&finished.sink.into_inner()).unwrap();
    metrics(experiment, &recording).pose.position_rms_m.unwrap()
}

/// Compared: diagnostics and simulated runs, of drives that filter setpoints or feed their velocity forward. The
/// extrapolation inverts them. Equation (K10) does not, and feed-forward makes it unstable at any frequency.
#[test]
fn drives_that_only_a_transformer_inverts_have_its_margin() {
    let filter = "setpoint_filter = { first-order = { cutoff_hz = 20.0 } }";
    let fed_forward = "velocity_feed_forward = 1.0";
    for (addition, interpolated, unstable) in [(filter, "held", 600.0), (fed_forward, "interpolated", 700.0)]
    {
        let servos =
            [("shoulder_pitch", 94.6), ("shoulder_roll", 89.9), ("shoulder_yaw", 30.4), ("elbow", 30.3)];
        let mut settings = servos
            .map(|(joint, kv)| {
                format!(
                    "robot.profile.a-med.servo.{joint}={{ cascaded = {{ kp_per_s = 50.265, kv_nms_per_rad = {kv:?}, \
                     velocity_filter_hz = 600.0, {addition} }} }}"
                )
            })
            .to_vec();
        settings.push(format!("robot.interface.setpoints={interpolated}"));
        let settings: Vec<&str> = settings.iter().map(String::as_str).collect();
        let with = |transformer: &str, frequency: f64| {
            let options = RunOptions {
                backend: CommandKind::Position,
                transformer: Some(TransformerName::from(transformer.to_owned())),
                duration_s: Some(1.2),
                ..RunOptions::default()
            };
            let frequency = format!("rad_per_s = {frequency:?}");
            experiment(HAND, &[("rad_per_s = 14.0", &frequency)], options, &settings)
        };
        assert_eq!(diagnostics(&with("extrapolation", 14.0)), [], "{addition}");
        let of_paper = diagnostics(&with("paper", 14.0));
        let unstable_with_paper = of_paper.iter().any(|found| found.message.contains("would be unstable"));
        assert_eq!(unstable_with_paper, addition == fed_forward, "{addition}: {of_paper:#?}");
        let stiff = with("extrapolation", unstable);
        let found = diagnostics(&stiff);
        assert_eq!(found.len(), 1, "{addition}: {found:#?}");
        let proposed = found[0].help.split(' ').nth(2).unwrap().parse::<f64>().unwrap();
        let soft = with("extrapolation", proposed);
        assert_eq!(diagnostics(&soft), [], "{addition}");
        let [shakes, follows] = [&stiff, &soft].map(tracking);
        assert!(
            shakes > 2e-3 && follows < 1e-3,
            "{addition}: {shakes} m at {unstable}, {follows} m at {proposed}"
        );
    }
}

/// Compared: diagnostics and simulated runs, on each kind of robot and at 1 kHz and 200 Hz. With gains that are
/// reported as unstable, the hand oscillates; with the proposed gains it follows, and nothing is reported.
#[test]
fn unstable_gains_are_reported() {
    for (backend, profile, unstable) in [
        (CommandKind::Torque, "a-med", 800.0),
        (CommandKind::Position, "a-med", 1000.0),
        (CommandKind::Velocity, "a-med", 1000.0),
        (CommandKind::Torque, "b-soft", 200.0),
        (CommandKind::Position, "b-soft", 300.0),
        (CommandKind::Velocity, "b-soft", 300.0),
    ] {
        let options = RunOptions {
            backend,
            profile: Some(profile.to_owned()),
            duration_s: Some(1.2),
            ..RunOptions::default()
        };
        let case = format!("{backend:?} {profile}");
        // The margins are those with the filter; an observer with the exact model of the simulation allows higher gains.
        let filter = format!("robot.profile.{profile}.estimator.velocity=filter");
        let settings = [filter.as_str()];
        let with = |frequency: f64| {
            experiment(
                HAND,
                &[("rad_per_s = 14.0", &format!("rad_per_s = {frequency:?}"))],
                options.clone(),
                if backend == CommandKind::Torque { &settings } else { &[] },
            )
        };
        let stiff = with(unstable);
        let found = diagnostics(&stiff);
        assert_eq!(found.len(), 1, "{case}: {found:#?}");
        let words =
            ["would be unstable on this robot: the phase margin is -", "Hz, on joint '", "margin of 45°"];
        assert_says(&found[0], "task.hand.cartesian.gains.frequency_rad_per_s", &words);
        let has_servo = found[0].message.contains("in addition to the servo's lag");
        assert_eq!(has_servo, backend != CommandKind::Torque, "{case}: {}", found[0].message);
        let proposed = found[0].help.split(' ').nth(2).unwrap().parse::<f64>().unwrap();
        let soft = with(proposed);
        assert_eq!(diagnostics(&soft), [], "{case}");
        let [shakes, follows] = [&stiff, &soft].map(tracking);
        assert!(
            shakes > 2e-3 && follows < 5e-4,
            "{case}: {shakes} m at {unstable}, {follows} m at {proposed}"
        );
    }
    // Gains of other tasks, each with its key.
    let posture = [("rad_per_s = 6.0", "rad_per_s = 2000.0")];
    let (found, _) = only_diagnostic(HAND, &posture, &[]);
    assert_says(&found, "task.rest.joint-posture.frequency_rad_per_s", &["unstable"]);
    let (found, _) = only_diagnostic(JOINTS, &[("rad_per_s = 14.0", "rad_per_s = 2000.0")], &[]);
    assert_says(&found, "task.joints.joint-tracking.gains.frequency_rad_per_s", &["unstable"]);
    let posture = "[task.rest.joint-posture]\nfrequency_rad_per_s = 6.0\ndamping_ratio = 0.8";
    let damping = "[task.rest.joint-damping]\ndamping_nms_per_rad = 500.0";
    let (found, _) = only_diagnostic(HAND, &[(posture, damping)], &[]);
    assert_says(
        &found,
        "task.rest.joint-damping.damping_nms_per_rad",
        &["damping_nms_per_rad = 500", "unstable"],
    );
    let compliant = [
        ("x = \"motion\"", "x = \"compliant\""),
        ("frame = \"hand\"", "frame = \"hand\"\ncompliant_damping_per_s = 3000.0"),
    ];
    let mut found = diagnostics(&experiment(HAND, &compliant, RunOptions::default(), &[]));
    found.retain(|diagnostic| diagnostic.code.name() != "compliant-drift");
    assert_eq!(found.len(), 1, "{found:#?}");
    assert_says(
        &found[0],
        "task.hand.cartesian.compliant_damping_per_s",
        &["compliant_damping_per_s = 3000 along x"],
    );
}

/// Changes that let the hand press on a surface along x, with a gain.
fn pressing(gain: &str) -> [(&'static str, String); 2] {
    [
        ("x = \"motion\"", "x = \"force\"".to_owned()),
        (
            "frame = \"hand\"",
            format!("frame = \"hand\"\nforce = {{ sensor = \"wrist\", target_n = {{ x = -20.0 }}, {gain} }}"),
        ),
    ]
}

/// A gain that is too high for a stated surface, or for a wall of the environment; the gain that is proposed has no
/// diagnostic.
#[test]
fn contact_that_oscillates_is_found() {
    let surface = "surface = { stiffness_n_per_m = 50000.0 }";
    let wall = "\n[environment.board.wall]\nframe = 'hand'\npoint_m = [0.37, 0.0, 0.0]\nnormal = [-1.0, 0.0, 0.0]\n\
                stiffness_n_per_m = 50000.0\ndamping_ns_per_m = 0.0\n";
    for (stated, environment) in [(surface, ""), ("ramp_s = 0.1", wall)] {
        let found = |gain: &str| {
            let changes = pressing(&format!("{gain}, {stated}"));
            let changes: Vec<(&str, &str)> = changes.iter().map(|(old, new)| (*old, new.as_str())).collect();
            let text = format!("{HAND}{environment}");
            diagnostics(&experiment(&text, &changes, RunOptions::default(), &[]))
        };
        let too_high = found("gain = 20.0");
        assert_eq!(too_high.len(), 1, "{too_high:#?}");
        assert_says(
            &too_high[0],
            "task.hand.cartesian.force.gain",
            &["50000 N/m", "gain 20", "may oscillate", "passivity control", "set `gain` to at most"],
        );
        let proposed = too_high[0].help.split("at most ").nth(1).unwrap().split(' ').next().unwrap();
        assert_eq!(found(&format!("gain = {proposed}")), [], "{proposed}");
    }
}

/// An approach whose peak exceeds the torque limits; the speed that is proposed has no diagnostic.
#[test]
fn impact_that_the_joints_cannot_bear_is_found() {
    let found = |speed: &str| {
        let changes = pressing(&format!(
            "contact = {{ approach_m_per_s = {speed} }}, surface = {{ stiffness_n_per_m = 100000.0, damping_ns_per_m = 500.0 }}"
        ));
        let changes: Vec<(&str, &str)> = changes.iter().map(|(old, new)| (*old, new.as_str())).collect();
        diagnostics(&experiment(HAND, &changes, RunOptions::default(), &[]))
    };
    let too_fast = found("1.5");
    assert_eq!(too_fast.len(), 1, "{too_fast:#?}");
    assert_says(
        &too_fast[0],
        "task.hand.cartesian.force.contact",
        &["at 1.5 m/s", "torque limit of", "approach"],
    );
    let proposed = too_fast[0].help.split("approach_m_per_s = ").nth(1).unwrap().split(' ').next().unwrap();
    assert_eq!(found(proposed), [], "{proposed}");
}

/// Compared: limits with each other and with the start position.
#[test]
fn contradictory_limits_are_reported() {
    let (found, _) = only_diagnostic(HAND, &[], &["limits.velocity_fraction=1.5"]);
    assert_says(&found, "limits.velocity_fraction", &["velocity_fraction is 1.5", "1 is used"]);
    let (found, _) = only_diagnostic(HAND, &[], &["limits.torque_fraction=2.0"]);
    assert_says(&found, "limits.torque_fraction", &["torque_fraction is 2"]);

    // The elbow starts in the middle of its range of 2.27 rad; the ranges of the shoulder joints are wider.
    let middle = [("elbow = -1.35", "elbow = -1.134")];
    let text = HAND
        .replace("shoulder_roll = -0.35", "shoulder_roll = -0.8727")
        .replace(OFFSET, "position = { offset_m = [0.0, 0.0, 0.0] }");
    let wide = experiment(&text, &middle, RunOptions::default(), &["limits.position_margin_rad=1.2"]);
    let found = diagnostics(&wide);
    assert!(
        found.iter().any(|f| f.message.contains("both ends of joint 'elbow', whose range is 2.27")),
        "{found:#?}"
    );
    assert!(found.iter().all(|f| !f.message.contains("both ends of joint 'shoulder_pitch'")), "{found:#?}");

    let (found, _) = only_diagnostic(JOINTS, &[("{ elbow = -1.35 }", "{ elbow = -0.004 }")], &[]);
    let words = [
        "joint 'elbow' starts at -0.004",
        "its limit at 0 than position_margin_rad = 0.01",
        "start it at -0.01",
    ];
    assert_says(&found, "start_rad.elbow", &words);
    // Braking from 8 rad/s at 10 rad/s² requires 3.2 rad; the range is 2.27 rad.
    let (found, _) = only_diagnostic(HAND, &[], &["robot.joint.elbow.acceleration_limit_rad_per_s2=10.0"]);
    let words = ["velocity limit of 8 takes a distance of 3.2, but its range is 2.27", "at least 14.2"];
    assert_says(&found, "joint.elbow.acceleration_limit_rad_per_s2", &words);
}

/// Compared: torques, and the weight of the arm in closed form: two links of 1 m and 1 kg with their centres of mass
/// in the middle, the shoulder 0.6 rad above the horizontal and the elbow bent by 1.2 rad.
#[test]
fn weight_beyond_torque_limit_is_reported() {
    let needed = 9.81 * (1.5 * f64::cos(0.6) + 0.5 * f64::cos(1.8));
    assert!((needed - 11.03).abs() < 5e-3);
    let share = |of_needed: f64| format!("limits.torque_fraction={}", of_needed * needed / 60.0);
    let (found, _) = only_diagnostic(TIP, &[], &[&share(0.9)]);
    let words = [
        "joint 'shoulder' needs 11 Nm to hold the start posture, but only 9.93 Nm is allowed",
        "torque_fraction to at least 0.184",
    ];
    assert_says(&found, "limits.torque_fraction", &words);
    // For a limit that small the encoder must be finer.
    let small = [
        "robot.joint.shoulder.torque_limit_nm=8.0",
        "robot.joint.shoulder.rotor.encoder_counts_per_turn=65536",
    ];
    let (found, line) = only_diagnostic(TIP, &[], &small);
    assert_says(&found, "joint.shoulder.torque_limit_nm", &["needs", "only 8 Nm is allowed"]);
    assert_eq!(line, None, "told at the setting");
    // Slightly more torque than required.
    let enough = share(1.01);
    assert_eq!(diagnostics(&experiment(TIP, &[], RunOptions::default(), &[&enough])), []);

    // At the end of the motion the arm is stretched farther, and its weight causes more torque than at the start.
    let stretched = TIP.replace(
        "reference = \"hold\"",
        "reference.point-to-point = { position = { offset_m = [0.6, 0.0, 0.0] }, duration_s = 1.5 }",
    );
    let (found, _) = only_diagnostic(&stretched, &[], &[&enough]);
    assert_says(
        &found,
        "limits.torque_fraction",
        &["joint 'shoulder' needs", "to hold the reference posture at"],
    );
    let (found, _) =
        only_diagnostic(&stretched, &[], &["robot.joint.shoulder.torque_rate_limit_nm_per_s=2.0"]);
    let words = ["gravity torque of joint 'shoulder'", "its torque rate limit is 2 Nm/s"];
    assert_says(&found, "joint.shoulder.torque_rate_limit_nm_per_s", &words);
}

/// Compared: the lost direction, and the geometry: a straight arm cannot move its tip along the arm.
#[test]
fn singular_start_is_reported() {
    let straight =
        |elbow: &str| [("shoulder = 0.6, elbow = 1.2", format!("shoulder = 0.0, elbow = {elbow}"))];
    for (elbow, lost) in [("0.0", "cannot be moved along"), ("0.02", "% of its force along")] {
        let changes = straight(elbow);
        let (found, _) =
            only_diagnostic(TIP, &changes.each_ref().map(|(old, new)| (*old, new.as_str())), &[]);
        assert_says(&found, "start_rad", &["task 'tip'", lost, "start with joint 'elbow' at "]);
        let along = found.message.split("along ").nth(1).unwrap();
        assert!(
            along.starts_with("x") || along.starts_with("z"),
            "the arm lies nearly along an axis: {found:?}"
        );
        // The proposed start.
        let better = found.help.split(" at ").nth(1).unwrap().split(' ').next().unwrap();
        let changes = straight(better);
        let better = experiment(
            TIP,
            &changes.each_ref().map(|(old, new)| (*old, new.as_str())),
            RunOptions::default(),
            &[],
        );
        assert_eq!(diagnostics(&better), []);
    }
}

#[test]
fn freedom_without_a_task_is_reported() {
    let rest = "[task.rest.joint-posture]\nfrequency_rad_per_s = 6.0\ndamping_ratio = 0.8\n";
    let (found, line) = only_diagnostic(HAND, &[("\"hand\", \"rest\"", "\"hand\""), (rest, "")], &[]);
    assert_says(&found, "priority", &["1 of the 4 degrees of freedom", "[task.rest.joint-damping]"]);
    assert_eq!(line, Some(5));
    // Damping of zero is intentional.
    let zero = experiment(
        HAND,
        &[(rest, "[task.rest.joint-damping]\ndamping_nms_per_rad = 0.0\n")],
        RunOptions::default(),
        &[],
    );
    assert_eq!(diagnostics(&zero), []);
}

#[test]
fn too_short_run_is_reported() {
    let event = |time_s: &str| {
        format!(
            "{HAND}[[event]]\ntime_s = {time_s}\nset = [\"task.hand.cartesian.gains.damping_ratio=0.9\"]\n"
        )
    };
    let (found, _) = only_diagnostic(&event("2.0"), &[], &[]);
    assert_says(&found, "event.0.time_s", &["the event at 2 s does not occur: the run ends at 2 s"]);
    assert_eq!(diagnostics(&experiment(&event("1.9"), &[], RunOptions::default(), &[])), []);

    let longer = [("0.05] }, duration_s = 1.0", "0.05] }, duration_s = 2.5")];
    let (found, line) = only_diagnostic(HAND, &longer, &[]);
    assert_says(
        &found,
        "duration_s",
        &["'hand': its reference arrives at 2.5 s, but the run ends at 2 s", "duration_s = 2.5"],
    );
    assert_eq!(line, Some(3));
    let goal = "reference.goal = { position = { offset_m = [0.05, 0.0, 0.05] }, velocity_m_per_s = 0.02, \
                acceleration_m_per_s2 = 1.0, jerk_m_per_s3 = 10.0 }";
    let before =
        "reference.point-to-point = { position = { offset_m = [0.05, 0.0, 0.05] }, duration_s = 1.0 }";
    let (found, _) = only_diagnostic(HAND, &[(before, goal)], &[]);
    assert_says(
        &found,
        "duration_s",
        &["has not arrived when the run ends at 2 s: it still moves at 0.02 m/s"],
    );
    let faster = goal.replace("velocity_m_per_s = 0.02", "velocity_m_per_s = 0.2");
    assert_eq!(diagnostics(&experiment(HAND, &[(before, &faster)], RunOptions::default(), &[])), []);

    let (found, _) = only_diagnostic(HAND, &[("settle_s = 0.5", "settle_s = 0.1")], &[]);
    assert_says(&found, "settle_s", &["start at 0.1 s", "over the first 0.2 s", "settle_s = 0.2"]);
}

/// Compared: the phase margin of an admittance with the simulated force of an arm without friction. Below zero it oscillates;
/// the proposed admittance is quiet, and nothing is reported.
#[test]
fn unstable_admittance_is_reported() {
    let ik = || RunOptions { controller: ControllerKind::Ik, ..RunOptions::default() };
    let no_friction = "robot.simulated.true_over_nominal.friction=0.0";
    let force_rms_n = |experiment: &Experiment| {
        let finished = experiment.run(std::io::Cursor::new(Vec::new()), &Progress::default()).unwrap();
        let recording = Recording::from_bytes(&finished.sink.into_inner()).unwrap();
        metrics(experiment, &recording).contact.force_rms_n.unwrap()
    };
    let press = format!("{PRESS}{}", table(50_000.0));
    for (profile, given) in [("a-med", "50.0"), ("b-soft", "20.0")] {
        let set = format!("task.hand.cartesian.force.admittance_ns_per_m={given}");
        let options = RunOptions { profile: Some(profile.to_owned()), ..ik() };
        let unstable = experiment(&press, &[], options.clone(), &[no_friction, &set]);
        let found = diagnostics(&unstable);
        let [finding] = &found[..] else { panic!("{found:#?}") };
        assert_eq!(finding.key(), "task.hand.cartesian.force.admittance_ns_per_m");
        assert!(finding.message.contains("would be unstable on 'table' of 50000 N/m"), "{}", finding.message);
        let proposed = finding.help.split(' ').nth(2).unwrap();
        let set = format!("task.hand.cartesian.force.admittance_ns_per_m={proposed}.0");
        let steady = experiment(&press, &[], options, &[no_friction, &set]);
        assert_eq!(diagnostics(&steady), []);
        let [unstable, steady] = [&unstable, &steady].map(force_rms_n);
        assert!(unstable > 1.0 && steady < 0.2, "{profile}: {unstable} N, {steady} N with {proposed} Ns/m");
    }
    // The servos yield too: with 100 Ns/m, no object is too stiff.
    let unknown = |given: &str| {
        let set = format!("task.hand.cartesian.force.admittance_ns_per_m={given}");
        not_checked(&experiment(PRESS, &[], ik(), &[&set]))
    };
    assert_eq!(unknown("100.0"), []);
    let found = unknown("50.0");
    let [finding] = &found[..] else { panic!("{found:#?}") };
    assert!(finding.message.contains("what the hand touches along z is not known"), "{}", finding.message);
}

/// A compliant axis that nothing holds is pointed out once; a spring, a regulated force or an object that holds the frame is not.
#[test]
fn compliant_axis_that_stays_away_is_reported() {
    let compliant = [("x = \"motion\", y", "x = \"compliant\", y")];
    let (found, _) = only_diagnostic(HAND, &compliant, &[]);
    assert_eq!(found.code.name(), "compliant-drift");
    assert_says(
        &found,
        "task.hand.cartesian.axes",
        &["nothing brings 'hand' back along x", "stiffness_n_per_m = { x = 100.0"],
    );
    let again =
        "[[event]]\ntime_s = 1.0\nset = [\"task.rest.joint-posture.damping_ratio=1.0\"]\n\n[task.rest";
    let (once, _) = only_diagnostic(HAND, &[compliant[0], ("[task.rest", again)], &[]);
    assert_eq!(once.key(), found.key());
    let holds = |addition: &str| {
        let changed = experiment(HAND, &[compliant[0], ("[task.rest", addition)], RunOptions::default(), &[]);
        assert_eq!(diagnostics(&changed), [], "{addition}");
    };
    holds("force = { sensor = \"wrist\", target_n = 0.0, gain = 1.0, filter_hz = 100.0 }\n[task.rest");
    holds(
        "[environment.someone.spring]\nframe = \"hand\"\nstiffness_n_per_m = 200.0\ndamping_ns_per_m = 15.0\n\
         motion.random = { rms_m = 0.025, from_hz = 0.1, to_hz = 0.7, ramp_s = 1.0 }\n[task.rest",
    );
    let pushed = "[environment.someone.pushes]\nframe = \"hand\"\npush = [{ at_s = 0.5, duration_s = 0.2, force_n = [5.0, 0.0, 0.0] }]\n[task.rest";
    let (pushed, _) = only_diagnostic(HAND, &[compliant[0], ("[task.rest", pushed)], &[]);
    assert_eq!(pushed.code, found.code);
}
