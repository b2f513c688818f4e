//! Nominal parameters of a robot's drives: the parts of robot.toml that describe joints and profiles.

use crate::closed_loop_model::ClosedLoopModel;
use crate::estimator::EstimatorParameters;
use crate::friction::FrictionParameters;
use crate::gain_adaptation::GainAdaptationParameters;
#[cfg(feature = "schema")]
use crate::optional_keys::{with_empty_entries, with_optional_keys};
use crate::servo::ServoParameters;
use crate::setpoint_limits::SetpointLimitParameters;
use crate::transformer::TransformerName;
use crate::velocity_servo::VelocityServo;
use opspace_backend::quantity::{Count, NonNegative, Positive};
#[cfg(feature = "schema")]
use schemars::JsonSchema;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::ops::RangeInclusive;

/// Drive of one joint.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(transform = with_optional_keys))]
#[serde(deny_unknown_fields)]
pub struct JointParameters {
    /// Largest torque of the drive at the joint, Nm (N for a prismatic joint).
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "effort of the URDF")))]
    pub torque_limit_nm: Positive,
    /// Largest rate of the commanded torque, Nm/s (N/s).
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the torque limit in 10 ms")))]
    pub torque_rate_limit_nm_per_s: Option<Positive>,
    /// Largest acceleration, also for braking, rad/s² (m/s²). By default joints brake before their position limits with
    /// half of the torque that gravity leaves in the worst of many postures.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "computed")))]
    pub acceleration_limit_rad_per_s2: Option<Positive>,
    /// Largest speed, rad/s (m/s).
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "that of the URDF")))]
    pub velocity_limit_rad_per_s: Option<Positive>,
    /// Resolution of position setpoints, rad (m): the drive rounds each to a multiple of it, as a servo on a serial bus does.
    /// Exact if absent.
    pub setpoint_resolution_rad: Option<Positive>,
    /// Stiffness of the gear between rotor and link, Nm/rad (N/m); rigid, or unknown, if absent. The simulated gear has
    /// it, unless `simulated.gear` has another.
    pub gear_stiffness_nm_per_rad: Option<Positive>,
    /// Rotor and encoder of the motor.
    pub rotor: RotorParameters,
    /// Friction at the joint.
    pub friction: FrictionParameters,
}

/// Rotor and encoder of a joint's motor.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(transform = with_optional_keys))]
#[serde(deny_unknown_fields)]
pub struct RotorParameters {
    /// Inertia of all parts that turn at motor speed, kg m².
    pub inertia_kg_m2: NonNegative,
    /// Motor turns per joint turn.
    pub gear_ratio: Positive,
    /// Encoder counts per motor turn.
    #[serde(default = "default_counts")]
    pub encoder_counts_per_turn: Count,
}

const fn default_counts() -> Count {
    Count::literal(16384)
}

impl RotorParameters {
    /// Inertia reflected to the joint: the gear ratio squared times the rotor's, kg m².
    #[must_use]
    pub fn reflected_inertia(&self) -> f64 {
        self.gear_ratio.get().powi(2) * self.inertia_kg_m2.get()
    }

    /// Resolution of the joint position, one encoder count, rad.
    #[must_use]
    pub fn resolution_rad(&self) -> f64 {
        TAU / (f64::from(self.encoder_counts_per_turn.get()) * self.gear_ratio.get())
    }
}

/// Range of servo rates, Hz. A lower one indicates a mistake in a unit, and its period may be infinite. No position or
/// velocity servo is faster, and the work of checks and simulations grows with the rate.
pub const SERVO_RATES_HZ: RangeInclusive<f64> = 1e-3..=5e4;

/// Drive profile of a robot: rates, servo gains and transformer. A robot may have several profiles.
#[derive(Clone, Debug, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ProfileParameters {
    /// Rate at which the drives close their loops, Hz.
    #[cfg_attr(feature = "schema", schemars(extend("minimum" = SERVO_RATES_HZ.start(), "maximum" = SERVO_RATES_HZ.end())))]
    pub servo_hz: Positive,
    /// Servo ticks per interface cycle: setpoints are accepted and positions measured at
    /// `servo_hz / servo_ticks_per_cycle`.
    #[cfg_attr(feature = "schema", schemars(extend("maximum" = 10_000)))]
    pub servo_ticks_per_cycle: Count,
    /// Delay from the interface cycle at which a command is written until it acts, in servo ticks; at most 32 interface
    /// cycles. The age of measurements counts too: a controller cannot tell it from a delay of commands.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "unknown")))]
    pub delay_servo_ticks: Option<u32>,
    /// Transformer that converts torques to positions or velocities.
    #[cfg_attr(feature = "schema", schemars(extend("x-default" = "the best one for the robot's declared properties")))]
    pub transformer: Option<TransformerName>,
    /// Adaptation of the servo gains from measured motor current during a run; none if absent.
    pub adapt_gains: Option<GainAdaptationParameters>,
    /// Estimator of joint velocity at the interface.
    #[serde(default)]
    pub estimator: EstimatorParameters,
    /// Position servo of each joint, by name of a joint, of a group of joints, or `joint_defaults` for all that state no other;
    /// a value that is absent is that of the group or of all. Only robots that accept positions need it.
    #[serde(default)]
    #[cfg_attr(feature = "schema", schemars(transform = with_empty_entries))]
    pub servo: BTreeMap<String, ServoParameters>,
    /// Velocity servo of each joint, by name as in `servo`, for a robot that accepts velocities; absent otherwise.
    #[serde(default)]
    pub velocity_servo: BTreeMap<String, VelocityServo>,
    /// Limits of the drives on the sequence of setpoints, and their reaction; none if absent.
    pub setpoint_limits: Option<SetpointLimitParameters>,
    /// Measured closed loop of each joint, by joint name, for the `identified` transformers.
    #[serde(default)]
    pub identified: BTreeMap<String, ClosedLoopModel>,
}

impl ProfileParameters {
    /// Time between two servo ticks, s.
    #[must_use]
    pub fn servo_period_s(&self) -> f64 {
        1.0 / self.servo_hz.get()
    }

    /// Delay in servo ticks; 0 if unknown.
    #[must_use]
    pub fn delay(&self) -> u32 {
        self.delay_servo_ticks.unwrap_or(0)
    }

    /// Time between two interface cycles, s.
    #[must_use]
    pub fn period_s(&self) -> f64 {
        f64::from(self.servo_ticks_per_cycle.get()) / self.servo_hz.get()
    }
}
