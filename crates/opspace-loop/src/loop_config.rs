//! Parts of a control loop, and checks that they are compatible.

use crate::collision_detector::{CollisionDetector, CollisionReaction};
use crate::estimated_force::EstimatedForce;
use crate::safety::SafetyParameters;
use crate::sensor_compensation::SensorCompensation;
use opspace_backend::{Capabilities, CommandKind};
use opspace_control::Controller;
use opspace_model::{Model, UnknownFrame};
use opspace_transformer::setpoint_limits::JointSetpointLimits;
use opspace_transformer::{
    EstimatorParameters, FrictionCompensation, FrictionObserver, Identity, ServoGains, Transformer,
};
use thiserror::Error;

/// Parts of a [`ControlLoop`](crate::ControlLoop).
pub struct LoopConfig {
    /// Model of the robot.
    pub model: Model,
    /// Properties of the robot and its interface.
    pub capabilities: Capabilities,
    /// Controller: computes torques, or positions or velocities, from tasks.
    pub controller: Box<dyn Controller>,
    /// Transformer: computes the robot's commands from torques.
    pub transformer: Box<dyn Transformer>,
    /// Equivalent gains of the servos of a position or velocity robot (n); not used for a torque robot.
    pub servo_gains: Vec<ServoGains>,
    /// Velocity estimator, for a robot that measures positions only.
    pub estimator: EstimatorParameters,
    /// Friction compensation n̂, added to the controller's torques.
    pub friction: FrictionCompensation,
    /// Observer of the friction that the compensation leaves, if any. It needs a force sensor: otherwise it would oppose all
    /// contact.
    pub friction_observer: Option<FrictionObserver>,
    /// True if the observer is accepted without a force sensor. It then takes all contact for friction.
    pub unsensed_contact: bool,
    /// Compensation of the bias of each force sensor, and of the load beyond it.
    pub sensors: Vec<SensorCompensation>,
    /// Estimated forces, which follow those of the force sensors in the measurement. Without measured motor torque they need
    /// a controller that commands torques.
    pub estimated_forces: Vec<EstimatedForce>,
    /// Detector of collisions, if any. Like estimated forces it needs the torques of the motors.
    pub collision: Option<CollisionDetector>,
    /// Time from a sample until the torque of its command acts, s. Observers of external torques use it if motor torques are
    /// not measured.
    pub command_delay_s: f64,
    /// Torque limits of the drives (n; Nm, N).
    pub torque_limits: Vec<f64>,
    /// Limits of the setpoints that the drives accept (n); empty if they have none. Setpoints of a transformer are kept
    /// within them.
    pub setpoint_limits: Vec<JointSetpointLimits>,
    /// Safety parameters.
    pub safety: SafetyParameters,
}

impl LoopConfig {
    /// Returns the configuration of a torque robot without friction compensation, with the torque limits of the URDF
    /// and default safety parameters. For any other robot, change the fields.
    #[must_use]
    pub fn new(model: Model, capabilities: Capabilities, controller: Box<dyn Controller>) -> Self {
        Self {
            torque_limits: model.joints().iter().map(|joint| joint.limits.effort).collect(),
            friction: FrictionCompensation::none(model.n()),
            friction_observer: None,
            unsensed_contact: false,
            sensors: vec![
                SensorCompensation::new(None, None, capabilities.period_s);
                capabilities.force_sensors.len()
            ],
            estimated_forces: Vec::new(),
            collision: None,
            command_delay_s: 0.0,
            transformer: Box::new(Identity),
            servo_gains: Vec::new(),
            setpoint_limits: Vec::new(),
            estimator: EstimatorParameters::default(),
            safety: SafetyParameters::default(),
            model,
            capabilities,
            controller,
        }
    }

    /// Checks that the parts are compatible.
    pub(crate) fn check(&self) -> Result<(), LoopError> {
        let LoopConfig { model, capabilities, controller, transformer, .. } = self;
        let joints = model.n();
        let names = || model.joints().iter().map(|joint| joint.name.clone());
        if !names().eq(capabilities.joints.iter().cloned()) {
            return Err(LoopError::Joints { robot: capabilities.joints.clone(), model: names().collect() });
        }
        let takes = capabilities.command;
        let servos = if takes == CommandKind::Torque { joints } else { self.servo_gains.len() };
        let lengths = [
            ("torque_limits", self.torque_limits.len()),
            ("servo_gains", servos),
            ("friction", self.friction.joints()),
            (
                "setpoint_limits",
                if self.setpoint_limits.is_empty() { joints } else { self.setpoint_limits.len() },
            ),
        ];
        for (what, found) in lengths {
            if found != joints {
                return Err(LoopError::Length { what, found, joints });
            }
        }
        let (found, sensors) = (self.sensors.len(), capabilities.force_sensors.len());
        if found != sensors {
            return Err(LoopError::Sensors { found, sensors });
        }
        let value = |what, allowed, found| Err(LoopError::Value { what, allowed, found });
        if !(capabilities.period_s.is_finite() && capabilities.period_s > 0.0) {
            return value("the period in seconds", "finite and above 0", capabilities.period_s);
        }
        if let Some(&limit) = self.torque_limits.iter().find(|limit| limit.is_nan() || **limit <= 0.0) {
            return value("a torque limit", "above 0", limit);
        }
        let gains = self.servo_gains.iter().flat_map(|servo| [servo.stiffness, servo.damping]);
        if let Some(gain) =
            gains.filter(|_| takes != CommandKind::Torque).find(|gain| !gain.is_finite() || *gain < 0.0)
        {
            return value("a servo gain", "finite and not below 0", gain);
        }
        let is_sensed = !capabilities.force_sensors.is_empty() || self.unsensed_contact;
        if self.friction_observer.is_some() && !is_sensed {
            return Err(LoopError::NoForceSensor);
        }
        let gives = controller.command_kind();
        let knows_torques = gives == CommandKind::Torque || capabilities.measures_motor_torque;
        let needs_torques = !self.estimated_forces.is_empty() || self.collision.is_some();
        if needs_torques && !knows_torques {
            return Err(LoopError::UnknownTorques);
        }
        let reaction = self.collision.as_ref().map(|detector| detector.reaction);
        if reaction == Some(CollisionReaction::Compliant) && gives != CommandKind::Torque {
            return Err(LoopError::NotCompliant);
        }
        if let Some(CollisionReaction::Retract(parameters)) = reaction {
            let speed = parameters.top_speed();
            if model.joints().iter().any(|joint| speed > joint.limits.velocity) {
                let allowed = "at most the velocity limit of each joint";
                return value(
                    "the top speed of the retraction, 1.875 distance_rad/duration_s,",
                    allowed,
                    speed,
                );
            }
        }
        if gives != CommandKind::Torque && gives != takes {
            return Err(LoopError::Kind { part: "controller", gives, takes });
        }
        if transformer.takes() != takes {
            return Err(LoopError::Kind { part: "transformer", gives: transformer.takes(), takes });
        }
        Ok(())
    }
}

/// Incompatible parts of a control loop.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum LoopError {
    /// Force sensor on a frame that the model does not have.
    #[error("force sensor: {0}")]
    Sensor(#[from] UnknownFrame),
    /// A number of compensations that is not that of the force sensors.
    #[error("`sensors` has {found} values for {sensors} force sensors")]
    Sensors {
        /// Number of compensations.
        found: usize,
        /// Number of force sensors.
        sensors: usize,
    },
    /// Joints that differ from the model's.
    #[error("the robot's joints {robot:?} are not the model's joints {model:?}")]
    Joints {
        /// Joints declared by the robot.
        robot: Vec<String>,
        /// Joints of the model.
        model: Vec<String>,
    },
    /// Friction observer on a robot without a force sensor.
    #[error("the friction observer needs a force sensor: without one it would oppose all contact")]
    NoForceSensor,
    /// Estimated forces or collision detection on a robot whose motor torques are neither measured nor commanded.
    #[error(
        "external torques are unknown: the robot does not measure motor current, and the controller commands no torques"
    )]
    UnknownTorques,
    /// Compliance after a collision with a controller that commands no torques.
    #[error("the robot cannot react to a collision by compliance: its controller commands no torques")]
    NotCompliant,
    /// Array that does not have one value per joint.
    #[error("{what} has {found} values; the model has {joints} joints")]
    Length {
        /// Name of the array.
        what: &'static str,
        /// Number of its values.
        found: usize,
        /// Number of joints, n.
        joints: usize,
    },
    /// Value out of range.
    #[error("{what} must be {allowed}, got {found}")]
    Value {
        /// Name of the value.
        what: &'static str,
        /// Allowed values.
        allowed: &'static str,
        /// Rejected value.
        found: f64,
    },
    /// Controller or transformer whose commands the robot does not accept.
    #[error("the {part} returns {} commands, but the robot accepts {} commands", gives.name(), takes.name())]
    Kind {
        /// `controller` or `transformer`.
        part: &'static str,
        /// Kind of command that the part returns.
        gives: CommandKind,
        /// Kind of command that the robot accepts.
        takes: CommandKind,
    },
}
