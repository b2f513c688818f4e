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

use super::diagnostic::{at_least, at_most, short};
use opspace_backend::Setpoints;
use opspace_backend::quantity::Positive;
use opspace_experiment::codes::Code;
use opspace_experiment::finding::Finding;
use opspace_experiment::run::experiment::Experiment;
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
    /// Frequency up to which this amplitude is a tenth of the torque limit, Hz; `None` without limits of setpoints.
    pub bandwidth_hz: Option<f64>,
}

/// Amplitude of the torque whose bandwidth is stated, as a share of the torque limit.
const BANDWIDTH_SHARE: f64 = 0.1;

/// Bandwidth below which the limits of setpoints are reported, Hz: that of a task with 30 rad/s.
const LEAST_BANDWIDTH_HZ: f64 = 5.0;

/// Torque error by a resolution that is reported, as a share of the torque limit.
const COARSE: f64 = 0.05;

/// Frequencies between which a bandwidth is searched, Hz.
const SEARCHED_HZ: [f64; 2] = [1e-2, 1e4];

/// Halvings of that range.
const BISECTIONS: u32 = 40;

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
            let amplitudes = |limits| TORQUE_HZ.map(|hz| amplitude(experiment, &law, limits, hz));
            let least = BANDWIDTH_SHARE * drive.torque_limit_nm.get();
            let is_reached = |limits, hz| amplitude(experiment, &law, limits, hz) >= least;
            Some(JointFloor {
                joint: joint.name.clone(),
                floor_nm: gains[i].damping * drive.rotor.resolution_rad()
                    / (12.0_f64.sqrt() * profile.period_s()),
                setpoint_floor_nm: gains[i].stiffness
                    * drive.setpoint_resolution_rad.map_or(0.0, Positive::get)
                    / 12.0_f64.sqrt(),
                torque_limit_nm: drive.torque_limit_nm.get(),
                within_setpoint_limits_nm: limits.map(amplitudes),
                bandwidth_hz: limits.map(|limits| last_hz(|hz| is_reached(limits, hz))),
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

/// Last frequency at which a condition holds that holds up to there, Hz.
fn last_hz(holds: impl Fn(f64) -> bool) -> f64 {
    let [mut low, mut high] = SEARCHED_HZ;
    for _ in 0..BISECTIONS {
        let middle = (low * high).sqrt();
        if holds(middle) { low = middle } else { high = middle }
    }
    low
}

/// Finds the joint whose encoder, and the one whose setpoints, are so coarse that their torque error is a noticeable share of the torque
/// limit.
pub(crate) fn coarse(experiment: &Experiment) -> Vec<Finding> {
    let Some(floors) = floors(experiment) else { return Vec::new() };
    let worst = |of: fn(&JointFloor) -> f64| {
        let shares = floors.iter().map(|floor| (floor, of(floor) / floor.torque_limit_nm));
        shares.filter(|(_, share)| *share > COARSE).max_by(|a, b| a.1.total_cmp(&b.1))
    };
    let percent = |share: f64| format!("{} % of its torque limit", short(100.0 * share));
    let drive = |joint: &str| experiment.robot().file.joint.get(joint);
    let encoder = worst(|floor| floor.floor_nm).map(|(floor, share)| {
        let message = format!(
            "the encoder of joint '{}' is coarse: each cycle its resolution causes a torque error of {} Nm (N) rms, {}",
            floor.joint,
            short(floor.floor_nm),
            percent(share),
        );
        let counts = drive(&floor.joint).map_or(0.0, |drive| f64::from(drive.rotor.encoder_counts_per_turn.get()));
        let help = format!(
            "check gear_ratio and encoder_counts_per_turn, which are per turn of the motor: {} counts are fine enough; otherwise use a longer \
             period, or softer drives",
            (counts * share / COARSE).ceil()
        );
        let key = ["joint", &floor.joint, "rotor", "encoder_counts_per_turn"];
        Finding::new(Code::CoarseEncoder, &key, message, help).of_robot()
    });
    let setpoints = worst(|floor| floor.setpoint_floor_nm).map(|(floor, share)| {
        let message = format!(
            "the setpoints of joint '{}' are coarse: their resolution causes a torque error of {} Nm (N) rms, {}",
            floor.joint,
            short(floor.setpoint_floor_nm),
            percent(share),
        );
        let resolution =
            drive(&floor.joint).and_then(|drive| drive.setpoint_resolution_rad).map_or(0.0, Positive::get);
        let help = format!(
            "check setpoint_resolution_rad: {} is fine enough; otherwise use an interface with finer setpoints, or softer drives",
            at_most(resolution * COARSE / share)
        );
        let key = ["joint", &floor.joint, "setpoint_resolution_rad"];
        Finding::new(Code::CoarseSetpoints, &key, message, help).of_robot()
    });
    encoder.into_iter().chain(setpoints).collect()
}

/// Finds limits of setpoints that leave a small bandwidth to the torque.
pub(crate) fn narrow_limits(experiment: &Experiment) -> Option<Finding> {
    let floors = floors(experiment)?;
    let of = |floor: &'_ JointFloor| floor.bandwidth_hz.unwrap_or(f64::INFINITY);
    let (place, worst) = floors.iter().enumerate().min_by(|(_, a), (_, b)| of(a).total_cmp(&of(b)))?;
    let bandwidth_hz = worst.bandwidth_hz.filter(|hz| *hz < LEAST_BANDWIDTH_HZ)?;
    let (profile_name, profile) = experiment.profile();
    let limits = profile.setpoint_limits.as_ref()?.joint.get(&worst.joint)?;
    let law = ServoLaw::new(&experiment.servos().ok()?[place], profile.servo_period_s()).ok()?;
    let needed = BANDWIDTH_SHARE * worst.torque_limit_nm;
    let only = |velocity, acceleration, jerk| {
        let mut one = JointSetpointLimits::default();
        (one.velocity_rad_per_s, one.acceleration_rad_per_s2, one.jerk_rad_per_s3) =
            (velocity, acceleration, jerk);
        one
    };
    let each = [
        ("velocity_rad_per_s", limits.velocity_rad_per_s, only(limits.velocity_rad_per_s, None, None)),
        (
            "acceleration_rad_per_s2",
            limits.acceleration_rad_per_s2,
            only(None, limits.acceleration_rad_per_s2, None),
        ),
        ("jerk_rad_per_s3", limits.jerk_rad_per_s3, only(None, None, limits.jerk_rad_per_s3)),
    ];
    let raised = each.into_iter().filter_map(|(key, limit, alone)| {
        let left = amplitude(experiment, &law, &alone, LEAST_BANDWIDTH_HZ);
        (left < needed).then(|| Some(format!("{key} = {}", at_least(limit?.get() * needed / left))))?
    });
    let raised: Vec<String> = raised.collect();
    let message = format!(
        "limits of setpoints leave joint '{}' a torque bandwidth of {} Hz, for a tenth of its torque limit while it is held: \
         faster torques are not produced, and the joint is as stiff as its servo",
        worst.joint,
        short(bandwidth_hz),
    );
    let help = format!(
        "if the drives allow it, raise the limits in drives and file: {} for {} Hz",
        raised.join(", "),
        short(LEAST_BANDWIDTH_HZ),
    );
    let key = ["profile", profile_name, "setpoint_limits", "joint", &worst.joint];
    Some(Finding::new(Code::NarrowSetpointLimits, &key, message, help).of_robot())
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
