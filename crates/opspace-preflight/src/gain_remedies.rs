//! Remedies for a small gain margin. Each is tried with a nudge; only those that help are proposed.

use super::changed::{alternatives, with_task, with_transformer};
use super::diagnostic::{at_least, at_most, short};
use opspace_backend::quantity::NonNegative;
use opspace_control::{AxisMode, PerAxis, PerJoint, TaskParameters};
use opspace_experiment::run::experiment::Experiment;
use opspace_transformer::{Gears, TransformerName};

/// Dampings of compliant axes that are tried, 1/s.
const COMPLIANT_PER_S: [f64; 4] = [4.0, 8.0, 16.0, 32.0];

/// Multiples of the damping ratio of a posture that are tried.
const RATIOS: [f64; 3] = [2.0, 4.0, 8.0];

/// Fractions of the present friction compensation that are tried.
const OF_FRICTION: [f64; 4] = [0.9, 0.8, 0.5, 0.2];

/// Describes the remedies that help; empty without any. `missing` is the excess that the margin lacks.
pub(super) fn help(
    experiment: &Experiment,
    transformer: &str,
    joint: &str,
    missing: f64,
    helps: &dyn Fn(&Experiment) -> bool,
) -> String {
    let mut found: Vec<String> = Vec::new();
    found.extend(corrected(experiment, transformer, helps));
    found.extend(less_friction(experiment, helps));
    let named = experiment.task().file.priority.iter();
    found.extend(named.filter_map(|name| more_damping(experiment, name, joint, missing, helps)));
    alternatives(&found)
}

/// Proposes the correction by motor current, if it is measured: on elastic gears that of the extrapolation.
fn corrected(
    experiment: &Experiment,
    transformer: &str,
    helps: &dyn Fn(&Experiment) -> bool,
) -> Option<String> {
    let name = match experiment.robot().gears() {
        Gears::Elastic => TransformerName::EXTRAPOLATION,
        Gears::Rigid if transformer.starts_with("paper") => TransformerName::EMULATION,
        Gears::Rigid => TransformerName::from(transformer.to_owned()),
    };
    let name = name.with_current(true);
    if !experiment.measures_current() || name.as_str() == transformer {
        return None;
    }
    let changed = with_transformer(experiment, &name)?;
    let profile = experiment.profile().0;
    helps(&changed).then(|| {
        format!(
            "write profile.{profile}.transformer = \"{name}\", which corrects wrong gains by measured motor current"
        )
    })
}

/// Proposes less friction compensation, as little less as helps.
fn less_friction(experiment: &Experiment, helps: &dyn Fn(&Experiment) -> bool) -> Option<String> {
    let present = experiment.task().file.friction_compensation.gain.get();
    OF_FRICTION.iter().find_map(|fraction| {
        let text = at_most(fraction * present);
        let lower: NonNegative = text.parse::<f64>().ok()?.try_into().ok()?;
        let changed = with_task(experiment, |file| file.friction_compensation.gain = lower)?;
        helps(&changed).then(|| format!("set `friction_compensation.gain = {text}`"))
    })
}

/// Proposes more damping of a task.
fn more_damping(
    experiment: &Experiment,
    name: &str,
    joint: &str,
    missing: f64,
    helps: &dyn Fn(&Experiment) -> bool,
) -> Option<String> {
    let with = |change: &dyn Fn(&mut TaskParameters) -> Option<()>| {
        let changed = with_task(experiment, |file| {
            file.task.get_mut(name).and_then(change);
        })?;
        helps(&changed).then_some(())
    };
    match experiment.task().file.task.get(name)? {
        TaskParameters::Cartesian(task) if task.axes.with_mode(AxisMode::Compliant).contains(&true) => {
            COMPLIANT_PER_S.into_iter().find_map(|per_s| {
                let damping = NonNegative::try_from(per_s).ok()?;
                with(&|task| match task {
                    TaskParameters::Cartesian(task) => {
                        task.compliant_damping_per_s = Some(PerAxis::All(damping));
                        Some(())
                    }
                    _ => None,
                })?;
                Some(format!("set `task.{name}.cartesian.compliant_damping_per_s = {}`", short(per_s)))
            })
        }
        TaskParameters::JointPosture(task) => {
            let PerJoint::All(present) = task.damping_ratio else { return None };
            RATIOS.into_iter().find_map(|times| {
                let ratio = NonNegative::try_from(times * present.get()).ok()?;
                with(&|task| match task {
                    TaskParameters::JointPosture(task) => {
                        task.damping_ratio = PerJoint::All(ratio);
                        Some(())
                    }
                    _ => None,
                })?;
                Some(format!("set `task.{name}.joint-posture.damping_ratio = {}`", short(ratio.get())))
            })
        }
        TaskParameters::JointDamping(task) => {
            let PerJoint::All(present) = task.damping_nms_per_rad else { return None };
            let place = experiment.robot().model.joint(joint).ok()?;
            // A servo without damping is damped by the friction of its joint.
            let kv = match experiment.servo_gains().ok()?.get(place)?.damping {
                0.0 => experiment.robot().joints().get(place)?.friction.viscous_nms_per_rad.get(),
                kv => kv,
            };
            let text = at_least(present.get() + missing * kv);
            let damping: NonNegative = text.parse::<f64>().ok()?.try_into().ok()?;
            with(&|task| match task {
                TaskParameters::JointDamping(task) => {
                    task.damping_nms_per_rad = PerJoint::All(damping);
                    Some(())
                }
                _ => None,
            })?;
            Some(format!("set `task.{name}.joint-damping.damping_nms_per_rad = {text}`"))
        }
        _ => None,
    }
}
