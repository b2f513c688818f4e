//! References that are faster than what follows them.

use super::followed::{Followed, Instant};
use super::{Case, Finding, short};
use opspace_control::AxisMode;

/// How much faster than allowed a reference may be before it is found: a sum of roundings.
const TOLERANCE: f64 = 1.001;

/// Joints that would have to be faster than they are allowed to be: the one most beyond its limit.
pub(crate) fn of_joints(case: &Case<'_>, followed: &Followed) -> Option<Finding> {
    let limits = case.experiment.task().file.limits;
    let share = if limits.enforce { limits.velocity_share.get().min(1.0) } else { 1.0 };
    let (mut worst, mut most) = (None, TOLERANCE);
    for instant in &followed.instants {
        for (joint, dq) in instant.dq.iter().enumerate() {
            let of_allowed = dq.abs() / (share * case.model.joints()[joint].limits.velocity);
            if of_allowed > most {
                (worst, most) = (Some((instant, joint)), of_allowed);
            }
        }
    }
    let (instant, joint) = worst?;
    let key = key_of_fastest(case, instant)?;
    let limit = case.model.joints()[joint].limits.velocity;
    let allowed = if share < 1.0 {
        format!("{} rad/s, {} of its limit of {}", short(share * limit), short(share), short(limit))
    } else {
        format!("{} rad/s", short(limit))
    };
    let message = format!(
        "at {} s the references ask joint '{}' for {} rad/s; it may do {allowed}",
        short(instant.time_s),
        case.joint(joint),
        short(instant.dq[joint].abs()),
    );
    let help = format!("give the motion {} times as long, or make it smaller", short(most));
    Some(Finding::new(&key, message, help))
}

/// The reference that is under way, of the most important task.
fn key_of_fastest(case: &Case<'_>, instant: &Instant) -> Option<Vec<String>> {
    let stack = &case.stacks[instant.stack];
    stack.priority.iter().find_map(|name| {
        if let Some(place) = stack.motions.iter().position(|motion| motion.name == name) {
            let velocity = &instant.targets[place].velocity;
            let moves = velocity.linear.norm() + velocity.angular.norm() > 1e-6;
            return moves.then(|| case.key(instant.stack, name, &[stack.motions[place].kind, "reference"]));
        }
        let target = instant.joints.get(name)?;
        let moves = target.velocity.iter().any(|dq| dq.abs() > 1e-6);
        moves.then(|| case.key(instant.stack, name, &["joint-tracking", "reference"]))
    })
}

/// References beyond the speed limit of their own task.
pub(crate) fn of_tasks(case: &Case<'_>, followed: &Followed) -> Vec<Finding> {
    let mut found: Vec<Finding> = Vec::new();
    for (number, stack) in case.stacks.iter().enumerate() {
        for (place, motion) in stack.motions.iter().enumerate() {
            let p = &motion.parameters;
            for (first, limit, key, unit) in [
                (0, p.speed_limit_m_per_s, "speed_limit_m_per_s", "m/s"),
                (3, p.speed_limit_rad_per_s, "speed_limit_rad_per_s", "rad/s"),
            ] {
                let Some(limit) = limit else { continue };
                let modes = p.axes.modes();
                let counted = |axis: usize| axis / 3 == first / 3 && modes[axis] == AxisMode::Motion;
                let speed = |instant: &Instant| {
                    let axes = motion.axes(case.model, &case.data, [false; 6]);
                    let v = axes.of_motion(&instant.targets[place].velocity);
                    (0..6).filter(|&axis| counted(axis)).map(|axis| v[axis] * v[axis]).sum::<f64>().sqrt()
                };
                let in_force = followed.instants.iter().filter(|instant| instant.stack == number);
                let fastest = in_force.map(|i| (speed(i), i.time_s)).max_by(|a, b| a.0.total_cmp(&b.0));
                let Some((asked, time_s)) = fastest.filter(|(asked, _)| *asked > TOLERANCE * limit.get())
                else {
                    continue;
                };
                let message = format!(
                    "task '{}': at {} s its reference moves at {} {unit}, and {key} is {}: it will lag behind",
                    motion.name,
                    short(time_s),
                    short(asked),
                    short(limit.get()),
                );
                let help = format!(
                    "give the motion {} times as long, or the task a higher limit",
                    short(asked / limit.get())
                );
                let key = case.key(number, motion.name, &[motion.kind, key]);
                // The same task after an event that leaves it as it was.
                if !found.iter().any(|f| f.key == Finding::new(&key, String::new(), String::new()).key) {
                    found.push(Finding::new(&key, message, help));
                }
            }
        }
    }
    found
}
