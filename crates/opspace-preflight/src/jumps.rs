//! References that jump: between two steps they move further than the joints can, and further than their own velocities state.
//!
//! With the error e of a task's rows in the rollout, whose joints follow the velocities of the reference, a jump is e_k − e_{k−1}. The
//! joints would follow it by J⁺ (e_k − e_{k−1}) within the step. A motion above a speed limit that begins and ends within some
//! hundredths of a second is a jump, too.

use super::case::PreflightCase;
use super::diagnostic::{at_least, short};
use nalgebra::{DVector, Matrix6xX, Vector6};
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::rollout::{Instant, Rollout};
use opspace_model::{Data, update};

/// Displacement up to which nothing is reported, m or rad.
const LEAST: f64 = 2e-3;

/// Longest time from rest to rest of a motion above a speed limit that is a jump, s.
const BURST_S: f64 = 0.025;

/// Longest step across which a jump is searched, s.
const LONGEST_S: f64 = 0.1;

/// Proposed duration of a motion, as a multiple of the time that it takes at the speed limit: that of a minimum-jerk motion is 1.875.
const SLOWER: f64 = 3.0;

/// Jump of a reference.
struct Jump<'a> {
    instant: &'a Instant,
    task: String,
    /// Time since the step before it, s.
    within_s: f64,
    joint: usize,
    /// Displacement of the joint, rad or m, and the time that it needs for it at its speed limit, s.
    by: f64,
    at_limit_s: f64,
}

/// Reports the first jump of the references, if any.
pub(crate) fn of_references(case: &PreflightCase<'_>, followed: &Rollout) -> Option<Finding> {
    let mut data = case.data.clone();
    let step_s = followed.instants.windows(2).next().map(|pair| pair[1].time_s - pair[0].time_s)?;
    let at_start = followed.instants.first().and_then(|first| jump(case, &mut data, None, first, step_s));
    let on_the_way = || {
        let mut pairs = followed.instants.windows(2).filter(|pair| {
            let within_s = pair[1].time_s - pair[0].time_s;
            within_s > 0.0 && within_s < LONGEST_S
        });
        pairs
            .find_map(|pair| jump(case, &mut data, Some(&pair[0]), &pair[1], pair[1].time_s - pair[0].time_s))
    };
    let jump = at_start.or_else(|| burst(case, &followed.instants)).or_else(on_the_way);
    jump.map(|jump| finding(case, &jump))
}

/// Motion above a joint's speed limit that begins and ends within [`BURST_S`]: its velocities are those of a jump.
fn burst<'a>(case: &PreflightCase<'_>, instants: &'a [Instant]) -> Option<Jump<'a>> {
    let is_fast = |instant: &Instant| {
        let limits = case.model.joints().iter().map(|joint| joint.limits.velocity);
        instant.dq.iter().zip(limits).any(|(dq, limit)| dq.abs() > limit)
    };
    let mut slow = instants.first()?;
    let mut by = DVector::zeros(case.model.n());
    for pair in instants.windows(2) {
        let [before, after] = [&pair[0], &pair[1]];
        if is_fast(before) {
            by += DVector::from_column_slice(&before.dq) * (after.time_s - before.time_s);
        }
        if is_fast(after) {
            continue;
        }
        let within_s = after.time_s - slow.time_s;
        if is_fast(before) && within_s <= BURST_S {
            let moving = case.task_sets[before.task_set].tasks.tasks().zip(&before.tasks);
            let name =
                moving.into_iter().find(|(_, asked)| asked.velocity > 0.0).map(|(task, _)| task.name());
            let name = name.or_else(|| before.joints.keys().next().map(String::as_str))?;
            if let Some(jump) = fastest(case, before, name, within_s, &by) {
                return Some(jump);
            }
        }
        slow = after;
        by.fill(0.0);
    }
    None
}

/// Jump of a reference between two instants; `before` is absent at the start.
fn jump<'a>(
    case: &PreflightCase<'_>,
    data: &mut Data,
    before: Option<&Instant>,
    now: &'a Instant,
    within_s: f64,
) -> Option<Jump<'a>> {
    let set = &case.task_sets[now.task_set];
    let same_set = before.filter(|before| before.task_set == now.task_set);
    let names = set.tasks.tasks().map(|task| task.name().to_owned());
    for (place, name) in names.enumerate() {
        let (Some(asked), at_rest) = (now.tasks.get(place), Vector6::zeros()) else { continue };
        let last = same_set.and_then(|before| before.tasks.get(place));
        let jumped = asked.error - last.map_or(at_rest, |last| last.error);
        let stated = asked.velocity.max(last.map_or(0.0, |last| last.velocity)) * within_s;
        if jumped.norm() < LEAST.max(stated)
            || asked.error.norm() < last.map_or(0.0, |last| last.error.norm())
        {
            continue;
        }
        if !update(case.model, data, &now.q, &vec![0.0; case.model.n()]) {
            continue;
        }
        let by = displacement(case, data, now.task_set, place, &jumped);
        if let Some(jump) = fastest(case, now, &name, within_s, &by) {
            return Some(jump);
        }
    }
    for (name, targets) in &now.joints {
        let mut by = DVector::zeros(case.model.n());
        for target in targets {
            let last = same_set.and_then(|before| {
                let target = before.joints.get(name)?.iter().find(|last| last.joint == target.joint)?;
                Some((target.position - before.q[target.joint], target.velocity))
            });
            let (error, velocity) = last.unwrap_or_default();
            let jumped = target.position - now.q[target.joint] - error;
            let stated = within_s * velocity.abs().max(target.velocity.abs());
            by[target.joint] = if jumped.abs() > LEAST.max(stated) { jumped } else { 0.0 };
        }
        if let Some(jump) = fastest(case, now, name, within_s, &by) {
            return Some(jump);
        }
    }
    None
}

/// Displacements of the joints for one of the rows of a task: J⁺ d (n).
fn displacement(
    case: &PreflightCase<'_>,
    data: &Data,
    task_set: usize,
    place: usize,
    jumped: &Vector6<f64>,
) -> DVector<f64> {
    /// Damping μ² of J⁺ relative to the trace of J Jᵀ.
    const DAMPING: f64 = 1e-6;
    let still = DVector::zeros(case.model.n());
    let Some(task) = case.task_sets[task_set].tasks.tasks().nth(place) else { return still };
    let mut jacobian = Matrix6xX::zeros(case.model.n());
    task.jacobian(case.model, data, &mut jacobian);
    let rows = jacobian.rows(0, task.rows()).into_owned();
    let mut square = &rows * rows.transpose();
    let damping = DAMPING * square.trace();
    (0..task.rows()).for_each(|i| square[(i, i)] += damping);
    let Some(factor) = square.cholesky() else { return still };
    rows.tr_mul(&factor.solve(&jumped.rows(0, task.rows()).into_owned()))
}

/// Jump with the joint that exceeds its speed limit the most, if one does.
fn fastest<'a>(
    case: &PreflightCase<'_>,
    instant: &'a Instant,
    task: &str,
    within_s: f64,
    by: &DVector<f64>,
) -> Option<Jump<'a>> {
    let times_s =
        by.iter().zip(case.model.joints()).map(|(by, joint)| by.abs() / joint.limits.velocity).enumerate();
    let (joint, at_limit_s) = times_s.max_by(|a, b| a.1.total_cmp(&b.1))?;
    let jump = || Jump { instant, task: task.to_owned(), within_s, joint, by: by[joint].abs(), at_limit_s };
    (at_limit_s > within_s).then(jump)
}

fn finding(case: &PreflightCase<'_>, jump: &Jump<'_>) -> Finding {
    let Jump { instant, task, within_s, joint, by, at_limit_s } = jump;
    let when = match instant.step {
        0 => "starts away from the arm".to_owned(),
        _ => format!("jumps at {} s, within {} ms", short(instant.time_s), short(1e3 * within_s)),
    };
    let message = format!(
        "task '{task}': its reference {when}: joint '{}' would move by {} rad (m), which takes {} s at its speed limit",
        case.joint(*joint),
        short(*by),
        short(*at_limit_s),
    );
    let help = format!(
        "give this motion at least {} s, or let the reference begin where the one before it ends; for a file, check times and units",
        at_least(SLOWER * at_limit_s)
    );
    Finding::new(Code::ReferenceJump, &case.reference_key(instant.task_set, task), message, help)
}
