//! Calibration of an arm, in the file that LeRobot writes.

use crate::counts::RAD_PER_COUNT;
use crate::protocol::MAX_ID;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Calibrations of servos, by the names of the motors. Read from the JSON file of LeRobot
/// (`~/.cache/huggingface/lerobot/calibration/robots/…/NAME.json`).
///
/// ```
/// use opspace_feetech::calibration::Calibration;
///
/// let text = r#"{"elbow_flex": {"id": 3, "drive_mode": 0, "homing_offset": 1030, "range_min": 890, "range_max": 3100}}"#;
/// let calibration = Calibration::from_json(text)?;
/// assert_eq!(calibration.motor("elbow_flex").map(|motor| motor.id), Some(3));
/// # Ok::<(), opspace_feetech::calibration::CalibrationError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Calibration {
    motors: BTreeMap<String, MotorCalibration>,
}

/// Calibration of one servo. Its keys are LeRobot's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct MotorCalibration {
    /// Identifier on the bus.
    pub id: u8,
    /// 1 if the joint's positive direction is that of decreasing counts, otherwise 0.
    pub drive_mode: u8,
    /// Contents of register Homing_Offset, counts: the servo's position is that of its sensor less this.
    pub homing_offset: i32,
    /// Smallest position, counts; contents of register Min_Position_Limit.
    pub range_min: i32,
    /// Largest position, counts; contents of register Max_Position_Limit.
    pub range_max: i32,
}

/// Reason why a text is no calibration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// The text is not JSON of this form.
    #[error(
        "not a calibration of LeRobot, which has id, drive_mode, homing_offset, range_min and range_max for each motor: {0}"
    )]
    Json(#[from] serde_json::Error),
    /// A value is impossible.
    #[error("motor '{motor}': {key} is {value}; it must be {allowed}")]
    Value {
        /// Name of the motor.
        motor: String,
        /// Key.
        key: &'static str,
        /// Value.
        value: i32,
        /// Values that are allowed.
        allowed: &'static str,
    },
    /// Two motors have the same identifier.
    #[error("motors '{first}' and '{second}' have the same id {id}")]
    SameId {
        /// Name of one motor.
        first: String,
        /// Name of the other motor.
        second: String,
        /// Their identifier.
        id: u8,
    },
}

impl Calibration {
    /// Reads a calibration from the text of its file.
    ///
    /// # Errors
    /// If the text is not of this form, or a value is impossible.
    pub fn from_json(text: &str) -> Result<Self, CalibrationError> {
        let motors: BTreeMap<String, MotorCalibration> = serde_json::from_str(text)?;
        for (name, motor) in &motors {
            motor.check(name)?;
            let same = motors.iter().find(|(other, of_other)| *other > name && of_other.id == motor.id);
            if let Some((second, _)) = same {
                return Err(CalibrationError::SameId {
                    first: name.clone(),
                    second: second.clone(),
                    id: motor.id,
                });
            }
        }
        Ok(Self { motors })
    }

    /// Returns the calibration of a simulated arm: motors with the identifiers 1, 2, ... and these ranges (rad), of which the middle
    /// is half a turn. A range of more than a turn becomes one turn. A real arm is calibrated by LeRobot.
    ///
    /// # Errors
    /// If a range is empty, or there are more motors than identifiers.
    pub fn of_simulation<'a>(
        motors: impl IntoIterator<Item = (&'a str, (f64, f64))>,
    ) -> Result<Self, CalibrationError> {
        let mut calibrations = BTreeMap::new();
        for (id, (name, (lower, upper))) in (1..).zip(motors) {
            let half = ((upper - lower) / RAD_PER_COUNT / 2.0).round().min(2047.0) as i32;
            let (range_min, range_max) = (2048 - half, 2048 + half);
            let motor = MotorCalibration { id, drive_mode: 0, homing_offset: 0, range_min, range_max };
            motor.check(name)?;
            calibrations.insert(name.to_owned(), motor);
        }
        Ok(Self { motors: calibrations })
    }

    /// Text of the file, as LeRobot writes it.
    ///
    /// # Errors
    /// If it cannot be written as JSON.
    pub fn to_json(&self) -> Result<String, CalibrationError> {
        Ok(serde_json::to_string_pretty(&self.motors)?)
    }

    /// Calibration of the motor with this name.
    #[must_use]
    pub fn motor(&self, name: &str) -> Option<MotorCalibration> {
        self.motors.get(name).copied()
    }

    /// Names of the motors, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.motors.keys().map(String::as_str)
    }
}

impl MotorCalibration {
    fn check(&self, name: &str) -> Result<(), CalibrationError> {
        let wrong = |key, value, allowed| {
            Err(CalibrationError::Value { motor: name.to_owned(), key, value, allowed })
        };
        if self.id > MAX_ID {
            return wrong("id", self.id.into(), "0 to 253");
        }
        if self.drive_mode > 1 {
            return wrong("drive_mode", self.drive_mode.into(), "0 or 1");
        }
        if !(-2047..=2047).contains(&self.homing_offset) {
            return wrong("homing_offset", self.homing_offset, "-2047 to 2047");
        }
        if !(0..=4095).contains(&self.range_min) {
            return wrong("range_min", self.range_min, "0 to 4095");
        }
        if self.range_max <= self.range_min || self.range_max > 4095 {
            return wrong("range_max", self.range_max, "above range_min, and at most 4095");
        }
        Ok(())
    }
}
