//! Errors in the parameters of a simulation.

use crate::environment::Mistake;
use crate::plant::PlantError;
use opspace_backend::{CommandKind, MAX_DELAY_CYCLES};
use opspace_model::{UnknownFrame, UnknownJoint};
use opspace_transformer::ServoError;
use thiserror::Error;

/// Parameters that contradict each other.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum SimulationError {
    /// Delay longer than [`MAX_DELAY_CYCLES`] interface periods.
    #[error(
        "a delay of {delay} servo ticks is longer than {MAX_DELAY_CYCLES} interface periods, {most} servo ticks"
    )]
    Delay {
        /// Delay, `delay_servo_ticks`.
        delay: u32,
        /// Longest delay possible, servo ticks.
        most: u32,
        /// True if the true delay is too long, false if the nominal delay is.
        truth: bool,
    },
    /// True parameter of a joint that doesn't exist.
    #[error("simulated.{section}: {source}")]
    Joint {
        /// Key of `[simulated]`, with a dot between the parts.
        section: &'static str,
        /// Unknown name, and the model's joints.
        source: UnknownJoint,
    },
    /// Setpoint limits of a joint that doesn't exist.
    #[error("setpoint_limits.joint: {source}")]
    SetpointLimits {
        /// Unknown name, and the model's joints.
        source: UnknownJoint,
    },
    /// Measured motor or joint torques that are too late.
    #[error("measured torques are {delay} servo ticks late; at most {most} are possible")]
    TorqueDelay {
        /// Section of the file, `current_measurement` or `joint_torque_measurement`.
        section: &'static str,
        /// Lateness, `delay_servo_ticks`.
        delay: u32,
        /// Largest lateness allowed.
        most: u32,
    },
    /// Offset of a joint's torque sensor that is not a finite number.
    #[error("the offset of the torque sensor of joint '{joint}' is not a finite number")]
    TorqueOffset {
        /// Name of the joint.
        joint: String,
    },
    /// Payload on a frame that doesn't exist.
    #[error("simulated.payload.{payload}: {source}")]
    Payload {
        /// Name of the payload.
        payload: String,
        /// Unknown name, and the model's frames.
        source: UnknownFrame,
    },
    /// Elastic gear without a stiffness.
    #[error(
        "the elastic gear of joint '{joint}' has no stiffness: give stiffness_nm_per_rad here, or \
         gear_stiffness_nm_per_rad in [joint.{joint}]"
    )]
    GearStiffness {
        /// Name of the joint.
        joint: String,
    },
    /// Elastic gear on a rotor without inertia.
    #[error("the rotor of joint '{joint}' has no inertia: its elastic gear needs rotor.inertia_kg_m2")]
    GearRotor {
        /// Name of the joint.
        joint: String,
    },
    /// Joint that moves no inertia.
    #[error(
        "joint '{joint}' moves hardly any inertia, so that no torque determines its motion: give its link mass and inertia, or \
         its rotor inertia_kg_m2 if its gear is rigid"
    )]
    NoInertia {
        /// Joint with the least inertia at the start.
        joint: String,
    },
    /// Invalid servo.
    #[error("the servo of joint '{joint}': {source}")]
    Servo {
        /// Name of its joint.
        joint: String,
        /// Quantity of its setpoints.
        setpoints: CommandKind,
        /// True if it is the true servo, not the nominal one.
        truth: bool,
        /// Cause of the error.
        source: ServoError,
    },
    /// Number of servos that differs from the number of joints.
    #[error("{found} servos for {joints} joints: one per joint is needed")]
    Servos {
        /// Number of servos.
        found: usize,
        /// Number of joints n.
        joints: usize,
    },
    /// Servo of a kind that does not fit the robot.
    #[error("the servo of joint '{joint}' does not accept {} setpoints: {} is missing", setpoints.name(), needed(joint, *truth, *setpoints))]
    ServoKind {
        /// Name of its joint.
        joint: String,
        /// True if it is the true servo, not the nominal one.
        truth: bool,
        /// Quantity of the setpoints that the robot's drives receive.
        setpoints: CommandKind,
    },
    /// Physics rate that is not a multiple of the servo rate.
    #[error(
        "a physics rate of {physics_hz} Hz is not a whole multiple (1 to 10000) of the servo rate of {servo_hz} Hz"
    )]
    PhysicsRate {
        /// Physics rate `physics_hz`, Hz.
        physics_hz: f64,
        /// Servo rate `servo_hz`, Hz.
        servo_hz: f64,
    },
    /// Servo rates without a common clock.
    #[error(
        "the arms of a simulation have servo rates of {first_hz} Hz and {second_hz} Hz: whole numbers of hertz are needed"
    )]
    ServoRates {
        /// Servo rate of one arm, Hz.
        first_hz: f64,
        /// Servo rate of another arm, Hz.
        second_hz: f64,
    },
    /// Declared joints that are not those of the model.
    #[error("the declared joints are not those of the model, in the order of the model: {}", declared.join(", "))]
    Joints {
        /// Names of the declared joints.
        declared: Vec<String>,
    },
    /// Interface period that is not a finite number above zero.
    #[error("the interface period is {period_s} s; it must be finite and above 0")]
    Period {
        /// Interface period `period_s`, s.
        period_s: f64,
    },
    /// Simulation without arms.
    #[error("a simulation needs at least one arm")]
    NoArm,
    /// Coupling of an arm with itself, or of an arm or a frame that doesn't exist.
    #[error("coupling '{coupling}': {reason}")]
    Coupling {
        /// Name of the coupling.
        coupling: String,
        /// Description: missing arm or frame, or an arm coupled with itself.
        reason: String,
    },
    /// Object held by arms with contradictory parameters, or by an arm or a frame that doesn't exist.
    #[error("objects.{object}: {}", mistake.message)]
    HeldObject {
        /// Name of the object.
        object: String,
        /// Key and description.
        mistake: Mistake,
    },
    /// Bus that loses every cycle.
    #[error("the fraction of lost cycles is {share}; it must be less than 1")]
    LostCycles {
        /// Probability of losing a cycle, `lost_cycles_share`.
        share: f64,
    },
    /// Dropout that is too long to keep its rows.
    #[error("a dropout of {duration_s} s is longer than the maximum of {longest_s} s")]
    Dropout {
        /// Duration, `duration_s`, s.
        duration_s: f64,
        /// Longest duration allowed, s.
        longest_s: f64,
    },
    /// Jitter of an interface period or more: a setpoint could act after the next one.
    #[error(
        "a jitter of {jitter} servo ticks is not shorter than an interface period of {ratio} servo ticks"
    )]
    Jitter {
        /// Jitter, `jitter_servo_ticks`.
        jitter: u32,
        /// Servo ticks per interface cycle, `servo_ticks_per_cycle`.
        ratio: u32,
    },
    /// Force sensor without parameters in `[simulated]`.
    #[error("force sensor '{sensor}' is declared, but [simulated.force_sensor.{sensor}] is missing")]
    UnknownSensorQuality {
        /// Name of the sensor.
        sensor: String,
    },
    /// Force sensor on a frame that doesn't exist.
    #[error("force sensor '{sensor}': {source}")]
    SensorFrame {
        /// Name of the sensor.
        sensor: String,
        /// Unknown name, and the model's frames.
        source: UnknownFrame,
    },
    /// Object of the environment on a frame that the robot does not have.
    #[error("environment.{object}: {source}")]
    Frame {
        /// Name of the object.
        object: String,
        /// Unknown name, and the model's frames.
        source: UnknownFrame,
    },
    /// Band from a higher to a lower frequency.
    #[error("environment.{object}: to_hz is below from_hz")]
    Band {
        /// Name of the object.
        object: String,
    },
    /// Operator without a reported axis.
    #[error("environment.{object}: report names no axis; omit it to report x, y and z")]
    NothingReported {
        /// Name of the object.
        object: String,
    },
    /// Object of the environment with contradictory parameters.
    #[error("environment.{object}: {}", mistake.message)]
    EnvironmentObject {
        /// Name of the object.
        object: String,
        /// Key and description.
        mistake: Mistake,
    },
    /// Physics engine that cannot build the plant.
    #[error(transparent)]
    Plant(PlantError),
    /// Wall whose normal is zero.
    #[error("environment.{object}: the normal has no length")]
    Normal {
        /// Name of the object.
        object: String,
    },
}

/// Name of the table of servos with setpoints of this kind, in a profile and in `[simulated]`.
fn table(setpoints: CommandKind) -> &'static str {
    match setpoints {
        CommandKind::Velocity => "velocity_servo",
        CommandKind::Position | CommandKind::Torque => "servo",
    }
}

/// Returns the section for a servo of this kind, in `[simulated]` or in the profile in use.
fn needed(joint: &str, truth: bool, setpoints: CommandKind) -> String {
    let root = if truth { "simulated." } else { "" };
    let kind = match setpoints {
        CommandKind::Velocity => "",
        CommandKind::Position | CommandKind::Torque => ".cascaded, .pid or .transfer-function",
    };
    format!("{root}{}.{joint}{kind}", table(setpoints))
}

impl SimulationError {
    /// File and key that cause the error: a path from the root of the task or robot file.
    #[must_use]
    pub fn key(&self) -> Key {
        let task = |name: &str, key: &str| Key::Task(vec!["environment".into(), name.into(), key.into()]);
        let bus = |key: &str| Key::Robot(vec!["simulated".into(), "bus".into(), key.into()]);
        match self {
            Self::Delay { truth: true, .. } => {
                Key::Robot(vec!["simulated".into(), "delay_servo_ticks".into()])
            }
            Self::Delay { .. } => Key::Profile(vec!["delay_servo_ticks".into()]),
            Self::Joint { section, source } => {
                let path = ["simulated"].into_iter().chain(section.split('.')).chain([source.name.as_str()]);
                Key::Robot(path.map(str::to_owned).collect())
            }
            Self::Servo { joint, setpoints, truth, .. } | Self::ServoKind { joint, setpoints, truth } => {
                let own = [table(*setpoints).to_owned(), joint.clone()];
                match truth {
                    true => Key::Robot(std::iter::once("simulated".to_owned()).chain(own).collect()),
                    false => Key::Profile(own.into()),
                }
            }
            Self::SetpointLimits { source } => {
                Key::Profile(vec!["setpoint_limits".into(), "joint".into(), source.name.clone()])
            }
            Self::TorqueOffset { joint } => {
                let path = ["simulated", "joint_torque_measurement", "offset_nm", joint];
                Key::Robot(path.map(str::to_owned).to_vec())
            }
            Self::TorqueDelay { section, .. } => {
                let path = ["simulated", section, "delay_servo_ticks"];
                Key::Robot(path.map(str::to_owned).to_vec())
            }
            Self::Payload { payload, .. } => {
                let path = ["simulated", "payload", payload, "frame"];
                Key::Robot(path.map(str::to_owned).to_vec())
            }
            Self::GearStiffness { joint } => {
                Key::Robot(vec!["simulated".into(), "gear".into(), joint.clone()])
            }
            Self::GearRotor { joint } => Key::Robot(vec!["joint".into(), joint.clone(), "rotor".into()]),
            Self::NoInertia { joint } => Key::Robot(vec!["joint".into(), joint.clone(), "rotor".into()]),
            Self::Servos { .. } => Key::Profile(vec!["servo".into()]),
            Self::Period { .. } | Self::ServoRates { .. } => Key::Profile(vec!["servo_hz".into()]),
            Self::Joints { .. } => Key::Robot(vec!["joint".into()]),
            Self::NoArm | Self::Coupling { .. } | Self::Plant(_) => Key::Task(Vec::new()),
            Self::PhysicsRate { .. } => Key::Robot(vec!["simulated".into(), "physics_hz".into()]),
            Self::HeldObject { object, mistake } => {
                let path = ["objects", object].into_iter().chain(mistake.key.split_terminator('.'));
                Key::Simulation(path.map(str::to_owned).collect())
            }
            Self::LostCycles { .. } => bus("lost_cycles_share"),
            Self::Dropout { .. } => bus("dropouts"),
            Self::Jitter { .. } => bus("jitter_servo_ticks"),
            Self::UnknownSensorQuality { sensor } => {
                Key::Robot(vec!["simulated".into(), "force_sensor".into(), sensor.clone()])
            }
            Self::SensorFrame { sensor, .. } => {
                Key::Robot(vec!["force_sensor".into(), sensor.clone(), "frame".into()])
            }
            Self::Frame { object, .. } => task(object, "frame"),
            Self::Band { object } => task(object, "motion"),
            Self::NothingReported { object } => task(object, "report"),
            Self::Normal { object } => task(object, "normal"),
            Self::EnvironmentObject { object, mistake } => {
                let path = ["environment", object].into_iter().chain(mistake.key.split('.'));
                Key::Task(path.map(str::to_owned).collect())
            }
        }
    }
}

/// Location of an error's cause.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Key {
    /// Path in the robot file.
    Robot(Vec<String>),
    /// Path in the profile of the robot file that is in use.
    Profile(Vec<String>),
    /// Path in the task file.
    Task(Vec<String>),
    /// Path in the file that describes the simulation of several robots.
    Simulation(Vec<String>),
}
