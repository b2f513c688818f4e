//! Parameters `[simulated]` of robot.toml: differences of the simulated robot from its nominal parameters, and further
//! parameters of the plant. The controller doesn't know them.

use crate::bus::BusParameters;
use opspace_backend::quantity::{Count, Fraction, NonNegative, Positive, exactly};
use opspace_transformer::{FrictionParameters, ServoParameters, VelocityServo};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Parameters of the simulated plant, drives, sensors and bus.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SimulatedParameters {
    /// Rate of the rigid-body integrator, Hz: a whole multiple of every profile's `servo_hz`.
    #[cfg_attr(feature = "schema", schemars(with = "Option<Positive>", extend("x-default" = "the smallest from 10 kHz")))]
    pub physics_hz: Positive,
    /// Bandwidth of the motors' first-order current loop, Hz; no lag if absent.
    pub current_loop_hz: Option<Positive>,
    /// Rms noise of the measured motor torque, Nm (N).
    #[serde(default)]
    pub torque_noise_nm: NonNegative,
    /// True if positions are rounded to whole encoder counts.
    #[serde(default = "yes")]
    pub encoder_quantisation: bool,
    /// True if the drives' torque limits are active.
    #[serde(default = "yes")]
    pub torque_saturation: bool,
    /// Bristles of the friction model. By default those of each joint have the stiffness static_nm/presliding_rad of its
    /// friction, and this stiffness times 5 ms as damping, which decreases over 0.1 rad/s (m/s).
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "computed")))]
    pub bristle: Option<BristleParameters>,
    /// End stops at the joints' position limits. By default the torque limit of a joint compresses its stop by 0.01 rad
    /// (m); the damping is the stiffness times 10 ms.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "computed")))]
    pub end_stop: Option<EndStopParameters>,
    /// Brakes of the joints. By default a brake slips at 1.5 times the torque limit of its joint, after 0.01 rad (m); the
    /// damping is the stiffness times 5 ms.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "computed")))]
    pub brake: Option<BrakeParameters>,
    /// Measurement errors of each force sensor, by sensor name.
    #[serde(default)]
    pub force_sensor: BTreeMap<String, ForceSensorParameters>,
    /// Ratios of true to nominal values.
    #[serde(default)]
    pub true_over_nominal: ScaleParameters,
    /// Losses and delays of the field bus.
    #[serde(default)]
    pub bus: BusParameters,
    /// True position servos, by joint name, if they differ from the nominal ones; `true_over_nominal` applies to them.
    #[serde(default)]
    pub servo: BTreeMap<String, ServoParameters>,
    /// True velocity servos, by joint name, if they differ from the nominal ones; `true_over_nominal` applies to them.
    #[serde(default)]
    pub velocity_servo: BTreeMap<String, VelocityServo>,
    /// True friction, by joint name, if it differs from the nominal one; `true_over_nominal` applies to it.
    #[serde(default)]
    pub friction: BTreeMap<String, FrictionParameters>,
    /// Coulomb friction of each joint per torque of its motor, in addition to `friction`: that of gears whose teeth carry the load.
    #[serde(default)]
    pub friction_per_load: NonNegative,
    /// Elastic gears, by joint name; the others are rigid, unless `joint.NAME.gear_stiffness_nm_per_rad` states a stiffness.
    #[serde(default)]
    pub gear: BTreeMap<String, GearParameters>,
    /// Cogging of all motors; none if absent.
    pub cogging: Option<CoggingParameters>,
    /// Ripple of the torque of all motors; none if absent.
    pub torque_ripple: Option<TorqueRippleParameters>,
    /// Errors of the measured motor torques in addition to `torque_noise_nm`.
    #[serde(default)]
    pub current_measurement: CurrentMeasurementParameters,
    /// Errors of the measured joint torques.
    #[serde(default)]
    pub joint_torque_measurement: TorqueMeasurementParameters,
    /// Loads of the true arm that its model does not have, by name.
    #[serde(default)]
    pub payload: BTreeMap<String, PayloadParameters>,
    /// Encoders that drives and interface read.
    #[serde(default)]
    pub encoder: EncoderParameters,
    /// True delay of setpoints in servo ticks, at most 32 interface cycles.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the nominal one")))]
    pub delay_servo_ticks: Option<u32>,
}

const fn yes() -> bool {
    true
}

/// Deflection of a default end stop under the torque limit, and of a default brake that slips, rad (m).
const DEFLECTION: f64 = 0.01;

/// Speed over which the damping of default bristles decreases, rad/s (m/s).
const DAMPING_FADE: Positive = Positive::literal(0.1);

/// Holding torque of a default brake over the torque limit.
const HOLDING_RATIO: Positive = Positive::literal(1.5);

/// Damping over stiffness of default bristles and brakes, s.
const DAMPING_S: f64 = 0.005;

/// Damping over stiffness of default end stops, s.
const END_STOP_S: f64 = 0.01;

impl SimulatedParameters {
    /// Bristles of a joint with this true friction.
    #[must_use]
    pub fn bristle_of(&self, friction: &FrictionParameters) -> BristleParameters {
        self.bristle.clone().unwrap_or_else(|| {
            // Without friction, bristles have no effect.
            let stiffness = positive(friction.static_nm.get() / friction.presliding_rad.get());
            BristleParameters {
                stiffness_nm_per_rad: stiffness,
                damping_nms_per_rad: times(stiffness, DAMPING_S),
                damping_fade_velocity_rad_per_s: DAMPING_FADE,
            }
        })
    }

    /// End stops of a joint with this torque limit (Nm, N).
    #[must_use]
    pub fn end_stop_of(&self, torque_limit: f64) -> EndStopParameters {
        self.end_stop.clone().unwrap_or_else(|| {
            let stiffness = positive(torque_limit / DEFLECTION);
            EndStopParameters {
                stiffness_nm_per_rad: stiffness,
                damping_nms_per_rad: times(stiffness, END_STOP_S),
            }
        })
    }

    /// Brake of a joint with this torque limit (Nm, N).
    #[must_use]
    pub fn brake_of(&self, torque_limit: f64) -> BrakeParameters {
        self.brake.clone().unwrap_or_else(|| {
            let stiffness = positive(HOLDING_RATIO.get() * torque_limit / DEFLECTION);
            BrakeParameters {
                holding_torque_ratio: HOLDING_RATIO,
                stiffness_nm_per_rad: stiffness,
                damping_nms_per_rad: times(stiffness, DAMPING_S),
            }
        })
    }
}

fn positive(value: f64) -> Positive {
    Positive::try_from(value).unwrap_or(Positive::literal(1.0))
}

fn times(stiffness: Positive, seconds: f64) -> NonNegative {
    NonNegative::try_from(stiffness.get() * seconds).unwrap_or_default()
}

/// Bristles of the LuGre model, which describe presliding friction.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct BristleParameters {
    /// Stiffness σ₀, Nm/rad (N/m).
    pub stiffness_nm_per_rad: Positive,
    /// Damping σ₁ at rest, Nms/rad (Ns/m).
    pub damping_nms_per_rad: NonNegative,
    /// Speed over which σ₁ decreases, rad/s (m/s).
    pub damping_fade_velocity_rad_per_s: Positive,
}

/// Spring and damper beyond each position limit of the URDF.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EndStopParameters {
    /// Stiffness, Nm/rad (N/m).
    pub stiffness_nm_per_rad: Positive,
    /// Damping while in the stop, Nms/rad (Ns/m).
    pub damping_nms_per_rad: NonNegative,
}

/// Brake: a spring and a damper to the position at which it was engaged; it slips above its holding torque.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct BrakeParameters {
    /// Torque at which it slips, as a multiple of the joint's torque limit.
    pub holding_torque_ratio: Positive,
    /// Stiffness, Nm/rad (N/m).
    pub stiffness_nm_per_rad: Positive,
    /// Damping, Nms/rad (Ns/m).
    pub damping_nms_per_rad: NonNegative,
}

/// Elastic gear between the rotor of a motor and its link.
#[derive(Clone, Debug, Default, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct GearParameters {
    /// Stiffness, Nm/rad (N/m). That of the joint is `gear_stiffness_nm_per_rad`; `true_over_nominal.gear_stiffness`
    /// multiplies both.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the joint")))]
    pub stiffness_nm_per_rad: Option<Positive>,
    /// Damping of the twist, Nms/rad (Ns/m).
    #[serde(default)]
    pub damping_nms_per_rad: NonNegative,
    /// Free play of the link while the rotor is at rest, from end to end, rad (m).
    #[serde(default)]
    pub backlash_rad: NonNegative,
}

/// Cogging: a torque at the joint that is a sine of the motor's angle. The motor current does not show it.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct CoggingParameters {
    /// Amplitude as a fraction of the joint's torque limit.
    pub amplitude_of_limit: Fraction,
    /// Periods per turn of the motor.
    pub periods_per_motor_turn: Count,
}

/// Torque ripple: a sine of the motor's angle that multiplies the motor's torque. The motor current does not show it.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct TorqueRippleParameters {
    /// Amplitude as a fraction of the motor's torque.
    pub amplitude: Fraction,
    /// Periods per turn of the motor.
    pub periods_per_motor_turn: Count,
}

/// Errors of the motor torques that the interface reports.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct CurrentMeasurementParameters {
    /// Measured over true torque, of all joints.
    pub scale: Positive,
    /// Measured over true torque of single joints, by joint name; multiplied by `scale`.
    pub joint_scale: BTreeMap<String, Positive>,
    /// Lateness of the measured torques, in servo ticks.
    pub delay_servo_ticks: u32,
}

impl Default for CurrentMeasurementParameters {
    fn default() -> Self {
        Self { scale: Positive::literal(1.0), joint_scale: BTreeMap::new(), delay_servo_ticks: 0 }
    }
}

/// Errors of the joints' torque sensors.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct TorqueMeasurementParameters {
    /// Measured over true torque, of all joints.
    pub scale: Positive,
    /// Measured torque at a torque of zero, by joint name, Nm (N); 0 for joints that are absent.
    pub offset_nm: BTreeMap<String, f64>,
    /// Rms noise, Nm (N).
    pub noise_nm: NonNegative,
    /// Lateness of the measured torques, in servo ticks.
    pub delay_servo_ticks: u32,
}

impl Default for TorqueMeasurementParameters {
    fn default() -> Self {
        Self {
            scale: Positive::literal(1.0),
            offset_nm: BTreeMap::new(),
            noise_nm: NonNegative::literal(0.0),
            delay_servo_ticks: 0,
        }
    }
}

/// Load on the true arm that its model does not have: a point mass.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PayloadParameters {
    /// Link of the URDF, or tool, that carries it.
    pub frame: String,
    /// Mass, kg.
    pub mass_kg: NonNegative,
    /// Position in the axes of the frame, m.
    #[serde(default, deserialize_with = "exactly")]
    pub centre_m: [f64; 3],
}

/// Encoders of all joints: on the rotor, whose position counts at the joint, or on the link.
#[derive(Clone, Debug, Default, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct EncoderParameters {
    /// Encoder on which the drives close their loops.
    #[serde(default)]
    pub drive: EncoderSide,
    /// Encoder that the interface reports.
    #[serde(default)]
    pub interface: EncoderSide,
    /// Counts per turn of the encoders on the links.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "those at the rotors, times the gear ratio")))]
    pub link_counts_per_turn: Option<Count>,
}

/// Side of the gear on which an encoder is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum EncoderSide {
    /// Rotor of the motor.
    #[default]
    Motor,
    /// Link.
    Link,
}

/// Six-axis force sensor.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ForceSensorParameters {
    /// Bandwidth of its first-order filter, Hz.
    pub bandwidth_hz: Positive,
    /// Rms noise of each force component, N.
    pub noise_n: NonNegative,
    /// Rms noise of each moment component, Nm.
    pub noise_nm: NonNegative,
    /// Largest constant error of each force component, N.
    pub bias_n: NonNegative,
    /// Largest constant error of each moment component, Nm.
    pub bias_nm: NonNegative,
    /// Largest rate at which the error of each force component grows, N/s.
    #[serde(default)]
    pub drift_n_per_s: NonNegative,
    /// Largest rate at which the error of each moment component grows, Nm/s.
    #[serde(default)]
    pub drift_nm_per_s: NonNegative,
    /// Part of the arm beyond the sensor, whose weight and inertia it reads; by default the links and tools beyond it. The part is
    /// one that the model or a payload has there: this table adds no mass to the arm.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the links and tools beyond")))]
    pub load: Option<SensorLoadParameters>,
}

/// Part of the arm beyond a force sensor, a point mass.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SensorLoadParameters {
    /// Mass, kg.
    pub mass_kg: Positive,
    /// Centre of mass in the axes of the sensor, m.
    #[serde(deserialize_with = "exactly")]
    pub centre_m: [f64; 3],
}

/// Ratios of true to nominal values.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ScaleParameters {
    /// Scale of the position loops' gains.
    pub kp: Positive,
    /// Scale of the velocity loops' gains.
    pub kv: Positive,
    /// Scale of Coulomb, static and viscous friction; 0 means no friction.
    pub friction: NonNegative,
    /// Scale of all masses and inertias.
    pub inertia: Positive,
    /// Scale of the stiffness of all elastic gears.
    pub gear_stiffness: Positive,
}

impl Default for ScaleParameters {
    fn default() -> Self {
        Self {
            kp: Positive::literal(1.0),
            kv: Positive::literal(1.0),
            friction: NonNegative::literal(1.0),
            inertia: Positive::literal(1.0),
            gear_stiffness: Positive::literal(1.0),
        }
    }
}
