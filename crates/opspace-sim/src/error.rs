//! What keeps an arm from being simulated.

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
        /// Whether it is the true one, not the one that is believed.
        truth: bool,
        /// What is wrong with it.
        source: ServoError,
    },
    /// Physics and servo don't fit.
    #[error("physics at {physics_hz} Hz is not a whole multiple, 1 to 10000, of the servo's {servo_hz} Hz")]
    PhysicsRate {
        /// `physics_hz`.
        physics_hz: f64,
        /// `servo_hz`.
        servo_hz: f64,
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
    /// A surrounding touches a frame that isn't there.
    #[error("surroundings.{surrounding}: {source}")]
    Frame {
        /// The surrounding's name.
        surrounding: String,
        /// What there is.
        source: UnknownFrame,
    },
    /// A band from a higher to a lower frequency.
    #[error("surroundings.{surrounding}: to_hz is below from_hz")]
    Band {
        /// The surrounding's name.
        surrounding: String,
    },
    /// A hand that reports no axis.
    #[error("surroundings.{surrounding}: report names no axis; leave it out for all of x, y and z")]
    NothingReported {
        /// The surrounding's name.
        surrounding: String,
    },
    /// A wall without a direction.
    #[error("surroundings.{surrounding}: the normal has no length")]
    Normal {
        /// The surrounding's name.
        surrounding: String,
    },
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
            Self::Servo { joint, truth: true, .. } => {
                Key::Robot(vec!["simulated".into(), "servo".into(), joint.clone()])
            }
            Self::Servo { joint, .. } => Key::Profile(vec!["servo".into(), joint.clone()]),
            Self::PhysicsRate { .. } => Key::Robot(vec!["simulated".into(), "physics_hz".into()]),
            Self::LostCycles { .. } => bus("lost_cycles_share"),
            Self::Dropout { .. } => bus("dropouts"),
            Self::Jitter { .. } => bus("jitter_servo_ticks"),
            Self::UnknownSensorQuality { sensor } => {
                Key::Robot(vec!["simulated".into(), "force_sensor".into(), sensor.clone()])
            }
            Self::Frame { surrounding, .. } => task(surrounding, "frame"),
            Self::Band { surrounding } => task(surrounding, "motion"),
            Self::NothingReported { surrounding } => task(surrounding, "report"),
            Self::Normal { surrounding } => task(surrounding, "normal"),
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
