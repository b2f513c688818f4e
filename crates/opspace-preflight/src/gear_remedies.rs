//! Remedies for an arm that oscillates on elastic gears. Each is tried with a nudge; only those that help are proposed.

use super::changed::{other_transformers, with_task, with_transformer};
use super::diagnostic::short;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_experiment::run::experiment::Experiment;

/// Corner frequency of a friction observer that is proposed, rad/s.
const OBSERVER_RAD_PER_S: Positive = Positive::literal(60.0);

/// Fraction of the present friction compensation, and of the frequencies of the tasks, that is proposed.
const LOWER: f64 = 0.5;

/// Tells if an arm is stable on all gears that it may have, with a fraction of the damping of its tasks.
type IsStable<'a> = &'a dyn Fn(&Experiment, f64) -> bool;

/// Remedies with which the arm is stable.
pub(super) fn that_help(experiment: &Experiment, is_stable: IsStable<'_>) -> Vec<String> {
    let mut found = Vec::new();
    // The first transformer that helps is enough.
    let transformers = other_transformers(experiment);
    let stable =
        |name: &_| with_transformer(experiment, name).is_some_and(|changed| is_stable(&changed, 1.0));
    found.extend(transformers.iter().find(|name| stable(name)).map(|name| format!("use '{name}'")));
    found.extend(friction_observer(experiment, is_stable));
    found.extend(friction_gain(experiment, is_stable));
    if is_stable(experiment, LOWER) {
        found.push(format!("lower the frequencies of the tasks to {LOWER} times their values"));
    }
    found
}

/// Proposes a friction observer, or to omit it. It needs a force sensor.
fn friction_observer(experiment: &Experiment, is_stable: IsStable<'_>) -> Option<String> {
    let present = experiment.task().file.friction_compensation.observer_rad_per_s;
    let other = present.is_none().then_some(OBSERVER_RAD_PER_S);
    if other.is_some() && experiment.robot().file.force_sensor.is_empty() {
        return None;
    }
    let changed = with_task(experiment, |file| file.friction_compensation.observer_rad_per_s = other)?;
    is_stable(&changed, 1.0).then(|| match other {
        Some(corner) => {
            format!("set `friction_compensation.observer_rad_per_s = {}`", short(corner.get()))
        }
        None => "omit `friction_compensation.observer_rad_per_s`".to_owned(),
    })
}

/// Proposes less friction compensation.
fn friction_gain(experiment: &Experiment, is_stable: IsStable<'_>) -> Option<String> {
    let gain = LOWER * experiment.task().file.friction_compensation.gain.get();
    let lower = NonNegative::try_from(gain).ok().filter(|_| gain > 0.0)?;
    let changed = with_task(experiment, |file| file.friction_compensation.gain = lower)?;
    is_stable(&changed, 1.0).then(|| format!("set `friction_compensation.gain = {}`", short(gain)))
}
