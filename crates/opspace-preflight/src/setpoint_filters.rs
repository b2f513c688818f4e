//! Filters of setpoints that are too slow for the torque.
//!
//! A transformer that evaluates the servo's law inverts the filter. The slower the filter, the larger the setpoints that a change of
//! torque needs: with the setpoints g_k after a desired torque of 1 in one cycle, at a joint at rest, torque errors that differ
//! from cycle to cycle with the rms value σ let setpoints step by
//!
//! ```text
//! step = σ √Σ (g_k − g_{k−1})²     (rms)
//! ```
//!
//! σ is a multiple of that of the encoder's resolution (see `torque_floor`). Setpoints step no further than the joint's speed limit allows in
//! a period: beyond, the torque is not the desired one.
//!
//! A transformer that does not invert the filter leaves its lag t: at the velocity q̇ the torque is wrong by K t q̇.

use super::diagnostic::{at_least, short};
use super::torque_floor::floors;
use opspace_backend::{CommandKind, Sample};
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::experiment::Experiment;
use opspace_model::{Data, update};
use opspace_transformer::impulse_response::ImpulseResponse;
use opspace_transformer::moving_joint::MovingJoint;
use opspace_transformer::{ServoLaw, VelocityEstimator};

/// Multiple of the rms step that setpoints must be able to make. Torque errors of other causes, such as friction and the noise of motor
/// current, are some three times those of the encoder's resolution.
const STEPS: f64 = 9.0;

/// Share of the speed limit of a joint at which the torque error of a lag is computed.
const SPEED: f64 = 0.1;

/// Largest torque error of a lag that is not reported, as a share of the torque limit.
const LARGEST_ERROR: f64 = 0.1;

/// Reports the joint whose filter is the slowest, if it is too slow.
pub(crate) fn slow(experiment: &Experiment) -> Option<Finding> {
    if experiment.command_kind() != CommandKind::Position {
        return None;
    }
    let traits = experiment.transformer_traits()?;
    if traits.evaluates_servo_law { inverted(experiment) } else { ignored(experiment) }
}

/// Key of the servo of a joint in the robot file.
fn key<'a>(experiment: &'a Experiment, joint: &'a str) -> [&'a str; 4] {
    ["profile", experiment.profile().0, "servo", joint]
}

/// Filter that a transformer inverts, if its setpoints would be clamped.
fn inverted(experiment: &Experiment) -> Option<Finding> {
    let (servos, timing) = (experiment.servos().ok()?, experiment.drive_timing());
    let (floors, mut transformer) = (floors(experiment)?, experiment.transformer().ok()?);
    let (model, start) = (&experiment.robot().model, experiment.start().ok()?);
    let mut data = Data::new(model);
    if !update(model, &mut data, &start, &vec![0.0; model.n()]) {
        return None;
    }
    let filtered = (0..model.n()).filter(|&joint| servos[joint].setpoint_filter().is_some());
    let steps = filtered.filter_map(|joint| {
        let law = ServoLaw::new(&servos[joint], timing.servo_period_s).ok()?;
        let velocity =
            VelocityEstimator::new(model.n(), &experiment.profile().1.estimator, timing.period_s());
        let sample = Sample::new(&experiment.capabilities());
        let mut arm = MovingJoint::new(&mut *transformer, &data, joint, velocity, sample);
        let response = ImpulseResponse::new(&mut arm, law, timing).setpoint;
        let first = response.first()?.powi(2);
        let squares = first + response.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum::<f64>();
        let step = floors[joint].floor_nm * squares.sqrt();
        let allowed = model.joints()[joint].limits.velocity * timing.period_s();
        Some((joint, STEPS * step, allowed))
    });
    let worst = steps.filter(|(_, step, allowed)| step > allowed);
    let (joint, step, allowed) = worst.max_by(|a, b| (a.1 / a.2).total_cmp(&(b.1 / b.2)))?;
    let joint = &model.joints()[joint].name;
    let message = format!(
        "the filter of the setpoints of joint '{joint}' is slow: to invert it, setpoints step by some {} rad (m) in a cycle, to correct \
         small torque errors; the joint's speed limit allows {}, and the torque is wrong beyond",
        short(step),
        short(allowed),
    );
    let help = format!(
        "make the filter {} times as fast (a higher cut-off frequency, a shorter look-ahead or smoothing time) in drives and file, or \
         use a finer encoder",
        at_least(step / allowed)
    );
    Some(Finding::new(Code::SlowSetpointFilter, &key(experiment, joint), message, help).of_robot())
}

/// Filter that the transformer does not invert, if its lag causes a large torque error.
fn ignored(experiment: &Experiment) -> Option<Finding> {
    let (servos, gains) = (experiment.servos().ok()?, experiment.servo_gains().ok()?);
    let (robot, limits) = (experiment.robot(), experiment.robot().torque_limits());
    let joints = robot.model.joints().iter().enumerate().filter_map(|(i, joint)| {
        let lag_s = servos[i].setpoint_filter_lag_s();
        let speed = SPEED * joint.limits.velocity;
        let error = gains[i].stiffness * lag_s * speed;
        (error > LARGEST_ERROR * limits[i]).then_some((error / limits[i], &joint.name, lag_s, speed, error))
    });
    let (share, joint, lag_s, speed, error) = joints.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let message = format!(
        "transformer '{}' does not invert the filter of the setpoints of joint '{joint}', which lags by {} ms: at {} rad/s (m/s) the torque is \
         wrong by {} Nm (N), {} % of its limit",
        experiment.transformer_name()?,
        short(1e3 * lag_s),
        short(speed),
        short(error),
        short(100.0 * share),
    );
    let help = format!(
        "use a transformer that evaluates the servo's law (`--transformer extrapolation`), or make the filter of the drives {} times as fast",
        at_least(share / LARGEST_ERROR)
    );
    Some(Finding::new(Code::SlowSetpointFilter, &key(experiment, joint), message, help).of_robot())
}
