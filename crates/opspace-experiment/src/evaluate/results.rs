//! Comparison of summaries: the table that all commands print.

use crate::evaluate::grid_keys::{GridKey, own_label};
use crate::evaluate::spread::Spread;
use crate::evaluate::summary::Summary;
use crate::evaluate::table::{Cell, Table, shown_unit};
use crate::files::controller_kind::ControllerKind;
use crate::metrics::metric::{Column, Metric, Needs};
use crate::metrics::metric_tables::{JointMetrics, PoseErrors};
use crate::run::experiment::Experiment;
use crate::run::physics::OWN_PLANT;
use crate::text::NOISE;
use opspace_backend::CommandKind;
use opspace_control::TaskParameters;
use opspace_sim::EnvironmentObjectParameters;
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
    /// Creates the group of a single run.
    pub fn of(run: &'a Summary) -> Self {
        Self { runs: vec![run] }
    }

    /// Returns the first run of the group; the others differ from it only in the seed and in the results.
    #[must_use]
    pub fn first(&self) -> &'a Summary {
        self.runs[0]
    }

    /// Median of a number over the runs that have it, with its interval.
    pub fn spread(&self, number: impl Fn(&Summary) -> Option<f64>) -> Option<Spread> {
        Spread::of(self.runs.iter().filter_map(|run| number(run)))
    }

    /// Median of a metric with its interval, in the unit of its column.
    pub fn of_column(&self, metric: &Metric, column: &Column) -> Option<Spread> {
        self.spread(|run| Some(column.factor * value(run, metric)?))
    }

    /// Spread of each metric that a run of the group has, by its key in a summary.
    #[must_use]
    pub fn metrics(&self) -> BTreeMap<String, Spread> {
        let mut numbers: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        for run in &self.runs {
            let Ok(Value::Object(metrics)) = serde_json::to_value(&run.metrics) else { continue };
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

/// The table of results: one row per group with medians and their intervals, the name of each task on a line above its rows,
/// one column for each setting of a grid, and one for each of these metrics that has one.
#[must_use]
pub fn table(summaries: &[Summary], metrics: &[Metric]) -> Table {
    let columns: Vec<(&Metric, Column)> =
        metrics.iter().filter_map(|metric| Some((metric, metric.column?))).collect();
    let groups = group(summaries);
    let firsts: Vec<&Summary> = groups.iter().map(Group::first).collect();
    let swept = GridKey::of(firsts.iter().copied());
    let settings: Vec<Vec<Cell>> = swept.iter().map(|key| key.cells(&firsts)).collect();
    let mut heads = vec![("robot, control", "")];
    heads.extend(swept.iter().map(|key| (key.name.as_str(), key.unit)));
    heads.extend([("profile", ""), ("runs", "")]);
    heads.extend(columns.iter().map(|(_, column)| (column.title, column.unit)));
    heads.push(("stopped", ""));
    let mut table = Table { further_names: swept.len(), ..Table::new(&heads) };
    let mut task = None;
    for (place, group) in groups.iter().enumerate() {
        let first = group.first();
        if task.replace((&first.task, &first.robot)) != Some((&first.task, &first.robot)) {
            // Missing cells at the end of a row stay blank.
            table.push(vec![first.task.clone().into()]);
        }
        let runs = group.runs.len();
        let own = Summary { label: own_label(first), ..first.clone() };
        let mut row: Vec<Cell> = vec![format!("  {} {}", first.backend, control(&own)).into()];
        row.extend(settings.iter().map(|cells| cells[place].clone()));
        row.push(profile(first).into());
        row.push(if summaries.len() > 1 { (runs as u64).into() } else { Cell::Empty });
        row.extend(columns.iter().map(|column| median(group, *column)));
        row.push(stopped(group));
        table.push(row);
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

pub(crate) fn profile(summary: &Summary) -> String {
    format!("{} 1:{}", summary.profile, summary.ratio)
}

/// Value of a metric in a summary, in its own unit.
pub fn value(summary: &Summary, metric: &Metric) -> Option<f64> {
    summary.metrics.get(metric.key).or_else(|| summary.timing.value(metric.key))
}

/// True if any of the runs has a value for the metric.
#[must_use]
pub fn has_value(summaries: &[Summary], metric: &Metric) -> bool {
    summaries.iter().any(|summary| value(summary, metric).is_some())
}

/// False if a run of the experiment cannot have a value for a metric.
pub fn is_possible(needs: Needs, experiment: &Experiment) -> bool {
    let tasks = experiment.task().tasks_of_the_run();
    let task = |kind: fn(&TaskParameters) -> bool| tasks.iter().any(|(_, task)| kind(task));
    let torques = experiment.options().controller == ControllerKind::Osc;
    match needs {
        Needs::Nothing => true,
        Needs::Pose => task(|t| matches!(t, TaskParameters::Cartesian(_) | TaskParameters::CenterOfMass(_))),
        Needs::Frame => task(|t| matches!(t, TaskParameters::Cartesian(_))),
        Needs::JointTracking => task(|t| matches!(t, TaskParameters::JointTracking(_))),
        Needs::Operator => experiment
            .task()
            .file
            .environment
            .values()
            .any(|o| matches!(o, EnvironmentObjectParameters::Spring(_))),
        Needs::TorqueToPosition => torques && experiment.options().backend == CommandKind::Position,
        Needs::Torque => torques,
    }
}

/// Median of a metric over runs with its interval, in the unit of its column; computing times have none.
fn median(group: &Group<'_>, (metric, column): (&Metric, Column)) -> Cell {
    let is_reproducible = group.first().timing.value(metric.key).is_none();
    let Some(spread) = group.spread(|run| value(run, metric)) else { return Cell::Empty };
    let [median, low, high] = [spread.median, spread.low, spread.high].map(|value| column.factor * value);
    if is_reproducible && spread.high > spread.low {
        Cell::Spread { median, low, high }
    } else {
        median.into()
    }
}

/// Failures and missed expectations of runs, each with its run, the first ten.
#[must_use]
pub fn failures(summaries: &[Summary]) -> Vec<String> {
    const MOST: usize = 10;
    let of_run = |summary: &Summary| {
        let missed = summary.missed_expectations.iter().map(|missed| format!("expectation missed: {missed}"));
        let all: Vec<String> = summary.findings.failures().map(ToString::to_string).chain(missed).collect();
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
    for (name, task) in summary.ordered_tasks() {
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
        row("force error", "N", task.contact.force_rms_n, task.contact.force_error_max_n);
        row("force error, reference at rest", "N", task.contact.force_hold_rms_n, None);
        row("force error, reference in motion", "N", task.contact.force_moving_rms_n, None);
        row("force in the first second of contact", "N", None, task.contact.contact_peak_n);
        row("compliant motion", "m", task.compliance.compliant_motion_rms_m, None);
        let slack = &task.slack;
        // Without limits in force it is a rounding error.
        let taken = |max: Option<f64>| max.filter(|max| *max > NOISE);
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

/// Table of the torques of each joint of a run, with the columns that say something; without rows if the controller computes no
/// torques.
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
    let saturates = |joint: &JointMetrics| joint.torque_saturated_fraction.is_some_and(|share| share > 0.0);
    let any_saturates = summary.joints.values().any(saturates);
    for (name, joint) in summary.ordered_joints() {
        table.push(vec![
            name.as_str().into(),
            joint.torque_error_rms_nm.into(),
            percent(joint.torque_error_of_limit),
            percent(error_of_desired(joint)),
            joint.torque_chatter_rms_nm.into(),
            joint.torque_chatter_hz.into(),
            percent(joint.torque_saturated_fraction.filter(|_| any_saturates)),
        ]);
    }
    drop_empty_columns(&mut table);
    if table.columns.len() == 1 {
        table.rows.clear();
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
pub(crate) fn drop_empty_columns(table: &mut Table) {
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
    use super::{group, group_rows, joint_table, table, task_table};
    use crate::evaluate::summary::Summary;
    use crate::evaluate::table::Table;
    use crate::metrics::columns::default_columns;
    use crate::metrics::metric_tables::{JointMetrics, TaskMetrics};
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
            findings: Default::default(),
            tasks: Default::default(),
            frames: Default::default(),
            joints: Default::default(),
            task_order: Vec::new(),
            joint_order: Vec::new(),
            missed_cycles: 0,
            stale_target_cycles: 0,
            resumed: 0,
            metrics: crate::Metrics::default(),
            timing: crate::Timing::default(),
            real_time: None,
        };
        summary.metrics.pose.position_rms_m = Some(position);
        summary
    }

    /// Checks the orders of rows against those of robot and priority, and that a run without torques has no table of them.
    #[test]
    fn rows_are_in_the_order_of_robot_and_priority() {
        let mut run = summary("a", "p", 1, 0.1);
        for name in ["elbow", "shoulder", "wrist"] {
            let joint = JointMetrics { torque_saturated_fraction: Some(0.0), ..JointMetrics::default() };
            run.joints.insert(name.to_owned(), joint);
        }
        run.joint_order = ["shoulder", "elbow", "wrist"].map(str::to_owned).into();
        assert!(joint_table(&run).rows.is_empty(), "only torques that are never cut off");
        run.joints.values_mut().for_each(|joint| joint.torque_error_rms_nm = Some(0.1));
        let names = |table: Table| table.texts().into_iter().map(|row| row[0].clone()).collect::<Vec<_>>();
        assert_eq!(names(joint_table(&run)), run.joint_order);
        for name in ["hand", "elbow"] {
            let mut task = TaskMetrics::default();
            task.pose.position_rms_m = Some(0.1);
            run.tasks.insert(name.to_owned(), task);
        }
        run.task_order = ["hand", "elbow"].map(str::to_owned).into();
        assert_eq!(names(task_table(&run)), run.task_order);
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
        let titles: Vec<String> = table(&[summary("a", "p", 1, 0.1)], &default_columns(&[]))
            .columns
            .into_iter()
            .map(|c| c.title)
            .collect();
        assert!(titles.contains(&"position error rms".to_owned()));
        assert!(!titles.contains(&"operator force rms".to_owned()));
    }

    /// Compared: the columns of a grid, and names, units and values by hand. Its values are not in the names of the rows.
    #[test]
    fn settings_of_a_grid_have_columns() {
        let run = |stiffness: &str, kp: &str| Summary {
            overrides: vec![
                format!("environment.board.wall.stiffness_n_per_m={stiffness}"),
                format!("robot.simulated.true_over_nominal.kp={kp}"),
                "duration_s=2.0".to_owned(),
            ],
            label: Some(format!("soft, stiffness_n_per_m={stiffness}, kp={kp}")),
            ..summary("a", "p", 1, 0.001)
        };
        let table = table(&[run("1000.0", "0.9"), run("50000.0", "1.1")], &default_columns(&[]));
        let titles: Vec<String> = table.columns.iter().map(|column| column.column_title()).collect();
        assert_eq!(titles[..4], ["robot, control", "stiffness (N/m)", "kp (true/nominal)", "profile"]);
        let texts = table.texts();
        assert_eq!(texts[1][..4], ["  position osc + soft", "1000", "0.9", "p 1:5"]);
        assert_eq!(texts[2][..4], ["  position osc + soft", "50000", "1.1", "p 1:5"]);
    }

    /// Compared: the rows of a table, and rows written by hand: the task is above its rows, the median in its column.
    #[test]
    fn task_heading_precedes_its_rows() {
        let runs = [summary("a", "p", 1, 0.001), summary("a", "p", 2, 0.003), summary("b", "q", 1, 0.005)];
        let texts = table(&runs, &default_columns(&[])).texts();
        let firsts: Vec<&str> = texts.iter().map(|row| row[0].as_str()).collect();
        assert_eq!(firsts, ["a", "  position osc", "b", "  position osc"]);
        assert_eq!(texts[1][1..4], ["p 1:5", "2", "2.00 ±1.00"]);
        assert_eq!(texts[3][1..4], ["q 1:5", "1", "5.00      "]);
    }
}
