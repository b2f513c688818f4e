//! `[simulated]` in robot.toml: where the simulated robot differs from, or goes beyond, what is believed
//! of it. The controller never sees any of this.

use crate::bus::BusParameters;
use opspace_backend::quantity::{NonNegative, Positive};
use opspace_transformer::{FrictionParameters, ServoParameters, VelocityServo};
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;

/// The plant behind the interface.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SimulatedParameters {
    /// Steps of the rigid-body integrator, Hz: a whole multiple of every profile's `servo_hz`.
    pub physics_hz: Positive,
    /// Bandwidth of the motors' first-order current loop, Hz; without it the motor follows at once.
    pub current_loop_hz: Option<Positive>,
    /// Noise of the measured motor torque, rms, Nm.
    #[serde(default)]
    pub torque_noise_nm: NonNegative,
    /// Whether positions are read to a whole encoder count.
    #[serde(default = "yes")]
    pub encoder_quantisation: bool,
    /// Whether the drives' torque limits hold.
    #[serde(default = "yes")]
    pub torque_saturation: bool,
    /// The bristles of the friction model.
    pub bristle: BristleParameters,
    /// The stops at the ends of the joints' ranges.
    pub end_stop: EndStopParameters,
    /// The torque robot's brakes.
    pub brake: BrakeParameters,
    /// How well each force sensor measures, by its name.
    #[serde(default)]
    pub force_sensor: BTreeMap<String, ForceSensorParameters>,
    /// Truth over belief.
    #[serde(default)]
    pub scale: ScaleParameters,
    /// What the field bus loses and delays; nothing if absent.
    #[serde(default)]
    pub bus: BusParameters,
    /// True position servos, by joint name, where they aren't the nominal ones; `scale` is of these.
    #[serde(default)]
    pub servo: BTreeMap<String, ServoParameters>,
    /// True velocity servos, by joint name, where they aren't the nominal ones; `scale` is of these.
    #[serde(default)]
    pub velocity_servo: BTreeMap<String, VelocityServo>,
    /// True friction, by joint name, where it isn't the believed one; `scale` is of this.
    #[serde(default)]
    pub friction: BTreeMap<String, FrictionParameters>,
    /// True delay of set-points in servo ticks, at most `ratio`, where it isn't the believed one; 0 if neither is
    /// given.
    #[serde(default)]
    pub delay_servo_ticks: Option<u32>,
}

const fn yes() -> bool {
    true
}

/// LuGre bristles: how friction builds up before the joint slides.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BristleParameters {
    /// σ₀, Nm/rad.
    pub stiffness_nm_per_rad: Positive,
    /// σ₁ at rest, Nms/rad.
    pub damping_nms_per_rad: NonNegative,
    /// Speed over which σ₁ fades, rad/s.
    pub damping_fades_over_rad_per_s: Positive,
}

/// A spring and a damper beyond each joint limit of the URDF.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EndStopParameters {
    /// Nm/rad.
    pub stiffness_nm_per_rad: Positive,
    /// Nms/rad, while in the stop.
    pub damping_nms_per_rad: NonNegative,
}

/// A brake: a spring and a damper to where the joint stood when it fell in, slipping at its torque.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BrakeParameters {
    /// Torque at which it slips, as a multiple of the joint's torque limit.
    pub slips_at_torque_limits: Positive,
    /// Nm/rad.
    pub stiffness_nm_per_rad: Positive,
    /// Nms/rad.
    pub damping_nms_per_rad: NonNegative,
}

/// A six-axis force sensor.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ForceSensorParameters {
    /// Bandwidth of its first-order filter, Hz.
    pub bandwidth_hz: Positive,
    /// Noise of each force, rms, N.
    pub noise_n: NonNegative,
    /// Noise of each moment, rms, Nm.
    pub noise_nm: NonNegative,
    /// Constant error of each force, up to, N.
    pub bias_n: NonNegative,
    /// Constant error of each moment, up to, Nm.
    pub bias_nm: NonNegative,
}

/// The true value over the believed one.
#[derive(Clone, Debug, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScaleParameters {
    /// Of the position loops' gains.
    #[serde(default = "one")]
    pub kp: Positive,
    /// Of the velocity loops' gains.
    #[serde(default = "one")]
    pub kv: Positive,
    /// Of Coulomb, static and viscous friction; 0 is a robot without friction.
    #[serde(default = "one_or_none")]
    pub friction: NonNegative,
    /// Of all masses and inertias.
    #[serde(default = "one")]
    pub inertia: Positive,
}

const fn one() -> Positive {
    Positive::literal(1.0)
}

const fn one_or_none() -> NonNegative {
    NonNegative::literal(1.0)
}

impl Default for ScaleParameters {
    fn default() -> Self {
        Self { kp: one(), kv: one(), friction: one_or_none(), inertia: one() }
    }
}
