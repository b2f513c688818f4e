//! Figures of runs: what each of them shows, and what not.
#![expect(clippy::unwrap_used, reason = "a test that can't go on has failed")]

use opspace_backend::CommandKind;
use opspace_experiment::metrics::columns::default_columns;
use opspace_experiment::{Experiment, Files, Progress, RunOptions, Scenario, Summary};
use opspace_log::{OutcomeRecord, Recording};
use opspace_loop::Phase;
use opspace_model::{Data, frame_placement, kinematics};
use opspace_report::document::{RunSection, page};
use opspace_report::figure::{Figure, Panel, Style};
use std::io::Cursor;
use std::path::Path;

/// Relative rounding of the largest of some thousand numbers in other units.
const ROUNDING: f64 = 1e-9;

pub fn load(task: &str, backend: CommandKind, duration_s: f64) -> Experiment {
    let options = RunOptions { backend, duration_s: Some(duration_s), ..RunOptions::default() };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../tasks/{task}.toml"));
    Experiment::load(Files::Disk, &path, None, options, &["settle_s=0.2".to_owned()]).unwrap()
}

/// Runs an experiment without a log, and returns its rows, its outcome and its figures.
pub fn shown(experiment: &Experiment) -> ((Recording, OutcomeRecord), RunSection) {
    let mut rows = Recording::default();
    let receive = |_: usize, segment: &Recording, is_last: bool| {
        assert!(is_last);
        rows = segment.clone();
    };
    let scenario = Scenario::from(experiment.clone());
    let (record, _) = scenario.run_in_segments(&Progress::default(), receive).unwrap().remove(0);
    let summary = experiment.summary(&rows, &record, None);
    let section = RunSection::new(experiment, &rows, summary);
    ((rows, record), section)
}

fn figure<'a>(section: &'a RunSection, title: &str) -> &'a Figure {
    let titles: Vec<&str> = section.figures.iter().map(|figure| figure.title.as_str()).collect();
    let found = section.figures.iter().find(|figure| figure.title.starts_with(title));
    found.unwrap_or_else(|| panic!("no figure '{title}' in {titles:?}"))
}

fn labels(panel: &Panel) -> Vec<&str> {
    panel.series.iter().map(|series| series.label.as_str()).collect()
}

/// Checks that a compliant axis has no reference, and the axes that hold their place have one.
#[test]
fn free_axes_have_no_reference() {
    let (_, section) = shown(&load("compliant-x", CommandKind::Position, 0.6));
    let position = figure(&section, "Position of");
    let with: Vec<Vec<&str>> = position.panels.iter().map(labels).collect();
    assert_eq!(with, [vec!["true"], vec!["true", "reference"], vec!["true", "reference"]]);
    assert!(position.caption.contains("y and z follow a reference; x is compliant."), "{}", position.caption);
    // The force on the compliant axis is controlled to zero.
    let force = figure(&section, "Force on the frame");
    assert_eq!(labels(&force.panels[0]), ["true", "sensed", "target"]);
    assert!(force.panels[0].series[2].y.iter().all(|force| *force == 0.0));
    assert_eq!(labels(&force.panels[1]), ["true", "sensed"]);
    assert!(force.caption.ends_with("The target is that of x."), "{}", force.caption);
}

/// Checks that a reference is drawn exactly while its axis follows it, and that a task to which an event gives a priority
/// has figures and metrics.
#[test]
fn figures_follow_the_task_set_in_force() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/cartesian-tracking.toml");
    let options = RunOptions { duration_s: Some(1.0), ..RunOptions::default() };
    let events = r#"event=[{ time_s = 0.4, set = ["task.hand.cartesian.axes.x=compliant"] },
        { time_s = 0.7, set = ["task.hand.cartesian.axes.x=motion"] },
        { time_s = 0.8, set = ['task={ fist = { cartesian = { frame = "hand", axes = { z = "motion" }, reference = "hold", gains = { frequency_rad_per_s = 10.0, damping_ratio = 1.0 } } } }',
          'priority=["fist"]'] }]"#;
    let settings = ["settle_s=0.2", events];
    let experiment =
        Experiment::load(Files::Disk, &path, None, options, &settings.map(str::to_owned)).unwrap();
    let (_, section) = shown(&experiment);
    let position = figure(&section, "Position of 'hand'");
    let drawn_while = "A reference is drawn while the axis follows it.";
    let events = "Vertical lines without a name: the events at 0.4, 0.7 and 0.8 s.";
    assert_eq!(
        position.caption,
        format!("Position (true) from that at the start, in world axes. {drawn_while} {events}")
    );
    let marks: Vec<f64> = position.panels[2].marks.iter().map(|(time_s, _)| *time_s).collect();
    assert_eq!(marks, [0.4, 0.7, 0.8]);
    assert!(
        section
            .facts
            .iter()
            .any(|(term, text)| term == "event at 0.4 s" && text.contains("axes.x=compliant"))
    );
    let drawn = |axis: usize, time_s: f64| {
        let reference = &position.panels[axis].series[1];
        let at = reference.x.iter().position(|t| (t - time_s).abs() < 1e-3).unwrap();
        reference.y[at].is_finite()
    };
    // Lines are interrupted where the task has no such axis, or no priority.
    assert_eq!(
        [0.39, 0.41, 0.69, 0.71, 0.79, 0.81].map(|time_s| drawn(0, time_s)),
        [true, false, false, true, true, false]
    );
    assert_eq!([0.41, 0.79, 0.81].map(|time_s| drawn(2, time_s)), [true, true, false]);
    assert!(section.summary.tasks["fist"].pose.position_rms_m.is_some());
    assert!(section.figures.iter().any(|figure| figure.title == "Error of task 'fist'"));
}

/// Compared: the largest error in the figure of a centre of mass, and in the table. A task of one joint shows this joint.
#[test]
fn centre_of_mass_and_single_joints_have_figures() {
    let (_, section) = shown(&load("panda-levels", CommandKind::Torque, 0.6));
    let joints: Vec<&str> =
        figure(&section, "Joint positions of task 'turn'").panels.iter().map(|p| p.title.as_str()).collect();
    assert_eq!(joints, ["joint1"]);
    assert_eq!(labels(&figure(&section, "Position of the centre of mass").panels[0])[0], "true");
    let error = &figure(&section, "Error of task 'balance'").panels[0].series[0];
    let settled = error.x.iter().zip(&error.y).filter(|(t, _)| **t >= 0.2 - 1e-4).map(|(_, mm)| *mm);
    let largest = settled.fold(0.0, f64::max);
    let metric = 1e3 * section.summary.tasks["balance"].pose.position_max_m.unwrap();
    assert!((largest / metric - 1.0).abs() < ROUNDING, "{largest} mm drawn, {metric} mm in the table");
    let error = &figure(&section, "Error of task 'turn'").panels[0].series[0];
    let settled = error.x.iter().zip(&error.y).filter(|(t, _)| **t >= 0.2 - 1e-4);
    let largest = settled.map(|(_, mrad)| mrad.abs()).fold(0.0, f64::max);
    let metric = 1e3 * section.summary.tasks["turn"].elements[0].max;
    assert!((largest / metric - 1.0).abs() < ROUNDING, "{largest} mrad drawn, {metric} mrad in the table");
}

/// Compared: the position of a task that is relative to a link, as drawn, and that by the kinematics in the axes of the link;
/// the figure says so, and which axes are followed.
#[test]
fn position_relative_to_a_link_says_so() {
    let experiment = load("panda-levels", CommandKind::Torque, 0.6);
    let (run, section) = shown(&experiment);
    let position = figure(&section, "Position of 'flange' relative to 'link1'");
    for part in [
        "relative to 'link1', in its axes",
        "In the axes of the task (axes_frame), z follows a reference; x and y are not controlled",
    ] {
        assert!(position.caption.contains(part), "{}", position.caption);
    }
    let truth = run.0.channel("truth").unwrap();
    let q = truth.signal("q").unwrap();
    let model = &experiment.robot().model;
    let place = |name: &str| model.frame_id(name).unwrap();
    let mut data = Data::new(model);
    for (axis, panel) in position.panels.iter().enumerate() {
        assert_eq!(labels(panel), ["true", "reference in other axes"]);
        let drawn = &panel.series[0];
        let first = truth.len() - drawn.x.len();
        let mut start_m = None;
        for k in (0..drawn.x.len()).step_by(100) {
            kinematics(model, &mut data, q.row(first + k), &[0.0; 7]);
            let [flange, link] = ["flange", "link1"].map(|name| frame_placement(model, &data, place(name)));
            let expected = link.rotation.tr_mul(&(flange.translation - link.translation))[axis];
            let start = *start_m.get_or_insert(expected);
            let expected_mm = 1e3 * (expected - start);
            assert!(
                (drawn.y[k] - expected_mm).abs() < 1e3 * ROUNDING,
                "{} mm for {expected_mm} mm",
                drawn.y[k]
            );
        }
    }
}

/// Checks that tasks without an error are named with the reason, that tasks are in the order of priority and joints in that of
/// the robot, and that durations are said to be measured.
#[test]
fn page_of_a_run_names_what_it_shows() {
    let (_, section) = shown(&load("press-wall", CommandKind::Position, 0.6));
    let html = page(
        "Title",
        "Lead.",
        std::slice::from_ref(&section.summary),
        &default_columns(&[]),
        std::slice::from_ref(&section),
    );
    for part in [
        "Values after the first 0.2 s (settle_s)",
        "Task &#39;rest&#39; (joint-posture) is not in the table: it pulls the joints to a posture",
        "force in the first second of contact",
        "force error rms",
        "of the whole run, measured on the computer on which it ran",
        "All other values are from simulation.",
        "1:5: a command every 5 servo ticks",
        "<th scope=\"rowgroup\" colspan=",
    ] {
        assert!(html.contains(part), "{part}");
    }
    assert!(!html.contains("share one plant"), "one run is compared with no other");
    let places =
        [">shoulder_pitch</th>", ">shoulder_roll</th>", ">elbow</th>"].map(|name| html.find(name).unwrap());
    assert!(places.is_sorted(), "{places:?}");
    let (_, levels) = shown(&load("panda-levels", CommandKind::Torque, 0.6));
    let html = page(
        "Title",
        "Lead.",
        std::slice::from_ref(&levels.summary),
        &default_columns(&[]),
        std::slice::from_ref(&levels),
    );
    let places = [">turn</th>", ">flange</th>", ">balance</th>"].map(|name| html.find(name).unwrap());
    assert!(places.is_sorted(), "{places:?}");
    assert!(html.contains("Errors of position and orientation: those of task &#39;flange&#39;"));
}

/// Checks that a limit is drawn and named only if a line comes near it; otherwise the closest one is named.
#[test]
fn only_near_limits_are_drawn() {
    let (_, section) = shown(&load("compliant-x", CommandKind::Position, 0.4));
    let torques = figure(&section, "Desired and motor torque");
    assert!(!torques.caption.contains("limit"), "{}", torques.caption);
    assert!(torques.remark.starts_with("No limit is near: '"), "{}", torques.remark);
    assert!(torques.panels.iter().all(|panel| !labels(panel).contains(&"limit")));
    let options = RunOptions { duration_s: Some(0.4), ..RunOptions::default() };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/compliant-x.toml");
    let settings = ["settle_s=0.2", "start_rad.elbow=-0.1"].map(str::to_owned);
    let near = Experiment::load(Files::Disk, &path, None, options, &settings).unwrap();
    let (_, section) = shown(&near);
    let setpoints = figure(&section, "Setpoints");
    assert!(setpoints.panels.iter().any(|panel| labels(panel).contains(&"limit")));
    assert!(setpoints.caption.contains("A limit is drawn where") && setpoints.remark.is_empty());
}

/// Checks that a task of another kind has a figure of the errors that it logs.
#[test]
fn swivel_angle_has_a_figure_of_its_error() {
    let (run, section) = shown(&load("panda-swivel", CommandKind::Torque, 0.6));
    let logged = run.0.channel("tick").unwrap().signal("elbow.error").unwrap();
    let panel = &figure(&section, "Error of task 'elbow'").panels[0];
    assert!(panel.y_label == "error (mrad)", "{}", panel.y_label);
    let largest = |values: &mut dyn Iterator<Item = f64>| {
        values.filter(|v| v.is_finite()).fold(0.0, |a: f64, v| a.max(v))
    };
    let drawn = largest(&mut panel.series[0].y.iter().copied());
    assert!(drawn > 0.0 && drawn == largest(&mut logged.rows().map(|row| 1e3 * row[0])));
}

/// Compared: the force figure's true force and target, and those of log and task file; the error figure, and the metric
/// of the summary.
#[test]
fn force_is_drawn_with_its_target_and_errors_over_time() {
    let experiment = load("press-wall", CommandKind::Position, 1.0);
    let (run, section) = shown(&experiment);
    let position = figure(&section, "Position of");
    assert!(position.caption.contains("x controls the force"), "{}", position.caption);
    let x = &figure(&section, "Force on the frame").panels[0];
    assert_eq!(labels(x), ["true", "sensed", "target"]);
    let targets = run.0.channel("tick").unwrap().signal("hand.target_force").unwrap();
    let is_logged = |force: &f64| targets.rows().any(|row| row[0] == *force);
    assert!(x.series[2].y.iter().all(is_logged) && x.series[2].y.last() == Some(&-10.0));
    let logged = run.0.channel("truth").unwrap().signal("board.force").unwrap();
    let largest = |values: &mut dyn Iterator<Item = f64>| {
        values.filter(|v| v.is_finite()).map(f64::abs).fold(0.0, f64::max)
    };
    let in_log = largest(&mut logged.rows().map(|row| row[0]));
    assert!(in_log > 0.0);
    assert_eq!(largest(&mut x.series[0].y.iter().copied()), in_log);
    let y = &figure(&section, "Force on the frame").panels[1];
    assert!(!labels(y).contains(&"target"), "{:?}", labels(y));

    let error = &figure(&section, "Error of task").panels[0].series[0];
    let settled = error.x.iter().zip(&error.y).filter(|(t, _)| **t >= 0.2 - 1e-4).map(|(_, mm)| *mm);
    let largest = settled.fold(0.0, f64::max);
    let metric = 1e3 * section.summary.metrics.pose.position_max_m.unwrap();
    assert!((largest / metric - 1.0).abs() < ROUNDING, "{largest} mm drawn, {metric} mm in the table");
}

/// Change of a force of 16 N, reached in 5 s, between two drawn samples, N: 8 ms apart, and rounded up.
const BETWEEN_SAMPLES_N: f64 = 0.03;

/// Compared: the figures of a push with the force and the position in the log, and the numbers of the summary with those of a
/// computation here. The spring has 400 N/m, and the joints have no friction.
#[test]
fn response_to_a_push_is_drawn_and_measured() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/cookbook/hold-against-pushes.toml");
    let options =
        RunOptions { backend: CommandKind::Torque, duration_s: Some(12.0), ..RunOptions::default() };
    let push = r#"environment.someone.pushes.push=[{ at_s = 1.0, duration_s = 10.0, shape = "ramp", force_n = [0.0, 12.0, -16.0] }]"#;
    let settings = [
        push,
        "expect={}",
        "robot.simulated.true_over_nominal.friction=0.0",
        "friction_compensation.gain=0.0",
    ];
    let experiment =
        Experiment::load(Files::Disk, &path, None, options, &settings.map(str::to_owned)).unwrap();
    let (run, section) = shown(&experiment);
    let axes = &section.summary.tasks["flange"].axes;
    let force = run.0.channel("truth").unwrap().signal("someone.force").unwrap();
    for (axis, name, peak_n) in [(1, "y", 12.0), (2, "z", 16.0)] {
        let number = |quantity: &str| axes[&format!("{name}_{quantity}")];
        let logged = force.rows().map(|row| row[axis].abs()).fold(0.0, f64::max);
        assert!((number("force_max_n") - logged).abs() < 0.01 && (logged - peak_n).abs() < 0.01, "{logged}");
        let stiffness = number("stiffness_n_per_m");
        assert!((stiffness / 400.0 - 1.0).abs() < 0.05, "{name}: {stiffness} N/m");
        let deflection_m = number("deflection_max_m");
        assert!((deflection_m / (peak_n / 400.0) - 1.0).abs() < 0.05, "{name}: {deflection_m} m");
        assert!(number("return_m") < 0.02 * deflection_m, "{name}: {}", number("return_m"));
        assert!(number("hysteresis_m") < 0.1 * deflection_m, "{name}: {}", number("hysteresis_m"));
    }
    assert!(!axes.contains_key("x_stiffness_n_per_m"), "nothing pushes along x");
    assert_eq!(axes["x_force_max_n"], 0.0);
    let first = &section.figures[0];
    assert!(first.title.starts_with("Force over displacement"), "{}", first.title);
    let [y, z] = &first.panels[..] else { panic!("axes that are pushed") };
    assert_eq!(labels(z), ["measured", "desired stiffness", "measured stiffness"]);
    // Pushed downwards.
    let lowest = |values: &[f64]| values.iter().copied().fold(f64::INFINITY, f64::min);
    assert!((lowest(&z.series[0].y) + 16.0).abs() < BETWEEN_SAMPLES_N && lowest(&z.series[0].x) < -38.0);
    assert!(y.title == "y" && first.remark.contains("400 N/m desired"), "{}", first.remark);
    let over_time = &section.figures[1].panels;
    let titles: Vec<&str> = over_time.iter().map(|panel| panel.title.as_str()).collect();
    assert_eq!(titles, ["force along y", "force along z", "displacement along y", "displacement along z"]);
    let end = |line: &[f64]| line.last().copied().unwrap_or(f64::NAN).abs();
    let returned = over_time[2..].iter().flat_map(|panel| &panel.series);
    assert!(returned.clone().all(|line| end(&line.y) < 1.0), "{over_time:?}");
    let story = section.story.concat();
    assert!(story.contains("12 N along y and 16 N along z") || story.contains("12.00 N along y"), "{story}");
}

/// Compared: the energy of the force feedback in figure and log, with the store of the task.
#[test]
fn energies_of_force_control_are_drawn() {
    let (run, section) = shown(&load("press-table", CommandKind::Torque, 1.0));
    let energies = figure(&section, "Energies of force control");
    let [z] = energies.panels.as_slice() else { panic!("only z is in force control") };
    assert_eq!((z.title.as_str(), labels(z)), ("task 'hand', z", vec!["energy", "store"]));
    let logged = run.0.channel("tick").unwrap().signal("hand.force_energy").unwrap();
    let largest = logged.rows().map(|row| 1e3 * row[2]).filter(|x| x.is_finite()).fold(0.0, f64::max);
    assert_eq!(z.series[0].y.iter().copied().filter(|x| x.is_finite()).fold(0.0, f64::max), largest);
    assert!(largest > 0.0 && z.series[1].y.last() == Some(&20.0));
}

/// Checks that orientation, the spectrum of the torque error and computing times have figures, and that a mark shows the
/// interface rate.
#[test]
fn orientation_spectrum_and_computing_time_are_drawn() {
    let (run, section) = shown(&load("ur5e-tracking", CommandKind::Position, 0.6));
    let rotations = figure(&section, "Orientation of");
    assert!(
        !rotations.panels.is_empty() && rotations.panels.iter().all(|panel| panel.y_label.contains("mrad"))
    );
    let spectrum = figure(&section, "Spectrum of the torque error");
    assert_eq!(spectrum.panels.len(), 6);
    assert!(spectrum.panels.iter().all(|panel| panel.marks[0].1 == "interface rate"));
    let times = &figure(&section, "Computing time").panels[0].series[0];
    let counted: f64 = times.y.iter().filter(|count| count.is_finite()).sum::<f64>() / 2.0;
    let phase = run.0.channel("tick").unwrap().signal("phase").unwrap();
    let cycles = phase.rows().filter(|phase| phase[0] == Phase::Control.code()).count();
    assert_eq!(counted, cycles as f64, "every control cycle");
}

/// Checks that the page of two runs of one task draws them over each other, each named, and one reference for both.
#[test]
fn runs_of_one_task_are_drawn_over_each_other() {
    let sections: Vec<RunSection> = [CommandKind::Position, CommandKind::Torque]
        .map(|backend| shown(&load("cartesian-tracking", backend, 0.6)).1)
        .into();
    let summaries: Vec<Summary> = sections.iter().map(|section| section.summary.clone()).collect();
    let html = page("Title", "Lead.", &summaries, &default_columns(&[]), &sections);
    assert!(html.contains("Position of &#39;hand&#39;: 2 runs"));
    for name in ["position robot: true", "torque robot: true"] {
        assert!(html.contains(name), "{name}");
    }
    assert!(!html.contains("torque robot: reference"));
    // A statement about one run is not one about two.
    let (_, overlay) = html.split_once("Desired and motor torque: 2 runs").unwrap();
    let (caption, rest) = overlay.split_once("</figcaption>").unwrap();
    assert!(!caption.contains("No limit is near") && rest.contains("No limit is near"), "{caption}");
    // What failed is at the top, also of a run without a section.
    let mut failed = summaries.clone();
    failed[1].missed_expectations.push("position_max_m is 1".to_owned());
    let head = |summaries: &[Summary]| {
        let html = page("Title", "Lead.", summaries, &default_columns(&[]), &sections[..1]);
        html.split_once("Results").unwrap().0.to_owned()
    };
    assert!(head(&failed).contains("torque robot, osc, seed 1: expectation missed: position_max_m is 1"));
    assert!(!head(&summaries).contains("Failed"));
    let alone = page("Title", "Lead.", &summaries[..1], &default_columns(&[]), &sections[..1]);
    assert!(!alone.contains(": 2 runs") && !alone.contains(": 1 runs"));
}

/// Compared: all rows of a run without a log, and those of the log of the same run, bit for bit; computing times differ.
#[test]
fn segments_of_a_run_have_the_rows_of_its_log() {
    let experiment = load("compliant-x", CommandKind::Position, 0.3);
    let result = experiment.run(Cursor::new(Vec::new()), &Progress::default()).unwrap();
    let logged = Recording::from_bytes(&result.sink.into_inner()).unwrap();
    let (run, _) = shown(&experiment);
    assert_eq!(run.1, result.record);
    for channel in &logged.channels {
        let other = run.0.channel(&channel.layout.channel).unwrap();
        assert_eq!((&channel.layout, &channel.time_s), (&other.layout, &other.time_s));
        for signal in channel.layout.signals.iter().filter(|signal| signal.unit() != "ns") {
            let [a, b] = [channel, other].map(|data| data.signal(&signal.name).unwrap());
            let bits = |row: &[f64]| row.iter().map(|v| v.to_bits()).collect::<Vec<u64>>();
            assert!(a.rows().map(bits).eq(b.rows().map(bits)), "{} differs", signal.name);
        }
    }
}

/// Compared: the ends, the extremes and a gap of a long line before and after it was thinned.
#[test]
fn thinned_line_keeps_its_extremes() {
    use opspace_report::figure::Series;
    let x: Vec<f64> = (0..100_000).map(f64::from).collect();
    let mut y: Vec<f64> = x.iter().map(|x| (x * 1e-3).sin()).collect();
    (y[31_234], y[77_777]) = (40.0, -30.0);
    y[50_000..55_000].fill(f64::NAN);
    let line = Series::new("line", x, y).style(Style::Thin);
    let thin = line.clone().thinned(100);
    assert!(thin.x.len() < 500 && thin.style == Style::Thin);
    assert!(thin.y.contains(&40.0) && thin.y.contains(&-30.0));
    assert_eq!((thin.x.first(), thin.x.last()), (line.x.first(), line.x.last()));
    let gap = thin.x.iter().position(|x| x.is_nan()).expect("the gap of five columns interrupts the line");
    assert!(thin.x[gap - 1] < 50_000.0 && thin.x[gap + 1] >= 55_000.0);
}

/// Checks that the page of runs with three values of a setting draws the metrics over it, and of one value does not.
#[test]
fn sweep_is_drawn_over_its_setting() {
    let run = |ticks: u32, seed: u64| {
        let options = RunOptions { duration_s: Some(0.4), seed: Some(seed), ..RunOptions::default() };
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tasks/cartesian-tracking.toml");
        let key = "robot.profile.a-med.servo_ticks_per_cycle";
        let settings = ["settle_s=0.2".to_owned(), format!("{key}={ticks}")];
        shown(&Experiment::load(Files::Disk, &path, None, options, &settings).unwrap()).1.summary
    };
    let runs: Vec<Summary> =
        [1, 5, 10].into_iter().flat_map(|ticks| [run(ticks, 1), run(ticks, 2)]).collect();
    let html = page("Title", "Lead.", &runs, &default_columns(&[]), &[]);
    assert!(html.contains("Position error rms over servo ticks per cycle"), "{html}");
    let one = page("Title", "Lead.", &runs[..2], &default_columns(&[]), &[]);
    assert!(!one.contains(" over servo ticks"));
}
