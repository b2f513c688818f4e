//! Faults: causes of a stop. A run latches the first one.

use opspace_backend::DeviceFault;
use opspace_control::QpError;
use opspace_model::{JointKind, Model};
use std::fmt;
use thiserror::Error;

/// Code of a fault that the robot itself reported.
pub(crate) const DEVICE_CODE: u32 = 17;

/// Number with four significant digits in a message.
struct Rounded(f64);

impl fmt::Display for Rounded {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(number) = *self;
        if number == 0.0 || !number.is_finite() {
            return write!(f, "{number}");
        }
        // Quotients of whole numbers print with the digits that they have, products with rounding errors.
        let decimals = 3 - number.abs().log10().floor() as i32;
        let power = 10.0_f64.powi(decimals.abs());
        let rounded =
            if decimals >= 0 { (number * power).round() / power } else { (number / power).round() * power };
        write!(f, "{rounded}")
    }
}

/// Step of a clock, s, in a message; -∞ before the first sample.
struct ClockStep(f64, f64);

impl fmt::Display for ClockStep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(before_s, now_s) = *self;
        if before_s == f64::NEG_INFINITY {
            return write!(f, "reads {now_s} s in the first sample");
        }
        write!(f, "went from {before_s} s to {now_s} s")
    }
}

/// Cause of a stop. Joints are given by their index, as if all were revolute; [`describe`](Fault::describe) names them, with
/// their units.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum Fault {
    /// A measured value is not a finite number.
    #[error("joint {joint}: a measured position, velocity or torque is not a finite number")]
    MeasurementNotFinite {
        /// Joint index.
        joint: usize,
    },
    /// A force sensor's reading is not a finite number.
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
    /// No solver found a command within the limits, and there is no second one.
    #[error(
        "the command within the limits was not found: {error}; build opspace-control with its feature `clarabel`"
    )]
    UnsolvedLimits {
        /// Error of the solver.
        error: QpError,
    },
    /// The robot's clock did not advance, is not a finite number, or is far ahead.
    #[error("the robot's clock {}", ClockStep(*before_s, *now_s))]
    Clock {
        /// Time of the previous sample, s; -∞ if there is none.
        before_s: f64,
        /// Time of this sample, s.
        now_s: f64,
    },
    /// The samples come at another rate than the robot's period says.
    #[error(
        "samples came {} ms apart on the robot's clock, but its period is {} ms: the period is wrong, or cycles are lost",
        Rounded(1e3 * *spacing_s),
        Rounded(1e3 * *period_s)
    )]
    SampleRate {
        /// Mean time between two samples, s.
        spacing_s: f64,
        /// Interface period of the robot, s.
        period_s: f64,
    },
    /// Cycles are lost too often.
    #[error("cycles were lost before {gaps} of the last {samples} samples, limit {limit} in {window}")]
    LostCycles {
        /// Number of samples before which cycles were lost.
        gaps: u32,
        /// Number of samples.
        samples: u32,
        /// Largest number of such samples in a window.
        limit: u32,
        /// Number of samples of a window.
        window: u32,
    },
    /// The robot sent no sample for too long.
    #[error("the robot was silent for {} s; limit: {} s", Rounded(*silent_s), Rounded(*limit_s))]
    Dropout {
        /// Time without a sample, s.
        silent_s: f64,
        /// Limit `max_dropout_s`, s.
        limit_s: f64,
    },
    /// A joint still moves although the robot is held.
    #[error("joint {joint}: still moving after being held for {} s following a dropout", Rounded(*held_s))]
    HoldFailed {
        /// Joint index.
        joint: usize,
        /// Duration of the hold, s.
        held_s: f64,
    },
    /// A measured position differs from the previous one by more than the joint can move.
    #[error("joint {joint}: the measured position jumped by {} rad, limit {} rad", Rounded(*step), Rounded(*limit))]
    PositionJump {
        /// Joint index.
        joint: usize,
        /// Change of the position between two samples, rad or m.
        step: f64,
        /// Limit, rad or m.
        limit: f64,
    },
    /// A joint is outside its limits.
    #[error("joint {joint}: position {} rad is outside its limits {} to {} rad", Rounded(*q), Rounded(*lower), Rounded(*upper))]
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
    /// A joint exceeds its speed limit.
    #[error("joint {joint}: speed {} rad/s is above its limit {} rad/s", Rounded(*dq), Rounded(*limit))]
    Speed {
        /// Joint index.
        joint: usize,
        /// Measured or estimated velocity, rad/s or m/s.
        dq: f64,
        /// Limit, rad/s or m/s.
        limit: f64,
    },
    /// A joint is farther from its setpoint than full torque at full speed explains.
    #[error("following error of joint {joint}: {} rad, limit {} rad", Rounded(*error), Rounded(*limit))]
    FollowingError {
        /// Joint index.
        joint: usize,
        /// Distance from the setpoint, rad or m.
        error: f64,
        /// Limit, rad or m.
        limit: f64,
    },
    /// The motor torque of a position or velocity robot differs from the desired torque.
    #[error("joint {joint}: the motor's torque is {} Nm from the desired torque, limit {} Nm", Rounded(*deviation), Rounded(*limit))]
    TorqueDeviation {
        /// Joint index.
        joint: usize,
        /// Mean of measured minus desired torque over the watchdog's time constant, Nm or N.
        deviation: f64,
        /// Limit, Nm or N.
        limit: f64,
    },
    /// The motor of a position or velocity robot delivers more power than the desired torque would.
    #[error("joint {joint}: the motor delivers {} W more than the desired torque would, limit {} W", Rounded(*power), Rounded(*limit))]
    ExcessPower {
        /// Joint index.
        joint: usize,
        /// Mean of (τ_motor − τ_desired) q̇ over the watchdog's time constant, W.
        power: f64,
        /// Limit, W.
        limit: f64,
    },
    /// The motor torque of a position or velocity robot oscillates about the desired torque.
    #[error(
        "joint {joint}: the motor's torque oscillates about the desired torque by {} Nm rms above 15 Hz, limit {} Nm; declare delay and gears as they are, or lower the gains; `opspace check -v` prints the margins",
        Rounded(*rms),
        Rounded(*limit)
    )]
    TorqueOscillation {
        /// Joint index.
        joint: usize,
        /// Rms of measured minus desired torque above 15 Hz over 0.4 s, Nm or N.
        rms: f64,
        /// Limit, Nm or N.
        limit: f64,
    },
    /// The mass matrix cannot be factorized.
    #[error("the mass matrix is not positive definite at the measured position")]
    MassMatrix,
    /// The robot itself reported a fault.
    #[error("the robot reports: {0}")]
    Device(DeviceFault),
    /// A streamed target is too old, and its task requires a stop in this case.
    #[error("the target of task {task} is {} s old", Rounded(*age_s))]
    StaleTarget {
        /// Index of the task in the order of priority, from 0.
        task: usize,
        /// Age of the target, s.
        age_s: f64,
    },
    /// The robot has collided with something.
    #[error("joint {joint}: an external torque of {} Nm shows a collision, threshold {} Nm", Rounded(*torque), Rounded(*threshold))]
    Collision {
        /// Joint index.
        joint: usize,
        /// External torque, Nm or N.
        torque: f64,
        /// Threshold, Nm or N.
        threshold: f64,
    },
    /// A part of the control loop panicked: a task, a controller or a sink of the user. A panic of a driver is a
    /// [`Device`](Self::Device) fault.
    #[error(
        "the control loop panicked; the message was printed to standard error, and the log ends before the panic"
    )]
    Panicked,
}

impl Fault {
    /// Number of the fault in a log; 0 means no fault.
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
            Self::Collision { .. } => 20,
            Self::UnsolvedLimits { .. } => 21,
            Self::TorqueOscillation { .. } => 22,
            Self::SampleRate { .. } => 23,
            Self::LostCycles { .. } => 24,
        }
    }

    /// Index of the joint that is at fault; `None` if the fault concerns none, or all.
    #[must_use]
    pub fn joint(&self) -> Option<usize> {
        match *self {
            Self::MeasurementNotFinite { joint }
            | Self::CommandNotFinite { joint }
            | Self::JointLimit { joint, .. }
            | Self::Speed { joint, .. }
            | Self::FollowingError { joint, .. }
            | Self::HoldFailed { joint, .. }
            | Self::PositionJump { joint, .. }
            | Self::TorqueDeviation { joint, .. }
            | Self::ExcessPower { joint, .. }
            | Self::TorqueOscillation { joint, .. }
            | Self::Collision { joint, .. } => Some(joint),
            _ => None,
        }
    }

    /// Description of the fault with the joint's name and units. Allocates, so it must not be called in the loop.
    #[must_use]
    pub fn describe(&self, model: &Model) -> String {
        let text = self.to_string();
        let Some(joint) = self.joint() else { return text };
        let moved = &model.joints()[joint];
        let text = match moved.kind {
            JointKind::Prismatic => text.replace(" rad", " m").replace(" Nm", " N"),
            _ => text,
        };
        text.replacen(&format!("joint {joint}"), &format!("joint '{}'", moved.name), 1)
    }
}

#[cfg(test)]
mod tests {
    use super::Rounded;

    /// Numbers that binary fractions miss, and large and small ones.
    #[test]
    fn numbers_have_four_digits() {
        let texts =
            [0.1 + 0.2, -2.0 / 3.0, 9999.6, 123_456.0, 1.5e-7, 0.0, 40.0].map(|x| Rounded(x).to_string());
        assert_eq!(texts, ["0.3", "-0.6667", "10000", "123500", "0.00000015", "0", "40"]);
    }
}
