//! Charts that compare runs: medians of all runs, and runs of one task drawn over each other.

use crate::dot_columns::{DotColumn, DotColumns, WIDE};
use crate::figure::{Comparison, ComparisonRow, Figure, Panel, Scale, Series, Style};
use crate::kinds::{Kinds, rest, run_names, sentence};
use crate::run_section::RunSection;
use crate::sweep_figures::sweeps;
use opspace_experiment::evaluate::results::{Group, group, value};
use opspace_experiment::evaluate::summary::Summary;
use opspace_experiment::metrics::columns::default_columns;
use opspace_experiment::metrics::metric::{Column, Metric};
use opspace_experiment::metrics::metric_tables::Metrics;
use opspace_experiment::text::format_short;
use std::collections::BTreeSet;

/// Metrics that a page with the usual columns does not draw: computing times, and torque errors that hardly differ from others.
const NOT_DRAWN: [&str; 5] =
    ["tick_ns_median", "realtime_factor", "torque_error_servo", "torque_error_tick", "in_contact_fraction"];

/// Columns of a page that are drawn: all that a suite lists.
fn drawn(metrics: &[Metric]) -> Vec<(&Metric, Column)> {
    let is_usual = default_columns(&[]).iter().all(|usual| metrics.contains(usual));
    let columns = metrics.iter().filter_map(|metric| Some((metric, metric.column?)));
    columns.filter(|(metric, _)| !is_usual || !NOT_DRAWN.contains(&metric.key)).collect()
}

/// Draws the columns of a suite: over each setting that is swept, and for all other runs a row per task, profile and label, with
/// a mark per kind of robot and control.
pub(crate) fn columns(summaries: &[Summary], metrics: &[Metric]) -> (Vec<Figure>, Vec<Comparison>) {
    let groups = group(summaries);
    let kinds = Kinds::of(groups.iter().map(Group::first));
    let drawn = drawn(metrics);
    let (figures, rest) = sweeps(&groups, &kinds, &drawn);
    let charts = drawn.iter().filter_map(|(metric, column)| comparison(&rest, &kinds, metric, column));
    (figures, charts.collect())
}

/// Chart of one column; `None` if there is nothing to compare.
fn comparison(groups: &[&Group<'_>], kinds: &Kinds, metric: &Metric, column: &Column) -> Option<Comparison> {
    let several = |of: &dyn Fn(&Summary) -> String| {
        groups.iter().any(|group| of(group.first()) != of(groups[0].first()))
    };
    // A profile has one ratio of rates, unless the ratio is a setting.
    let has_ratios = groups.iter().map(|g| g.first()).any(|run| {
        groups.iter().map(|g| g.first()).any(|other| other.profile == run.profile && other.ratio != run.ratio)
    });
    let profile = |run: &Summary| match has_ratios {
        true => format!("{} 1:{}", run.profile, run.ratio),
        false => run.profile.clone(),
    };
    let (tasks, profiles) = (several(&|run| run.task.clone()), several(&profile));
    let place = |run: &Summary| {
        let parts =
            [Some(run.task.clone()).filter(|_| tasks), rest(run), Some(profile(run)).filter(|_| profiles)];
        parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
    };
    let mut rows: Vec<ComparisonRow> = Vec::new();
    for group in groups {
        let Some(value) = group.of_column(metric, column) else { continue };
        let (kind, label) = (kinds.place(group.first()), place(group.first()));
        let free = rows.iter().position(|row| row.label == label && row.values[kind].is_none());
        let at = free.unwrap_or_else(|| {
            rows.push(ComparisonRow { label, values: vec![None; kinds.names.len()] });
            rows.len() - 1
        });
        rows[at].values[kind] = Some(value);
    }
    let values: Vec<f64> =
        rows.iter().flat_map(|row| row.values.iter().flatten()).map(|spread| spread.median).collect();
    if values.len() < 2 || values.iter().all(|value| *value == 0.0) {
        return None;
    }
    let (low, high) = values.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(*v), h.max(*v)));
    let has_intervals = rows.iter().flat_map(|row| row.values.iter().flatten()).any(|s| s.high > s.low);
    let caption =
        if has_intervals { "Medians over the seeds; the lines are the intervals of the table." } else { "" };
    let unit = if column.unit.is_empty() { String::new() } else { format!(" ({})", column.unit) };
    Some(Comparison {
        title: sentence(column.title),
        caption: caption.to_owned(),
        x_label: format!("{}{unit}", column.title),
        series: kinds.names.clone(),
        rows,
        scale: if low > 0.0 && high > WIDE * low { Scale::Log } else { Scale::Linear },
    })
}

/// Quantities of a task, the most important one first: what it is about.
const SUBJECTS: [&str; 11] = [
    "force_hold_rms_n",
    "force_moving_rms_n",
    "force_rms_n",
    "hand_force_rms_n",
    "hand_motion_rms_m",
    "stiffness_n_per_m",
    "deflection_max_m",
    "compliant_motion_rms_m",
    "position_rms_m",
    "orientation_rms_rad",
    "joint_rms_rad",
];
const TORQUE_ERROR: &str = "torque_error_interval";

/// Sentences about a suite of one task: for each of its columns that the task is about, the least and the largest value of each kind of
/// robot and control over its rows; empty for several tasks and for one kind.
pub(crate) fn suite_story(summaries: &[Summary], listed: &[Metric]) -> Vec<String> {
    const MOST: usize = 2;
    let Some(first) = summaries.first().filter(|first| summaries.iter().all(|run| run.task == first.task))
    else {
        return Vec::new();
    };
    let groups = group(summaries);
    let kinds = Kinds::of(groups.iter().map(Group::first));
    if kinds.names.len() < 2 || groups.len() <= kinds.names.len() {
        return Vec::new();
    }
    let about = |key: &&str| {
        let metric = listed.iter().find(|metric| metric.key == *key)?;
        let column = metric.column?;
        let range = |(place, name): (usize, &String)| {
            let own = groups.iter().filter(|group| kinds.place(group.first()) == place);
            let values: Vec<f64> =
                own.filter_map(|group| Some(group.of_column(metric, &column)?.median)).collect();
            let least = values.iter().copied().reduce(f64::min)?;
            let largest = values.iter().copied().reduce(f64::max)?;
            Some((largest, format!("{} to {} with {name}", format_short(least), format_short(largest))))
        };
        let mut ranges: Vec<(f64, String)> = kinds.names.iter().enumerate().filter_map(range).collect();
        ranges.sort_by(|a, b| a.0.total_cmp(&b.0));
        let texts: Vec<String> = ranges.into_iter().map(|(_, text)| text).collect();
        let unit = if column.unit.is_empty() { String::new() } else { format!(" ({})", column.unit) };
        (texts.len() > 1).then(|| {
            format!(
                "{}{unit} of '{}' over its settings: {}.",
                sentence(column.title),
                first.task,
                texts.join("; ")
            )
        })
    };
    SUBJECTS.iter().filter_map(about).take(MOST).collect()
}

/// Chart of runs of one task side by side, with what the task is about first; `None` if there are several tasks.
pub(crate) fn side_by_side(summaries: &[Summary]) -> Option<DotColumns> {
    const MOST: usize = 3;
    let first = summaries.first()?;
    if summaries.len() < 2 || summaries.iter().any(|run| run.task != first.task) {
        return None;
    }
    let runs: Vec<&Summary> = summaries.iter().collect();
    let groups: Vec<Group<'_>> = runs.iter().map(|run| Group::of(run)).collect();
    let metrics = Metrics::rows();
    let has_value = |metric: &&Metric| summaries.iter().any(|run| value(run, metric).is_some());
    let known = |key: &&str| metrics.iter().find(|metric| metric.key == *key).filter(has_value);
    let torque = known(&TORQUE_ERROR);
    let subjects = SUBJECTS.iter().filter_map(known).take(MOST - usize::from(torque.is_some()));
    let columns = subjects.chain(torque).filter_map(|metric| {
        let column = metric.column?;
        let values = groups.iter().map(|group| vec![group.of_column(metric, &column)]).collect();
        Some(DotColumn { label: format!("{} ({})", column.title, column.unit), values })
    });
    let columns: Vec<DotColumn> = columns.collect();
    (!columns.is_empty()).then(|| DotColumns {
        title: "Runs compared".to_owned(),
        caption: "Values of the table. A run without a mark has no such value.".to_owned(),
        rows: run_names(&runs),
        marks: vec![String::new()],
        columns,
    })
}

/// Picture of torque error and compliance of each kind of position and torque robot, for suites in which an operator pulls at
/// both; `None` for others.
pub(crate) fn compliance(summaries: &[Summary], metrics: &[Metric]) -> Option<DotColumns> {
    const KEYS: [&str; 3] = [TORQUE_ERROR, "hand_force_rms_n", "hand_motion_rms_m"];
    let shown: Vec<(&Metric, Column)> =
        drawn(metrics).into_iter().filter(|(metric, _)| KEYS.contains(&metric.key)).collect();
    let groups = group(summaries);
    let is_pulled = |group: &&Group<'_>| {
        let run = group.first();
        let robot = ["position", "torque"].contains(&run.backend.as_str());
        robot && rest(run).is_none() && run.metrics.hand_force_rms_n.is_some()
    };
    // The task that compares torque control with inverse kinematics.
    let by_ik = groups.iter().filter(is_pulled).find(|group| group.first().controller != "osc")?.first();
    let mut own: Vec<&Group<'_>> = groups
        .iter()
        .filter(is_pulled)
        .filter(|g| g.first().task == by_ik.task && g.first().robot == by_ik.robot)
        .collect();
    // Few seeds are a supplement of the suite.
    let most = own.iter().map(|group| group.runs.len()).max()?;
    own.retain(|group| group.runs.len() == most);
    if shown.len() < KEYS.len() || !own.iter().any(|group| group.first().backend == "torque") {
        return None;
    }
    let kinds = Kinds::of(own.iter().map(|group| group.first()));
    let mut profiles: Vec<&str> = own.iter().map(|group| group.first().profile.as_str()).collect();
    profiles.sort_unstable();
    profiles.dedup();
    let mut places: Vec<usize> = (0..kinds.names.len()).collect();
    // Torque control before inverse kinematics, the most accurate first.
    let error = |kind: &usize| {
        let own = own.iter().filter(|group| kinds.place(group.first()) == *kind);
        own.filter_map(|g| g.spread(|run| run.metrics.torque_error_interval))
            .map(|s| s.median)
            .fold(f64::NAN, f64::max)
    };
    places.sort_by(|a, b| error(a).total_cmp(&error(b)));
    let columns = KEYS.iter().filter_map(|key| {
        let (metric, column) = shown.iter().find(|(metric, _)| metric.key == *key)?;
        let of = |kind: &usize, profile: &str| {
            let found =
                own.iter().find(|g| kinds.place(g.first()) == *kind && g.first().profile == profile)?;
            found.of_column(metric, column)
        };
        let values = places.iter().map(|kind| profiles.iter().map(|profile| of(kind, profile)).collect());
        Some(DotColumn { label: format!("{} ({})", column.title, column.unit), values: values.collect() })
    });
    Some(DotColumns {
        title: format!("Torque error and compliance in the task {}", by_ik.task),
        caption: "A simulated operator pulls at the hand. A compliant hand moves far under a small force. Inverse kinematics \
                  has no torque error, because it desires no torques. Medians over the seeds; the lines are the intervals of \
                  the table."
            .to_owned(),
        rows: places.iter().map(|place| kinds.names[*place].clone()).collect(),
        marks: profiles.iter().map(|profile| (*profile).to_owned()).collect(),
        columns: columns.collect(),
    })
}

/// Draws the runs of each task over each other, where a page shows several: what they did, and their errors. A reference
/// is drawn once if it is the same for all.
pub(crate) fn overlays(shown: &[RunSection]) -> Vec<Figure> {
    let mut figures = Vec::new();
    let mut done: Vec<(&str, &str)> = Vec::new();
    for first in shown {
        let key = (first.summary.task.as_str(), first.summary.robot.as_str());
        if done.contains(&key) {
            continue;
        }
        done.push(key);
        let runs: Vec<&RunSection> = shown
            .iter()
            .filter(|run| (run.summary.task.as_str(), run.summary.robot.as_str()) == key)
            .collect();
        if runs.len() > 1 {
            let mut own: Vec<&Figure> = first.figures.iter().filter(|figure| figure.overlays).collect();
            own.sort_by_key(|figure| order(figure, &first.summary));
            figures.extend(own.into_iter().filter_map(|figure| overlay(figure, &runs)));
        }
    }
    figures
}

/// Place of a figure on a page: what the task is about comes first, torques and setpoints come last.
fn order(figure: &Figure, summary: &Summary) -> usize {
    let is_about_forces = summary.metrics.contact.force_rms_n.is_some();
    let starts: [&str; 8] = match is_about_forces {
        true => ["Force over", "Response", "Force", "Path", "Error", "Position of", "Orientation", "Joint"],
        false => ["Force over", "Response", "Path", "Position of", "Error", "Orientation", "Force", "Joint"],
    };
    starts.iter().position(|start| figure.title.starts_with(start)).unwrap_or(starts.len())
}

/// Draws one figure of several runs into one; `None` if only one run has it.
fn overlay<'a>(figure: &Figure, runs: &[&'a RunSection]) -> Option<Figure> {
    let same = |other: &&Figure| other.title == figure.title;
    let names = run_names(&runs.iter().map(|run| &run.summary).collect::<Vec<_>>());
    let found: Vec<(&String, &'a Figure)> = names
        .iter()
        .zip(runs)
        .filter_map(|(name, run)| Some((name, run.figures.iter().find(same)?)))
        .collect();
    if found.len() < 2 {
        return None;
    }
    // A run has one colour on the page, unless it has several measured lines in a panel.
    let is_measured = |series: &&Series| series.style == Style::Solid;
    let has_several = figure.panels.iter().any(|panel| panel.series.iter().filter(is_measured).count() > 1);
    let drawn = figure.panels.iter().flat_map(|panel| &panel.series).filter(|line| line.style != Style::Thin);
    let lines: BTreeSet<&str> = drawn.map(|series| series.label.as_str()).collect();
    let labels = lines.len();
    // An axis along which one run moves may be missing in another one.
    let mut axes: Vec<&str> = Vec::new();
    for panel in found.iter().flat_map(|(_, figure)| &figure.panels) {
        if !axes.contains(&axis_of(panel)) {
            axes.push(axis_of(panel));
        }
    }
    let panel = |axis: &&str| {
        let panel_of = |figure: &'a Figure| figure.panels.iter().find(|panel| axis_of(panel) == *axis);
        let of = |figure: &'a Figure, label: &str| {
            panel_of(figure)?.series.iter().find(|series| series.label == label).cloned()
        };
        // A reference that looks the same in all runs is drawn once.
        let is_shared = |one: &Series| {
            one.style == Style::Desired
                && found
                    .iter()
                    .all(|(_, figure)| of(figure, &one.label).is_some_and(|other| looks_equal(one, &other)))
        };
        let mut series = Vec::new();
        for (index, (name, figure)) in found.iter().enumerate() {
            // Lines in the background of each run would hide those of the others.
            let lines = panel_of(figure).into_iter().flat_map(|panel| &panel.series);
            for one in lines.filter(|line| line.style != Style::Thin) {
                let is_own = one.style != Style::Desired;
                let color = if is_own && !has_several { Some(index) } else { one.color };
                let label = if labels == 1 { (*name).clone() } else { format!("{name}: {}", one.label) };
                match is_shared(one) {
                    true if index > 0 => {}
                    true => series.push(one.clone()),
                    false => series.push(Series { label, color, ..one.clone() }),
                }
            }
        }
        let first = found.iter().find_map(|(_, figure)| panel_of(figure))?;
        Some(Panel { series, ..first.clone() })
    };
    Some(Figure {
        title: format!("{}: {} runs", figure.title, found.len()),
        panels: axes.iter().filter_map(panel).collect(),
        remark: String::new(),
        ..figure.clone()
    })
}

/// Joint or axis of a panel, without the value at the start of a run.
fn axis_of(panel: &Panel) -> &str {
    panel.title.split(", from ").next().unwrap_or_default()
}

/// True if two lines cannot be told apart in a figure: references begin at the measured position of each run.
fn looks_equal(one: &Series, other: &Series) -> bool {
    const FRACTION_OF_RANGE: f64 = 2e-3;
    let along = |one: &[f64], other: &[f64]| {
        let finite = || one.iter().copied().filter(|value| value.is_finite());
        let range = finite().fold(f64::NEG_INFINITY, f64::max) - finite().fold(f64::INFINITY, f64::min);
        let near =
            |(a, b): (&f64, &f64)| (a - b).abs() <= FRACTION_OF_RANGE * range || (a.is_nan() && b.is_nan());
        one.len() == other.len() && one.iter().zip(other).all(near)
    };
    along(&one.x, &other.x) && along(&one.y, &other.y)
}

#[cfg(test)]
mod tests {
    use super::{NOT_DRAWN, SUBJECTS, columns, compliance, side_by_side};
    use crate::figure::{Scale, Style};
    use crate::test_summary::summary;
    use opspace_experiment::evaluate::summary::Summary;
    use opspace_experiment::metrics::columns::{columns_named, default_columns, with_columns};

    /// Checks that each key which is chosen by hand is that of a metric with a column.
    #[test]
    fn chosen_keys_are_metrics_with_columns() {
        let known: Vec<&str> = with_columns(&[]).map(|(metric, _)| metric.key).collect();
        for key in SUBJECTS.iter().chain(&NOT_DRAWN) {
            assert!(known.contains(key), "{key}");
        }
    }

    /// Run of a grid: pressing on a surface, with a deviation of kp.
    fn press(controller: &str, stiffness: f64, kp: f64, seed: u64) -> Summary {
        let mut run = summary("press", "p", seed, 0.001);
        run.controller = controller.to_owned();
        run.overrides = vec![
            format!("environment.board.wall.stiffness_n_per_m={stiffness:.1}"),
            format!("robot.simulated.true_over_nominal.kp={kp:.1}"),
            format!("expect.contact_peak_n.at_most={}", 30.0 + stiffness / 1e3),
        ];
        run.label = Some(format!("stiffness_n_per_m={stiffness:.1}, kp={kp:.1}"));
        run.metrics.contact.force_moving_rms_n = Some(0.1 * seed as f64);
        run
    }

    fn grid() -> Vec<Summary> {
        let mut runs = Vec::new();
        for controller in ["osc", "ik-lead"] {
            for stiffness in [1e3, 1e4, 5e4] {
                for kp in [0.9, 1.0, 1.1] {
                    runs.extend([1, 2, 3].map(|seed| press(controller, stiffness, kp, seed)));
                }
            }
        }
        runs
    }

    /// Compared: the figure of a sweep of two settings, and axes, panels and lines by hand. Only the listed column is drawn.
    #[test]
    fn swept_settings_are_axis_and_panels() {
        let metrics = columns_named(["force-moving"], &[]).expect("a column");
        let (figures, charts) = columns(&grid(), &metrics);
        assert_eq!((figures.len(), charts.len()), (1, 0));
        let figure = &figures[0];
        assert_eq!(figure.title, "Force error rms in motion over stiffness");
        let titles: Vec<&str> = figure.panels.iter().map(|panel| panel.title.as_str()).collect();
        assert_eq!(titles, ["kp 0.9", "kp 1", "kp 1.1"]);
        for panel in &figure.panels {
            assert_eq!((panel.x_label.as_str(), panel.x_scale), ("stiffness (N/m)", Scale::Log));
            assert_eq!(panel.x_ticks, [1e3, 1e4, 5e4]);
            let lines: Vec<(&str, Style, Option<usize>)> =
                panel.series.iter().map(|s| (s.label.as_str(), s.style, s.color)).collect();
            let of = |label, color| [(label, Style::Band, Some(color)), (label, Style::Marked, Some(color))];
            assert_eq!(lines, [of("position robot", 0), of("ik-lead", 1)].concat());
        }
        let svg = figure.svg();
        assert!(svg.contains("50000") && svg.contains("<polygon"), "ticks and bands");
    }

    /// Compared: rows and kinds of runs without a sweep, and names by hand: the label distinguishes rows, the robot colours.
    #[test]
    fn labels_are_rows_and_robots_are_colours() {
        let runs = ["torque", "position"].map(|backend| {
            ["posture 1", "posture 2"].map(|label| {
                let mut run = summary("hold", "p", 1, 0.05);
                run.backend = backend.to_owned();
                run.label = Some(label.to_owned());
                run
            })
        });
        let metrics = columns_named(["position-rms", "limited"], &[]).expect("columns");
        let (figures, charts) = columns(&runs.concat(), &metrics);
        assert_eq!((figures.len(), charts.len()), (0, 1), "a column without a value has no chart");
        assert_eq!(charts[0].series, ["torque robot", "position robot"]);
        let rows: Vec<&str> = charts[0].rows.iter().map(|row| row.label.as_str()).collect();
        assert_eq!(rows, ["posture 1", "posture 2"]);
    }

    fn pulled(backend: &str, controller: &str, transformer: Option<&str>, error: Option<f64>) -> Summary {
        let mut run = summary("pull", "p", 1, 0.001);
        run.backend = backend.to_owned();
        run.controller = controller.to_owned();
        run.transformer = transformer.map(str::to_owned);
        run.metrics.hand_force_rms_n = Some(1.7);
        run.metrics.hand_motion_rms_m = Some(0.028);
        run.metrics.torque_error_interval = error;
        run
    }

    /// Compared: rows and quantities of the first picture of the usual suite, and those by hand.
    #[test]
    fn first_picture_has_torque_error_and_compliance() {
        let runs = [
            pulled("position", "osc", Some("paper"), Some(0.1)),
            pulled("torque", "osc", None, Some(0.001)),
            pulled("position", "ik", None, None),
            pulled("position", "osc", Some("emulation"), Some(0.02)),
        ];
        let chart = compliance(&runs, &default_columns(&[])).expect("a picture");
        assert_eq!(chart.rows, ["torque robot", "emulation", "paper", "ik"]);
        let labels: Vec<&str> = chart.columns.iter().map(|column| column.label.as_str()).collect();
        assert_eq!(labels, ["torque error interval (%)", "operator force rms (N)", "hand motion rms (mm)"]);
        assert!(chart.svg().contains("torque robot"));
        assert!(compliance(&runs[..2], &default_columns(&[])).is_none(), "nothing to compare with");
        let side = side_by_side(&runs).expect("runs of one task");
        assert_eq!(side.columns[0].label, "operator force rms (N)", "what the task is about");
    }
}
