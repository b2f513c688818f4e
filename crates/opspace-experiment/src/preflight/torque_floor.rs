//! Torque errors that no transformer can avoid: those of the resolutions of encoders and of setpoints, that of the drives'
//! limits on setpoints, and that of velocity feed-forward with held setpoints.
//!
//! The mean torque of an interface interval of period T contains the difference of two rounded positions, times kv/T. If
//! setpoints act one servo tick after they are sent, the first of the two is known. The rounding of the last one is
//! not, and uniform within the resolution Δ:
//!
//! ```text
//! floor = kv Δ/(√12 T)     (rms)
//! ```
//!
//! With another delay the first is unknown too (a factor of up to √2); the servo's velocity filter lessens the error.
//!
//! A drive that rounds position setpoints to multiples of Δq adds the torque K times the rounding, for as long as it holds
//! the setpoint:
//!
//! ```text
//! floor = K Δq/√12     (rms)
//! ```

use super::diagnostic::short;
use crate::codes::Code;
use crate::finding::Finding;
use crate::run::experiment::Experiment;
use opspace_backend::Setpoints;
use opspace_backend::quantity::Positive;
use opspace_transformer::{JointSetpointLimits, ServoLaw};
use std::f64::consts::TAU;

/// Frequencies for which the torque within setpoint limits is computed, Hz.
pub const TORQUE_HZ: [f64; 5] = [1.0, 5.0, 10.0, 20.0, 50.0];

/// Torque errors of a joint.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct JointFloor {
    /// Name of the joint.
    pub joint: String,
    /// Rms error of the mean torque that the encoder's resolution causes, Nm (N).
    pub floor_nm: f64,
    /// Rms error of the torque that the resolution of position setpoints causes, Nm (N); zero if they are exact.
    pub setpoint_floor_nm: f64,
    /// Torque limit of the drive, Nm (N).
    pub torque_limit_nm: f64,
    /// Largest amplitude (Nm, N) at each of [`TORQUE_HZ`] of the torque on a joint that is held from outside, within the
    /// limits of setpoints; `None` if there are none.
    pub within_setpoint_limits_nm: Option<[f64; 5]>,
}

/// Computes the torque errors of all joints; `None` if commands pass without a transformer.
#[must_use]
pub fn floors(experiment: &Experiment) -> Option<Vec<JointFloor>> {
    experiment.transformer_name()?;
    let (robot, profile) = (experiment.robot(), experiment.profile().1);
    let (servos, gains) = (experiment.servos().ok()?, experiment.servo_gains().ok()?);
    let limits = profile.setpoint_limits.as_ref();
    let joints = robot.joints().into_iter().zip(robot.model.joints()).enumerate();
    joints
        .map(|(i, (drive, joint))| {
            let law = ServoLaw::new(&servos[i], profile.servo_period_s()).ok()?;
            let limits = limits.and_then(|limits| limits.joint.get(&joint.name));
            let amplitude = |limits| TORQUE_HZ.map(|hz| amplitude(experiment, &law, limits, hz));
            Some(JointFloor {
                joint: joint.name.clone(),
                floor_nm: gains[i].damping * drive.rotor.resolution_rad()
                    / (12.0_f64.sqrt() * profile.period_s()),
                setpoint_floor_nm: gains[i].stiffness
                    * drive.setpoint_resolution_rad.map_or(0.0, Positive::get)
                    / 12.0_f64.sqrt(),
                torque_limit_nm: drive.torque_limit_nm.get(),
                within_setpoint_limits_nm: limits.map(amplitude),
            })
        })
        .collect()
}

/// Largest amplitude of a sinusoidal torque (Nm, N) on a held joint within the limits of its setpoints: the response of
/// the servo to setpoints, |K + iωD| with velocity feed-forward, times min(V/ω, a/ω², J/ω³).
fn amplitude(experiment: &Experiment, law: &ServoLaw, limits: &JointSetpointLimits, hz: f64) -> f64 {
    let omega = TAU * hz;
    let period_s = experiment.profile().1.servo_period_s();
    let z = nalgebra::Complex::from_polar(1.0, omega * period_s);
    // The limits of a velocity robot are those of its setpoints and their differences.
    let first = i32::from(experiment.command_kind() == opspace_backend::CommandKind::Position);
    let given = [limits.velocity_rad_per_s, limits.acceleration_rad_per_s2, limits.jerk_rad_per_s3];
    let allowed = (first..)
        .zip(given)
        .map(|(power, limit)| limit.map_or(f64::INFINITY, Positive::get) / omega.powi(power));
    law.response(z)[0].norm() * allowed.fold(f64::INFINITY, f64::min)
}

/// Finds velocity feed-forward with held setpoints whose torque impulse at the speed limit exceeds the torque limit: a
/// setpoint that moves on by v T within one servo tick gives R kv φ v.
pub(crate) fn feed_forward_impulses(experiment: &Experiment) -> Option<Finding> {
    experiment.transformer_name()?;
    let (robot, (profile_name, profile)) = (experiment.robot(), experiment.profile());
    if robot.file.interface.setpoints == Setpoints::Interpolated {
        return None;
    }
    let ratio = f64::from(profile.servo_ticks_per_cycle.get());
    let (servos, gains) = (experiment.servos().ok()?, experiment.servo_gains().ok()?);
    let impulses =
        robot.joints().into_iter().zip(robot.model.joints()).enumerate().map(|(i, (drive, joint))| {
            let speed = joint.limits.velocity;
            let impulse = ratio * servos[i].velocity_feed_forward() * gains[i].damping * speed;
            (impulse, drive.torque_limit_nm.get(), speed, joint.name.as_str())
        });
    let worst = impulses.filter(|(impulse, limit, ..)| impulse > limit);
    let (impulse, limit, speed, joint) = worst.max_by(|a, b| (a.0 / a.1).total_cmp(&(b.0 / b.1)))?;
    let message = format!(
        "velocity feed-forward with held setpoints: at its speed limit of {} rad/s (m/s), each setpoint of joint '{joint}' \
         gives an impulse of {} Nm (N) for one servo tick, beyond the torque limit of {}",
        short(speed),
        short(impulse),
        short(limit),
    );
    let help = "let the drives interpolate (setpoints = \"interpolated\"), or set velocity_feed_forward = 0 in drives and \
                file"
        .to_owned();
    Some(
        Finding::new(Code::FeedForwardImpulse, &["profile", profile_name, "servo", joint], message, help)
            .of_robot(),
    )
}
