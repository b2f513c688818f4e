//! Causes of a stop: a run has one, and it is latched.

use opspace_backend::DeviceFault;
use opspace_model::Model;
use thiserror::Error;

/// The code of a fault that the robot itself reported.
pub(crate) const DEVICE_CODE: u32 = 17;

/// The cause of a stop. Joints are given by their index; [`describe`](Fault::describe) names them.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum Fault {
    /// A measured value is not a finite number.
    #[error("joint {joint}: a measured position, velocity or torque is not a finite number")]
    MeasurementNotFinite {
        /// Joint index.
        joint: usize,
    },
    /// A force sensor gave no finite number.
    #[error("force sensor {sensor}: the measured force is not a finite number")]
    SensorNotFinite {
        /// Sensor index.
        sensor: usize,
    },
    /// The controller's command is not a finite number.
    #[error("joint {joint}: the controller's command is not a finite number")]
    CommandNotFinite {
        /// Joint index.
        joint: usize,
    },
    /// The robot's clock stood still or went back.
    #[error("the robot's clock went from {before_s} s to {now_s} s")]
    Clock {
        /// Time of the sample before, s.
        before_s: f64,
        /// Time of this sample, s.
        now_s: f64,
    },
    /// The robot was silent for too long.
    #[error("the robot was silent for {silent_s} s; limit: {limit_s} s")]
    Dropout {
        /// Time without a sample, s.
        silent_s: f64,
        /// `max_dropout_s`.
        limit_s: f64,
    },
    /// After a dropout, a joint that should be held goes on moving.
    #[error("joint {joint}: still moving after being held for {held_s} s following a dropout")]
    HoldFailed {
        /// Joint index.
        joint: usize,
        /// Time for which it was held, s.
        held_s: f64,
    },
    /// A measured position is further from the one before than any speed explains.
    #[error("joint {joint}: the measured position jumped by {step}, limit {limit}")]
    PositionJump {
        /// Joint index.
        joint: usize,
        /// Distance from one sample to the next, rad or m.
        step: f64,
        /// Limit, rad or m.
        limit: f64,
    },
    /// A joint is outside its limits.
    #[error("joint {joint}: position {q} is outside its limits {lower} to {upper}")]
    JointLimit {
        /// Joint index.
        joint: usize,
        /// Measured position, rad or m.
        q: f64,
        /// Lower limit, rad or m.
        lower: f64,
        /// Upper limit, rad or m.
        upper: f64,
    },
    /// A joint moves faster than it may.
    #[error("joint {joint}: speed {dq} is above its limit {limit}")]
    Speed {
        /// Joint index.
        joint: usize,
        /// Estimated speed, rad/s or m/s.
        dq: f64,
        /// Limit, rad/s or m/s.
        limit: f64,
    },
    /// A joint is further from its setpoint than full torque and full speed explain.
    #[error("following error of joint {joint}: {error}, limit {limit}")]
    FollowingError {
        /// Joint index.
        joint: usize,
        /// Distance from the setpoint, rad or m.
        error: f64,
        /// Limit, rad or m.
        limit: f64,
    },
    /// The motor of a position robot gives another torque than the one for which its setpoints were made.
    #[error("joint {joint}: the motor's torque is {deviation} Nm from the desired torque, limit {limit}")]
    TorqueDeviation {
        /// Joint index.
        joint: usize,
        /// Measured less desired, as a mean over the watchdog's time, Nm or N.
        deviation: f64,
        /// Limit, Nm or N.
        limit: f64,
    },
    /// The motor of a position robot drives its joint with more power than was asked for.
    #[error("joint {joint}: the motor delivers {power} W more than the desired torque would, limit {limit}")]
    ExcessPower {
        /// Joint index.
        joint: usize,
        /// (τ_motor − τ_desired) q̇ as a mean over the watchdog's time, W.
        power: f64,
        /// Limit, W.
        limit: f64,
    },
    /// The mass matrix can't be factored.
    #[error("the mass matrix is not positive definite at the measured position")]
    MassMatrix,
    /// The robot itself reported a fault.
    #[error("the robot reports: {0}")]
    Device(DeviceFault),
    /// A streamed target is too old, and its task asks for a stop.
    #[error("the target of task {task} is {age_s} s old")]
    StaleTarget {
        /// Place of the task in the priority, from 0.
        task: usize,
        /// Age of the target, s.
        age_s: f64,
    },
    /// A part of the control loop panicked: a task, a controller or a backend of the user.
    #[error(
        "the control loop panicked; the message was printed to standard error, and the log ends before the panic"
    )]
    Panicked,
}

impl Fault {
    /// Its number in a log; 0 is none.
    #[must_use]
    pub fn code(&self) -> u32 {
        match self {
            Self::MeasurementNotFinite { .. } => 1,
            Self::SensorNotFinite { .. } => 2,
            Self::CommandNotFinite { .. } => 3,
            Self::Clock { .. } => 4,
            Self::JointLimit { .. } => 5,
            Self::Speed { .. } => 6,
            Self::FollowingError { .. } => 7,
            Self::MassMatrix => 8,
            Self::Dropout { .. } => 12,
            Self::HoldFailed { .. } => 13,
            Self::PositionJump { .. } => 14,
            Self::TorqueDeviation { .. } => 15,
            Self::ExcessPower { .. } => 16,
            Self::Device(_) => DEVICE_CODE,
            Self::StaleTarget { .. } => 18,
            Self::Panicked => 19,
        }
    }

    /// The cause in words, with the joint's name. Allocates: not for the loop.
    #[must_use]
    pub fn describe(&self, model: &Model) -> String {
        let text = self.to_string();
        let joint = match *self {
            Self::MeasurementNotFinite { joint }
            | Self::CommandNotFinite { joint }
            | Self::JointLimit { joint, .. }
            | Self::Speed { joint, .. }
            | Self::FollowingError { joint, .. }
            | Self::HoldFailed { joint, .. }
            | Self::PositionJump { joint, .. }
            | Self::TorqueDeviation { joint, .. }
            | Self::ExcessPower { joint, .. } => joint,
            _ => return text,
        };
        text.replacen(&format!("joint {joint}"), &format!("joint '{}'", model.joints()[joint].name), 1)
    }
}
