//! Statements of summaries, in the terminal and in the page. Each code that a run can give has a run that gives it, and each key of
//! summary.json is in one of the lists below.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use crate::cli_common::{Ran, opspace, project, read, read_json, scratch};
use opspace_backend::{Backend, GroundTruth, Sample};
use opspace_experiment::codes::Effect;
use opspace_experiment::{Code, Entry, Experiment, Files, Metric, Progress, RunOptions};
use opspace_log::Recording;
use opspace_report::document::RunSection;
use serde_json::Value;
use std::fs;
use std::io::Cursor;
use std::path::Path;

/// A run of a task of the project.
struct Case {
    task: &'static str,
    options: &'static [&'static str],
    settings: &'static [&'static str],
    exit: i32,
}

/// Text of a run.
struct Texts {
    summary: Value,
    terminal: String,
    page: String,
}

impl Texts {
    /// Returns the text of a folder of results, and of the command that wrote it.
    fn of(folder: &Path, ran: &Ran) -> Self {
        let page = read(folder.join("report.html"));
        let page =
            page.replace("&#39;", "'").replace("&quot;", "\"").replace("&lt;", "<").replace("&gt;", ">");
        let page = page.replace("&amp;", "&");
        let terminal = format!("{}\n{}", ran.stdout, ran.stderr);
        Self { summary: read_json(folder.join("summary.json")), terminal, page }
    }

    #[track_caller]
    fn say(&self, text: &str) {
        assert!(self.terminal.contains(text), "'{text}' is not in the terminal:\n{}", self.terminal);
        assert!(self.page.contains(text), "'{text}' is not in the page");
    }

    /// Value of a key of the summary, or of one of its metrics.
    fn value(&self, key: &str) -> &Value {
        let metric = &self.summary["metrics"][key];
        if metric.is_null() { &self.summary[key] } else { metric }
    }

    /// Checks that the run has the code, says so, and has the values that the code is about.
    #[track_caller]
    fn say_code(&self, code: Code) {
        let findings = self.summary["findings"].as_array().unwrap();
        let mut own = findings.iter().filter(|finding| finding["code"] == code.name()).peekable();
        assert!(own.peek().is_some(), "{code}: {findings:#?}\n{}", self.terminal);
        own.for_each(|finding| self.say(finding["message"].as_str().unwrap()));
        for (key, _) in BY_CODE.iter().filter(|(_, other)| *other == code) {
            let value = self.value(key);
            let is_told = value.as_f64().is_some_and(|value| value != 0.0)
                || value.as_array().is_some_and(|values| !values.is_empty());
            assert!(is_told, "{code}: {key} is {value}");
        }
    }
}

impl Case {
    #[track_caller]
    fn run(&self) -> Texts {
        let folder = scratch();
        let task = project(&format!("tasks/{}.toml", self.task));
        let settings = self.settings.iter().flat_map(|setting| ["--set", *setting]);
        let arguments: Vec<&str> = ["run", &task, "--out", "run"].into_iter().collect();
        let arguments: Vec<&str> =
            arguments.into_iter().chain(self.options.iter().copied()).chain(settings).collect();
        let ran = opspace(folder.path(), &arguments).exits(self.exit);
        Texts::of(&folder.path().join("run"), &ran)
    }
}

/// Defines a test for each code, and the list of these codes.
macro_rules! cases {
    ($($code:ident $test:ident $exit:literal $task:literal [$($option:literal),*] [$($setting:literal),* $(,)?],)*) => {
        /// Codes that runs of single robots give.
        const CASES: &[Code] = &[$(Code::$code),*];

        $(
            #[test]
            fn $test() {
                let case = Case { task: $task, options: &[$($option),*], settings: &[$($setting),*], exit: $exit };
                case.run().say_code(Code::$code);
            }
        )*
    };
}

cases! {
    NeverTouched never_touched 1 "press-wall" ["--duration-s", "1.5"]
        ["settle_s=0.5", "environment.board.wall.point_m=[0.9, 0.0, 0.0]"],
    ContactLost contact_lost 1 "press-wall" ["--duration-s", "4", "--backend", "torque"] [
        "settle_s=3.5",
        "task.hand.reference=\"hold\"",
        "event=[{ time_s = 1.5, set = [\"task.hand.cartesian.force.target_n.x=20.0\"] }]",
    ],
    CyclesMissed cycles_missed 1 "compliant-x" ["--duration-s", "1"]
        ["settle_s=0.2", "robot.simulated.bus.dropouts=[{ at_s = 0.3, duration_s = 0.15 }]"],
    JointsHeld joints_held 1 "joint-tracking" ["--duration-s", "2", "--backend", "torque"]
        ["robot.simulated.true_over_nominal.friction=200.0"],
    ControlInterrupted control_interrupted 0 "compliant-x" ["--duration-s", "2"]
        ["robot.simulated.bus.dropouts=[{ at_s = 0.4, duration_s = 0.1 }]"],
    SetpointsClamped setpoints_clamped 0 "panda-tracking" ["--duration-s", "1.5"] [
        "settle_s=0.2",
        "robot.simulated.bus.lost_cycles_share=0.08",
        "robot.profile.interface-1khz.setpoint_limits={ reaction = \"clamp\", joint = { joint1 = { velocity_rad_per_s = 1.0, \
         acceleration_rad_per_s2 = 5.0, jerk_rad_per_s3 = 500.0 } } }",
    ],
    GoalNotReached goal_not_reached 0 "panda-goals" ["--duration-s", "3"] [
        "event=[]",
        "task.flange.reference={ point-to-point = { position = { offset_m = [-0.35, 0.0, -0.2] }, duration_s = 1.0 } }",
    ],
    ReferenceLimited reference_limited 0 "panda-goals" ["--duration-s", "2"] [
        "event=[]",
        "limits.velocity_fraction=0.2",
        "task.flange.reference={ sinusoid = { y = [{ amplitude_m = 0.12, frequency_hz = 1.0 }] } }",
    ],
    EscapedSingularity escaped_singularity 0 "ur5e-straight" [] [],
    DampedDirection damped_direction 0 "ur5e-pulled-straight" ["--duration-s", "2.5"] [],
    CompliantAxesMoved load_falls 0 "panda-compliant" ["--duration-s", "2"] [
        "task.flange.cartesian.axes.z=\"compliant\"",
        "environment={ load = { mass = { frame = \"flange\", mass_kg = 2.0, put_on_s = 0.5 } } }",
    ],
    SpringDeflected spring_deflected 0 "panda-impedance" [] [
        "friction_compensation.gain=0.0",
        "task.flange.cartesian.impedance.stiffness_n_per_m=60.0",
    ],
    TorquesSaturated torques_saturated 0 "joint-tracking" ["--duration-s", "2", "--backend", "torque"]
        ["robot.joint.elbow.torque_limit_nm=1.0"],
    IgnoredCompliance ignored_compliance 0 "compliant-x" ["--duration-s", "2", "--controller", "ik"] [],
    DampedCompliance damped_compliance 0 "compliant-x" ["--duration-s", "2"] [
        "robot.interface.gears=\"elastic\"",
        "robot.interface.measured=[\"position\"]",
        "robot.profile.a-med.servo.elbow.cascaded.gain_uncertainty=0.3",
    ],
}

/// Codes of runs without a case above, each with the test that has it.
const ELSEWHERE: &[(Code, &str)] = &[
    (Code::StaleTargets, "`stale_targets` below: only a program streams targets"),
    (
        Code::SetpointsLimited,
        "`setpoints_limited` below: the loop keeps to the limits that robot.toml declares",
    ),
];

#[test]
fn each_code_of_a_run_has_a_case() {
    for code in Code::ALL {
        let is_of_run = matches!(code.effect(), Effect::Noted | Effect::Failed)
            || [Code::IgnoredCompliance, Code::DampedCompliance].contains(code);
        let places = CASES.iter().filter(|case| *case == code).count()
            + ELSEWHERE.iter().filter(|(other, _)| other == code).count();
        assert_eq!(places, usize::from(is_of_run), "{code}");
    }
}

/// Keys of summary.json, and of its metrics, that a finding states in words.
const BY_CODE: &[(&str, Code)] = &[
    ("missed_cycles", Code::ControlInterrupted),
    ("resumed", Code::ControlInterrupted),
    ("stale_target_cycles", Code::StaleTargets),
    ("failures", Code::NeverTouched),
    ("unreached_goals", Code::GoalNotReached),
    ("limited_references", Code::ReferenceLimited),
    ("limited_share", Code::ReferenceLimited),
    ("escapes", Code::EscapedSingularity),
    ("ignored_compliance", Code::IgnoredCompliance),
    ("compliant_motion_rms_m", Code::CompliantAxesMoved),
    ("damped_fraction", Code::DampedDirection),
    ("torque_saturated_share", Code::TorquesSaturated),
    ("setpoints_clamped", Code::SetpointsClamped),
    ("setpoints_limited", Code::SetpointsLimited),
    ("missed_fraction", Code::CyclesMissed),
];

/// Keys that are stated in other words, each with the test.
const BY_OTHER_WORDS: &[(&str, &str)] = &[
    ("transformer", "the_choice_of_the_transformer_is_said"),
    ("transformer_reason", "the_choice_of_the_transformer_is_said"),
    ("faulted", "a_stop_is_said"),
    ("fault_time_s", "a_stop_is_said"),
    ("missed_expectations", "a_missed_expectation_is_said"),
    ("assumed", "assumed_values_are_said"),
    ("position_final_m", "errors_at_the_end_are_said"),
    ("orientation_final_rad", "errors_at_the_end_are_said"),
    ("force_final_n", "`notes.rs`: forces_that_are_missed_at_the_end_are_noted"),
    ("in_contact_fraction", "never_touched, contact_lost"),
    ("contact_begin_s", "`notes.rs`: forces_that_are_missed_at_the_end_are_noted"),
    ("contact_losses", "`notes.rs`: forces_that_are_missed_at_the_end_are_noted"),
    ("sensed_contact_losses", "`notes.rs`: forces_that_are_missed_at_the_end_are_noted"),
    ("allowed", "`allow.rs`"),
    ("replay", "`replay.rs`"),
    ("interrupted", "`exit_codes.rs`"),
    ("interrupted_time_s", "`exit_codes.rs`"),
    ("rows_lost", "`result_files.rs`"),
    ("not_saved", "`result_files.rs`"),
];

/// Keys that identify the run, in the title or the table.
const IDENTITY: &[&str] = &[
    "task",
    "robot",
    "backend",
    "controller",
    "profile",
    "ratio",
    "seed",
    "simulated",
    "plant",
    "duration_s",
    "overrides",
    "label",
    "findings",
    "metrics",
    "tasks",
    "frames",
    "joints",
    "task_order",
    "joint_order",
    "timing",
];

/// Metrics that are quantities: tables show them, and no value of them alone asks for an action.
const QUANTITIES: &[&str] = &[
    "position_rms_m",
    "position_max_m",
    "orientation_rms_rad",
    "orientation_max_rad",
    "joint_rms_rad",
    "force_rms_n",
    "force_error_max_n",
    "force_hold_rms_n",
    "force_moving_rms_n",
    "force_settle_s",
    "contact_peak_n",
    "late_contact_losses",
    "passivity_active_s",
    "compliant_work_j",
    "external_force_max_n",
    "deflection_max_m",
    "stiffness_n_per_m",
    "hysteresis_m",
    "return_m",
    "slack_rms_m_per_s2",
    "slack_max_m_per_s2",
    "slack_rms_rad_per_s2",
    "slack_max_rad_per_s2",
    "hand_force_rms_n",
    "estimate_rms_n",
    "hole_depth_m",
    "drawer_opening_max_m",
    "hand_motion_rms_m",
    "torque_error_servo",
    "torque_error_interval",
    "torque_error_tick",
    "hold_ripple",
    "setpoint_speed_max_rad_per_s",
    "setpoint_acceleration_max_rad_per_s2",
    "torque_commanded_max_nm",
    "torque_step_max_nm",
    "speed_max_rad_per_s",
    "least_distance_m",
    "torque_chatter_rms_nm",
    "torque_chatter_hz",
    "torque_error_of_limit_max",
    "tick_ns_median",
    "realtime_factor",
];

/// Checks that each metric, and each key of a summary, is in one of the lists.
#[test]
fn each_key_is_said_or_a_quantity() {
    let run = Case {
        task: "joint-tracking",
        options: &["--duration-s", "1"],
        settings: &["settle_s=0.2"],
        exit: 0,
    };
    let summary = run.run().summary;
    let keys = summary.as_object().unwrap().keys().chain(summary["metrics"].as_object().unwrap().keys());
    let keys: Vec<String> =
        keys.cloned().chain(Metric::built_in().iter().map(|metric| metric.key.to_owned())).collect();
    let lists: Vec<&str> = BY_CODE
        .iter()
        .map(|(key, _)| *key)
        .chain(BY_OTHER_WORDS.iter().map(|(key, _)| *key))
        .chain(IDENTITY.iter().chain(QUANTITIES).copied())
        .collect();
    for key in &keys {
        assert_eq!(lists.iter().filter(|other| *other == key).count(), 1, "{key}");
    }
    // Keys that are absent where they do not apply.
    let absent = ["assumed", "allowed", "replay", "ignored_compliance", "frames"];
    let is_known = |key: &&str| keys.iter().any(|other| other == key) || absent.contains(key);
    let unknown: Vec<&&str> = lists.iter().filter(|key| !is_known(key)).collect();
    assert!(unknown.is_empty(), "{unknown:?}");
}

#[test]
fn the_choice_of_the_transformer_is_said() {
    let case = Case {
        task: "joint-tracking",
        options: &["--duration-s", "1", "-v"],
        settings: &["settle_s=0.2"],
        exit: 0,
    };
    let texts = case.run();
    let text = |key: &str| texts.summary[key].as_str().unwrap().to_owned();
    let (name, reason) = (text("transformer"), text("transformer_reason"));
    // The terminal breaks lines.
    let terminal = texts.terminal.split_whitespace().collect::<Vec<_>>().join(" ");
    let choice = format!("Transformer '{name}': {reason}.");
    Texts { terminal, ..texts }.say(&choice);
}

#[test]
fn a_stop_is_said() {
    let case = Case {
        task: "joint-tracking",
        options: &["--duration-s", "2.5"],
        settings: &["robot.simulated.bus.dropouts=[{ at_s = 0.3, duration_s = 1.5 }]"],
        exit: 1,
    };
    let texts = case.run();
    texts.say(texts.summary["faulted"].as_str().unwrap());
}

#[test]
fn a_missed_expectation_is_said() {
    let case = Case {
        task: "joint-tracking",
        options: &["--duration-s", "1"],
        settings: &["settle_s=0.2", "expect={ joint_rms_rad = { at_most = 1e-9 } }"],
        exit: 1,
    };
    let texts = case.run();
    texts.say(texts.summary["missed_expectations"][0].as_str().unwrap());
}

#[test]
fn assumed_values_are_said() {
    let case = Case {
        task: "joint-tracking",
        options: &["--duration-s", "1", "-v"],
        settings: &["settle_s=0.2", "robot.assumed=[\"joint.elbow.torque_limit_nm\"]"],
        exit: 0,
    };
    case.run().say("rest on assumed values (`assumed` in its robot.toml): torque_limit_nm of elbow");
}

#[test]
fn errors_at_the_end_are_said() {
    // A weight that the model does not have.
    let case = Case {
        task: "panda-tracking",
        options: &["--duration-s", "1.5"],
        settings: &[
            "settle_s=0.2",
            "task.flange.cartesian.reference=\"hold\"",
            "environment.load={ mass = { frame = \"flange\", mass_kg = 2.0, put_on_s = 0.2 } }",
        ],
        exit: 0,
    };
    case.run().say("goal not reached, ");
}

/// A program renews a target too rarely; `opspace replay` runs another task on the log.
#[test]
fn stale_targets() {
    let folder = scratch();
    let options = RunOptions { duration_s: Some(1.0), ..RunOptions::default() };
    let task = project("examples/tasks/streamed.toml");
    let experiment = Experiment::load(Files::Disk, Path::new(&task), None, options, &[]).unwrap();
    let mut arm = experiment.simulated_arm().unwrap();
    let (capabilities, truth) = (arm.capabilities().clone(), arm.ground_truth().map(GroundTruth::layouts));
    let log = folder.path().join("run.mcap");
    let body = |run: &mut opspace_loop::Run<'_>| {
        let mut hand = opspace_control::CartesianTarget::of(run.targets(), "hand").unwrap();
        hand.twist([0.0; 6]).unwrap();
        let mut sample = Sample::new(&capabilities);
        let mut cycles = 0;
        while !run.is_over() {
            arm.read(&mut sample).unwrap();
            if cycles == 10 {
                hand.write(run.targets(), sample.time_s).unwrap();
            }
            if let Some(command) = run.cycle(&sample) {
                arm.write(command).unwrap();
            }
            cycles += 1;
        }
        arm.stop();
    };
    let file = fs::File::create(&log).unwrap();
    experiment.run_with(&capabilities, truth, file, &Progress::default(), body).unwrap();
    let arguments = ["replay", "run.mcap", "--set", "settle_s=0.3", "--out", "again"];
    let ran = opspace(folder.path(), &arguments);
    Texts::of(&folder.path().join("again"), &ran.exits(0)).say_code(Code::StaleTargets);
}

/// Drives that accept less than robot.toml declares. A simulated drive has the declared limits, so the arm is that of another file;
/// the page has the note, and the terminal has the notes of a page.
#[test]
fn setpoints_limited() {
    let experiment = |settings: &[&str]| {
        let settings: Vec<String> = settings.iter().map(|setting| (*setting).to_owned()).collect();
        let options = RunOptions { duration_s: Some(1.0), ..RunOptions::default() };
        let task = project("tasks/panda-tracking.toml");
        Experiment::load(Files::Disk, Path::new(&task), None, options, &settings).unwrap()
    };
    let limits = "robot.profile.interface-1khz.setpoint_limits={ reaction = \"clamp\", joint = { joint1 = { velocity_rad_per_s = 0.1, \
                  acceleration_rad_per_s2 = 1.0, jerk_rad_per_s3 = 100.0 } } }";
    let (declared, limited) = (experiment(&["settle_s=0.2"]), experiment(&["settle_s=0.2", limits]));
    let mut arm = limited.simulated_arm().unwrap();
    let result = declared.run_on(&mut arm, Cursor::new(Vec::new()), &Progress::default()).unwrap();
    let recording = Recording::from_bytes(&result.sink.into_inner()).unwrap();
    let summary = declared.summary(&recording, &result.record, None);
    assert!(summary.metrics.setpoints_limited > Some(0), "{:?}", summary.metrics.setpoints_limited);
    let message = summary.findings.of(Code::SetpointsLimited).next().unwrap().to_string();
    let section = RunSection::new(&declared, &recording, summary);
    assert!(section.warnings.contains(&format!("Note: {message}.")), "{message}: {:?}", section.warnings);
}
