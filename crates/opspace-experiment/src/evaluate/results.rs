//! Comparison of summaries: the table that all commands print.

use crate::evaluate::spread::Spread;
use crate::evaluate::summary::Summary;
use crate::evaluate::table::{Cell, Table, shown_unit};
use crate::files::controller_kind::ControllerKind;
use crate::metrics::metric_tables::{JointMetrics, PoseErrors};
use crate::run::experiment::Experiment;
use crate::run::physics::OWN_PLANT;
use opspace_backend::CommandKind;
use opspace_control::TaskParameters;
use opspace_sim::EnvironmentObjectParameters;
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// Summaries that differ only in the seed.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Group<'a> {
    /// All runs of the group, in the order given.
    pub runs: Vec<&'a Summary>,
}

impl<'a> Group<'a> {
    /// Returns the first run of the group; the others differ from it only in the seed and in the results.
    #[must_use]
    pub fn first(&self) -> &'a Summary {
        self.runs[0]
    }

    /// Median of a number over the runs that have it, with its interval.
    pub fn spread(&self, number: impl Fn(&Summary) -> Option<f64>) -> Option<Spread> {
        Spread::of(self.runs.iter().filter_map(|run| number(run)))
    }

    /// Spread of each metric that a run of the group has, by its key in a summary.
    #[must_use]
    pub fn metrics(&self) -> BTreeMap<String, Spread> {
        let mut numbers: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        for run in &self.runs {
            let Ok(Value::Object(metrics)) = serde_json::to_value(run.metrics) else { continue };
            for (key, value) in metrics {
                numbers.entry(key).or_default().extend(value.as_f64());
            }
        }
        let spread = |(key, numbers): (String, Vec<f64>)| Some((key, Spread::of(numbers)?));
        numbers.into_iter().filter_map(spread).collect()
    }
}

/// Groups of runs that differ only in the seed, with the spread of each metric: the entry `groups` of a bench's file.
#[must_use]
pub fn group_rows(summaries: &[Summary]) -> Vec<Value> {
    let row = |group: &Group<'_>| {
        let first = group.first();
        json!({
            "task": first.task,
            "robot": first.robot,
            "backend": first.backend,
            "plant": first.plant,
            "controller": first.controller,
            "transformer": first.transformer,
            "profile": first.profile,
            "ratio": first.ratio,
            "duration_s": first.duration_s,
            "overrides": first.overrides,
            "label": first.label,
            "seeds": group.runs.iter().map(|run| run.seed).collect::<Vec<u64>>(),
            "metrics": group.metrics(),
        })
    };
    group(summaries).iter().map(row).collect()
}

/// Groups runs that differ only in the seed. The groups are ordered by robot and task, then by profile.
#[must_use]
pub fn group(summaries: &[Summary]) -> Vec<Group<'_>> {
    let mut groups: Vec<Group<'_>> = Vec::new();
    for summary in summaries {
        match groups.iter_mut().find(|group| same(group.first(), summary)) {
            Some(group) => group.runs.push(summary),
            None => groups.push(Group { runs: vec![summary] }),
        }
    }
    let first_of = |same: &dyn Fn(&Summary) -> bool| summaries.iter().position(same);
    groups.sort_by_key(|group| {
        let own = group.first();
        (
            first_of(&|s| s.robot == own.robot && s.task == own.task),
            first_of(&|s| s.profile == own.profile),
            first_of(&|s| same(s, own)),
        )
    });
    groups
}

fn same(a: &Summary, b: &Summary) -> bool {
    a.task == b.task
        && a.robot == b.robot
        && a.backend == b.backend
        && a.plant == b.plant
        && a.controller == b.controller
        && a.transformer == b.transformer
        && a.profile == b.profile
        && a.ratio == b.ratio
        && a.duration_s == b.duration_s
        && a.overrides == b.overrides
        && a.label == b.label
}

/// The table of results: one row per group with medians, below it the ends of their intervals, the name of each task on a
/// line above its rows, and one column per measure.
#[must_use]
pub fn table(summaries: &[Summary], measures: &[Measure]) -> Table {
    let mut heads = vec![("robot, control", ""), ("profile", ""), ("runs", "")];
    heads.extend(measures.iter().map(|measure| measure.head()));
    heads.push(("stopped", ""));
    let mut table = Table::new(&heads);
    let mut task = None;
    for group in group(summaries) {
        let first = group.first();
        if task.replace((&first.task, &first.robot)) != Some((&first.task, &first.robot)) {
            // Missing cells at the end of a row stay blank.
            table.push(vec![first.task.clone().into()]);
        }
        let runs = group.runs.len();
        let mut row: Vec<Cell> = vec![
            format!("  {} {}", first.backend, control(first)).into(),
            profile(first).into(),
            if summaries.len() > 1 { (runs as u64).into() } else { Cell::Empty },
        ];
        row.extend(measures.iter().map(|measure| measure.median(&group)));
        row.push(stopped(&group));
        table.push(row);
        let ends = [("    from", Spread::low as fn(&Spread) -> f64), ("    to", Spread::high)];
        for (name, end) in ends {
            let ends: Vec<Cell> = measures.iter().map(|measure| measure.end(&group, end)).collect();
            // Runs without any random influence have no spread.
            if ends.iter().any(|cell| *cell != "".into()) {
                table.push([name.into(), "".into(), "".into()].into_iter().chain(ends).collect());
            }
        }
    }
    drop_empty_columns(&mut table);
    table
}

/// Names the control of a run, controller, transformer and label, and the plant if it is not the library's own.
pub(crate) fn control(summary: &Summary) -> String {
    let mut text = summary.controller.clone();
    for more in [&summary.transformer, &summary.label].into_iter().flatten() {
        text += &format!(" + {more}");
    }
    match &summary.plant {
        Some(plant) if plant != OWN_PLANT => format!("{text}, {plant}"),
        _ => text,
    }
}

fn profile(summary: &Summary) -> String {
    format!("{} 1:{}", summary.profile, summary.ratio)
}

/// Column of a table of results.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Measure {
    /// Distance from the reference, rms.
    PositionRms,
    /// Distance from the reference, largest.
    PositionMax,
    /// Angle from the reference, rms.
    OrientationRms,
    /// Angle from the reference, largest.
    OrientationMax,
    /// Joint error, rms.
    JointRms,
    /// Error of the contact force on force axes, rms.
    ForceRms,
    /// Error of the contact force while the references rest, rms.
    ForceHold,
    /// Error of the contact force while the references move, rms.
    ForceMoving,
    /// Force of the simulated hand, rms.
    HandForce,
    /// Displacement of the simulated hand's frame, rms.
    HandMotion,
    /// Error of the motor torque at servo rate, relative to the desired torque.
    TorqueErrorServo,
    /// Error of the mean motor torque over each interface interval, relative to the desired torque.
    TorqueErrorInterval,
    /// Error of the motor torque in the first servo period of each interface cycle, relative to the desired torque.
    TorqueErrorTick,
    /// Torque error within interface intervals, relative to the ripple that held setpoints inevitably cause.
    HoldRipple,
    /// Largest torque that the controller commanded.
    TorqueMax,
    /// Largest change of a commanded torque from one interface cycle to the next.
    TorqueStepMax,
    /// Largest speed of a joint.
    SpeedMax,
    /// Fraction of interface cycles in which a limit changed the command.
    Limited,
    /// Acceleration that limits take from the first task, over its translations (of a task of joints, its prismatic joints), rms.
    Slack,
    /// Acceleration that limits take from the first task, over its rotations (of a task of joints, its revolute joints), rms.
    AngularSlack,
    /// Fraction of the time in which a force task has contact.
    InContact,
    /// Largest contact force in the first second of contact.
    ContactPeak,
    /// Displacement along the compliant axes, rms.
    CompliantMotion,
    /// Desired torque above 8 Hz of the joint with the most, rms.
    TorqueChatter,
    /// Fraction of control cycles in which a task was damped near a singular pose.
    Damped,
    /// Fraction of interface cycles that were missed.
    Missed,
    /// Largest error of a joint's mean motor torque, relative to the torque limit of the joint.
    TorqueErrorOfLimit,
    /// Median duration of a control cycle.
    TickTime,
    /// Ratio of robot time to wall-clock time.
    RealTime,
}

/// Default columns of a table.
pub const MEASURES: &[Measure] = &[
    Measure::PositionRms,
    Measure::JointRms,
    Measure::ForceRms,
    Measure::InContact,
    Measure::HandForce,
    Measure::HandMotion,
    Measure::TorqueErrorServo,
    Measure::TorqueErrorInterval,
    Measure::TorqueErrorTick,
    Measure::TickTime,
    Measure::RealTime,
];

/// Title and unit of a column, factor from SI units to this unit, and function that reads the value from a summary.
struct Row(&'static str, &'static str, f64, fn(&Summary) -> Option<f64>);

impl Measure {
    /// Column of a measure.
    fn row(self) -> Row {
        match self {
            Self::PositionRms => Row("position error rms", "mm", 1e3, |s| s.metrics.pose.position_rms_m),
            Self::PositionMax => Row("position error max", "mm", 1e3, |s| s.metrics.pose.position_max_m),
            Self::OrientationRms => {
                Row("orientation error rms", "mrad", 1e3, |s| s.metrics.pose.orientation_rms_rad)
            }
            Self::OrientationMax => {
                Row("orientation error max", "mrad", 1e3, |s| s.metrics.pose.orientation_max_rad)
            }
            Self::JointRms => Row("joint error rms", "mrad", 1e3, |s| s.metrics.joint_rms_rad),
            Self::ForceRms => Row("force error rms", "N", 1.0, |s| s.metrics.contact.force_rms_n),
            Self::ForceHold => {
                Row("force error rms at rest", "N", 1.0, |s| s.metrics.contact.force_hold_rms_n)
            }
            Self::ForceMoving => {
                Row("force error rms in motion", "N", 1.0, |s| s.metrics.contact.force_moving_rms_n)
            }
            Self::HandForce => Row("operator force rms", "N", 1.0, |s| s.metrics.hand_force_rms_n),
            Self::HandMotion => Row("hand motion rms", "mm", 1e3, |s| s.metrics.hand_motion_rms_m),
            Self::TorqueErrorServo => Row("torque error servo", "%", 1e2, |s| s.metrics.torque_error_servo),
            Self::TorqueErrorInterval => {
                Row("torque error interval", "%", 1e2, |s| s.metrics.torque_error_interval)
            }
            Self::TorqueErrorTick => Row("torque error tick", "%", 1e2, |s| s.metrics.torque_error_tick),
            Self::HoldRipple => Row("hold ripple", "×", 1.0, |s| s.metrics.hold_ripple),
            Self::TorqueMax => Row("torque max", "N·m", 1.0, |s| s.metrics.torque_commanded_max_nm),
            Self::TorqueStepMax => Row("torque step max", "N·m", 1.0, |s| s.metrics.torque_step_max_nm),
            Self::SpeedMax => Row("speed max", "rad/s", 1.0, |s| s.metrics.speed_max_rad_per_s),
            Self::Limited => Row("limited", "%", 1e2, |s| s.metrics.limited_share),
            Self::Slack => Row("slack rms", "m/s²", 1.0, |s| s.metrics.slack.slack_rms_m_per_s2),
            Self::AngularSlack => {
                Row("angular slack rms", "rad/s²", 1.0, |s| s.metrics.slack.slack_rms_rad_per_s2)
            }
            Self::InContact => Row("in contact", "%", 1e2, |s| s.metrics.contact.in_contact_fraction),
            Self::ContactPeak => {
                Row("contact peak (first second)", "N", 1.0, |s| s.metrics.contact.contact_peak_n)
            }
            Self::CompliantMotion => {
                Row("compliant motion rms", "mm", 1e3, |s| s.metrics.compliance.compliant_motion_rms_m)
            }
            Self::TorqueChatter => {
                Row("desired torque above 8 Hz, rms", "N·m", 1.0, |s| s.metrics.torque_chatter_rms_nm)
            }
            Self::Damped => Row("damped", "%", 1e2, |s| s.metrics.damped_fraction),
            Self::Missed => Row("missed cycles", "%", 1e2, |s| s.metrics.missed_fraction),
            Self::TorqueErrorOfLimit => {
                Row("torque error of limit", "%", 1e2, |s| s.metrics.torque_error_of_limit_max)
            }
            Self::TickTime => Row("cycle time", "µs", 1e-3, |s| Some(s.timing.tick_ns_median)),
            Self::RealTime => Row("times real time", "", 1.0, |s| s.timing.realtime_factor),
        }
    }

    /// Name of the measure in a suite file.
    #[must_use]
    pub fn name(self) -> String {
        serde_json::to_value(self).ok().and_then(|name| name.as_str().map(str::to_owned)).unwrap_or_default()
    }

    /// True if any of the runs has a value for the measure.
    #[must_use]
    pub fn is_in(self, summaries: &[Summary]) -> bool {
        let Row(.., value) = self.row();
        summaries.iter().any(|summary| value(summary).is_some())
    }

    /// Requirement on an experiment for a value of the measure, as far as it is known before a run.
    pub(crate) fn needed(self) -> Option<&'static str> {
        Some(match self {
            Self::PositionRms | Self::PositionMax | Self::OrientationRms | Self::OrientationMax => {
                "a task with a Cartesian frame or the centre of mass"
            }
            Self::ForceRms | Self::InContact | Self::ContactPeak | Self::CompliantMotion => {
                "a task with a Cartesian frame"
            }
            Self::JointRms => "a task of the kind `joint-tracking`",
            Self::HandForce | Self::HandMotion => {
                "a task with a spring in `environment`, which is the operator"
            }
            Self::HoldRipple => "a position robot with the controller `osc`",
            Self::TorqueErrorServo
            | Self::TorqueErrorInterval
            | Self::TorqueErrorTick
            | Self::TorqueErrorOfLimit
            | Self::TorqueMax
            | Self::TorqueStepMax
            | Self::Slack
            | Self::AngularSlack => "the controller `osc`",
            _ => return None,
        })
    }

    /// False if a run of the experiment cannot have a value for the measure.
    pub(crate) fn is_possible(self, experiment: &Experiment) -> bool {
        let tasks = experiment.task().tasks_of_the_run();
        let task = |kind: fn(&TaskParameters) -> bool| tasks.iter().any(|(_, task)| kind(task));
        let torques = experiment.options().controller == ControllerKind::Osc;
        match self {
            Self::PositionRms | Self::PositionMax | Self::OrientationRms | Self::OrientationMax => {
                task(|t| matches!(t, TaskParameters::Cartesian(_) | TaskParameters::CenterOfMass(_)))
            }
            Self::ForceRms | Self::InContact | Self::ContactPeak | Self::CompliantMotion => {
                task(|t| matches!(t, TaskParameters::Cartesian(_)))
            }
            Self::JointRms => task(|t| matches!(t, TaskParameters::JointTracking(_))),
            Self::HandForce | Self::HandMotion => experiment
                .task()
                .file
                .environment
                .values()
                .any(|o| matches!(o, EnvironmentObjectParameters::Spring(_))),
            Self::HoldRipple => torques && experiment.options().backend == CommandKind::Position,
            Self::TorqueErrorServo
            | Self::TorqueErrorInterval
            | Self::TorqueErrorTick
            | Self::TorqueErrorOfLimit
            | Self::TorqueMax
            | Self::TorqueStepMax
            | Self::Slack
            | Self::AngularSlack => torques,
            _ => true,
        }
    }

    /// Title and unit of the measure's column.
    fn head(self) -> (&'static str, &'static str) {
        let Row(title, unit, ..) = self.row();
        (title, unit)
    }

    /// Median of the measure over runs, in the unit of its column.
    fn median(self, group: &Group<'_>) -> Cell {
        let Row(.., factor, value) = self.row();
        Cell::from(group.spread(value).map(|spread| factor * spread.median))
    }

    /// End of the interval of that median; blank where the interval has no width, and for computing times.
    fn end(self, group: &Group<'_>, end: fn(&Spread) -> f64) -> Cell {
        let Row(.., factor, value) = self.row();
        let is_reproducible = !matches!(self, Self::TickTime | Self::RealTime);
        let spread = group.spread(value).filter(|spread| is_reproducible && spread.high > spread.low);
        spread.map_or("".into(), |spread| (factor * end(&spread)).into())
    }
}

/// Failures and missed expectations of runs, each with its run, the first ten.
#[must_use]
pub fn failures(summaries: &[Summary]) -> Vec<String> {
    const MOST: usize = 10;
    let of_run = |summary: &Summary| {
        let missed = summary.missed_expectations.iter().map(|missed| format!("expectation missed: {missed}"));
        let all: Vec<String> = summary.failures.iter().cloned().chain(missed).collect();
        let run = format!(
            "{}, {} robot, {}, seed {}",
            summary.task,
            summary.backend,
            control(summary),
            summary.seed
        );
        all.into_iter().map(move |text| format!("{run}: {text}"))
    };
    let all: Vec<String> = summaries.iter().flat_map(of_run).collect();
    let more = all.len().saturating_sub(MOST);
    let more = (more > 0).then(|| format!("and {more} more failures"));
    all.into_iter().take(MOST).chain(more).collect()
}

/// Table of the errors, forces and motions of each task of a run, of what limits take from it, and of each joint of its joint
/// tasks; `end` is the error at the end of the run, if the reference rests there.
#[must_use]
pub fn task_table(summary: &Summary) -> Table {
    let titles = ["task", "quantity", "rms", "max", "end", "unit"];
    let mut table = Table::new(&titles.map(|title| (title, "")));
    // Millimetres, milliradians and newtons have nothing in common.
    table.decimals_by_row = true;
    for (name, task) in &summary.tasks {
        let mut row_with_end = |quantity: &str, unit: &str, values: [Option<f64>; 3]| {
            let (factor, unit) = shown_unit(unit);
            if values.iter().any(Option::is_some) {
                let cells = values.map(|value| Cell::from(value.map(|value| factor * value)));
                let texts: [Cell; 2] = [name.as_str().into(), quantity.into()];
                table.push(texts.into_iter().chain(cells).chain([unit.into()]).collect());
            }
        };
        let PoseErrors { position_rms_m, position_max_m, position_final_m, .. } = task.pose;
        row_with_end("position error", "m", [position_rms_m, position_max_m, position_final_m]);
        let PoseErrors { orientation_rms_rad, orientation_max_rad, orientation_final_rad, .. } = task.pose;
        row_with_end(
            "orientation error",
            "rad",
            [orientation_rms_rad, orientation_max_rad, orientation_final_rad],
        );
        let mut row = |quantity: &str, unit: &str, rms: Option<f64>, max: Option<f64>| {
            row_with_end(quantity, unit, [rms, max, None]);
        };
        row("force error", "N", task.contact.force_rms_n, None);
        row("force error, reference at rest", "N", task.contact.force_hold_rms_n, None);
        row("force error, reference in motion", "N", task.contact.force_moving_rms_n, None);
        row("contact peak (first second of contact)", "N", None, task.contact.contact_peak_n);
        row("compliant motion", "m", task.compliance.compliant_motion_rms_m, None);
        let slack = &task.slack;
        // Without limits in force it is a rounding error.
        let taken = |max: Option<f64>| max.filter(|max| *max > 1e-9);
        if let Some(max) = taken(slack.slack_max_m_per_s2) {
            row("slack (taken by limits)", "m/s²", slack.slack_rms_m_per_s2, Some(max));
        }
        if let Some(max) = taken(slack.slack_max_rad_per_s2) {
            row("slack (taken by limits)", "rad/s²", slack.slack_rms_rad_per_s2, Some(max));
        }
        for element in &task.elements {
            row(&format!("{} error", element.name), &element.unit, Some(element.rms), Some(element.max));
        }
    }
    table
}

/// Smallest rms of a desired torque, relative to the torque limit, to which an error can be related.
const MIN_DESIRED_OF_LIMIT: f64 = 0.01;

/// Error of a joint's torque relative to the desired one; `None` if this is hardly above zero.
pub(crate) fn error_of_desired(joint: &JointMetrics) -> Option<f64> {
    let is_small = |of_desired: f64| {
        joint.torque_error_of_limit.is_some_and(|of_limit| of_limit < MIN_DESIRED_OF_LIMIT * of_desired)
    };
    joint.torque_error_of_desired.filter(|of_desired| !is_small(*of_desired))
}

/// Table of the torques of each joint of a run.
#[must_use]
pub fn joint_table(summary: &Summary) -> Table {
    let mut table = Table::new(&[
        ("joint", ""),
        ("torque error, interval, rms", "N·m"),
        ("torque error of limit", "%"),
        ("torque error of desired", "%"),
        ("desired torque above 8 Hz, rms", "N·m"),
        ("largest line", "Hz"),
        ("saturated cycles", "%"),
    ]);
    let percent = |fraction: Option<f64>| Cell::from(fraction.map(|fraction| 100.0 * fraction));
    for (name, joint) in &summary.joints {
        table.push(vec![
            name.as_str().into(),
            joint.torque_error_rms_nm.into(),
            percent(joint.torque_error_of_limit),
            percent(error_of_desired(joint)),
            joint.torque_chatter_rms_nm.into(),
            joint.torque_chatter_hz.into(),
            percent(joint.torque_saturated_fraction),
        ]);
    }
    table
}

fn stopped(group: &Group<'_>) -> Cell {
    let faulted = group.runs.iter().filter(|run| run.faulted.is_some()).count();
    let interrupted = group.runs.iter().filter(|run| run.interrupted).count();
    match (faulted, interrupted) {
        (0, 0) => Cell::Empty,
        (0, n) => Cell::Fail(format!("{n} interrupted")),
        (n, _) => Cell::Fail(format!("{n} faulted")),
    }
}

/// Drops the columns that are empty in all rows.
fn drop_empty_columns(table: &mut Table) {
    for place in (0..table.columns.len()).rev() {
        let is_empty = |cell: &Cell| *cell == Cell::Empty || *cell == "".into();
        if table.rows.iter().all(|row| row.get(place).is_none_or(is_empty)) {
            table.columns.remove(place);
            for row in table.rows.iter_mut().filter(|row| place < row.len()) {
                row.remove(place);
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::{MEASURES, group, group_rows, table};
    use crate::evaluate::summary::Summary;
    use crate::run::physics::OWN_PLANT;
    use serde_json::json;

    pub(crate) fn summary(task: &str, profile: &str, seed: u64, position: f64) -> Summary {
        let mut summary = Summary {
            task: task.to_owned(),
            robot: "arm".to_owned(),
            backend: "position".to_owned(),
            controller: "osc".to_owned(),
            transformer: None,
            transformer_reason: None,
            profile: profile.to_owned(),
            ratio: 5,
            seed,
            simulated: true,
            plant: Some(OWN_PLANT.to_owned()),
            assumed: Vec::new(),
            allowed: Vec::new(),
            duration_s: 1.0,
            overrides: Vec::new(),
            label: None,
            replay: None,
            faulted: None,
            fault_time_s: None,
            interrupted: false,
            interrupted_time_s: None,
            rows_lost: 0,
            not_saved: Vec::new(),
            missed_expectations: Vec::new(),
            failures: Vec::new(),
            unreached_goals: Vec::new(),
            limited_references: Vec::new(),
            ignored_compliance: Vec::new(),
            escapes: Vec::new(),
            tasks: Default::default(),
            joints: Default::default(),
            missed_cycles: 0,
            stale_target_cycles: 0,
            resumed: 0,
            metrics: crate::Metrics::default(),
            timing: crate::Timing::default(),
        };
        summary.metrics.pose.position_rms_m = Some(position);
        summary
    }

    #[test]
    fn runs_are_grouped_into_rows_with_medians() {
        let runs = [
            summary("a", "p", 1, 0.1),
            summary("b", "p", 1, 1.0),
            summary("a", "p", 2, 0.3),
            summary("a", "q", 1, 0.5),
            summary("a", "p", 3, 0.2),
        ];
        let groups = group(&runs);
        let heads: Vec<(&str, &str, usize)> = (groups.iter())
            .map(|g| (g.first().task.as_str(), g.first().profile.as_str(), g.runs.len()))
            .collect();
        assert_eq!(heads, [("a", "p", 3), ("a", "q", 1), ("b", "p", 1)]);
        let position = groups[0].spread(|s| s.metrics.pose.position_rms_m).expect("three runs");
        assert_eq!((position.median, position.low, position.high, position.runs), (0.2, 0.1, 0.3, 3));
        assert_eq!(groups[0].spread(|s| s.metrics.joint_rms_rad), None);
    }

    /// Compared: the entry of a group in a bench's file, and its runs' seeds and metrics.
    #[test]
    fn groups_of_a_file_have_the_spread_of_each_metric() {
        let runs = [summary("a", "p", 1, 0.1), summary("a", "p", 4, 0.4), summary("a", "p", 2, 0.2)];
        let groups = group_rows(&runs);
        assert_eq!(groups.len(), 1);
        assert_eq!(groups[0]["seeds"], json!([1, 4, 2]));
        let spread = json!({ "median": 0.2, "low": 0.1, "high": 0.4, "runs": 3 });
        assert_eq!(
            groups[0]["metrics"],
            json!({ "position_rms_m": spread }),
            "only metrics that the runs have"
        );
    }

    #[test]
    fn missing_quantity_has_no_column() {
        let titles: Vec<String> =
            table(&[summary("a", "p", 1, 0.1)], MEASURES).columns.into_iter().map(|c| c.title).collect();
        assert!(titles.contains(&"position error rms".to_owned()));
        assert!(!titles.contains(&"operator force rms".to_owned()));
    }

    /// Compared: the rows of a table, and rows written by hand: the task is above its rows, the median in its column.
    #[test]
    fn task_heading_precedes_its_rows() {
        let runs = [summary("a", "p", 1, 0.001), summary("a", "p", 2, 0.003), summary("b", "q", 1, 0.005)];
        let texts = table(&runs, MEASURES).texts();
        let firsts: Vec<&str> = texts.iter().map(|row| row[0].as_str()).collect();
        assert_eq!(firsts, ["a", "  position osc", "    from", "    to", "b", "  position osc"]);
        assert_eq!(texts[1][1..4], ["p 1:5", "2", "2.000"]);
        assert_eq!(texts[2][1..4], ["", "", "1.000"]);
        assert_eq!(texts[3][1..4], ["", "", "3.000"]);
        assert_eq!(texts[5][1..4], ["q 1:5", "1", "5.000"]);
    }
}
