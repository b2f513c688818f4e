//! Summaries and figures of logs that are read in segments.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_backend::CommandKind;
use opspace_experiment::{Experiment, Files, Progress, RunOptions, Scenario, Summary};
use opspace_log::{LogFile, Recording};
use opspace_report::document::RunSection;
use opspace_report::figure::Series;
use serde_json::Value;
use std::io::Cursor;
use std::path::Path;

/// Relative rounding of sums of some thousand numbers in another order.
const ROUNDING: f64 = 1e-9;

fn load(task: &str, backend: CommandKind, settings: &[&str]) -> Experiment {
    let options = RunOptions { backend, duration_s: Some(1.5), ..RunOptions::default() };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../tasks/{task}.toml"));
    let settings: Vec<String> = settings.iter().map(|setting| (*setting).to_owned()).collect();
    Experiment::load(Files::Disk, &path, None, options, &settings).unwrap()
}

/// Compares two JSON values, numbers up to rounding.
fn assert_equal(a: &Value, b: &Value, path: &str) {
    match (a, b) {
        (Value::Object(a), Value::Object(b)) => {
            assert!(a.keys().eq(b.keys()), "{path}");
            a.iter().for_each(|(key, value)| assert_equal(value, &b[key], &format!("{path}.{key}")));
        }
        (Value::Array(a), Value::Array(b)) => {
            assert_eq!(a.len(), b.len(), "{path}");
            a.iter().zip(b).for_each(|(a, b)| assert_equal(a, b, path));
        }
        (Value::Number(a), Value::Number(b)) => {
            let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
            assert!((a - b).abs() <= ROUNDING * a.abs().max(b.abs()), "{path}: {a} and {b}");
        }
        _ => assert_eq!(a, b, "{path}"),
    }
}

/// Least and largest abscissa and ordinate of a line.
fn ends(line: &Series) -> [f64; 4] {
    let points = || line.x.iter().zip(&line.y).filter(|(_, y)| y.is_finite());
    let least = |values: &mut dyn Iterator<Item = f64>| values.reduce(f64::min).unwrap();
    [
        least(&mut points().map(|(x, _)| *x)),
        -least(&mut points().map(|(x, _)| -*x)),
        least(&mut points().map(|(_, y)| *y)),
        -least(&mut points().map(|(_, y)| -*y)),
    ]
}

/// Compared: the summary and the lines of the figures, computed from a log as a whole and from segments of any size; for
/// tasks of every kind, with contact, missed cycles and a stop in the middle.
#[test]
fn segments_have_the_summary_and_the_figures_of_the_whole() {
    let lossy = [
        "settle_s=0.2",
        "robot.simulated.bus.lost_cycles_share=0.02",
        "robot.simulated.bus.dropouts=[{ at_s = 0.7, duration_s = 0.1 }]",
    ];
    let dead = ["settle_s=0.2", "robot.simulated.bus.dropouts=[{ at_s = 0.8, duration_s = 5.0 }]"];
    for (task, backend, settings) in [
        ("press-wall", CommandKind::Position, &["settle_s=0.2"][..]),
        ("compliant-x", CommandKind::Torque, &["settle_s=0.3"]),
        ("joint-tracking", CommandKind::Position, &lossy),
        ("cartesian-tracking", CommandKind::Velocity, &dead),
    ] {
        let experiment = load(task, backend, settings);
        let finished = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
        let bytes = finished.sink.into_inner();
        let recording = Recording::from_bytes(&bytes).unwrap();
        let whole = experiment.summary(&recording, &finished.record, None);
        let shown = RunSection::new(&experiment, &recording, whole.clone());
        for values in [3000, 40_000, 100_000] {
            let log = LogFile::from_bytes(bytes.clone()).unwrap().segment_values(values);
            let part: Summary = experiment.summary_of_file(&log, &finished.record, None).unwrap();
            let [a, b] = [&whole, &part].map(|summary| serde_json::to_value(summary).unwrap());
            assert_equal(&a, &b, task);
            let section = RunSection::of_file(&experiment, &log, part).unwrap();
            let titles = |section: &RunSection| {
                section.figures.iter().map(|figure| figure.title.clone()).collect::<Vec<_>>()
            };
            assert_eq!(titles(&shown), titles(&section));
            for (figure, other) in shown.figures.iter().zip(&section.figures) {
                assert_eq!(figure.panels.len(), other.panels.len(), "{}", figure.title);
                for (panel, other) in figure.panels.iter().zip(&other.panels) {
                    for (line, other) in panel.series.iter().zip(&other.series) {
                        assert_eq!(line.label, other.label, "{}", figure.title);
                        for (a, b) in ends(line).into_iter().zip(ends(other)) {
                            let message = format!("{task}, {}: {a} and {b}", figure.title);
                            assert!((a - b).abs() <= ROUNDING * a.abs().max(1.0), "{message}");
                        }
                    }
                }
            }
        }
    }
}

/// Compared, bit by bit: the rows in the log of a robot that is driven alone, and those of a scenario of one robot on a clock;
/// with lost cycles, at a rate that is no whole number of hertz, to the end or to a stop in the middle.
#[test]
fn scenario_of_one_robot_has_the_rows_of_its_experiment() {
    for dropout_s in [0.02, 5.0] {
        let dropout = format!("robot.simulated.bus.dropouts=[{{ at_s = 0.8, duration_s = {dropout_s:?} }}]");
        let settings = [
            "settle_s=0.2",
            "robot.profile.a-med.servo_ticks_per_cycle=7",
            "robot.simulated.bus.lost_cycles_share=0.02",
            &dropout,
        ];
        let experiment = load("cartesian-tracking", CommandKind::Position, &settings);
        let finished = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
        assert_eq!(finished.record.fault.is_some(), dropout_s > 1.0);
        let log = Recording::from_bytes(finished.sink.get_ref()).unwrap();
        let mut segments: Vec<Recording> = Vec::new();
        let scenario = Scenario::from(experiment);
        let results =
            scenario.run_in_segments(&Progress::default(), |_, segment, _| segments.push(segment.clone()));
        assert_eq!(results.unwrap()[0].0, finished.record);
        assert_eq!(segments.len(), 1, "a run of one segment");
        for name in ["tick", "servo", "truth"] {
            let bits = |recording: &Recording| {
                let channel = recording.channel(name).unwrap();
                let numbers = channel.time_s.iter().chain(&channel.rows);
                numbers.map(|number| number.to_bits()).collect::<Vec<_>>()
            };
            assert!(log.channel(name).unwrap().len() > 100, "{name}");
            assert!(bits(&log) == bits(&segments[0]), "{name}");
        }
    }
}
