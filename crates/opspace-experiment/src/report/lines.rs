//! Lines and panels over time, from the log of a run.

use crate::evaluate::metrics::run_log::Run;
use crate::report::figure::{Figure, Panel, Series, Style};
use opspace_backend::signal_names::Q;
use opspace_log::{ChannelData, Column};

/// Number of parts of the time axis in which a line keeps its first, lowest, highest and last sample: more than a screen
/// shows.
pub(super) const COLUMNS: usize = 1500;

/// Fraction of the largest value shown, beside which a limit is drawn.
const NEAR_LIMIT: f64 = 0.4;

/// Figure of a quantity of each joint, with the desired one of the control cycles and the position limits.
pub(super) fn joint_figure(
    run: &Run<'_>,
    title: &str,
    caption: &str,
    quantity: &str,
    (channel, name, label): (&ChannelData, &str, &str),
    desired: &Column<'_>,
) -> Option<Figure> {
    let actual = channel.signal(name)?;
    let joints = run.experiment.robot().model.joints();
    let panel = |(j, joint): (usize, &String)| {
        let place = desired.elements().iter().position(|name| name == joint);
        let mut series = vec![element(run, label, &channel.time_s, &actual, j, Style::Solid)];
        series.extend(
            place.map(|place| element(run, "desired", &run.tick.time_s, desired, place, Style::Desired)),
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
pub(super) fn time_panel(title: &str, y_label: &str, series: Vec<Series>) -> Panel {
    Panel {
        title: title.to_owned(),
        x_label: "time (s)".to_owned(),
        y_label: y_label.to_owned(),
        series,
        ..Panel::default()
    }
}

/// Axis label: the quantity, and the unit of one element of a signal.
pub(super) fn label_of(quantity: &str, column: &Column<'_>, element: usize) -> String {
    format!("{quantity} ({})", column.units()[element].replace("Nm", "N·m"))
}

/// Line of a quantity at times on the robot's clock, from the start of control on.
pub(super) fn line(
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
pub(super) fn element(
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
pub(super) fn append(figures: &mut Vec<Figure>, next: Vec<Figure>) {
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

/// Completes figures whose lines are complete: draws limits, and removes lines without a finite value.
pub(super) fn complete(mut figures: Vec<Figure>) -> Vec<Figure> {
    for figure in &mut figures {
        for panel in &mut figure.panels {
            panel.series.retain(|series| series.y.iter().any(|value| value.is_finite()));
            if let Some(limits) = panel.limits.clone() {
                draw_limits(panel, limits);
            }
        }
        figure.panels.retain(|panel| !panel.series.is_empty());
    }
    figures.retain(|figure| !figure.panels.is_empty());
    figures
}

/// Draws the limits that the lines of a panel come near.
fn draw_limits(panel: &mut Panel, limits: std::ops::Range<f64>) {
    let values = || panel.series.iter().flat_map(|series| series.y.iter().copied()).filter(|v| v.is_finite());
    let times = || panel.series.iter().flat_map(|series| series.x.iter().copied());
    let (low, high) = (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
    let (begin, end) = (times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max));
    let span = limits.end - limits.start;
    let mut near = Vec::new();
    if limits.end.is_finite() && span.is_finite() && high > limits.end - NEAR_LIMIT * 0.5 * span {
        near.push(limits.end);
    }
    if limits.start.is_finite() && span.is_finite() && low < limits.start + NEAR_LIMIT * 0.5 * span {
        near.push(limits.start);
    }
    for limit in near {
        panel.series.push(Series::new("limit", vec![begin, end], vec![limit; 2]).style(Style::Thin));
    }
}
