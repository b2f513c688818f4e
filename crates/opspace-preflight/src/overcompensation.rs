//! Compensation of more friction than the simulated joints have.

use super::diagnostic::{at_most, short};
use crate::case::PreflightCase;
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_transformer::FrictionParameters;

/// Compensated over true friction above which a joint moves by itself: the smooth compensation stays below its full value.
const OVER: f64 = 1.01;

/// Finds the joint whose friction is compensated by most more than the simulated joint has; `None` with a friction observer, which
/// takes the surplus back.
pub(crate) fn overcompensation(case: &PreflightCase<'_>) -> Option<Finding> {
    let experiment = case.experiment;
    let compensation = &experiment.task().file.friction_compensation;
    if compensation.observer_rad_per_s.is_some() {
        return None;
    }
    let gain = compensation.gain.get();
    let simulated = experiment.robot().file.simulated.as_ref()?;
    let scale = simulated.true_over_nominal.friction.get();
    let coulomb_nm = |friction: &FrictionParameters| friction.coulomb_nm.get();
    let joints = case.model.joints().iter().zip(experiment.robot().joints());
    let compared = joints.filter_map(|(joint, parameters)| {
        let compensated_nm = gain * coulomb_nm(&parameters.friction);
        let true_friction = simulated.friction.get(&joint.name).unwrap_or(&parameters.friction);
        let true_nm = scale * coulomb_nm(true_friction);
        (compensated_nm > OVER * true_nm).then_some((joint.name.as_str(), compensated_nm, true_nm))
    });
    let (joint, compensated_nm, true_nm) = compared.max_by(|a, b| (a.1 / a.2).total_cmp(&(b.1 / b.2)))?;
    let message = format!(
        "{} Nm (N) of friction of joint '{joint}' are compensated, but its simulated friction is {} Nm (N): the surplus drives the \
         joint",
        short(compensated_nm),
        short(true_nm)
    );
    let enough = gain * true_nm / compensated_nm;
    let help = format!(
        "set `friction_compensation.gain = {}`, and correct the friction of robot.toml: a real robot moves by itself as well",
        at_most(enough)
    );
    Some(Finding::new(Code::OvercompensatedFriction, &["friction_compensation", "gain"], message, help))
}
