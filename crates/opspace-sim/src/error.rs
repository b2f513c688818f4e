//! What keeps an arm from being simulated.

use opspace_backend::CommandKind;
use opspace_model::{UnknownFrame, UnknownJoint};
use opspace_transformer::ServoError;
use thiserror::Error;

/// Parameters that contradict each other.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum SimulationError {
    /// A command would act after the next one.
    #[error("a delay of {delay} servo ticks is longer than the {ratio} of an interface period")]
    Delay {
        /// `delay_servo_ticks`.
        delay: u32,
        /// `ratio`.
        ratio: u32,
        /// Whether it is the true one that is too long, not the one that is believed.
        truth: bool,
    },
    /// A truth about a joint that isn't there.
    #[error("simulated.{section}: {source}")]
    Joint {
        /// The key of `[simulated]`.
        section: &'static str,
        /// What there is.
        source: UnknownJoint,
    },
    /// A servo that can't be run.
    #[error("the servo of joint '{joint}': {source}")]
    Servo {
        /// Its joint.
        joint: String,
        /// The kind of its setpoints.
        setpoints: CommandKind,
        /// Whether it is the true one, not the one that is believed.
        truth: bool,
        /// What is wrong with it.
        source: ServoError,
    },
    /// Another number of servos than of joints.
    #[error("{found} servos for {joints} joints")]
    Servos {
        /// Number of servos.
        found: usize,
        /// n.
        joints: usize,
    },
    /// A servo of another kind than the robot needs.
    #[error("the servo of joint '{joint}' does not take {} setpoints: {} is missing", setpoints.name(), needed(joint, *truth, *setpoints))]
    ServoKind {
        /// Its joint.
        joint: String,
        /// Whether it is the true one, not the nominal one.
        truth: bool,
        /// The setpoints that the drives have for it.
        setpoints: CommandKind,
    },
    /// Physics and servo don't fit.
    #[error("physics at {physics_hz} Hz is not a whole multiple, 1 to 10000, of the servo's {servo_hz} Hz")]
    PhysicsRate {
        /// `physics_hz`.
        physics_hz: f64,
        /// `servo_hz`.
        servo_hz: f64,
    },
    /// Servo rates without a common clock.
    #[error(
        "arms of one simulation have servo rates of {first_hz} Hz and {second_hz} Hz: whole numbers of hertz are needed"
    )]
    ServoRates {
        /// Rate of one arm.
        first_hz: f64,
        /// Rate of another arm.
        second_hz: f64,
    },
    /// Declared joints that are not those of the model.
    #[error("the declared joints are not those of the model, in its order: {}", declared.join(", "))]
    Joints {
        /// The declared ones.
        declared: Vec<String>,
    },
    /// A simulation without arms.
    #[error("a simulation needs an arm")]
    NoArm,
    /// A coupling of an arm or a frame that there isn't.
    #[error("coupling '{coupling}': {reason}")]
    Coupling {
        /// Its name.
        coupling: String,
        /// The arm or the frame that is missing, or the arm that is named twice.
        reason: String,
    },
    /// A bus on which nothing passes.
    #[error("a bus that loses {share} of its cycles passes nothing: less than 1")]
    LostCycles {
        /// `lost_cycles_share`.
        share: f64,
    },
    /// A dropout that is too long to be kept.
    #[error("a dropout of {duration_s} s is longer than {longest_s} s")]
    Dropout {
        /// `duration_s`.
        duration_s: f64,
        /// What is the longest.
        longest_s: f64,
    },
    /// A set-point would act after the next one.
    #[error("a jitter of {jitter} servo ticks is not fewer than the {ratio} of an interface period")]
    Jitter {
        /// `jitter_servo_ticks`.
        jitter: u32,
        /// `ratio`.
        ratio: u32,
    },
    /// A sensor of the robot has no quality in the simulation.
    #[error("force sensor '{sensor}' is declared, but [simulated.force_sensor.{sensor}] is missing")]
    UnknownSensorQuality {
        /// Its name.
        sensor: String,
    },
    /// The frame of a force sensor is missing.
    #[error("force sensor '{sensor}': {source}")]
    SensorFrame {
        /// Its name.
        sensor: String,
        /// The frames that there are.
        source: UnknownFrame,
    },
    /// An object of the environment touches a frame that the robot does not have.
    #[error("surroundings.{object}: {source}")]
    Frame {
        /// Its name.
        object: String,
        /// What there is.
        source: UnknownFrame,
    },
    /// A band from a higher to a lower frequency.
    #[error("surroundings.{object}: to_hz is below from_hz")]
    Band {
        /// Its name.
        object: String,
    },
    /// An operator that reports no axis.
    #[error("surroundings.{object}: report names no axis; leave it out for all of x, y and z")]
    NothingReported {
        /// Its name.
        object: String,
    },
    /// A wall without a direction.
    #[error("surroundings.{object}: the normal has no length")]
    Normal {
        /// Its name.
        object: String,
    },
}

/// The table of the servos of a kind, in a profile and in `[simulated]`.
fn table(setpoints: CommandKind) -> &'static str {
    match setpoints {
        CommandKind::Velocity => "velocity_servo",
        CommandKind::Position | CommandKind::Torque => "servo",
    }
}

/// The section that a servo of the kind would be: of `[simulated]`, or of the profile in use.
fn needed(joint: &str, truth: bool, setpoints: CommandKind) -> String {
    let root = if truth { "simulated." } else { "" };
    let kind = match setpoints {
        CommandKind::Velocity => "",
        CommandKind::Position | CommandKind::Torque => ".cascaded, .pid or .transfer-function",
    };
    format!("{root}{}.{joint}{kind}", table(setpoints))
}

impl SimulationError {
    /// The file and the key that are to blame: a path from the root of the task or robot file.
    #[must_use]
    pub fn key(&self) -> Key {
        let task = |name: &str, key: &str| Key::Task(vec!["surroundings".into(), name.into(), key.into()]);
        let bus = |key: &str| Key::Robot(vec!["simulated".into(), "bus".into(), key.into()]);
        match self {
            Self::Delay { truth: true, .. } => {
                Key::Robot(vec!["simulated".into(), "delay_servo_ticks".into()])
            }
            Self::Delay { .. } => Key::Profile(vec!["delay_servo_ticks".into()]),
            Self::Joint { section, source } => {
                Key::Robot(vec!["simulated".into(), (*section).into(), source.name.clone()])
            }
            Self::Servo { joint, setpoints, truth, .. } | Self::ServoKind { joint, setpoints, truth } => {
                let own = [table(*setpoints).to_owned(), joint.clone()];
                match truth {
                    true => Key::Robot(std::iter::once("simulated".to_owned()).chain(own).collect()),
                    false => Key::Profile(own.into()),
                }
            }
            Self::Servos { .. } => Key::Profile(vec!["servo".into()]),
            Self::ServoRates { .. } => Key::Profile(vec!["servo_hz".into()]),
            Self::Joints { .. } => Key::Robot(vec!["joint".into()]),
            Self::NoArm | Self::Coupling { .. } => Key::Task(Vec::new()),
            Self::PhysicsRate { .. } => Key::Robot(vec!["simulated".into(), "physics_hz".into()]),
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
        }
    }
}

/// Where an error's cause stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Key {
    /// In the robot file.
    Robot(Vec<String>),
    /// In the profile of the robot file that is in use.
    Profile(Vec<String>),
    /// In the task file.
    Task(Vec<String>),
}
