//! Reports: figures of a run, arranged as in the paper, and pages that contain them.

use crate::evaluate::results::{Group, Measure, group, joint_table, notes, table, task_table};
use crate::report::figure::{Comparison, ComparisonRow, Figure, Panel, Scale, Series, Style};
use crate::report::html::Page;
use crate::run::experiment::Experiment;
use crate::run::log_header;
use crate::run::summary::Summary;
use opspace_backend::signal_names::{
    self, DQ, DQ_DESIRED, MOTOR_TORQUE, PHASE, Q, Q_DESIRED, REFERENCE, SERVO_CHANNEL, TICK_CHANNEL,
    TORQUE_DESIRED, TRUTH_CHANNEL, WRENCH,
};
use opspace_control::TaskParameters;
use opspace_log::{ChannelData, Column, Recording};
use opspace_loop::Phase;
use opspace_model::{Data, frame_placement, kinematics};

/// Section of a page about one run, with all its figures.
#[derive(Clone, Debug)]
pub struct RunSection {
    /// Title of the run, in one line.
    pub title: String,
    /// Summary of the run.
    pub summary: Summary,
    /// Figures of the run.
    pub figures: Vec<Figure>,
    /// Warnings about the log: damage, lost rows.
    pub warnings: Vec<String>,
    /// Origin of the run: files, seed, versions.
    pub facts: Vec<(String, String)>,
}

impl RunSection {
    /// Creates the section of a run from its log.
    #[must_use]
    pub fn new(experiment: &Experiment, recording: &Recording, summary: Summary) -> Self {
        let mut warnings = Vec::new();
        if let Some(damage) = &recording.damage {
            let shown = if damage.rows_lost { "; only the readable part is shown" } else { "" };
            warnings.push(format!("The log is damaged{shown}: {damage}."));
        }
        if recording.dropped() > 0 {
            warnings.push(format!("{} rows were dropped and are not in the log.", recording.dropped()));
        }
        warnings.extend(summary.failures.iter().map(|failure| format!("Failure: {failure}.")));
        warnings.extend(
            summary.missed_expectations.iter().map(|missed| format!("Expectation missed: {missed}.")),
        );
        if let Some(fault) = &summary.faulted {
            let time = summary.fault_time_s.unwrap_or(f64::NAN);
            warnings.push(format!("The run was stopped at {time:.3} s: {fault}."));
        }
        // Entries for a replay; a robot without a transformer has none to be shown.
        let has_transformer = summary.transformer.is_some();
        let is_shown =
            |key: &str| key != log_header::ASKED_FOR && (has_transformer || !key.starts_with("transformer"));
        let metadata = recording.metadata(log_header::RUN).into_iter().flatten();
        let facts = metadata.filter(|(key, value)| is_shown(key) && !value.is_empty());
        Self {
            title: title(&summary),
            figures: figures(experiment, recording),
            summary,
            warnings,
            facts: facts.map(|(key, value)| (key.clone(), value.clone())).collect(),
        }
    }
}

/// Builds a page about runs: one table, then a section for each run in `shown`.
#[must_use]
pub fn page(
    title: &str,
    lead: &str,
    summaries: &[Summary],
    measures: &[Measure],
    shown: &[RunSection],
) -> String {
    let mut page = Page::new(title).lead(lead).section("Results").table(
        if summaries.len() == 1 {
            "Values after settle_s"
        } else {
            "Medians over the runs of each row, after settle_s"
        },
        &table(summaries, measures),
        &notes(summaries),
    );
    if summaries.len() > 1 {
        for comparison in comparisons(summaries) {
            page = page.comparison(&comparison);
        }
    }
    for run in shown {
        page = page.section(&run.title);
        for warning in &run.warnings {
            page = page.warning(warning);
        }
        let (tasks, joints) = (task_table(&run.summary), joint_table(&run.summary));
        for (caption, table) in [
            ("Errors of the tasks", tasks),
            ("Torques of the joints; chatter is the desired torque above 8 Hz", joints),
        ] {
            if !table.rows.is_empty() {
                page = page.table(caption, &table, &[]);
            }
        }
        for figure in &run.figures {
            page = page.figure(figure);
        }
        page = page.facts(run.facts.iter().map(|(term, text)| (term.as_str(), text.as_str())));
    }
    page.render()
}

fn title(summary: &Summary) -> String {
    let by = summary.transformer.as_ref().map_or_else(String::new, |t| format!(" through '{t}'"));
    format!(
        "{}: {} robot, {}{by}, {} 1:{}, seed {}",
        summary.task, summary.backend, summary.controller, summary.profile, summary.ratio, summary.seed
    )
}

/// Creates the figures of a run: torques by joint, then the signals of its tasks and sensors.
#[must_use]
pub fn figures(experiment: &Experiment, recording: &Recording) -> Vec<Figure> {
    let recording = &from_control_start(recording);
    let Some(tick) = recording.channel(TICK_CHANNEL) else { return Vec::new() };
    let truth = recording.channel(TRUTH_CHANNEL).unwrap_or(tick);
    let mut figures: Vec<Figure> = torques(recording, tick).into_iter().collect();
    for name in &experiment.task().file.priority {
        match experiment.task().file.task.get(name) {
            Some(TaskParameters::Cartesian(task)) => {
                figures.extend(positions(experiment, tick, truth, name, &task.frame));
                figures.extend(forces(tick, name, task.force.as_ref().map(|f| f.sensor.as_str())));
            }
            Some(TaskParameters::JointTracking(_)) => figures.extend(joints(tick, truth, name)),
            _ => {}
        }
    }
    figures.extend(setpoint_figure(tick));
    figures
}

/// Figure of desired and motor torque of each joint, at servo rate if the log contains it.
fn torques(recording: &Recording, tick: &ChannelData) -> Option<Figure> {
    let (channel, caption) = match recording.channel(SERVO_CHANNEL) {
        Some(servo) => (servo, "True motor torque, mean over each servo period, and desired torque."),
        None => (tick, "Motor torque measured by current, and desired torque."),
    };
    let motor = channel.signal(MOTOR_TORQUE)?;
    let desired = channel.signal(TORQUE_DESIRED);
    let panels = (motor.elements().iter().enumerate())
        .map(|(j, joint)| Panel {
            title: joint.clone(),
            x_label: "time (s)".to_owned(),
            y_label: label_of("torque", &motor, j),
            series: [("motor", Style::Solid, Some(motor)), ("desired", Style::Desired, desired)]
                .into_iter()
                .filter_map(|(label, style, column)| series(label, &channel.time_s, &column?, j, style))
                .collect(),
            ..Panel::default()
        })
        .collect();
    Some(Figure {
        title: "Desired and motor torque".to_owned(),
        caption: caption.to_owned(),
        panels,
        columns: None,
    })
}

fn positions(
    experiment: &Experiment,
    tick: &ChannelData,
    truth: &ChannelData,
    task: &str,
    frame_name: &str,
) -> Option<Figure> {
    let reference = tick.signal(&signal_names::of(task, REFERENCE))?;
    let model = &experiment.robot().model;
    let frame = model.frame_id(frame_name).ok()?;
    let q = truth.signal(Q)?;
    let mut data = Data::new(model);
    let rest = vec![0.0; model.n()];
    let path: Vec<[f64; 3]> = (0..q.len())
        .map(|k| {
            kinematics(model, &mut data, q.row(k), &rest);
            frame_placement(model, &data, frame).translation.into()
        })
        .collect();
    let panels = (0..3)
        .map(|axis| Panel {
            title: ["x", "y", "z"][axis].to_owned(),
            x_label: "time (s)".to_owned(),
            y_label: "position (m)".to_owned(),
            series: [
                Some(Series::new("true", truth.time_s.clone(), path.iter().map(|p| p[axis]).collect())),
                series("reference", &tick.time_s, &reference, axis, Style::Desired),
            ]
            .into_iter()
            .flatten()
            .collect(),
            ..Panel::default()
        })
        .collect();
    Some(Figure {
        title: format!("Position of '{frame_name}'"),
        caption: "World axes. On a compliant axis the reference is the initial position of the frame."
            .to_owned(),
        panels,
        columns: None,
    })
}

fn forces(tick: &ChannelData, task: &str, sensor: Option<&str>) -> Option<Figure> {
    let wrench = tick.signal(&signal_names::of(sensor?, WRENCH))?;
    let panels = (0..3)
        .map(|axis| Panel {
            title: ["x", "y", "z"][axis].to_owned(),
            x_label: "time (s)".to_owned(),
            y_label: "force (N)".to_owned(),
            series: series("sensed", &tick.time_s, &wrench, axis, Style::Solid).into_iter().collect(),
            ..Panel::default()
        })
        .collect();
    Some(Figure {
        title: format!("Contact force measured by task '{task}'"),
        caption: "Force on the robot in world axes, tared at the start.".to_owned(),
        panels,
        columns: None,
    })
}

fn joints(tick: &ChannelData, truth: &ChannelData, task: &str) -> Option<Figure> {
    let reference = tick.signal(&signal_names::of(task, REFERENCE))?;
    joint_figure(
        "Joint positions",
        "True positions and references.",
        "position",
        (truth, Q, "true"),
        (tick, &reference),
    )
}

/// Returns the recording with times relative to the first control cycle.
fn from_control_start(recording: &Recording) -> Recording {
    let mut shifted = recording.clone();
    let phase = recording.channel(TICK_CHANNEL).and_then(|tick| Some((tick, tick.signal(PHASE)?)));
    let first = phase.and_then(|(tick, phase)| {
        let first = phase.rows().position(|row| row[0] == Phase::Control.code())?;
        Some(tick.time_s[first])
    });
    let times = shifted.channels.iter_mut().flat_map(|channel| &mut channel.time_s);
    times.for_each(|time_s| *time_s -= first.unwrap_or(0.0));
    shifted
}

/// Figure of setpoints and measured values: velocities for a velocity robot, positions for a position robot.
fn setpoint_figure(tick: &ChannelData) -> Option<Figure> {
    if let Some(velocities) = tick.signal(DQ_DESIRED) {
        return joint_figure(
            "Setpoints",
            "Velocity setpoints (commands of the velocity servos), and measured or estimated velocities.",
            "velocity",
            (tick, DQ, "measured"),
            (tick, &velocities),
        );
    }
    let positions = tick.signal(Q_DESIRED)?;
    joint_figure(
        "Setpoints",
        "Position setpoints (commands of the position servos), and measured positions.",
        "position",
        (tick, Q, "measured"),
        (tick, &positions),
    )
}

fn joint_figure(
    title: &str,
    caption: &str,
    quantity: &str,
    (channel, name, label): (&ChannelData, &str, &str),
    (desired_channel, desired): (&ChannelData, &Column<'_>),
) -> Option<Figure> {
    let actual = channel.signal(name)?;
    let panels = (actual.elements().iter().enumerate())
        .map(|(j, joint)| Panel {
            title: joint.clone(),
            x_label: "time (s)".to_owned(),
            y_label: label_of(quantity, &actual, j),
            series: [
                series(label, &channel.time_s, &actual, j, Style::Solid),
                series("desired", &desired_channel.time_s, desired, j, Style::Desired),
            ]
            .into_iter()
            .flatten()
            .collect(),
            ..Panel::default()
        })
        .collect();
    Some(Figure { title: title.to_owned(), caption: caption.to_owned(), panels, columns: None })
}

/// Axis label: the quantity, and the unit of one element of a signal.
fn label_of(quantity: &str, column: &Column<'_>, element: usize) -> String {
    format!("{quantity} ({})", column.units()[element].replace("Nm", "N·m"))
}

/// Extracts one element of a signal over time. Values before the start of control are omitted, because references and
/// tared forces are meaningless there. `None` if no value is finite.
fn series(label: &str, time_s: &[f64], column: &Column<'_>, element: usize, style: Style) -> Option<Series> {
    let begun = |t: &f64| *t >= 0.0;
    let y: Vec<f64> = time_s
        .iter()
        .zip(column.rows())
        .map(|(t, row)| if begun(t) { row[element] } else { f64::NAN })
        .collect();
    let any = y.iter().any(|v| v.is_finite());
    any.then(|| Series::new(label, time_s.to_vec(), y).style(style))
}

/// Creates a chart for each quantity: a row per task and profile, a colour per kind of robot and controller.
fn comparisons(summaries: &[Summary]) -> Vec<Comparison> {
    type Quantity = (&'static str, &'static str, Scale, fn(&Summary) -> Option<f64>);
    let quantities: [Quantity; 4] = [
        ("Tracking", "position error, rms (mm)", Scale::Log, |s| {
            s.metrics.pose.position_rms_m.map(|v| 1e3 * v)
        }),
        ("Hand force", "force of the operator's hand, rms (N)", Scale::Linear, |s| {
            s.metrics.hand_force_rms_n
        }),
        ("Hand motion", "motion of the operator's hand, rms (mm)", Scale::Log, |s| {
            s.metrics.hand_motion_rms_m.map(|v| 1e3 * v)
        }),
        ("Torque error", "rms of interval means (%)", Scale::Log, |s| {
            s.metrics.torque_error_interval.map(|v| 1e2 * v)
        }),
    ];
    let groups = group(summaries);
    quantities
        .into_iter()
        .map(|(title, x_label, scale, number)| comparison(&groups, title, x_label, scale, number))
        // With a single kind of robot and controller there is nothing to compare.
        .filter(|comparison| comparison.series.len() > 1)
        .collect()
}

fn comparison(
    groups: &[Group<'_>],
    title: &str,
    x_label: &str,
    scale: Scale,
    number: fn(&Summary) -> Option<f64>,
) -> Comparison {
    let control = |s: &Summary| format!("{} {}", s.backend, s.controller);
    let place = |s: &Summary| format!("{}, {} 1:{}", s.task, s.profile, s.ratio);
    let mut controls: Vec<String> = Vec::new();
    let mut rows: Vec<ComparisonRow> = Vec::new();
    for group in groups {
        let first = group.first();
        let Some(value) = group.median(number) else { continue };
        let column = controls.iter().position(|c| *c == control(first)).unwrap_or_else(|| {
            controls.push(control(first));
            controls.len() - 1
        });
        let label = place(first);
        let at = rows.iter().position(|row| row.label == label).unwrap_or_else(|| {
            rows.push(ComparisonRow { label, values: Vec::new() });
            rows.len() - 1
        });
        let values = &mut rows[at].values;
        values.resize(values.len().max(column + 1), None);
        values[column] = Some(value);
    }
    rows.iter_mut().for_each(|row| row.values.resize(controls.len(), None));
    Comparison {
        title: title.to_owned(),
        caption: String::new(),
        x_label: x_label.to_owned(),
        series: controls,
        rows,
        scale,
    }
}
