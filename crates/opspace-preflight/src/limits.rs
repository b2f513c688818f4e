//! Limits that contradict each other, the start posture, or the arm's weight.

use super::case::PreflightCase;
use super::diagnostic::{at_least, at_most, distinct, short};
use opspace_backend::GravityCompensation;
use opspace_control::TaskParameters;
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::rollout::Rollout;
use opspace_model::JointKind;
use std::collections::BTreeSet;

/// Diagnostics that depend only on the start posture.
pub(crate) fn of_start(case: &PreflightCase<'_>) -> Vec<Finding> {
    let mut found: Vec<Finding> = Vec::new();
    found.extend(shares(case));
    for joint in 0..case.model.n() {
        found.extend(range(case, joint).or_else(|| start_in_margin(case, joint)));
        found.extend(weight(case, joint, case.data.gravity[joint], None));
        found.extend(braking(case, joint));
    }
    found
}

/// Finds limit fractions above 1, which count as 1.
fn shares(case: &PreflightCase<'_>) -> Vec<Finding> {
    let limits = case.experiment.task().file.limits;
    let all = [("velocity_fraction", limits.velocity_fraction), ("torque_fraction", limits.torque_fraction)];
    all.into_iter()
        .filter(|(_, share)| share.get() > 1.0)
        .map(|(key, share)| {
            let message = format!("{key} is {}, above 1: 1 is used", short(share.get()));
            let help = format!("give a fraction from 0 to 1: {key} = 0.9");
            Finding::new(Code::FractionAboveOne, &["limits", key], message, help)
        })
        .collect()
}

/// Finds a joint range that is not larger than its two margins.
fn range(case: &PreflightCase<'_>, joint: usize) -> Option<Finding> {
    let limits = &case.model.joints()[joint].limits;
    let (width, margin) = (limits.upper - limits.lower, case.margin());
    if width > 2.0 * margin {
        return None;
    }
    let message = format!(
        "position_margin_rad is {} at both ends of joint '{}', whose range is {}: the joint is kept at the middle",
        short(margin),
        case.joint(joint),
        short(width),
    );
    let help = format!("give a margin well below {}", short(0.5 * width));
    Some(Finding::new(Code::MarginAboveRange, &["limits", "position_margin_rad"], message, help))
}

/// Finds a start position within the margin; the joint moves away from there immediately.
fn start_in_margin(case: &PreflightCase<'_>, joint: usize) -> Option<Finding> {
    let (q, (lower, upper)) = (case.start[joint], case.range(joint));
    if q >= lower && q <= upper {
        return None;
    }
    let (end, inside) =
        if q < lower { (lower - case.margin(), lower) } else { (upper + case.margin(), upper) };
    let [starts, _, end] = distinct([q, inside, end]);
    let message = format!(
        "joint '{}' starts at {starts}, closer to its limit at {end} than position_margin_rad = {}: it moves away from \
         there as soon as control starts",
        case.joint(joint),
        short(case.margin()),
    );
    let inside = if q < lower { at_least(inside) } else { at_most(inside) };
    let help = format!("start it at {inside} or further inside, or give a smaller margin");
    Some(Finding::new(Code::StartInMargin, &["start_rad", case.joint(joint)], message, help))
}

/// Finds a joint whose torque limit is too low for the weight of the arm: at the start, or at a time on the
/// references.
fn weight(case: &PreflightCase<'_>, joint: usize, gravity: f64, time_s: Option<f64>) -> Option<Finding> {
    if case.experiment.robot().file.interface.gravity_compensated_by == GravityCompensation::Robot {
        return None;
    }
    let limits = case.experiment.task().file.limits;
    let limit = case.experiment.robot().torque_limits()[joint];
    let share = if limits.enforce { limits.torque_fraction.get().min(1.0) } else { 1.0 };
    if gravity.abs() <= share * limit {
        return None;
    }
    let unit = unit(case, joint);
    let whose = if share < 1.0 {
        format!(", {} of its limit of {}", short(share), short(limit))
    } else {
        String::new()
    };
    let what = time_s.map_or("to hold the start posture".to_owned(), |t| {
        format!("to hold the reference posture at {} s", short(t))
    });
    let message = format!(
        "joint '{}' needs {} {unit} {what}, but only {} {unit} is allowed{whose}",
        case.joint(joint),
        short(gravity.abs()),
        short(share * limit),
    );
    let name = case.joint(joint);
    if gravity.abs() <= limit {
        let help = format!("set torque_fraction to at least {}", at_least(gravity.abs() / limit));
        return Some(Finding::new(Code::WeightAboveLimit, &["limits", "torque_fraction"], message, help));
    }
    let help = "choose a posture with less gravity torque on this joint, or check the limit and the masses"
        .to_owned();
    Some(Finding::new(Code::WeightAboveLimit, &["joint", name, "torque_limit_nm"], message, help).of_robot())
}

/// Finds an acceleration limit so low that braking from the velocity limit requires more than the joint range.
fn braking(case: &PreflightCase<'_>, joint: usize) -> Option<Finding> {
    let acceleration = case.experiment.robot().joint_limits().acceleration[joint];
    let limits = &case.model.joints()[joint].limits;
    let (width, way) =
        (limits.upper - limits.lower, limits.velocity * limits.velocity / (2.0 * acceleration));
    if way <= width {
        return None;
    }
    let message = format!(
        "braking joint '{}' from its velocity limit of {} takes a distance of {}, but its range is {}: with \
         acceleration_limit_rad_per_s2 = {} it never reaches that speed",
        case.joint(joint),
        short(limits.velocity),
        short(way),
        short(width),
        short(acceleration),
    );
    let least = at_least(limits.velocity * limits.velocity / (2.0 * width));
    let help = format!("give it in rad/s² (m/s²); at least {least} lets the joint reach its velocity limit");
    Some(
        Finding::new(
            Code::UnreachableSpeed,
            &["joint", case.joint(joint), "acceleration_limit_rad_per_s2"],
            message,
            help,
        )
        .of_robot(),
    )
}

/// Finds target positions of posture tasks and joint references outside the joint ranges.
pub(crate) fn of_postures(case: &PreflightCase<'_>, followed: &Rollout) -> Vec<Finding> {
    let mut found: Vec<Finding> = Vec::new();
    let mut seen = BTreeSet::new();
    let mut note =
        |stack: usize, name: &str, rest: &[&str], joint: usize, asked: f64, time_s: Option<f64>| {
            if seen.insert((case.key(stack, name, rest), joint)) {
                found.push(beyond(case, case.key(stack, name, rest), name, joint, asked, time_s));
            }
        };
    for (number, stack) in case.task_sets.iter().enumerate() {
        for name in stack.priority {
            if let Some(TaskParameters::JointPosture(posture)) = stack.task.get(name) {
                for (joint, &asked) in &posture.posture_rad {
                    let Ok(index) = case.model.joint(joint) else { continue };
                    if outside(case, index, asked) > 0.0 {
                        note(number, name, &["joint-posture", "posture_rad", joint], index, asked, None);
                    }
                }
            }
            for joint in 0..case.model.n() {
                let in_force = followed.instants.iter().filter(|instant| instant.task_set == number);
                let asked = in_force.filter_map(|i| {
                    let target = i.joints.get(name)?.iter().find(|target| target.joint == joint)?;
                    Some((target.position, i.time_s))
                });
                let farthest =
                    asked.max_by(|a, b| outside(case, joint, a.0).total_cmp(&outside(case, joint, b.0)));
                if let Some((asked, time_s)) =
                    farthest.filter(|(asked, _)| outside(case, joint, *asked) > 1e-9)
                {
                    // A target at the start position is already reported as the start.
                    if (asked - case.start[joint]).abs() > 1e-12 {
                        let kind = stack.task.get(name).map_or("", TaskParameters::kind);
                        note(number, name, &[kind, "reference"], joint, asked, Some(time_s));
                    }
                }
            }
        }
    }
    found
}

/// Distance of a position from the allowed range of a joint, rad or m; negative inside.
fn outside(case: &PreflightCase<'_>, joint: usize, asked: f64) -> f64 {
    let (lower, upper) = case.range(joint);
    (lower - asked).max(asked - upper)
}

fn beyond(
    case: &PreflightCase<'_>,
    key: Vec<String>,
    name: &str,
    joint: usize,
    asked: f64,
    time_s: Option<f64>,
) -> Finding {
    let (lower, upper) = case.range(joint);
    let when = time_s.map_or(String::new(), |t| format!("at {} s ", short(t)));
    let kept = if case.margin() > 0.0 {
        format!(", a margin of {} from its limits", short(case.margin()))
    } else {
        String::new()
    };
    let [asked_text, _, lower_text, upper_text] =
        distinct([asked, if asked > upper { upper } else { lower }, lower, upper]);
    let message = format!(
        "task '{name}': {when}its target for joint '{}' is {asked_text}, but the joint is kept between {lower_text} and \
         {upper_text}{kept}",
        case.joint(joint),
    );
    let help = if asked > upper {
        format!("give a target of at most {}", at_most(upper))
    } else {
        format!("give a target of at least {}", at_least(lower))
    };
    Finding::new(Code::TargetBeyondLimits, &key, message, help)
}

/// Diagnostics along the references: weight above the torque limit of a joint, or changing faster than its torque
/// rate limit.
pub(crate) fn on_the_way(case: &PreflightCase<'_>, followed: &Rollout) -> Vec<Finding> {
    let mut found = Vec::new();
    for joint in 0..case.model.n() {
        let heaviest =
            followed.instants.iter().max_by(|a, b| a.gravity[joint].abs().total_cmp(&b.gravity[joint].abs()));
        if let Some(instant) = heaviest
            && weight(case, joint, case.data.gravity[joint], None).is_none()
        {
            found.extend(weight(case, joint, instant.gravity[joint], Some(instant.time_s)));
        }
        found.extend(torque_rate(case, followed, joint));
    }
    found
}

/// Finds a joint whose gravity torque changes faster than its torque rate limit.
fn torque_rate(case: &PreflightCase<'_>, followed: &Rollout, joint: usize) -> Option<Finding> {
    let rate = case.experiment.robot().joint_limits().torque_rate[joint];
    if rate == f64::INFINITY
        || case.experiment.robot().file.interface.gravity_compensated_by == GravityCompensation::Robot
    {
        return None;
    }
    let change = |pair: &[opspace_experiment::run::rollout::Instant]| {
        (pair[1].gravity[joint] - pair[0].gravity[joint]).abs() / (pair[1].time_s - pair[0].time_s)
    };
    let fastest = followed.instants.windows(2).max_by(|a, b| change(a).total_cmp(&change(b)))?;
    if change(fastest) <= rate {
        return None;
    }
    let unit = unit(case, joint);
    let message = format!(
        "at {} s the gravity torque of joint '{}' along the references changes by {} {unit}/s; its torque rate limit is \
         {} {unit}/s",
        short(fastest[0].time_s),
        case.joint(joint),
        short(change(fastest)),
        short(rate),
    );
    let help = format!(
        "make the motion {} times as long, or check the unit of the limit: {unit}/s",
        at_least(change(fastest) / rate)
    );
    Some(
        Finding::new(
            Code::WeightAboveRate,
            &["joint", case.joint(joint), "torque_rate_limit_nm_per_s"],
            message,
            help,
        )
        .of_robot(),
    )
}

fn unit(case: &PreflightCase<'_>, joint: usize) -> &'static str {
    if case.model.joints()[joint].kind == JointKind::Prismatic { "N" } else { "Nm" }
}
