//! Bounds on the results of the experiments, read from files of `opspace bench --json` that environment variables
//! name. `.ci/run acceptance` runs the suites, then these tests.
//!
//! Compared: medians of this simulation over seeds, and values of an independent simulation in another language (25 %
//! around its medians over ten seeds), or fixed bounds.

use serde_json::Value;
use std::collections::BTreeMap;

const FILE: &str = "OPSPACE_BENCH_JSON";
const PROFILES: [&str; 2] = ["a-med", "b-soft"];
const EVERYWHERE: [&str; 4] = ["gravity-compensation", "joint-tracking", "cartesian-tracking", "compliant-x"];

struct Bench {
    rows: Vec<Value>,
}

/// Key of a group of runs that differ only in the seed.
#[derive(Clone, Copy, Debug)]
struct Group<'a> {
    task: &'a str,
    backend: &'a str,
    controller: &'a str,
    profile: &'a str,
    ratio: u64,
    /// Name of the transformer; empty without a transformer.
    transformer: &'a str,
    /// Label of the row; empty without a deviation.
    label: &'a str,
}

impl<'a> Group<'a> {
    /// Creates the key of runs; a position or velocity robot under torque control uses the paper's transformer.
    fn new(task: &'a str, backend: &'a str, controller: &'a str, profile: &'a str) -> Self {
        let transformer = if backend != "torque" && controller == "osc" { "paper" } else { "" };
        Self { task, backend, controller, profile, ratio: 5, transformer, label: "" }
    }

    fn paper(task: &'a str, profile: &'a str) -> Self {
        Self::new(task, "position", "osc", profile)
    }
}

impl Bench {
    /// Reads the paper's suite from the file that the environment variable names.
    fn read() -> Self {
        Self::read_from(FILE)
    }

    fn read_from(variable: &str) -> Self {
        let path = std::env::var_os(variable);
        let path = path.unwrap_or_else(|| panic!("{variable} names no file of `opspace bench --json`"));
        let path = std::path::PathBuf::from(path);
        let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let file: Value = serde_json::from_str(&text).expect("JSON");
        assert_eq!(file["schema"], "opspace.bench/1");
        assert!(file["opspace_version"].is_string());
        Self { rows: file["rows"].as_array().expect("rows").clone() }
    }

    fn group(&self, group: Group<'_>) -> Vec<&Value> {
        let rows: Vec<&Value> = (self.rows.iter())
            .filter(|row| {
                row["task"] == group.task
                    && row["backend"] == group.backend
                    && row["controller"] == group.controller
                    && row["profile"] == group.profile
                    && row["ratio"] == group.ratio
                    && row["transformer"].as_str().unwrap_or_default() == group.transformer
                    && row["label"].as_str().unwrap_or_default() == group.label
            })
            .collect();
        assert!(!rows.is_empty(), "no row of {group:?}");
        rows
    }

    /// Median of a metric over the seeds of a group.
    fn median(&self, group: Group<'_>, metric: &str) -> f64 {
        let value = |row: &Value| row["metrics"][metric].as_f64();
        let mut values: Vec<f64> = self.group(group).into_iter().filter_map(value).collect();
        assert!(!values.is_empty(), "{group:?} has no {metric}");
        values.sort_by(f64::total_cmp);
        0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2])
    }
}

#[test]
#[ignore = "needs results of a suite, OPSPACE_BENCH_JSON: .ci/run acceptance"]
fn every_experiment_ran_on_every_robot_and_controller() {
    let bench = Bench::read();
    for profile in PROFILES {
        for task in EVERYWHERE {
            bench.group(Group::paper(task, profile));
            bench.group(Group::new(task, "torque", "osc", profile));
            for backend in ["position", "velocity"] {
                let of = Group::new(task, backend, "osc", profile);
                bench.group(Group { transformer: "emulation+current", ..of });
            }
            bench.group(Group::new(task, "velocity", "osc", profile));
            if task != "gravity-compensation" {
                bench.group(Group::new(task, "position", "ik", profile));
                bench.group(Group::new(task, "position", "ik-lead", profile));
            }
        }
    }
}

#[test]
#[ignore = "needs results of a suite, OPSPACE_BENCH_JSON: .ci/run acceptance"]
fn no_run_faulted_and_every_row_is_complete() {
    let bench = Bench::read();
    for row in &bench.rows {
        let keys = row.as_object().expect("a row is a table");
        assert_eq!(row["faulted"], Value::Null, "{row}");
        assert_eq!(row["fault_time_s"], Value::Null, "{row}");
        for key in ["robot", "seed", "duration_s", "overrides", "transformer", "metrics", "timing"] {
            assert!(keys.contains_key(key), "{key} is missing in {row}");
        }
        for key in ["tick_ns_median", "tick_ns_p99", "tick_ns_max", "realtime_factor"] {
            assert!(row["timing"][key].as_f64().is_some_and(|v| v > 0.0), "timing.{key} in {row}");
        }
        let controlled_by_torque = row["controller"] == "osc";
        for key in ["torque_error_servo", "torque_error_interval", "torque_error_tick"] {
            assert_eq!(row["metrics"][key].is_f64(), controlled_by_torque, "metrics.{key} in {row}");
        }
    }
}

#[test]
#[ignore = "needs results of a suite, OPSPACE_BENCH_JSON: .ci/run acceptance"]
fn paper_transformer_errors_match_publication() {
    const BAND: f64 = 0.25;
    let bench = Bench::read();
    let published = [
        ("cartesian-tracking", 0.25, 0.30),
        ("gravity-compensation", 0.146, 0.172),
        ("compliant-x", 0.114, 0.137),
    ];
    for (task, a_med, b_soft) in published {
        for (profile, expected) in [("a-med", a_med), ("b-soft", b_soft)] {
            let group = Group::paper(task, profile);
            assert!(bench.group(group).len() >= 10, "ten seeds of {group:?}");
            let error = bench.median(group, "torque_error_interval");
            assert!((error / expected - 1.0).abs() < BAND, "{group:?}: {error} for {expected}");
        }
    }
    let fast = Group { ratio: 1, ..Group::paper("cartesian-tracking", "b-soft") };
    let error = bench.median(fast, "torque_error_interval");
    assert!(error <= 0.07, "{fast:?}: {error}");
}

#[test]
#[ignore = "needs results of a suite, OPSPACE_BENCH_JSON: .ci/run acceptance"]
fn torque_robots_and_leading_kinematics_track_to_millimetres() {
    const BOUND_M: f64 = 1.5e-3;
    let bench = Bench::read();
    let groups = [
        Group::new("cartesian-tracking", "torque", "osc", "a-med"),
        Group::new("cartesian-tracking", "torque", "osc", "b-soft"),
        Group::new("cartesian-tracking", "position", "ik-lead", "a-med"),
    ];
    for group in groups {
        let error = bench.median(group, "position_rms_m");
        assert!(error <= BOUND_M, "{group:?}: {error} m");
    }
}

/// Backend, controller and transformer of a suite's row, and its label.
type Control = ([&'static str; 3], &'static str);

const POSITION: Control = (["position", "osc", "emulation+current"], "");
const TOO_SOFT: Control = (["position", "osc", "emulation+current"], "kp 0.8");
const TOO_SOFT_WITHOUT_CURRENT: Control = (["position", "osc", "emulation"], "kp 0.8");

/// Rows of the README's table, with the runs whose medians they show.
const README: [(&str, Control); 3] = [
    ("position robot, opspace", POSITION),
    ("torque robot, opspace", (["torque", "osc", ""], "")),
    ("position robot, inverse kinematics", (["position", "ik-lead", ""], "")),
];

/// Rows of the table of elastic gears and wrong gains in the results of the paper.
const WRONG_GAINS: [(&str, Control); 5] = [
    ("rigid, 1, `emulation+current`", POSITION),
    ("elastic, 1, `extrapolation+current`", (["position", "osc", "extrapolation+current"], "elastic gears")),
    ("rigid, 0.8, `emulation+current`", TOO_SOFT),
    ("rigid, 1.2, `emulation+current`", (["position", "osc", "emulation+current"], "kp 1.2")),
    ("rigid, 0.8, `emulation`", TOO_SOFT_WITHOUT_CURRENT),
];

/// Metrics of the README's columns: task, name, and factor to the unit that is shown.
const README_COLUMNS: [(&str, &str, f64); 4] = [
    ("compliant-x", "hand_motion_rms_m", 1e3),
    ("compliant-x", "hand_force_rms_n", 1.0),
    ("compliant-x", "position_rms_m", 1e3),
    ("cartesian-tracking", "position_rms_m", 1e3),
];

const WRONG_GAINS_COLUMNS: [(&str, &str, f64); 6] = [
    ("cartesian-tracking", "position_rms_m", 1e3),
    ("cartesian-tracking", "torque_error_interval", 1e2),
    ("compliant-x", "hand_motion_rms_m", 1e3),
    ("compliant-x", "hand_force_rms_n", 1.0),
    ("compliant-x", "position_rms_m", 1e3),
    ("compliant-x", "torque_error_interval", 1e2),
];

impl Bench {
    fn shown(&self, (control, label): Control, (task, metric, factor): (&str, &str, f64)) -> f64 {
        let [backend, controller, transformer] = control;
        factor
            * self.median(
                Group { transformer, label, ..Group::new(task, backend, controller, "a-med") },
                metric,
            )
    }

    /// Compared: the numbers of a table's rows, and medians of the suite, to half of the last digit that is shown.
    fn compare(&self, page: &str, rows: &[(&str, Control)], columns: &[(&str, &str, f64)]) {
        let text = crate::cli_common::read(crate::cli_common::project(page));
        for &(name, control) in rows {
            let begin = format!("| {name} |");
            let line = text.lines().find_map(|line| line.strip_prefix(&begin));
            let line = line.unwrap_or_else(|| panic!("{page} has no row {begin}"));
            let shown: Vec<&str> =
                line.split(['|', ';', ' ']).filter(|word| word.parse::<f64>().is_ok()).collect();
            assert_eq!(shown.len(), columns.len(), "{page}: {line}");
            for (shown, &column) in shown.iter().zip(columns) {
                let decimals = shown.split_once('.').map_or(0, |(_, decimals)| decimals.len());
                let value: f64 = shown.parse().expect("a number");
                let half = 0.5 * 0.1_f64.powi(i32::try_from(decimals).expect("few decimals"));
                let median = self.shown(control, column);
                assert!((value - median).abs() <= 1.001 * half, "{page}: {name}: {shown} for {median}");
            }
        }
    }
}

#[test]
#[ignore = "needs results of a suite, OPSPACE_BENCH_JSON: .ci/run acceptance"]
fn readme_and_results_show_the_medians() {
    let bench = Bench::read();
    bench.compare("README.md", &README, &README_COLUMNS);
    bench.compare("docs/results/paper.md", &WRONG_GAINS, &WRONG_GAINS_COLUMNS);
    let path_mm = |control| bench.shown(control, ("cartesian-tracking", "position_rms_m", 1e3));
    let (with, without) = (path_mm(TOO_SOFT), path_mm(TOO_SOFT_WITHOUT_CURRENT));
    let sentence = format!(
        "the error on the path is {with:.1} mm, but {without:.0} mm if motor current is not measured"
    );
    let readme = crate::cli_common::read(crate::cli_common::project("README.md"));
    assert!(
        readme.split_whitespace().collect::<Vec<_>>().join(" ").contains(&sentence),
        "README.md: {sentence}"
    );
}

#[test]
#[ignore = "needs results of a suite, OPSPACE_BENCH_JSON: .ci/run acceptance"]
fn operator_moves_compliant_arm_but_not_stiff_arm() {
    let bench = Bench::read();
    for profile in PROFILES {
        let soft = Group::paper("compliant-x", profile);
        for controller in ["ik", "ik-lead"] {
            let stiff = Group::new("compliant-x", "position", controller, profile);
            let median = |group, metric| bench.median(group, metric);
            assert!(
                median(soft, "hand_motion_rms_m") > 5.0 * median(stiff, "hand_motion_rms_m"),
                "{stiff:?}"
            );
            assert!(median(soft, "hand_force_rms_n") < median(stiff, "hand_force_rms_n"), "{stiff:?}");
        }
    }
}

/// Compared: the displacement of a spring of 400 N/m by a slow push of 20 N at twelve postures
/// (tasks/suites/stiffness.toml, with results in the file named by `OPSPACE_STIFFNESS_JSON`), and 50 mm: within 1 %
/// on the torque robot and 10 % on the position robot.
#[test]
#[ignore = "needs results of a suite, OPSPACE_STIFFNESS_JSON: .ci/run acceptance"]
fn stiffness_matches_requested_value() {
    let bench = Bench::read_from("OPSPACE_STIFFNESS_JSON");
    for (backend, tolerance) in [("torque", 0.01), ("position", 0.10)] {
        let rows: Vec<&Value> = bench.rows.iter().filter(|row| row["backend"] == backend).collect();
        assert_eq!(rows.len(), 12, "{backend}");
        for row in rows {
            let given_way_m = row["metrics"]["position_max_m"].as_f64().expect("a number");
            let stiffness = 20.0 / given_way_m;
            assert!(
                (stiffness / 400.0 - 1.0).abs() < tolerance,
                "{backend}, {}: {stiffness} N/m",
                row["label"]
            );
        }
    }
}

/// Rows of a suite's file that an environment variable names; they are selected by their settings.
struct Rows(Bench);

impl Rows {
    /// Median and worst value of a metric over the seeds of a row, which is given by task, robot and control, profile
    /// and label.
    fn values(&self, task: &str, control: [&str; 3], profile: &str, label: &str, metric: &str) -> (f64, f64) {
        let [backend, controller, transformer] = control;
        let same = |row: &&Value| {
            row["task"] == task
                && row["backend"] == backend
                && row["controller"] == controller
                && row["transformer"].as_str().unwrap_or_default() == transformer
                && row["profile"] == profile
                && row["label"].as_str().unwrap_or_default() == label
        };
        let what = format!("{task} {control:?} {profile} {label}");
        let mut values: Vec<f64> = (self.0.rows.iter().filter(same))
            .map(|row| {
                assert!(row["faulted"].is_null(), "{what}: {}", row["faulted"]);
                row["metrics"][metric].as_f64().unwrap_or_else(|| panic!("{what}: no {metric}"))
            })
            .collect();
        assert!(!values.is_empty(), "no row of {what}");
        values.sort_by(f64::total_cmp);
        let median = 0.5 * (values[(values.len() - 1) / 2] + values[values.len() / 2]);
        (median, values[values.len() - 1])
    }

    /// Ratio of a metric between two kinds of control with the same seed (first divided by second): the median over
    /// the seeds that both have.
    fn median_ratio(&self, controls: [[&str; 3]; 2], row: (&str, &str), metric: &str) -> f64 {
        let (task, profile) = row;
        let by_seed = controls.map(|[backend, controller, transformer]| {
            let same = self.0.rows.iter().filter(|row| {
                row["task"] == task
                    && row["backend"] == backend
                    && row["controller"] == controller
                    && row["transformer"].as_str().unwrap_or_default() == transformer
                    && row["profile"] == profile
                    && row["label"].as_str().unwrap_or_default().is_empty()
            });
            let value = |row: &Value| Some((row["seed"].as_u64()?, row["metrics"][metric].as_f64()?));
            same.filter_map(value).collect::<BTreeMap<u64, f64>>()
        });
        let [of, over] = &by_seed;
        let mut ratios: Vec<f64> =
            of.iter().filter_map(|(seed, value)| over.get(seed).map(|other| value / other)).collect();
        assert!(ratios.len() >= 3, "three seeds of both of {controls:?} {row:?} {metric}: {by_seed:?}");
        ratios.sort_by(f64::total_cmp);
        0.5 * (ratios[(ratios.len() - 1) / 2] + ratios[ratios.len() / 2])
    }

    /// Checks that the median of a metric is at most `bound`, and the value of each seed at most 1.5 times `bound`.
    fn below(&self, bound: f64, row: (&str, [&str; 3], &str, &str), metric: &str) {
        let (task, control, profile, label) = row;
        let (median, worst) = self.values(task, control, profile, label, metric);
        assert!(
            median <= bound && worst <= 1.5 * bound,
            "{row:?}: {metric} {median}, at worst {worst}, of {bound}"
        );
    }
}

const INTERVAL: &str = "torque_error_interval";
const TORQUE: [&str; 3] = ["torque", "osc", ""];

fn through(transformer: &str) -> [&str; 3] {
    ["position", "osc", transformer]
}

/// Largest acceptable torque error of interval means for each task of the paper's suite, as for the position rows;
/// the value of joint tracking is that of Cartesian tracking.
const INTERVAL_BARS: [(&str, f64); 4] = [
    ("gravity-compensation", 0.05),
    ("joint-tracking", 0.05),
    ("cartesian-tracking", 0.05),
    ("compliant-x", 0.06),
];

fn velocity(transformer: &str) -> [&str; 3] {
    ["velocity", "osc", transformer]
}

/// Compared: torque errors of the velocity rows of the paper's suite with `paper` and with `emulation+current`, and
/// fixed bounds. Both have the observer: with the fast servo of `a-med` the inner stage of the paper is as accurate as the
/// emulation, by up to 13 % more so where the hand is pushed; with the slow servo of `b-soft` it is not.
#[test]
#[ignore = "needs results of a suite, OPSPACE_BENCH_JSON: .ci/run acceptance"]
fn velocity_robots_produce_desired_torques() {
    let bench = Bench::read();
    let rows = Rows(bench);
    let emulation = velocity("emulation+current");
    for profile in PROFILES {
        for (task, bound) in INTERVAL_BARS {
            rows.below(bound, (task, emulation, profile, ""), INTERVAL);
            let error = |control| rows.values(task, control, profile, "", INTERVAL).0;
            let (paper, emulated) = (error(velocity("paper")), error(emulation));
            let least = if profile == "b-soft" { 1.4 } else { 0.85 };
            assert!(
                paper > least * emulated,
                "{task} {profile}: paper {paper}, emulation+current {emulated}"
            );
        }
    }
}

/// Compared: tracking, force and motion of the operator, and the motion perpendicular to it, of the velocity robot
/// with `emulation+current` and of the torque robot, for equal seeds: medians over ten seeds (three for joint
/// tracking).
#[test]
#[ignore = "needs results of a suite, OPSPACE_BENCH_JSON: .ci/run acceptance"]
fn velocity_robots_track_and_comply_like_torque_robots() {
    let bench = Bench::read();
    let rows = Rows(bench);
    let emulation = velocity("emulation+current");
    for profile in PROFILES {
        let ratio =
            |task: &str, metric: &str| rows.median_ratio([emulation, TORQUE], (task, profile), metric);
        let hand = ratio("cartesian-tracking", "position_rms_m");
        assert!(hand <= 1.5, "{profile}: hand error {hand}");
        let joints = ratio("joint-tracking", "joint_rms_rad");
        assert!(joints <= 1.5, "{profile}: joint error {joints}");
        for task in ["compliant-x", "gravity-compensation"] {
            let (force, motion) = (ratio(task, "hand_force_rms_n"), ratio(task, "hand_motion_rms_m"));
            assert!((0.9..=1.1).contains(&force), "{task} {profile}: operator's force {force}");
            assert!(motion >= 0.9, "{task} {profile}: operator's motion {motion}");
        }
        let across = ratio("compliant-x", "position_rms_m");
        assert!(across <= 1.2, "{profile}: y and z {across}");
    }
}

/// Compared: torque errors and tracking of each transformer in the experiments of the paper, in the file named by
/// `OPSPACE_TRANSFORMER_JSON`, and fixed bounds, the torque robot and inverse kinematics.
#[test]
#[ignore = "needs results of a suite, OPSPACE_TRANSFORMER_JSON: .ci/run acceptance"]
fn servo_emulation_produces_desired_torques() {
    let bench = Bench::read_from("OPSPACE_TRANSFORMER_JSON");
    let rows = Rows(bench);
    let held = [("emulation", ""), ("emulation+current", "")];
    let interpolated = [("interpolating", "interpolated"), ("interpolating+current", "interpolated")];
    for (transformer, label) in held.into_iter().chain(interpolated) {
        let position = through(transformer);
        for profile in PROFILES {
            let bars = [("cartesian-tracking", 0.05), ("gravity-compensation", 0.05), ("compliant-x", 0.06)];
            for (task, bound) in bars {
                rows.below(bound, (task, position, profile, label), INTERVAL);
                if label == "interpolated" {
                    rows.below(0.07, (task, position, profile, label), "torque_error_servo");
                }
            }
            let tracking = |control: [&str; 3], label: &str| {
                rows.values("cartesian-tracking", control, profile, label, "position_rms_m").0
            };
            let own = tracking(position, label);
            assert!(own <= 1.5 * tracking(TORQUE, ""), "{transformer} {profile}: {own} m");
            assert!(own <= 0.25 * tracking(["position", "ik", ""], ""), "{transformer} {profile}: {own} m");
            let ratio = |metric: &str| {
                let of = |control: [&str; 3], label: &str| {
                    rows.values("compliant-x", control, profile, label, metric).0
                };
                of(position, label) / of(TORQUE, "")
            };
            let (force, motion, aside) =
                (ratio("hand_force_rms_n"), ratio("hand_motion_rms_m"), ratio("position_rms_m"));
            assert!((0.9..=1.1).contains(&force), "{transformer} {profile}: hand force {force}");
            assert!(
                motion >= 0.9 && aside <= 1.2,
                "{transformer} {profile}: {motion} along x, {aside} aside"
            );
        }
    }
}

/// Compared: the ripple that a held setpoint causes within an interval, and the ripple predicted from the timing of
/// the drive. Compliant-x on the stiff drives is excluded: it moves so slowly that the encoder quantisation in the
/// servo's velocity has an effect of the same size.
#[test]
#[ignore = "needs results of a suite, OPSPACE_TRANSFORMER_JSON: .ci/run acceptance"]
fn remaining_error_is_held_setpoint_ripple() {
    let bench = Bench::read_from("OPSPACE_TRANSFORMER_JSON");
    let rows = Rows(bench);
    for transformer in ["emulation", "emulation+current"] {
        for (task, profile) in [
            ("cartesian-tracking", "a-med"),
            ("cartesian-tracking", "b-soft"),
            ("gravity-compensation", "a-med"),
            ("gravity-compensation", "b-soft"),
            ("compliant-x", "b-soft"),
        ] {
            rows.below(1.15, (task, through(transformer), profile, ""), "hold_ripple");
        }
    }
}

/// Compared: torque errors in the same suite, and fixed bounds: with known delays, other ratios, wrong gains with and
/// without refinement, other servos, and other robots.
#[test]
#[ignore = "needs results of a suite, OPSPACE_TRANSFORMER_JSON: .ci/run acceptance"]
fn desired_torques_are_produced_by_all_drives() {
    let bench = Bench::read_from("OPSPACE_TRANSFORMER_JSON");
    let rows = Rows(bench);
    let task = "cartesian-tracking";
    let current = through("emulation+current");
    for (profile, wrong_gain) in [("a-med", 0.10), ("b-soft", 0.18)] {
        for transformer in ["emulation", "emulation+current", "interpolating+current"] {
            for delay in 1..=5 {
                let label = format!("delay {delay}");
                rows.below(0.05, (task, through(transformer), profile, &label), INTERVAL);
            }
        }
        for gain in ["kp 0.8", "kp 1.1", "kp 1.3"] {
            rows.below(wrong_gain, (task, current, profile, gain), INTERVAL);
            rows.below(0.04, (task, current, profile, &format!("{gain} refined")), INTERVAL);
        }
        rows.below(0.05, (task, current, profile, "P-PI"), INTERVAL);
        rows.below(0.05, (task, through("paper+current"), profile, ""), INTERVAL);
    }
    rows.below(0.05, (task, current, "a-med", "PID"), INTERVAL);
    rows.below(0.01, (task, current, "b-soft", "ratio 1:1"), INTERVAL);
    for transformer in ["emulation", "emulation+current"] {
        for task in ["ur5e-reach", "ur5e-tracking", "ur5e-compliant"] {
            rows.below(0.07, (task, through(transformer), "industrial", "UR5e, stiff"), INTERVAL);
            rows.below(0.05, (task, through(transformer), "fieldbus-125hz", "UR5e, 125 Hz"), INTERVAL);
        }
        for task in ["panda-reach", "panda-tracking", "panda-compliant"] {
            rows.below(0.05, (task, through(transformer), "uneven", "Panda, uneven"), INTERVAL);
        }
    }
}

/// Runs of the suite of deviations, in the file named by `OPSPACE_ROBUSTNESS_JSON`. With measured motor currents,
/// every run completes, with the hand within 15 mm of its path unless the bus fails or the motors are too weak.
/// Without them, a position loop that is 30 % too stiff is stopped with its cause.
#[test]
#[ignore = "needs results of a suite, OPSPACE_ROBUSTNESS_JSON: .ci/run acceptance"]
fn single_deviations_are_tolerated() {
    let bench = Bench::read_from("OPSPACE_ROBUSTNESS_JSON");
    const NEAR_M: f64 = 0.015;
    const INTERRUPTED_M: f64 = 0.05;
    let mut stopped = 0;
    for row in &bench.rows {
        let label = row["label"].as_str().unwrap_or_default();
        let what = format!("{} {} {label}", row["transformer"], row["profile"]);
        if row["transformer"] == "paper" && label == "kp 1.3" {
            let cause = row["faulted"].as_str().unwrap_or_default();
            assert!(cause.contains("more than the desired torque"), "{what}: {cause}");
            stopped += 1;
            continue;
        }
        assert!(row["faulted"].is_null(), "{what}: {}", row["faulted"]);
        let error = row["metrics"]["position_rms_m"].as_f64().expect("a Cartesian task");
        let interrupted = label.starts_with("dead") || label == "torque limits 20 %";
        let bound = if interrupted { INTERRUPTED_M } else { NEAR_M };
        assert!(row["transformer"] == "paper" || error < bound, "{what}: {error} m");
    }
    assert_eq!(stopped, 6, "three seeds of two profiles");
}
