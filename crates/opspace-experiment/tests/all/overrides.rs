//! Compared: settings from the command line, and the file edited by hand: equal values, and errors that name the
//! settings.

use opspace_experiment::files::overrides::{KINDS, apply, apply_below, split};
use opspace_experiment::files::source::{FileError, Source, parse};
use opspace_experiment::{Experiment, Files, RunOptions};
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

const FILE: &str = r#"# the hand is compliant in x
robot = "../robots/asimo-arm"
seed = 1
[task.hand.cartesian]
frame = "hand" # the frame
gains = { frequency_rad_per_s = 14.142, damping_ratio = 1.0 }
motion.random = { rms_m = 0.025 }
[task.rest.joint-posture]
frequency_rad_per_s = 6.325
damping_ratio = 0.79
[[via]]
time_s = 1.0
[[via]]
time_s = 2.0
"#;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "read by serde")]
struct TaskFile {
    robot: String,
    seed: u32,
    duration_s: Option<f64>,
    task: BTreeMap<String, Task>,
    via: Vec<Via>,
    simulated: Option<Simulated>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[expect(dead_code, reason = "read by serde")]
enum Task {
    Cartesian(Cartesian),
    JointPosture(Gains),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "read by serde")]
struct Cartesian {
    frame: String,
    gains: Gains,
    motion: Motion,
    force: Option<Force>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[expect(dead_code, reason = "read by serde")]
enum Motion {
    Random { rms_m: f64 },
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "read by serde")]
struct Gains {
    frequency_rad_per_s: f64,
    damping_ratio: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "read by serde")]
struct Force {
    target_n: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "read by serde")]
struct Via {
    time_s: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "read by serde")]
struct Simulated {
    true_over_nominal: BTreeMap<String, f64>,
}

fn source() -> Source {
    Source::new("tasks/x.toml", FILE)
}

fn set(settings: &[&str]) -> Result<Source, FileError> {
    let settings: Vec<String> = settings.iter().map(|&setting| setting.to_owned()).collect();
    apply(&source(), &settings)
}

fn table(text: &str) -> toml::Table {
    text.parse().expect("TOML")
}

/// Compares a file with a setting to the file edited by hand, and checks that it is accepted.
#[track_caller]
fn check_equals_edited_file(setting: &str, from: &str, to: &str) {
    let applied = set(&[setting]).expect("applied");
    assert!(FILE.contains(from), "{from:?} is not in the file");
    assert_eq!(table(applied.text()), table(&FILE.replacen(from, to, 1)), "{setting}\n{}", applied.text());
    parse::<TaskFile>(&applied).expect("accepted");
}

/// Returns the error of reading the file with the given settings.
fn refusal(settings: &[&str]) -> FileError {
    match set(settings) {
        Err(error) => error,
        Ok(source) => parse::<TaskFile>(&source).expect_err("refused"),
    }
}

#[test]
fn values_in_every_kind_of_table_are_replaced() {
    check_equals_edited_file("seed=7", "seed = 1", "seed = 7");
    check_equals_edited_file(
        "task.hand.cartesian.gains.damping_ratio=0.7",
        "damping_ratio = 1.0",
        "damping_ratio = 0.7",
    );
    check_equals_edited_file("task.hand.cartesian.motion.random.rms_m = 1e-3", "0.025", "1e-3");
    check_equals_edited_file("task.rest.joint-posture.damping_ratio=1", "0.79", "1");
    check_equals_edited_file("via.1.time_s=3.5", "2.0", "3.5");
    check_equals_edited_file("task.\"hand\".'cartesian'.frame=wrist", "\"hand\"", "\"wrist\"");
    check_equals_edited_file("robot=../robots/other_arm-2", "../robots/asimo-arm", "../robots/other_arm-2");
}

#[test]
fn kind_tags_may_be_omitted() {
    check_equals_edited_file(
        "task.hand.gains.damping_ratio=0.7",
        "damping_ratio = 1.0",
        "damping_ratio = 0.7",
    );
    check_equals_edited_file("task.hand.frame=wrist", "\"hand\"", "\"wrist\"");
    check_equals_edited_file("task.hand.motion.rms_m=0.5", "0.025", "0.5");
    check_equals_edited_file("task.rest.damping_ratio=1", "0.79", "1");
    check_equals_edited_file(
        "task.hand.force.target_n=2",
        "motion.random",
        "force.target_n = 2\nmotion.random",
    );
}

#[test]
fn tables_and_new_keys_are_set() {
    check_equals_edited_file("duration_s=8", "seed = 1", "seed = 1\nduration_s = 8");
    check_equals_edited_file(
        "simulated.true_over_nominal.kp=1.2",
        "[[via]]",
        "[simulated.true_over_nominal]\nkp = 1.2\n[[via]]",
    );
    check_equals_edited_file(
        "task.hand.gains={frequency_rad_per_s=1, damping_ratio=2}",
        "{ frequency_rad_per_s = 14.142, damping_ratio = 1.0 }",
        "{ frequency_rad_per_s = 1, damping_ratio = 2 }",
    );
    check_equals_edited_file(
        "task.third={joint-posture={frequency_rad_per_s=1, damping_ratio=2}}",
        "[task.rest",
        "[task.third.joint-posture]\nfrequency_rad_per_s = 1\ndamping_ratio = 2\n[task.rest",
    );
    let replaced =
        set(&["task.rest.joint-posture={frequency_rad_per_s=1, damping_ratio=2}"]).expect("applied");
    let posture = &table(replaced.text())["task"]["rest"]["joint-posture"];
    assert_eq!(posture["damping_ratio"].as_integer(), Some(2));
}

#[test]
fn last_setting_wins_and_comments_stay() {
    let applied = set(&["seed=2", "task.hand.frame=wrist", "seed=3"]).expect("applied");
    assert_eq!(table(applied.text())["seed"].as_integer(), Some(3));
    assert!(applied.text().contains("frame = \"wrist\" # the frame"), "{}", applied.text());
    assert_eq!(set(&[]).expect("applied").text(), FILE);
}

#[test]
fn setting_error_names_the_setting() {
    let misspelt = refusal(&["seed=2", "task.hand.gains.dampng_ratio=0.7"]);
    assert_eq!(misspelt.to_string(), "--set task.hand.gains.dampng_ratio=0.7: unknown key `dampng_ratio`");
    assert_eq!(
        misspelt.help(),
        Some("did you mean `damping_ratio`?\nallowed here: `frequency_rad_per_s`, `damping_ratio`")
    );
    assert_eq!((misspelt.path(), misspelt.line()), ("--set", None));
    let cases = [
        ("seed=-1", "expected a whole number not below 0, got -1"),
        ("task.rest.damping_ratio=nan", "expected a finite number, got nan"),
        ("task.rest.damping_ratio=1e999", "expected a finite number, got inf"),
        ("task.rest.damping_ratio=high", "expected a number, got the text \"high\""),
        (
            "task.rest.frequency_hz=1",
            "`task.rest` has `joint-posture`, `frequency_hz`; it must have exactly one kind",
        ),
        ("task.hand.gains=3", "expected a table, got 3"),
        (
            "task.hand.gains={damping_ratio=1}",
            "missing key `frequency_rad_per_s` in `task.hand.cartesian.gains`",
        ),
        ("seed.x=1", "`seed` is of type integer: it has no key `x`"),
        ("via.2.time_s=1", "`via` has elements 0 to 1, but no element `2`"),
        ("via.1=3", "`via.1` is one of several tables: set its keys"),
        ("seed", "a setting needs an `=`"),
        ("=3", "`` is not a key"),
        ("a b=3", "`a b` is not a key"),
        ("seed=", "a value is missing after `=`"),
        ("task.rest.damping_ratio=400 N/m", "`400 N/m` is neither a TOML value nor a single word"),
        ("robot=[1", "`[1` is neither a TOML value nor a single word"),
    ];
    for (setting, message) in cases {
        let error = refusal(&[setting]);
        assert_eq!(error.to_string(), format!("--set {setting}: {message}"));
    }
}

/// Compared: numbers as people write them, and their value in TOML. Points of texts and of numbers with a digit stay.
#[test]
fn numbers_without_a_digit_beside_the_point_are_read() {
    for (given, read) in [
        (".5", "0.5"),
        ("1.", "1.0"),
        ("+.5", "+0.5"),
        ("1e3", "1e3"),
        ("[.1,0.2]", "[0.1,0.2]"),
        ("[-.1, +.25, 3.]", "[-0.1, +0.25, 3.0]"),
        ("{ x = .5, y = '.5' }", "{ x = 0.5, y = '.5' }"),
    ] {
        let text = set(&[&format!("start_rad={given}")]).expect(given).text().to_owned();
        assert_eq!(table(&text)["start_rad"], table(&format!("x = {read}"))["x"], "{given}");
    }
    for other in ["[.x]", "[.1", "[1.2.3]"] {
        let error = refusal(&[&format!("start_rad={other}")]);
        assert!(error.message().contains("neither a TOML value"), "{other}: {}", error.message());
    }
}

/// A number without a digit beside its point in a file: the line, and the form to write.
#[test]
fn numbers_of_a_file_have_the_form_to_write() {
    for (given, form) in
        [(".3", "0.3"), ("1.", "1.0"), ("+.5", "+0.5"), ("-1.e3", "-1.0e3"), ("[1.0, .3]", "0.3")]
    {
        let source = Source::new("arm.toml", format!("seed = 1\nduration_s = {given}\n"));
        let error = parse::<TaskFile>(&source).expect_err(given);
        assert_eq!(error.line(), Some(2), "{given}: {error}");
        assert!(error.message().contains("a digit on both sides of the point"), "{given}: {error}");
        assert_eq!(error.help(), Some(&*format!("write `{form}`")), "{given}");
    }
}

/// Checks that a table with one table in it is not taken for a kind: a setting adds the other one beside it. An empty table and
/// an absent one are the same.
#[test]
fn table_beside_a_sole_table_is_added() {
    let settings = ["simulated.cogging.periods=12", "simulated.true_over_nominal.kp=1.1"].map(str::to_owned);
    for file in
        ["", "[simulated]\n", "[simulated.cogging]\nperiods = 3\n", "[simulated.gear.J]\nbacklash = 1.0\n"]
    {
        let text = apply(&Source::new("robot.toml", file), &settings).expect("applied").text().to_owned();
        let simulated = &table(&text)["simulated"];
        assert_eq!(simulated["cogging"]["periods"].as_integer(), Some(12), "{file}: {text}");
        assert_eq!(simulated["true_over_nominal"]["kp"].as_float(), Some(1.1), "{file}: {text}");
    }
}

/// Compared: the names of kinds that a setting may leave out, and those in the schemas: objects of which exactly one key is
/// allowed.
#[test]
fn kinds_are_those_of_the_schemas() {
    fn collect(value: &serde_json::Value, kinds: &mut BTreeSet<String>) {
        let alternatives = ["oneOf", "anyOf"].into_iter().filter_map(|key| value[key].as_array()).flatten();
        for kind in alternatives {
            let (keys, required) = (kind["properties"].as_object(), kind["required"].as_array());
            if let (Some(keys), Some([only])) = (keys, required.map(Vec::as_slice))
                && keys.keys().eq(only.as_str())
            {
                kinds.extend(keys.keys().cloned());
            }
        }
        match value {
            serde_json::Value::Object(entries) => entries.values().for_each(|value| collect(value, kinds)),
            serde_json::Value::Array(values) => values.iter().for_each(|value| collect(value, kinds)),
            _ => {}
        }
    }
    let mut kinds = BTreeSet::new();
    for name in ["tasks/task", "robots/robot", "tasks/experiments/experiment"] {
        let path = format!("{}/../../{name}.schema.json", env!("CARGO_MANIFEST_DIR"));
        let text = std::fs::read_to_string(path).expect("a schema");
        collect(&serde_json::from_str(&text).expect("JSON"), &mut kinds);
    }
    assert!(kinds.iter().eq(KINDS.iter()), "{kinds:?}");
}

#[test]
fn misspelt_table_is_recognised() {
    let error = refusal(&["task.hnad.gains.damping_ratio=0.7"]);
    assert!(error.to_string().starts_with("--set task.hnad.gains.damping_ratio=0.7: "), "{error}");
    let help = error.help().expect("a help");
    assert!(help.starts_with("`task` has no `hnad`; it has `hand`, `rest`: did you mean `hand`?"), "{help}");
}

#[test]
fn file_errors_keep_their_lines() {
    // The settings add lines above the error.
    let text = FILE.replace("time_s = 2.0", "time = 2.0");
    let settings = ["duration_s=8".to_owned(), "simulated={true_over_nominal={kp=1}}".to_owned()];
    let source = apply(&Source::new("tasks/x.toml", text), &settings).expect("applied");
    let error = parse::<TaskFile>(&source).expect_err("refused");
    assert_eq!(error.to_string(), "tasks/x.toml:14: unknown key `time`");
    let broken = apply(&Source::new("tasks/x.toml", "a = 1\nb = \n"), &settings).expect_err("refused");
    assert_eq!(broken.to_string(), "tasks/x.toml:2: a value is missing after `=`");
}

#[test]
fn later_error_names_its_setting() {
    let source = set(&["task.hand.frame=wrst", "duration_s=1"]).expect("applied");
    let frame = FileError::at_key(&source, "task.hand.cartesian.frame", "unknown frame `wrst`", None);
    assert_eq!(frame.to_string(), "--set task.hand.frame=wrst: unknown frame `wrst`");
    let seed = FileError::at_key(&source, "seed", "m", None);
    assert_eq!(seed.to_string(), "tasks/x.toml:3: m");
    let around = FileError::at_key(&source, "task.hand.cartesian", "m", Some("h".to_owned()));
    assert_eq!(around.to_string(), "tasks/x.toml:4: m");
    assert_eq!(around.help(), Some("h\n`--set task.hand.frame=wrst` changed it"));
}

#[test]
fn settings_of_another_file_are_split_off() {
    let settings = ["robot.profile.a-med.servo_ticks_per_cycle=1", "robot=../x", "seed=2"].map(str::to_owned);
    let (robot, task) = split(&settings, "robot");
    assert_eq!((robot.as_slice(), task.as_slice()), (&settings[..1], &settings[1..]));
    let file = Source::new("robot.toml", "urdf = \"x\"\n[profile.a-med]\nservo_ticks_per_cycle = 5\n");
    let applied = apply_below(&file, "robot", &robot).expect("applied");
    assert_eq!(applied.text(), "urdf = \"x\"\n[profile.a-med]\nservo_ticks_per_cycle = 1\n");
    let error = FileError::at_key(&applied, "profile.a-med.servo_ticks_per_cycle", "m", None);
    assert_eq!(error.to_string(), "--set robot.profile.a-med.servo_ticks_per_cycle=1: m");
    let stray = apply_below(&file, "robot", &task).expect_err("refused");
    assert_eq!(stray.message(), "this setting must begin with `robot.`");
}

#[test]
fn nesting_depth_is_bounded() {
    let deep = format!("{}=1", vec!["a"; 60].join("."));
    assert!(set(&[&deep]).expect_err("refused").message().contains("nested too deeply"));
}

/// Settings with another kind of reference or servo than the file has, and values for servos of a kind that no joint has.
#[test]
fn another_kind_is_set_as_a_whole() {
    let pid = |stiffness: f64| {
        format!(
            "{{ pid = {{ stiffness_nm_per_rad = {stiffness:?}, damping_nms_per_rad = 90.0, derivative_filter_hz = 600.0 }} }}"
        )
    };
    let servos = format!("robot.profile.default.servo={{ shoulder = {}, elbow = {} }}", pid(26e3), pid(5e3));
    let whole = "for another kind, set all its values at once:";
    for (task, settings, message, help) in [
        (
            "joint-tracking",
            vec!["task.joints.reference.recorded.file=x.csv"],
            "`task.joints.joint-tracking.reference` is of kind `sinusoid`, not `recorded`",
            whole,
        ),
        (
            "planar-2-link-reach",
            vec!["robot.profile.default.servo.elbow.pid.stiffness_nm_per_rad=3.0"],
            "`profile.default.servo.elbow` is of kind `cascaded`, not `pid`",
            whole,
        ),
        (
            "planar-2-link-reach",
            vec![servos.as_str(), "robot.profile.default.servo.joint_defaults.cascaded.gain_uncertainty=0.1"],
            "no servo of its joints is of kind `cascaded`: these values have no effect",
            "the servos are of kind `pid`: write `joint_defaults = { pid = { ... } }`",
        ),
    ] {
        let settings: Vec<String> = settings.into_iter().map(str::to_owned).collect();
        let path = format!("{}/../../tasks/{task}.toml", env!("CARGO_MANIFEST_DIR"));
        let loaded = Experiment::load(Files::Disk, Path::new(&path), None, RunOptions::default(), &settings);
        let Err(error) = loaded else { panic!("a refusal") };
        assert!(error.to_string().contains(message), "{error}");
        assert!(error.help().is_some_and(|text| text.contains(help)), "{:?}", error.help());
    }
}
