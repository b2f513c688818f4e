//! Sentences about the response of a run to external forces.

use crate::codes::Code;
use crate::evaluate::summary::Summary;
use crate::metrics::metric_tables::{TaskMetrics, response_names};
use crate::text::{format_short, listed};
use opspace_control::AXIS_NAMES;

/// Force along an axis from which on the axis is named, relative to the largest of all axes.
const NAMED: f64 = 0.1;

/// Displacement at the end below which a frame has come back, m.
const BACK_M: f64 = 0.1e-3;

/// Describes for each task by how much external forces moved its frame; empty if none acted.
#[must_use]
pub fn response_sentences(summary: &Summary) -> Vec<String> {
    let friction = |name: &str| {
        let found =
            summary.findings.of(Code::SpringDeflected).find(|finding| finding.task() == Some(name))?;
        let joints = listed(&found.causes.friction);
        let friction_nm = found.number("friction_nm")?;
        Some(format!("friction of up to {} Nm in {joints} holds it", format_short(friction_nm)))
    };
    summary.ordered_tasks().filter_map(|(name, task)| sentences(name, task, friction(name))).collect()
}

/// Axes of a task along which a considerable force pushes its frame.
pub(crate) fn pushed_axes(task: &TaskMetrics) -> Vec<usize> {
    let force = |axis: usize| task.axes.get(&response_names(axis)[0]).copied().unwrap_or(0.0);
    let largest_n = (0..3).map(force).fold(0.0, f64::max);
    (0..3).filter(|&axis| largest_n > 0.0 && force(axis) >= NAMED * largest_n).collect()
}

/// Describes the response of one task, and the friction that holds its spring at the end.
fn sentences(name: &str, task: &TaskMetrics, friction: Option<String>) -> Option<String> {
    let value = |axis: usize, place: usize| task.axes.get(&response_names(axis)[place]).copied();
    let force = |axis: usize| value(axis, 0).unwrap_or(0.0);
    let pushed = pushed_axes(task);
    if pushed.is_empty() {
        return None;
    }
    let along = |text: &dyn Fn(usize) -> Option<String>| {
        let parts = pushed.iter().filter_map(|&axis| Some((axis, text(axis)?)));
        listed(&parts.map(|(axis, text)| format!("{text} along {}", AXIS_NAMES[axis])).collect::<Vec<_>>())
    };
    let mm = |m: f64| format!("{} mm", format_short(1e3 * m));
    let forces = along(&|axis| Some(format!("{} N", format_short(force(axis)))));
    let yielded = along(&|axis| {
        let desired = value(axis, 5).map_or_else(String::new, |k| format!(", desired {}", format_short(k)));
        let stiffness =
            value(axis, 2).map_or_else(String::new, |k| format!(" ({} N/m{desired})", format_short(k)));
        Some(format!("{}{stiffness}", mm(value(axis, 1)?)))
    });
    let left = along(&|axis| Some(mm(value(axis, 4).filter(|left| *left >= BACK_M)?)));
    let has_ended = pushed.iter().any(|&axis| value(axis, 4).is_some());
    let end = match (has_ended, left.is_empty()) {
        (false, _) => String::new(),
        (true, true) => " It came back to where it was.".to_owned(),
        (true, false) => {
            let friction = friction.map_or_else(String::new, |friction| format!(": {friction}"));
            format!(" At the end, without force, it is off by {left}{friction}.")
        }
    };
    let hysteresis = along(&|axis| Some(mm(value(axis, 3)?)));
    let hysteresis = match hysteresis.as_str() {
        "" => String::new(),
        _ => format!(", with a hysteresis of {hysteresis}"),
    };
    Some(format!(
        "External forces of up to {forces} acted on the frame of task '{name}'. It yielded by {yielded}{hysteresis}.{end}"
    ))
}
