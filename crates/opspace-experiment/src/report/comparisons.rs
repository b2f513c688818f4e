//! Charts that compare runs: medians of all runs, and runs of one task drawn over each other.

use crate::evaluate::results::{Group, control, group};
use crate::evaluate::spread::Spread;
use crate::evaluate::summary::Summary;
use crate::report::figure::{Comparison, ComparisonRow, Figure, Panel, Scale, Series, Style};
use crate::report::run_section::RunSection;
use std::collections::{BTreeMap, BTreeSet};

/// Creates a chart for each quantity: a row per task and profile, a mark per kind of robot, controller and transformer.
pub(super) fn comparisons(summaries: &[Summary]) -> Vec<Comparison> {
    let groups = group(summaries);
    QUANTITIES
        .into_iter()
        .map(|(title, x_label, scale, number)| comparison(&groups, title, x_label, scale, number))
        // With a single kind of control there is nothing to compare.
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
    let control = |s: &Summary| format!("{} {}", s.backend, control(s));
    let place = |s: &Summary| format!("{}, {} 1:{}", s.task, s.profile, s.ratio);
    let mut controls: Vec<String> = Vec::new();
    let mut rows: Vec<ComparisonRow> = Vec::new();
    for group in groups {
        let first = group.first();
        let Some(value) = group.spread(number) else { continue };
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
        caption: "Medians over the seeds; the lines are the intervals of the table.".to_owned(),
        x_label: x_label.to_owned(),
        series: controls,
        rows,
        scale,
    }
}

/// Quantities of the charts: title, label, scale, and value of a run.
type Quantity = (&'static str, &'static str, Scale, fn(&Summary) -> Option<f64>);

const QUANTITIES: [Quantity; 5] = [
    ("Tracking", "position error, rms (mm)", Scale::Log, |s| s.metrics.pose.position_rms_m.map(|v| 1e3 * v)),
    ("Orientation", "orientation error, rms (mrad)", Scale::Log, |s| {
        s.metrics.pose.orientation_rms_rad.map(|v| 1e3 * v)
    }),
    ("Hand force", "force of the operator's hand, rms (N)", Scale::Linear, |s| s.metrics.hand_force_rms_n),
    ("Hand motion", "motion of the operator's hand, rms (mm)", Scale::Log, |s| {
        s.metrics.hand_motion_rms_m.map(|v| 1e3 * v)
    }),
    ("Torque error", "torque error, rms of interval means (%)", Scale::Log, |s| {
        s.metrics.torque_error_interval.map(|v| 1e2 * v)
    }),
];

/// Draws the quantities over each setting that has three or more numbers in the runs.
pub(super) fn sweeps(summaries: &[Summary]) -> Vec<Figure> {
    let groups = group(summaries);
    let keys: BTreeSet<&str> =
        groups.iter().flat_map(|group| numbers(group.first())).map(|(key, _)| key).collect();
    keys.into_iter().filter_map(|key| sweep(&groups, key)).collect()
}

/// Settings of a run that are numbers.
fn numbers(summary: &Summary) -> impl Iterator<Item = (&str, f64)> {
    summary.overrides.iter().filter_map(|setting| {
        let (key, value) = setting.split_once('=')?;
        Some((key.trim(), value.trim().parse().ok()?))
    })
}

fn sweep(groups: &[Group<'_>], key: &str) -> Option<Figure> {
    let value =
        |group: &Group<'_>| numbers(group.first()).find(|(own, _)| *own == key).map(|(_, value)| value);
    let mut values: Vec<f64> = groups.iter().filter_map(value).collect();
    values.sort_by(f64::total_cmp);
    values.dedup();
    if values.len() < 3 {
        return None;
    }
    // Runs that differ in nothing but the seed and this setting are one line.
    let line_of = |group: &Group<'_>| {
        let run = group.first();
        let others: Vec<&str> = run
            .overrides
            .iter()
            .filter(|own| !own.starts_with(&format!("{key}=")))
            .map(String::as_str)
            .collect();
        let label = Summary { label: None, ..run.clone() };
        let mut name = format!("{}, {} {}, {}", run.task, run.backend, control(&label), run.profile);
        others.iter().for_each(|other| name += &format!(", {other}"));
        name
    };
    let panels: Vec<Panel> = QUANTITIES
        .iter()
        .filter_map(|(title, y_label, y_scale, number)| {
            let mut lines: BTreeMap<String, Vec<(f64, Spread)>> = BTreeMap::new();
            for group in groups {
                if let (Some(value), Some(spread)) = (value(group), group.spread(number)) {
                    lines.entry(line_of(group)).or_default().push((value, spread));
                }
            }
            let series = lines.into_iter().flat_map(|(name, mut points)| {
                points.sort_by(|a, b| a.0.total_cmp(&b.0));
                let x: Vec<f64> = points.iter().map(|point| point.0).collect();
                let along =
                    |end: fn(&Spread) -> f64| points.iter().map(|point| end(&point.1)).collect::<Vec<f64>>();
                let ends = [along(|s| s.low), along(|s| s.high)]
                    .map(|y| Series::new(format!("{name}: interval"), x.clone(), y).style(Style::Thin));
                let is_wide = points.iter().any(|point| point.1.high > point.1.low);
                let median = Series::new(name.clone(), x.clone(), along(|s| s.median));
                std::iter::once(median).chain(ends.into_iter().filter(move |_| is_wide)).collect::<Vec<_>>()
            });
            let series: Vec<Series> = series.collect();
            (!series.is_empty()).then(|| Panel {
                title: (*title).to_owned(),
                x_label: key.to_owned(),
                y_label: (*y_label).to_owned(),
                series,
                y_scale: *y_scale,
                ..Panel::default()
            })
        })
        .collect();
    (!panels.is_empty()).then(|| Figure {
        title: format!("Sweep of {key}"),
        caption: "Medians over the seeds; thin lines are the ends of their intervals.".to_owned(),
        panels,
        ..Figure::default()
    })
}

/// Draws the runs of each task over each other, where a page shows several: what they did, and their errors. A reference
/// is drawn once if it is the same for all.
pub(super) fn overlays(shown: &[RunSection]) -> Vec<Figure> {
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
            figures.extend(
                first.figures.iter().filter(|figure| figure.overlays).filter_map(|f| overlay(f, &runs)),
            );
        }
    }
    figures
}

/// Draws one figure of several runs into one; `None` if only one run has it.
fn overlay(figure: &Figure, runs: &[&RunSection]) -> Option<Figure> {
    let same = |other: &&Figure| other.title == figure.title && other.panels.len() == figure.panels.len();
    let found: Vec<(String, &Figure)> =
        runs.iter().filter_map(|run| Some((name(&run.summary), run.figures.iter().find(same)?))).collect();
    if found.len() < 2 {
        return None;
    }
    let panel = |place: usize| {
        let of = |figure: &Figure, label: &str| {
            figure.panels[place].series.iter().find(|series| series.label == label).cloned()
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
            for one in &figure.panels[place].series {
                match is_shared(one) {
                    true if index > 0 => {}
                    true => series.push(one.clone()),
                    false => series.push(Series { label: format!("{name}: {}", one.label), ..one.clone() }),
                }
            }
        }
        Panel { series, ..figure.panels[place].clone() }
    };
    Some(Figure {
        title: format!("{}: {} runs", figure.title, found.len()),
        panels: (0..figure.panels.len()).map(panel).collect(),
        remark: String::new(),
        ..figure.clone()
    })
}

/// True if two lines cannot be told apart in a figure: references begin at the measured position of each run.
fn looks_equal(one: &Series, other: &Series) -> bool {
    const FRACTION_OF_RANGE: f64 = 2e-3;
    let finite = || one.y.iter().copied().filter(|y| y.is_finite());
    let range = finite().fold(f64::NEG_INFINITY, f64::max) - finite().fold(f64::INFINITY, f64::min);
    let near =
        |(a, b): (&f64, &f64)| (a - b).abs() <= FRACTION_OF_RANGE * range || (a.is_nan() && b.is_nan());
    one.x == other.x && one.y.len() == other.y.len() && one.y.iter().zip(&other.y).all(near)
}

/// Name of a run in an overlay.
fn name(summary: &Summary) -> String {
    format!(
        "{} {}, {} 1:{}, seed {}",
        summary.backend,
        control(summary),
        summary.profile,
        summary.ratio,
        summary.seed
    )
}
