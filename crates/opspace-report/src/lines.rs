//! Lines and panels over time, from the log of a run.

use crate::figure::{Figure, Panel, Series, Style};
use opspace_backend::signal_names::Q;
use opspace_experiment::evaluate::metrics::run_log::Run;
use opspace_experiment::text::{format_short, listed};
use opspace_log::{ChannelData, Column};

/// Number of parts of the time axis in which a line keeps its first, lowest, highest and last sample: more than a screen
/// shows.
pub(crate) const COLUMNS: usize = 1500;

/// Largest distance to a limit at which the limit is drawn, relative to half the range between the limits.
const NEAR_LIMIT: f64 = 0.2;

/// Figure of a quantity of each joint, with the desired one of the control cycles and the position limits. Signals have
/// a label each.
pub(crate) fn joint_figure(
    run: &Run<'_>,
    title: &str,
    caption: &str,
    quantity: &str,
    (channel, name, label): (&ChannelData, &str, &str),
    (desired, desired_label): (&Column<'_>, &str),
) -> Option<Figure> {
    let actual = channel.signal(name)?;
    let joints = run.experiment.robot().model.joints();
    let panel = |(j, joint): (usize, &String)| {
        let place = desired.elements().iter().position(|name| name == joint);
        let mut series = vec![element(run, label, &channel.time_s, &actual, j, Style::Solid)];
        series.extend(
            place.map(|place| element(run, desired_label, &run.tick.time_s, desired, place, Style::Desired)),
        );
        let mut panel = time_panel(joint, &label_of(quantity, &actual, j), series);
        if let Some(joint) = joints.iter().find(|known| known.name == *joint).filter(|_| name == Q) {
            panel.limits = Some(joint.limits.lower..joint.limits.upper);
        }
        panel
    };
    Some(Figure {
        title: title.to_owned(),
        caption: caption.to_owned(),
        panels: actual.elements().iter().enumerate().map(panel).collect(),
        overlays: true,
        ..Figure::default()
    })
}

/// Panel over time.
pub(crate) fn time_panel(title: &str, y_label: &str, series: Vec<Series>) -> Panel {
    Panel {
        title: title.to_owned(),
        x_label: "time (s)".to_owned(),
        y_label: y_label.to_owned(),
        series,
        ..Panel::default()
    }
}

/// Panel over time of an error of which the tables have rms and maximum: their start is marked, and determines the scale.
pub(crate) fn error_panel(run: &Run<'_>, title: &str, y_label: &str, error: Series) -> Panel {
    let settle_s = run.experiment.task().file.settle_s.get();
    Panel {
        marks: vec![(settle_s, "settle_s".to_owned())],
        range_from_x: Some(settle_s - run.same_s),
        ..time_panel(title, y_label, vec![error])
    }
}

/// Sentence about the start of rms and maximum in the tables.
pub(crate) fn tables_begin(run: &Run<'_>) -> String {
    let settle_s = run.experiment.task().file.settle_s.get();
    format!("The rms and max values of the tables begin at settle_s ({settle_s} s).")
}

/// Axis label: the quantity, and the unit of one element of a signal.
pub(crate) fn label_of(quantity: &str, column: &Column<'_>, element: usize) -> String {
    format!("{quantity} ({})", column.units()[element].replace("Nm", "N·m"))
}

/// Line of a quantity at times on the robot's clock, from the start of control on.
pub(crate) fn line(
    run: &Run<'_>,
    label: &str,
    samples: impl Iterator<Item = (f64, f64)>,
    style: Style,
) -> Series {
    let (mut x, mut y) = (Vec::new(), Vec::new());
    for (time_s, value) in samples.filter(|(time_s, _)| *time_s >= run.start_s - run.same_s) {
        x.push(time_s - run.start_s);
        y.push(value);
    }
    Series::new(label, x, y).style(style).thinned(COLUMNS)
}

/// Line of one element of a signal.
pub(crate) fn element(
    run: &Run<'_>,
    label: &str,
    time_s: &[f64],
    column: &Column<'_>,
    element: usize,
    style: Style,
) -> Series {
    line(run, label, time_s.iter().copied().zip(column.rows().map(|row| row[element])), style)
}

/// Appends the lines of the next segment of a log to figures of the same run.
pub(crate) fn append(figures: &mut Vec<Figure>, next: Vec<Figure>) {
    if figures.is_empty() {
        *figures = next;
        return;
    }
    // All segments have the same figures, panels and lines.
    for (figure, next) in figures.iter_mut().zip(next) {
        for (panel, next) in figure.panels.iter_mut().zip(next.panels) {
            for (line, next) in panel.series.iter_mut().zip(next.series) {
                line.x.extend(next.x);
                line.y.extend(next.y);
                if line.x.len() > 8 * COLUMNS {
                    *line = std::mem::take(line).thinned(COLUMNS);
                }
            }
        }
    }
}

/// Completes figures over time whose lines are complete: marks events at times since the start of control (s), draws limits,
/// and removes lines without a finite value.
pub(crate) fn complete(events_s: &[f64], mut figures: Vec<Figure>) -> Vec<Figure> {
    for figure in &mut figures {
        for panel in &mut figure.panels {
            panel.series.retain(|series| series.y.iter().any(|value| value.is_finite()));
        }
        figure.panels.retain(|panel| !panel.series.is_empty());
        figure.panels.iter_mut().filter(|panel| panel.is_from_start).for_each(measure_from_start);
        draw_limits(figure);
        mark_events(figure, events_s);
    }
    figures.retain(|figure| !figure.panels.is_empty());
    figures
}

/// Converts the lines of a panel from m to mm from the first value of the first line, which the title states.
fn measure_from_start(panel: &mut Panel) {
    let Some(start) = panel.series.first().and_then(|line| line.y.iter().copied().find(|y| y.is_finite()))
    else {
        return;
    };
    for value in panel.series.iter_mut().flat_map(|line| &mut line.y) {
        *value = 1e3 * (*value - start);
    }
    panel.title += &format!(", from {start:.4} m").replace('-', "−");
}

/// Marks the events that occurred while the lines of a figure were logged.
fn mark_events(figure: &mut Figure, events_s: &[f64]) {
    let x =
        || figure.panels.iter().flat_map(|panel| &panel.series).flat_map(|series| series.x.iter().copied());
    let end = x().filter(|x| x.is_finite()).fold(0.0, f64::max);
    let times: Vec<f64> = events_s.iter().copied().filter(|time_s| *time_s <= end).collect();
    if times.is_empty() {
        return;
    }
    for panel in &mut figure.panels {
        panel.marks.extend(times.iter().map(|time_s| (*time_s, String::new())));
    }
    let named: Vec<String> = times.iter().map(f64::to_string).collect();
    let (lines, events) = if times.len() == 1 { ("line", "the event") } else { ("lines", "the events") };
    figure.caption += &format!(" Vertical {lines} without a name: {events} at {} s.", listed(&named));
}

/// Line of a panel that comes closest to a limit.
struct Closest {
    panel: usize,
    value: f64,
    limit: f64,
    /// Distance to the limit, relative to half the range between the limits.
    distance: f64,
}

/// Draws the limits that the lines of a figure come near; if there are none, names the one that they come closest to.
fn draw_limits(figure: &mut Figure) {
    let mut closest: Option<Closest> = None;
    let mut is_drawn = false;
    for (place, panel) in figure.panels.iter_mut().enumerate() {
        let Some(limits) = panel.limits.clone() else { continue };
        let half = 0.5 * (limits.end - limits.start);
        if !half.is_finite() {
            continue;
        }
        let values =
            || panel.series.iter().flat_map(|series| series.y.iter().copied()).filter(|v| v.is_finite());
        let times =
            || panel.series.iter().flat_map(|series| series.x.iter().copied()).filter(|v| v.is_finite());
        let (low, high) =
            (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
        let (begin, end) = (times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max));
        for (value, limit, distance) in
            [(high, limits.end, (limits.end - high) / half), (low, limits.start, (low - limits.start) / half)]
        {
            if distance < NEAR_LIMIT {
                is_drawn = true;
                panel.series.push(Series::new("limit", vec![begin, end], vec![limit; 2]).style(Style::Thin));
            }
            if closest.as_ref().is_none_or(|closest| distance < closest.distance) {
                closest = Some(Closest { panel: place, value, limit, distance });
            }
        }
    }
    let percent = 100.0 * NEAR_LIMIT;
    if is_drawn {
        figure.caption += &format!(
            " A limit is drawn where a line comes nearer to it than {percent:.0} % of half the range between the limits."
        );
    } else if let Some(Closest { panel, value, limit, .. }) = closest {
        let Panel { title, y_label, .. } = &figure.panels[panel];
        let unit = y_label.split_once('(').map_or("", |(_, unit)| unit.trim_end_matches(')'));
        let [value, limit] = [value, limit].map(|value| format_short(value).replace('-', "−"));
        figure.remark =
            format!("No limit is near: '{title}' comes closest: {value} {unit}, limit {limit} {unit}.");
    }
}
