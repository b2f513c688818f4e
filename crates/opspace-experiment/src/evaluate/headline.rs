//! Result of a run in one or two lines of plain words, from its summary.

use crate::evaluate::summary::Summary;
use crate::metrics::metric_tables::{PoseErrors, TaskMetrics, response_names};
use crate::text::{format_short, without_noise};
use opspace_control::AXIS_NAMES;
use std::collections::BTreeMap;

/// Longest line, in characters.
const WIDTH: usize = 100;

/// Number of lines from which on words are left out.
const LINES: usize = 2;

/// States what became of a run, with the main numbers of its tasks: force, motion of an operator, error of motion, torques.
#[must_use]
pub fn headline(summary: &Summary) -> Vec<String> {
    let mut parts = vec![end(summary)];
    parts.extend(force(summary));
    let motion = || response(summary).or_else(|| compliant_motion(summary)).or_else(|| free_motion(summary));
    parts.extend(operator(summary).or_else(motion));
    parts.extend(pose_error(summary).or_else(|| joint_error(summary)).or_else(|| element_error(summary)));
    let torque_error = summary.metrics.torque_error_interval;
    let torque_error = torque_error.map(|error| format!("torque error {} %", number(error, 1e2)));
    let with = |more: &str| {
        let last = torque_error.iter().map(|text| format!("{text}{more}"));
        lines(&parts.iter().cloned().chain(last).collect::<Vec<_>>())
    };
    let full = with(" of the desired torque");
    if full.len() > LINES { with("") } else { full }
}

/// States how the run ended; ends with the character that the numbers follow.
fn end(summary: &Summary) -> String {
    let planned = format!("{} s", format_short(summary.duration_s));
    let after = |time_s: Option<f64>| format!("{} s of {planned}", format_short(time_s.unwrap_or(f64::NAN)));
    if summary.faulted.is_some() {
        format!("stopped after {}:", after(summary.fault_time_s))
    } else if summary.interrupted {
        format!("interrupted after {}:", after(summary.interrupted_time_s))
    } else if summary.has_failed() {
        format!("completed {planned}, but failed:")
    } else {
        format!("completed {planned}:")
    }
}

/// Number in an SI unit as text in a unit `factor` times smaller, without noise.
fn number(value: f64, factor: f64) -> String {
    format_short(factor * without_noise(value))
}

fn mm(value_m: f64) -> String {
    format!("{} mm", number(value_m, 1e3))
}

fn mrad(value_rad: f64) -> String {
    format!("{} mrad", number(value_rad, 1e3))
}

fn newtons(value_n: f64) -> String {
    format!("{} N", number(value_n, 1.0))
}

/// First task by priority with a value.
fn first<T>(summary: &Summary, value: impl Fn(&TaskMetrics) -> Option<T>) -> Option<(&str, T)> {
    summary.ordered_tasks().find_map(|(name, task)| Some((name.as_str(), value(task)?)))
}

fn force(summary: &Summary) -> Option<String> {
    let (_, contact) = first(summary, |task| task.contact.force_rms_n.map(|_| task.contact))?;
    let share = contact.in_contact_fraction.filter(|share| *share < 0.999);
    let share = share.map(|share| format!("in contact {:.0} % of the time", 1e2 * share));
    let largest = contact.force_error_max_n.map(|max| format!("max {}", newtons(max)));
    let more: Vec<String> = largest.into_iter().chain(share).collect();
    let more = if more.is_empty() { String::new() } else { format!(" ({})", more.join(", ")) };
    Some(format!("force error {} rms{more}", newtons(contact.force_rms_n?)))
}

/// States by how much an operator moves the arm, and the force that this takes; `None` without an operator.
#[must_use]
pub fn operator(summary: &Summary) -> Option<String> {
    let metrics = &summary.metrics;
    let (motion_m, force_n) = (metrics.hand_motion_rms_m?, metrics.hand_force_rms_n?);
    Some(format!("the operator moves the arm by {} rms with {} rms", mm(motion_m), newtons(force_n)))
}

/// States how a person moves the arm, or how it yields to pushes; `None` if nobody does.
#[must_use]
pub fn moved_by_hand(summary: &Summary) -> Option<String> {
    operator(summary).or_else(|| pushed(summary)).or_else(|| free_motion(summary))
}

/// Deflection of the axis on which the largest force acts, with its stiffness; axes that have one come first.
fn response(summary: &Summary) -> Option<String> {
    let (name, (axis, force_n, moved_m, stiffness)) = first(summary, |task| {
        let of_axis = |axis: usize| {
            let [force, moved, stiffness, ..] =
                response_names(axis).map(|name| task.axes.get(&name).copied());
            Some((axis, force.filter(|force| *force > 0.0)?, moved?, stiffness))
        };
        let rank = |(_, force, _, stiffness): &(usize, f64, f64, Option<f64>)| (stiffness.is_some(), *force);
        (0..3).filter_map(of_axis).max_by(|a, b| {
            let ((a, a_n), (b, b_n)) = (rank(a), rank(b));
            a.cmp(&b).then(a_n.total_cmp(&b_n))
        })
    })?;
    let (moved, axis, force) = (mm(moved_m), AXIS_NAMES[axis], newtons(force_n));
    let stiffness =
        stiffness.map_or_else(String::new, |stiffness| format!(" ({} N/m)", number(stiffness, 1.0)));
    Some(format!("{name} yields by {moved} along {axis} under {force}{stiffness}"))
}

fn compliant_motion(summary: &Summary) -> Option<String> {
    let (name, motion_m) = first(summary, |task| task.compliance.compliant_motion_rms_m)?;
    Some(format!("{name} yields by {} rms", mm(motion_m)))
}

/// Largest motion of a frame that no Cartesian task holds along each axis on which it is pushed, with the largest push there.
fn free_motion(summary: &Summary) -> Option<String> {
    let (frame, axes) = summary.frames.iter().next()?;
    Some(format!("'{frame}' moves by up to {}", pushed_axes(axes)?))
}

/// Largest motion of the first task that is pushed, along each axis on which it is: two runs are compared on the same axes.
fn pushed(summary: &Summary) -> Option<String> {
    let (name, axes) = first(summary, |task| pushed_axes(&task.axes))?;
    Some(format!("{name} yields by up to {axes}"))
}

/// Largest motion and largest force along each axis with a force; they are not those of the same time.
fn pushed_axes(axes: &BTreeMap<String, f64>) -> Option<String> {
    let of_axis = |axis: usize| {
        let [force, moved, ..] = response_names(axis).map(|name| axes.get(&name).copied());
        let force_n = force.filter(|force| *force > 0.0)?;
        Some(format!("{} along {} (pushed by up to {})", mm(moved?), AXIS_NAMES[axis], newtons(force_n)))
    };
    let axes: Vec<String> = (0..3).filter_map(of_axis).collect();
    if axes.is_empty() { None } else { Some(axes.join(", ")) }
}

fn pose_error(summary: &Summary) -> Option<String> {
    let (name, pose) = first(summary, |task| Some(task.pose).filter(|pose| *pose != PoseErrors::default()))?;
    let of_unit = |unit: fn(f64) -> String, [rms, max, end]: [Option<f64>; 3]| {
        let max = max.map(|max| format!("max {}", unit(max)));
        let end = end.map(|end| format!("{} at the end", unit(end)));
        let more: Vec<String> = max.into_iter().chain(end).collect();
        rms.map(|rms| format!("{} rms of its reference ({})", unit(rms), more.join(", ")))
    };
    let position = of_unit(mm, [pose.position_rms_m, pose.position_max_m, pose.position_final_m]);
    let orientation =
        || of_unit(mrad, [pose.orientation_rms_rad, pose.orientation_max_rad, pose.orientation_final_rad]);
    Some(format!("{name} within {}", position.or_else(orientation)?))
}

fn joint_error(summary: &Summary) -> Option<String> {
    let (name, error) = first(summary, |task| task.joint_rms_rad)?;
    Some(format!("{name} within {} rms of its reference", mrad(error)))
}

fn element_error(summary: &Summary) -> Option<String> {
    let (_, element) = first(summary, |task| task.elements.first().cloned())?;
    let (rms, max) = (number(element.rms, 1.0), number(element.max, 1.0));
    Some(format!("{} within {rms} {} rms of its reference (max {max})", element.name, element.unit))
}

/// Joins parts with commas into lines; the first part ends with a colon of its own.
fn lines(parts: &[String]) -> Vec<String> {
    let [end, numbers @ ..] = parts else { return Vec::new() };
    let Some(last) = numbers.len().checked_sub(1) else { return vec![end.trim_end_matches(':').to_owned()] };
    let mut lines = vec![end.clone()];
    for (place, part) in numbers.iter().enumerate() {
        let part = format!("{part}{}", if place == last { "" } else { "," });
        let line = lines.len() - 1;
        let is_full = lines[line].chars().count() + 1 + part.chars().count() > WIDTH;
        if place > 0 && is_full {
            lines.push(format!("  {part}"));
        } else {
            lines[line] += &format!(" {part}");
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::{headline, moved_by_hand};
    use crate::evaluate::results::tests::summary;
    use crate::metrics::metric_tables::{TaskMetrics, response_names};

    fn task(fill: impl Fn(&mut TaskMetrics)) -> TaskMetrics {
        let mut task = TaskMetrics::default();
        fill(&mut task);
        task
    }

    /// Checks the sentences of a motion, of a stop, of a force task and of an operator, and that noise is zero.
    #[test]
    fn result_is_a_sentence() {
        let mut run = summary("a", "p", 1, 0.1);
        assert_eq!(headline(&run), ["completed 1 s"]);
        let hand = task(|task| {
            (task.pose.position_rms_m, task.pose.position_max_m) = (Some(5.606e-3), Some(9.843e-3));
            task.pose.position_final_m = Some(3e-17);
        });
        run.tasks.insert("hand".to_owned(), hand);
        run.metrics.torque_error_interval = Some(0.02547);
        let motion = [
            "completed 1 s: hand within 5.61 mm rms of its reference (max 9.84 mm, 0 mm at the end),",
            "  torque error 2.55 % of the desired torque",
        ];
        assert_eq!(headline(&run), motion);
        let press = task(|task| {
            (task.contact.force_rms_n, task.contact.force_error_max_n) = (Some(0.3784), Some(1.153));
            task.contact.in_contact_fraction = Some(0.9);
        });
        run.tasks.insert("press".to_owned(), press);
        let force = "completed 1 s: force error 0.378 N rms (max 1.15 N, in contact 90 % of the time),";
        assert_eq!(headline(&run)[0], force);
        run.tasks.clear();
        run.metrics.torque_error_interval = None;
        let pushed = task(|task| {
            for (name, value) in
                response_names(2).into_iter().zip([20.0, 0.0476, 417.26, 0.009, 0.001, 400.0])
            {
                task.axes.insert(name, value);
            }
        });
        run.tasks.insert("flange".to_owned(), pushed);
        let yields = "flange yields by 47.6 mm along z under 20 N (417 N/m)";
        assert!(headline(&run)[0].ends_with(yields), "{:?}", headline(&run));
        for task in run.tasks.values_mut() {
            task.axes.remove(&response_names(2)[2]);
        }
        assert!(headline(&run)[0].ends_with("47.6 mm along z under 20 N"), "{:?}", headline(&run));
        run.tasks.clear();
        // Of a frame that no task holds: each axis on which it is pushed, and no other.
        let axes = [(0, 0.0, 0.02), (1, 1.2, 0.0812), (2, 0.9, 0.003)].into_iter().flat_map(
            |(axis, force_n, moved_m)| {
                let [force, moved, ..] = response_names(axis);
                [(force, force_n), (moved, moved_m)]
            },
        );
        run.frames.insert("tip".to_owned(), axes.collect());
        let moves = "81.2 mm along y (pushed by up to 1.2 N), 3 mm along z (pushed by up to 0.9 N)";
        assert_eq!(moved_by_hand(&run), Some(format!("'tip' moves by up to {moves}")));
        assert!(headline(&run).concat().ends_with(moves), "{:?}", headline(&run));
        let axes = std::mem::take(&mut run.frames).remove("tip");
        run.tasks.insert("flange".to_owned(), task(|task| task.axes = axes.clone().unwrap_or_default()));
        assert_eq!(moved_by_hand(&run), Some(format!("flange yields by up to {moves}")));
        run.tasks.clear();
        (run.metrics.hand_motion_rms_m, run.metrics.hand_force_rms_n) = (Some(0.0225), Some(1.57));
        run.metrics.torque_error_interval = None;
        let moved = "the operator moves the arm by 22.5 mm rms with 1.57 N rms";
        assert_eq!(headline(&run), [format!("completed 1 s: {moved}")]);
        (run.faulted, run.fault_time_s) = (Some("joint 'a': too fast".to_owned()), Some(0.25));
        assert_eq!(headline(&run), [format!("stopped after 0.25 s of 1 s: {moved}")]);
    }
}
