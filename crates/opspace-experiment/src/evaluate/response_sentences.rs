//! Sentences about the response of a run to external forces.

use crate::codes::Code;
use crate::evaluate::summary::Summary;
use crate::metrics::metric_tables::response_names;
use crate::text::{format_short, listed};
use opspace_control::AXIS_NAMES;
use std::collections::BTreeMap;

/// Force along an axis from which on the axis is named, relative to the largest of all axes.
const NAMED: f64 = 0.1;

/// Displacement along an axis without a force from which on the axis is named, relative to the largest of all axes.
const CARRIED_ALONG: f64 = 0.3;

/// Displacement at the end below which a frame has come back, m.
const BACK_M: f64 = 0.1e-3;

/// Metrics of the response of a frame, by their names.
type Axes = BTreeMap<String, f64>;

/// Describes for each task, and for each frame that no task controls, by how much external forces moved it; empty if none acted.
#[must_use]
pub fn response_sentences(summary: &Summary) -> Vec<String> {
    let friction = |name: &str| {
        let found =
            summary.findings.of(Code::SpringDeflected).find(|finding| finding.task() == Some(name))?;
        let joints = listed(&found.causes.friction);
        let friction_nm = found.number("friction_nm").filter(|_| !joints.is_empty())?;
        Some(format!("friction of up to {} Nm in {joints} holds it", format_short(friction_nm)))
    };
    let has_stiffness = summary.faulted.is_none();
    let tasks = summary.ordered_tasks().filter_map(|(name, task)| {
        let (who, axes) = (format!("the frame of task '{name}'"), &task.axes);
        Some([forces(axes, &who)?, yielded(axes, has_stiffness), left(axes, friction(name))].concat())
    });
    let frames = summary.frames.iter().filter_map(|(frame, axes)| {
        let who = format!("'{frame}'");
        Some([forces(axes, &who)?, moved(axes), left(axes, None)].concat())
    });
    tasks.chain(frames).collect()
}

/// Number of the response along an axis, by its place among [`response_names`].
fn value(axes: &Axes, axis: usize, place: usize) -> Option<f64> {
    axes.get(&response_names(axis)[place]).copied()
}

/// Axes on which a number is not small beside the largest one.
fn considerable(axes: &Axes, place: usize, share: f64) -> Vec<usize> {
    let number = |axis: usize| value(axes, axis, place).unwrap_or(0.0);
    let largest = (0..3).map(number).fold(0.0, f64::max);
    (0..3).filter(|&axis| largest > 0.0 && number(axis) >= share * largest).collect()
}

/// Axes along which a considerable force pushes a frame.
pub(crate) fn pushed_axes(axes: &Axes) -> Vec<usize> {
    considerable(axes, 0, NAMED)
}

/// Lists texts of axes: `3 mm along x and 4 mm along z`.
fn along(shown: &[usize], text: impl Fn(usize) -> Option<String>) -> String {
    let parts = shown.iter().filter_map(|&axis| Some((axis, text(axis)?)));
    listed(&parts.map(|(axis, text)| format!("{text} along {}", AXIS_NAMES[axis])).collect::<Vec<_>>())
}

fn mm(m: f64) -> String {
    format!("{} mm", format_short(1e3 * m))
}

/// States the forces; `None` if nothing pushes the frame.
fn forces(axes: &Axes, who: &str) -> Option<String> {
    let pushed = pushed_axes(axes);
    let forces = along(&pushed, |axis| Some(format!("{} N", format_short(value(axes, axis, 0)?))));
    (!pushed.is_empty()).then(|| format!("External forces of up to {forces} acted on {who}."))
}

/// States by how much a frame yielded that a task holds, with its stiffness and hysteresis.
fn yielded(axes: &Axes, has_stiffness: bool) -> String {
    let pushed = pushed_axes(axes);
    let mut shown = considerable(axes, 1, CARRIED_ALONG);
    shown.extend(pushed.iter().copied().filter(|axis| !shown.contains(axis)).collect::<Vec<_>>());
    shown.sort_unstable();
    let yielded = along(&shown, |axis| {
        let desired =
            value(axes, axis, 5).map_or_else(String::new, |k| format!(", desired {}", format_short(k)));
        let stiffness = value(axes, axis, 2).filter(|_| has_stiffness);
        let stiffness =
            stiffness.map_or_else(String::new, |k| format!(" ({} N/m{desired})", format_short(k)));
        Some(format!("{}{stiffness}", mm(value(axes, axis, 1)?)))
    });
    let hysteresis = along(&pushed, |axis| Some(mm(value(axes, axis, 3).filter(|_| has_stiffness)?)));
    match hysteresis.as_str() {
        "" => format!(" It yielded by {yielded}."),
        _ => format!(" It yielded by {yielded}, with a hysteresis of {hysteresis}."),
    }
}

/// States by how much a frame moved that no Cartesian task holds.
fn moved(axes: &Axes) -> String {
    let moved = along(&considerable(axes, 1, NAMED), |axis| Some(mm(value(axes, axis, 1)?)));
    format!(" It moved by up to {moved}.")
}

/// States how far a frame is from where it was, and what holds it there; empty if a force still acts.
fn left(axes: &Axes, friction: Option<String>) -> String {
    let has_ended = (0..3).any(|axis| value(axes, axis, 4).is_some());
    let left = along(&considerable(axes, 4, NAMED), |axis| {
        Some(mm(value(axes, axis, 4).filter(|left| *left >= BACK_M)?))
    });
    let friction = friction.map_or_else(String::new, |friction| format!(": {friction}"));
    match (has_ended, left.is_empty()) {
        (false, _) => String::new(),
        (true, true) => " It came back to where it was.".to_owned(),
        (true, false) => format!(" At the end, without force, it is off by {left}{friction}."),
    }
}
