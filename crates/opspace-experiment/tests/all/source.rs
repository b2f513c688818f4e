//! Compared: the text and the line of each error of the strict parser, and the mistake in the file.

use std::collections::BTreeMap;

use opspace_experiment::files::source::{FileError, Source, parse};
use opspace_experiment::suggest::{nearest, unit_symbol};
use serde::Deserialize;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "read by serde")]
struct TaskFile {
    robot: String,
    #[serde(default)]
    duration_s: f64,
    #[serde(default)]
    seed: u32,
    #[serde(default)]
    start_rad: BTreeMap<String, f64>,
    task: BTreeMap<String, Task>,
    #[serde(default)]
    via: Vec<Via>,
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
    #[serde(default)]
    axes: BTreeMap<String, Axis>,
    gains: Gains,
    #[serde(default)]
    stiffness_n_per_m: f64,
    motion: Option<Motion>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Axis {
    Motion,
    Compliant,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[expect(dead_code, reason = "read by serde")]
enum Motion {
    Random { rms_m: f64 },
    Hold,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "read by serde")]
struct Gains {
    frequency_rad_per_s: f64,
    damping_ratio: f64,
    offset_m: Option<[f64; 3]>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(dead_code, reason = "read by serde")]
struct Via {
    time_s: f64,
}

const GOOD: &str = r#"robot = "../robots/asimo-arm"
duration_s = 8
[task.hand.cartesian]
frame = "hand"
axes = { x = "compliant", y = "motion" }
gains = { frequency_rad_per_s = 14.142, damping_ratio = 1.0 }
stiffness_n_per_m = 400.0
[task.rest.joint-posture]
frequency_rad_per_s = 6.325
damping_ratio = 0.79
[[via]]
time_s = 1.0
"#;

/// Returns the error of `GOOD` with one part replaced.
fn error(from: &str, to: &str) -> FileError {
    assert!(GOOD.contains(from), "{from:?} is not in the good file");
    let source = Source::new("tasks/x.toml", GOOD.replacen(from, to, 1));
    parse::<TaskFile>(&source).expect_err("the file is wrong")
}

/// Compares the displayed text (place and message) and the help with the expected texts.
#[track_caller]
fn check_error(error: &FileError, display: &str, help: &str) {
    assert_eq!(error.to_string(), display);
    assert_eq!(error.help().unwrap_or(""), help);
}

/// Returns the text that an error underlines.
fn underlined(error: &FileError) -> String {
    let (text, span) = error.excerpt().expect("a place in a text");
    text[span].to_owned()
}

#[test]
fn valid_file_is_read() {
    let file: TaskFile = parse(&Source::new("x", GOOD)).expect("the file is right");
    assert_eq!(file.duration_s, 8.0);
    assert_eq!(file.task.len(), 2);
}

#[test]
fn unknown_key_error_names_nearest_and_allowed() {
    let misspelt = error("stiffness_n_per_m", "stifness_n_per_m");
    check_error(
        &misspelt,
        "tasks/x.toml:7: unknown key `stifness_n_per_m`",
        "did you mean `stiffness_n_per_m`?\nallowed here: `frame`, `axes`, `gains`, `stiffness_n_per_m`, `motion`",
    );
    assert_eq!(underlined(&misspelt), "stifness_n_per_m");
    assert_eq!((misspelt.path(), misspelt.line()), ("tasks/x.toml", Some(7)));
    check_error(
        &error("frame = ", "zzz = "),
        "tasks/x.toml:4: unknown key `zzz`",
        "allowed here: `frame`, `axes`, `gains`, `stiffness_n_per_m`, `motion`",
    );
}

#[test]
fn wrong_unit_error_names_key_and_factor() {
    let allowed = "\nallowed here: `frequency_rad_per_s`, `damping_ratio`, `offset_m`";
    check_error(
        &error("{ frequency_rad_per_s", "{ frequency_hz"),
        "tasks/x.toml:6: unknown key `frequency_hz`",
        &format!("did you mean `frequency_rad_per_s`? The units differ: 1 Hz is 6.28319 rad/s.{allowed}"),
    );
    check_error(
        &error("{ frequency_rad_per_s", "{ frequency"),
        "tasks/x.toml:6: unknown key `frequency`",
        &format!("did you mean `frequency_rad_per_s`? The unit, rad/s, is part of the name.{allowed}"),
    );
    let stiffness = error("stiffness_n_per_m", "stiffness_n_per_mm");
    let help = stiffness.help().expect("a suggestion");
    assert!(
        help.starts_with("did you mean `stiffness_n_per_m`? The units differ: 1 N/mm is 1000 N/m."),
        "{help}"
    );
}

#[test]
fn unknown_kind_error_lists_kinds() {
    let axis = error("\"compliant\"", "\"complaint\"");
    check_error(
        &axis,
        "tasks/x.toml:5: unknown value `complaint`",
        "did you mean `compliant`?\nallowed here: `motion`, `compliant`",
    );
    assert_eq!(underlined(&axis), "\"complaint\"");
    check_error(
        &error("hand.cartesian", "hand.cartesan"),
        "tasks/x.toml:3: unknown value `cartesan`",
        "did you mean `cartesian`?\nallowed here: `cartesian`, `joint-posture`",
    );
}

#[test]
fn missing_key_error_names_table_and_unit() {
    check_error(
        &error("frame = \"hand\"", ""),
        "tasks/x.toml:3: missing key `frame` in `task.hand.cartesian`",
        "add `frame = ...`: it has no default",
    );
    let inline = error("{ frequency_rad_per_s = 14.142, ", "{ ");
    check_error(
        &inline,
        "tasks/x.toml:6: missing key `frequency_rad_per_s` in `task.hand.cartesian.gains`",
        "add `frequency_rad_per_s = ...`: a number in rad/s",
    );
    check_error(
        &error("time_s = 1.0", ""),
        "tasks/x.toml:11: missing key `time_s` in `via.0`",
        "add `time_s = ...`: a number in s",
    );
    let root = error("robot = \"../robots/asimo-arm\"", "");
    check_error(&root, "tasks/x.toml: missing key `robot`", "add `robot = ...`: it has no default");
    assert!(root.excerpt().is_none() && root.line().is_none());
}

#[test]
fn type_error_names_expected_and_found() {
    let unit = error("400.0", "\"400 N/m\"");
    check_error(
        &unit,
        "tasks/x.toml:7: expected a number, got the text \"400 N/m\"",
        "the unit is part of the key's name: write only the number, `stiffness_n_per_m = 400`",
    );
    assert_eq!(underlined(&unit), "\"400 N/m\"");
    check_error(
        &error("400.0", "\"4 N/cm\""),
        "tasks/x.toml:7: expected a number, got the text \"4 N/cm\"",
        "write only the number, in the unit at the end of the key's name",
    );
    check_error(
        &error("400.0", "\"4e2\""),
        "tasks/x.toml:7: expected a number, got the text \"4e2\"",
        "write the number without quotes: `stiffness_n_per_m = 4e2`",
    );
    check_error(&error("400.0", "true"), "tasks/x.toml:7: expected a number, got true", "");
    check_error(&error("\"hand\"", "[1]"), "tasks/x.toml:4: expected text in quotes, got an array", "");
    check_error(&error("\"hand\"", "2"), "tasks/x.toml:4: expected text in quotes, got 2", "");
    let seed = "duration_s = 8\nseed = -1";
    check_error(
        &error("duration_s = 8", seed),
        "tasks/x.toml:3: expected a whole number not below 0, got -1",
        "",
    );
    let seed = "duration_s = 8\nseed = 1.5";
    check_error(
        &error("duration_s = 8", seed),
        "tasks/x.toml:3: expected a whole number not below 0, got 1.5",
        "",
    );
    let table = error("{ frequency_rad_per_s = 14.142, damping_ratio = 1.0 }", "3");
    check_error(&table, "tasks/x.toml:6: expected a table, got 3", "");
    let short = error("damping_ratio = 1.0 }", "damping_ratio = 1.0, offset_m = [0.1, 0.2] }");
    check_error(&short, "tasks/x.toml:6: expected an array of length 3, got 2", "");
    let element = error("damping_ratio = 1.0 }", "damping_ratio = 1.0, offset_m = [0, \"2 mm\", 0] }");
    assert_eq!(element.message(), "expected a number, got the text \"2 mm\"");
    assert_eq!(underlined(&element), "\"2 mm\"");
}

/// Checks what serde itself would accept: the values of a table as a list, and values after the last of an array.
#[test]
fn list_in_place_of_a_table_and_surplus_values_are_refused() {
    check_error(
        &error("{ frequency_rad_per_s = 14.142, damping_ratio = 1.0 }", "[14.142, 1.0]"),
        "tasks/x.toml:6: expected a table, got an array",
        "",
    );
    let of_kind = error("stiffness_n_per_m = 400.0", "motion = { random = [0.1] }");
    check_error(&of_kind, "tasks/x.toml:7: expected a table, got an array", "");
    let surplus = error("damping_ratio = 1.0 }", "damping_ratio = 1.0, offset_m = [0.1, 0.2, 0.3, 0.4] }");
    check_error(&surplus, "tasks/x.toml:6: expected 3 values, got 4", "");
    assert_eq!(underlined(&surplus), "[0.1, 0.2, 0.3, 0.4]");
}

#[test]
fn two_kinds_or_none_are_refused() {
    check_error(
        &error("[[via]]", "[task.rest.cartesian]\nframe = \"hand\"\n[[via]]"),
        "tasks/x.toml:8: `task.rest` has `joint-posture`, `cartesian`; it must have exactly one kind",
        "a key of `joint-posture` is `task.rest.joint-posture.<key>`",
    );
    check_error(
        &error("[[via]]", "[task.third]\n[[via]]"),
        "tasks/x.toml:11: `task.third` is empty; it must have exactly one kind",
        "",
    );
    let number = error("[task.hand.cartesian]", "task.third = 3\n[task.hand.cartesian]");
    check_error(&number, "tasks/x.toml:3: expected text or a table, got 3", "");
}

#[test]
fn unknown_fields_of_a_kind_are_refused() {
    let motion = "stiffness_n_per_m = 400.0\nmotion.random = { rms_mm = 3.0 }";
    check_error(
        &error("stiffness_n_per_m = 400.0", motion),
        "tasks/x.toml:8: unknown key `rms_mm`",
        "did you mean `rms_m`? The units differ: 1 mm is 0.001 m.\nallowed here: `rms_m`",
    );
}

#[test]
fn non_finite_and_huge_numbers_are_refused_at_their_line() {
    for (text, shown) in [("nan", "nan"), ("-inf", "-inf"), ("1e400", "1e400"), ("+inf", "+inf")] {
        let error = error("400.0", text);
        assert_eq!(error.to_string(), format!("tasks/x.toml:7: expected a finite number, got {shown}"));
        assert_eq!(underlined(&error), text);
    }
    for text in ["1e308", "-1.1e12"] {
        let error = error("400.0", text);
        let wanted = format!("tasks/x.toml:7: {text} is too large: expected a number from -1e12 to 1e12");
        assert_eq!(error.to_string(), wanted);
        assert_eq!(underlined(&error), text);
    }
    // Also for an unknown key, and in an inline table, an array, and an array of tables.
    assert_eq!(error("duration_s = 8", "a.b = [1, { c = nan }]").line(), Some(2));
    assert_eq!(error("time_s = 1.0", "time_s = inf").line(), Some(12));
    assert_eq!(underlined(&error("14.142", "nan")), "nan");
}

#[test]
fn invalid_toml_is_refused_at_its_line() {
    check_error(
        &error("400.0", "400 N/m"),
        "tasks/x.toml:7: `400 N/m` is not a TOML value",
        "the unit is part of the key's name: write only the number in that unit, as in `400`",
    );
    check_error(
        &error("\"hand\"", "hand"),
        "tasks/x.toml:4: `hand` is not a TOML value",
        "text needs quotes: \"hand\"",
    );
    check_error(
        &error("\"hand\"", "foo"),
        "tasks/x.toml:4: `foo` is not a TOML value",
        "text needs quotes: \"foo\"",
    );
    check_error(&error("400.0", ""), "tasks/x.toml:7: a value is missing after `=`", "");
    check_error(
        &error("duration_s = 8", "duration_s = 8\nduration_s = 9"),
        "tasks/x.toml:3: `duration_s` is defined twice in this table",
        "remove one of the two",
    );
    assert_eq!(error("[[via]]", "[[via").line(), Some(11));
    assert_eq!(error("time_s = 1.0\n", "time_s = [1.0,").line(), Some(12));
}

/// Line ends of other editors, a byte-order mark and an empty file: they are read like plain text, or refused with a
/// message.
#[test]
fn line_endings_and_byte_order_mark_are_accepted() {
    let dos = format!("\u{feff}{}", GOOD.replace('\n', "\r\n"));
    parse::<TaskFile>(&Source::new("x", dos.clone())).expect("the file is right");
    let wrong = Source::new("x", dos.replace("stiffness", "stifness"));
    assert_eq!(parse::<TaskFile>(&wrong).expect_err("wrong").line(), Some(7));
    let empty = parse::<TaskFile>(&Source::new("x", "")).expect_err("nothing is there");
    assert_eq!(empty.to_string(), "x: missing key `robot`");
    assert!(empty.message().contains("missing key"));
}

/// Deep nesting is refused and does not overflow the call stack.
#[test]
fn nesting_depth_is_bounded() {
    let dotted = format!("{}=1", vec!["a"; 100_000].join("."));
    let arrays = format!("a={}", "[".repeat(100_000));
    let tables = format!("a={}", "{a=".repeat(100_000));
    for text in [dotted, arrays, tables] {
        let error = parse::<TaskFile>(&Source::new("x", text)).expect_err("too deep");
        assert_eq!(error.line(), Some(1));
    }
}

#[test]
fn later_error_points_at_its_key() {
    let source = Source::new("tasks/x.toml", GOOD);
    let frame = FileError::at_key(&source, "task.hand.cartesian.frame", "unknown frame `hand`", None);
    check_error(&frame, "tasks/x.toml:4: unknown frame `hand`", "");
    assert_eq!(underlined(&frame), "\"hand\"");
    let cases = [
        ("task.hand.cartesian.gains.damping_ratio", 6, "1.0"),
        ("task.hand.cartesian.axes.y", 5, "\"motion\""),
        ("task.hand.cartesian", 3, "cartesian"),
        // For a missing key, the nearest enclosing table.
        ("task.hand.cartesian.force.sensor", 3, "cartesian"),
        ("task.hand.cartesian.gains.kp", 6, "gains"),
        ("via.0.time_s", 12, "1.0"),
        ("via.7.time_s", 11, "via"),
    ];
    for (key, line, text) in cases {
        let error = FileError::at_key(&source, key, "m", None);
        assert_eq!((error.line(), underlined(&error)), (Some(line), text.to_owned()), "{key}");
    }
    assert_eq!(FileError::at_key(&source, "nothing.at.all", "m", None).to_string(), "tasks/x.toml: m");
}

/// Checks that the place in a blank line is a range, and in other lines their text without indentation.
#[test]
fn error_at_a_line_underlines_its_text() {
    let source = Source::new("x.urdf", "<robot>\n  \n  <link/> \n");
    for (line, text) in [(1, "<robot>"), (2, ""), (3, "<link/>")] {
        let error = FileError::at_line(&source, Some(line), "m", None);
        assert_eq!((error.line(), underlined(&error)), (Some(line), text.to_owned()));
    }
}

#[test]
fn keys_with_dots_are_located() {
    let source = Source::new("r", "[joint.\"arm.1\"]\nkp = 1.0\n[joint.arm]\n1 = 2\n");
    assert_eq!(FileError::at_key(&source, "joint.\"arm.1\".kp", "m", None).line(), Some(2));
    assert_eq!(FileError::at_key(&source, ["joint", "arm.1", "kp"], "m", None).line(), Some(2));
    assert_eq!(FileError::at_key(&source, "joint.arm.1", "m", None).line(), Some(4));
}

#[test]
fn unreadable_file_error_names_the_cause() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("compliant-x.toml"), "").expect("written");
    std::fs::write(at("latin.toml"), b"a = 1\nb = \"\xe9\"\n").expect("written");
    std::fs::write(at("log.mcap"), vec![b'#'; (4 << 20) + 1]).expect("written");
    let message = |name: &str| Source::read(at(name)).expect_err("refused");

    for name in ["complaint-x.toml", "compliant-x"] {
        let missing = message(name);
        assert_eq!(missing.path(), at(name).display().to_string());
        assert_eq!(missing.message(), "there is no such file");
        let near = at("compliant-x.toml");
        assert_eq!(missing.help(), Some(format!("did you mean `{}`?", near.display()).as_str()));
    }
    let listed = format!("`{}` contains `compliant-x.toml`, `latin.toml`", folder.path().display());
    assert_eq!(message("zzz").help(), Some(listed.as_str()));
    let nowhere = at("no-such").join("x.toml");
    let no_folder = Source::read(&nowhere).expect_err("refused");
    assert!(no_folder.message().contains("no folder"), "{no_folder}");
    let directory = Source::read(folder.path()).expect_err("refused");
    assert_eq!(
        (directory.message(), directory.help()),
        ("is a folder; a file is expected here", Some(listed.as_str()))
    );
    assert_eq!(message("latin.toml").message(), "is not UTF-8 (line 2)");
    assert_eq!(message("log.mcap").message(), "is larger than 4 MiB: is it the intended file?");
}

#[test]
fn only_similar_names_are_suggested() {
    let joints = ["shoulder_pitch", "shoulder_roll", "elbow"];
    assert_eq!(nearest("sholder_pitch", joints), Some("shoulder_pitch"));
    assert_eq!(nearest("Shoulder-Roll", joints), Some("shoulder_roll"));
    assert_eq!(nearest("elbwo", joints), Some("elbow"));
    assert_eq!(nearest("knee", joints), None);
    assert_eq!(nearest("x", ["y", "z"]), None);
    assert_eq!(nearest("", joints), None);
    let owned = vec!["hand".to_owned(), "wrist".to_owned()];
    assert_eq!(nearest("hnad", &owned), Some("hand"));
}

#[test]
fn units_are_parsed_from_key_names() {
    let cases = [
        ("stiffness_n_per_m", Some("N/m")),
        ("duration_s", Some("s")),
        ("velocity_rad_per_s", Some("rad/s")),
        ("kp_per_s", Some("1/s")),
        ("kv_nms_per_rad", Some("N·m·s/rad")),
        ("coulomb_nm", Some("N·m")),
        ("inertia_kg_m2", Some("kg·m²")),
        ("damping_ratio", None),
        ("axes", None),
        ("s", None),
    ];
    for (key, unit) in cases {
        assert_eq!(unit_symbol(key), unit, "{key}");
    }
}
