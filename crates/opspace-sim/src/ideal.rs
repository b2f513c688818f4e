//! Ideal arm, whose drives produce exactly the commanded torques; it needs no robot file.

use crate::config::ArmConfig;
use crate::error::SimulationError;
use crate::parameters::{
    BrakeParameters, BristleParameters, EndStopParameters, ScaleParameters, SimulatedParameters,
};
use opspace_backend::quantity::{Count, NonNegative, Positive};
use opspace_backend::{Capabilities, CommandKind};
use opspace_model::{Model, neutral};
use opspace_transformer::{
    CascadedServo, EstimatorParameters, FrictionParameters, JointParameters, ProfileParameters,
    RotorParameters, ServoParameters,
};
use std::collections::BTreeMap;

/// Servo ticks per interface cycle.
const SERVO_TICKS: Count = Count::literal(5);

/// Physics steps per servo tick.
const PHYSICS_STEPS: f64 = 2.0;

/// Stiffness of brakes and end stops, Nm/rad.
const STIFFNESS: Positive = Positive::literal(5000.0);

/// Damping of brakes and end stops, Nms/rad.
const DAMPING: NonNegative = NonNegative::literal(20.0);

/// Value of parameters that are divisors but have no effect.
const UNUSED: Positive = Positive::literal(1.0);

impl ArmConfig {
    /// Returns an arm without friction, rotor inertia, delay, noise or encoder quantisation. Its motors produce the
    /// commanded torques without lag, up to the effort limits of the URDF; an effort of zero means no limit. It starts
    /// at rest at the neutral position (all zeros) and has no contacts. Change the fields for any other arm.
    ///
    /// `servos` has one servo per joint (n); it may be empty for a torque robot with brakes. Servos run at five times
    /// the interface rate, physics at ten times.
    ///
    /// # Errors
    /// [`SimulationError::Period`] if the period of `capabilities` is not a finite number above zero.
    pub fn ideal(
        model: Model,
        capabilities: Capabilities,
        servos: Vec<ServoParameters>,
    ) -> Result<Self, SimulationError> {
        let period_s = capabilities.period_s;
        let rate = |ticks: f64| {
            Positive::try_from(ticks / period_s).map_err(|_| SimulationError::Period { period_s })
        };
        let servo_ticks = f64::from(SERVO_TICKS.get());
        let (servo_hz, physics_hz) = (rate(servo_ticks)?, rate(servo_ticks * PHYSICS_STEPS)?);
        let needs_none = capabilities.command == CommandKind::Torque && capabilities.has_brakes;
        Ok(Self {
            joints: model.joints().iter().map(|joint| drive(joint.limits.effort)).collect(),
            servos: if needs_none { Self::unused_servos(model.n()) } else { servos },
            profile: profile(servo_hz),
            simulated: plant(physics_hz),
            start: neutral(&model),
            model,
            capabilities,
            environment: Vec::new(),
            capsules: Vec::new(),
            external_forces: false,
            rest_s: 0.0,
            seed: 0,
        })
    }

    /// Placeholder servos for a torque robot with brakes, whose drives use none (n).
    #[must_use]
    pub fn unused_servos(n: usize) -> Vec<ServoParameters> {
        vec![ServoParameters::Cascaded(CascadedServo::new(UNUSED, UNUSED, UNUSED)); n]
    }
}

/// Returns an ideal drive with this torque limit (Nm, N); without a limit if it is zero.
fn drive(effort: f64) -> JointParameters {
    JointParameters {
        torque_limit_nm: Positive::try_from(effort).unwrap_or(Positive::literal(f64::MAX)),
        torque_rate_limit_nm_per_s: None,
        acceleration_limit_rad_per_s2: None,
        velocity_limit_rad_per_s: None,
        setpoint_resolution_rad: None,
        gear_stiffness_nm_per_rad: None,
        rotor: RotorParameters {
            inertia_kg_m2: NonNegative::default(),
            gear_ratio: UNUSED,
            encoder_counts_per_turn: Count::literal(1),
        },
        friction: FrictionParameters {
            coulomb_nm: NonNegative::default(),
            static_nm: NonNegative::default(),
            stribeck_rad_per_s: UNUSED,
            viscous_nms_per_rad: NonNegative::default(),
            presliding_rad: Positive::literal(0.001),
        },
    }
}

fn profile(servo_hz: Positive) -> ProfileParameters {
    ProfileParameters {
        servo_hz,
        servo_ticks_per_cycle: SERVO_TICKS,
        delay_servo_ticks: Some(0),
        transformer: None,
        adapt_gains: None,
        estimator: EstimatorParameters::default(),
        servo: BTreeMap::new(),
        velocity_servo: BTreeMap::new(),
        setpoint_limits: None,
        identified: BTreeMap::new(),
    }
}

fn plant(physics_hz: Positive) -> SimulatedParameters {
    SimulatedParameters {
        physics_hz,
        current_loop_hz: None,
        torque_noise_nm: NonNegative::default(),
        encoder_quantisation: false,
        torque_saturation: true,
        bristle: Some(BristleParameters {
            stiffness_nm_per_rad: UNUSED,
            damping_nms_per_rad: NonNegative::default(),
            damping_fade_velocity_rad_per_s: UNUSED,
        }),
        end_stop: Some(EndStopParameters { stiffness_nm_per_rad: STIFFNESS, damping_nms_per_rad: DAMPING }),
        brake: Some(BrakeParameters {
            holding_torque_ratio: UNUSED,
            stiffness_nm_per_rad: STIFFNESS,
            damping_nms_per_rad: DAMPING,
        }),
        force_sensor: BTreeMap::new(),
        true_over_nominal: ScaleParameters::default(),
        bus: Default::default(),
        servo: BTreeMap::new(),
        velocity_servo: BTreeMap::new(),
        friction: BTreeMap::new(),
        friction_per_load: NonNegative::default(),
        gear: BTreeMap::new(),
        cogging: None,
        torque_ripple: None,
        current_measurement: Default::default(),
        joint_torque_measurement: Default::default(),
        payload: BTreeMap::new(),
        encoder: Default::default(),
        delay_servo_ticks: None,
    }
}
