//! Configuration of an arm: the keys of `[driver]` in robot.toml.

use crate::calibration::{Calibration, MotorCalibration};
use crate::counts::{CountScale, RAD_PER_COUNT};
use opspace_backend::{CommandKind, DriverError, Settings};
use std::time::Duration;

/// Keys of `[driver]`.
pub const KEYS: [&str; 19] = [
    "port",
    "baud_hz",
    "calibration",
    "motors",
    "ids",
    "inverted",
    "zeros_rad",
    "p",
    "i",
    "d",
    "goal_speed_rad_per_s",
    "acceleration_rad_per_s2",
    "velocity",
    "torque_per_current_nm_per_a",
    "torque_per_load_nm",
    "silence_s",
    "at_end",
    "lowering_speed_rad_per_s",
    "lowering_s",
];

/// Configuration of an arm.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ArmConfig {
    /// Servos, in the order of the joints (n).
    pub servos: Vec<ServoConfig>,
    /// Interface period, s.
    pub period_s: f64,
    /// Gains of the position servos, as their registers contain them.
    pub gains: Gains,
    /// Speed limit of the profile to a goal, rad/s; `None` is no limit.
    pub goal_speed_rad_per_s: Option<f64>,
    /// Acceleration of the profile to a goal, rad/s²; `None` is no limit.
    pub acceleration_rad_per_s2: Option<f64>,
    /// True if samples contain the velocities that the servos report.
    pub measures_velocity: bool,
    /// Source of the motor torques in samples; `None` if they contain none.
    pub motor_torque: Option<TorqueSource>,
    /// Duration without complete answers that is a fault.
    pub silence: Duration,
    /// Treatment of the arm after a run.
    pub at_end: AtEnd,
}

/// Configuration of one servo.
#[derive(Clone, Debug, PartialEq)]
pub struct ServoConfig {
    /// Name of its joint.
    pub joint: String,
    /// Calibration.
    pub calibration: MotorCalibration,
    /// Counts and angles.
    pub scale: CountScale,
}

/// Gains of a position servo, as its registers contain them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gains {
    /// Register P_Coefficient.
    pub p: u8,
    /// Register I_Coefficient.
    pub i: u8,
    /// Register D_Coefficient.
    pub d: u8,
}

/// Source of motor torques.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TorqueSource {
    /// Motor current times a constant (Nm/A).
    Current(f64),
    /// Duty cycle of the motor voltage times the torque at full voltage and rest (Nm). It is the torque at rest only: in
    /// motion the motor's own voltage is part of it.
    Load(f64),
}

/// Treatment of an arm after a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AtEnd {
    /// The servos keep their last setpoints, with torque on.
    Hold,
    /// The setpoints follow the positions at this speed (rad/s), so that the arm sinks at this speed; when it lies, torque is
    /// switched off. If it does not lie after the duration, it is held.
    Lower {
        /// Speed of each joint, rad/s.
        speed_rad_per_s: f64,
        /// Longest duration.
        duration: Duration,
    },
}

impl ArmConfig {
    /// Reads the configuration from the keys of `[driver]`, and the calibration from its file.
    ///
    /// # Errors
    /// If a key is missing, unknown or wrong, or if the calibration cannot be read.
    pub fn from_settings(settings: &Settings) -> Result<Self, DriverError> {
        settings.expect_only(&KEYS)?;
        if settings.command != CommandKind::Position {
            return Err(DriverError::new(format!(
                "servos of this bus accept joint positions, not {}: use the backend position",
                match settings.command {
                    CommandKind::Torque => "torques",
                    _ => "velocities",
                }
            )));
        }
        if let Some(sensor) = settings.force_sensors.first() {
            return Err(DriverError::new(format!("this bus has no force sensor '{}'", sensor.name)));
        }
        let path = settings.text("calibration")?;
        let calibration = read_calibration(path).map_err(|words| DriverError::at("calibration", words))?;
        let motor_torque = match (
            optional(settings, "torque_per_current_nm_per_a")?,
            optional(settings, "torque_per_load_nm")?,
        ) {
            (None, None) => None,
            (Some(constant), None) => Some(TorqueSource::Current(constant)),
            (None, Some(constant)) => Some(TorqueSource::Load(constant)),
            (Some(_), Some(_)) => {
                let words =
                    "motor torques come from the current or from the load: state one of both constants";
                return Err(DriverError::at("torque_per_load_nm", words));
            }
        };
        Ok(Self {
            servos: servos(settings, &calibration, path)?,
            period_s: settings.period_s,
            gains: Gains { p: gain(settings, "p")?, i: gain(settings, "i")?, d: gain(settings, "d")? },
            goal_speed_rad_per_s: optional(settings, "goal_speed_rad_per_s")?,
            acceleration_rad_per_s2: optional(settings, "acceleration_rad_per_s2")?,
            measures_velocity: settings.flag("velocity")?,
            motor_torque,
            silence: seconds(settings, "silence_s", 0.2)?,
            at_end: at_end(settings)?,
        })
    }
}

/// Largest size of a calibration file, bytes: a motor has some 150.
const MAX_FILE: u64 = 100_000;

/// Reads a calibration; an error names the file and the remedy.
fn read_calibration(path: &str) -> Result<Calibration, String> {
    let metadata = std::fs::metadata(path).map_err(|error| {
        format!("{path}: {error}; LeRobot writes this file when the arm is calibrated (lerobot-calibrate)")
    })?;
    if !metadata.is_file() || metadata.len() > MAX_FILE {
        return Err(format!("{path} is no file of at most {MAX_FILE} bytes"));
    }
    let text = std::fs::read_to_string(path).map_err(|error| format!("{path}: {error}"))?;
    Calibration::from_json(&text).map_err(|error| format!("{path}: {error}"))
}

fn servos(
    settings: &Settings,
    calibration: &Calibration,
    path: &str,
) -> Result<Vec<ServoConfig>, DriverError> {
    let joints = &settings.joints;
    let motors = match list(settings, "motors")? {
        None => joints.clone(),
        Some(motors) if motors.len() == joints.len() => motors,
        Some(motors) => return Err(wrong_number("motors", motors.len(), joints)),
    };
    let inverted = list(settings, "inverted")?.unwrap_or_default();
    if let Some(unknown) = inverted.iter().find(|name| !joints.contains(name)) {
        return Err(DriverError::at(
            "inverted",
            format!("unknown joint '{unknown}'; the joints are: {}", joints.join(", ")),
        ));
    }
    let zeros = numbers(settings, "zeros_rad")?;
    let ids = numbers(settings, "ids")?;
    let mut servos = Vec::with_capacity(joints.len());
    for (index, (joint, motor)) in joints.iter().zip(&motors).enumerate() {
        let found = calibration.motor(motor).ok_or_else(|| {
            let names: Vec<&str> = calibration.names().collect();
            let words = format!(
                "{path} has no motor '{motor}' for joint '{joint}'; its motors are: {}. State the motors in the order of the \
                 joints: motors = \"…, …\"",
                names.join(", ")
            );
            DriverError::at("calibration", words)
        })?;
        if let Some(id) = ids.as_ref().map(|ids| ids[index])
            && id != f64::from(found.id)
        {
            let words = format!("the servo of joint '{joint}' has id {} in {path}, not {id}", found.id);
            return Err(DriverError::at("ids", words));
        }
        let is_inverted = (found.drive_mode == 1) != inverted.contains(joint);
        let sign = if is_inverted { -1.0 } else { 1.0 };
        let middle = f64::from(found.range_min + found.range_max) / 2.0;
        let zero_rad = zeros.as_ref().map_or(0.0, |zeros| zeros[index]);
        let scale = CountScale {
            // The joint is at zero_rad in the middle of its calibrated range.
            zero: middle - sign * zero_rad / RAD_PER_COUNT,
            sign,
            min: found.range_min,
            max: found.range_max,
        };
        servos.push(ServoConfig { joint: joint.clone(), calibration: found, scale });
    }
    let same = |id| servos.iter().filter(|servo| servo.calibration.id == id).count() > 1;
    if let Some(servo) = servos.iter().find(|servo| same(servo.calibration.id)) {
        let words = format!("two joints have the servo with id {}", servo.calibration.id);
        return Err(DriverError::at("motors", words));
    }
    Ok(servos)
}

fn at_end(settings: &Settings) -> Result<AtEnd, DriverError> {
    let speed = optional(settings, "lowering_speed_rad_per_s")?;
    let duration = seconds(settings, "lowering_s", 20.0)?;
    match optional_text(settings, "at_end")?.unwrap_or("hold") {
        "hold" => Ok(AtEnd::Hold),
        "lower" => Ok(AtEnd::Lower { speed_rad_per_s: speed.unwrap_or(0.3), duration }),
        other => {
            Err(DriverError::at("at_end", format!("'at_end' must be \"hold\" or \"lower\", not \"{other}\"")))
        }
    }
}

fn gain(settings: &Settings, key: &str) -> Result<u8, DriverError> {
    let number = settings.number(key)?;
    if number.fract() == 0.0 && (0.0..=255.0).contains(&number) {
        return Ok(number as u8);
    }
    Err(DriverError::at(
        key,
        format!("'{key}' is the content of a register, a whole number of 0 to 255, not {number}"),
    ))
}

/// Returns a number above zero, if the key exists.
fn optional(settings: &Settings, key: &str) -> Result<Option<f64>, DriverError> {
    if !settings.contains(key) {
        return Ok(None);
    }
    let number = settings.number(key)?;
    if number.is_finite() && number > 0.0 {
        return Ok(Some(number));
    }
    Err(DriverError::at(key, format!("'{key}' must be above 0, not {number}")))
}

fn seconds(settings: &Settings, key: &str, default_s: f64) -> Result<Duration, DriverError> {
    let number = optional(settings, key)?.unwrap_or(default_s);
    if number > 3600.0 {
        return Err(DriverError::at(key, format!("'{key}' must be at most 3600 s, not {number}")));
    }
    Ok(Duration::from_secs_f64(number))
}

fn optional_text<'a>(settings: &'a Settings, key: &str) -> Result<Option<&'a str>, DriverError> {
    if settings.contains(key) { settings.text(key).map(Some) } else { Ok(None) }
}

/// Returns the parts of a text that are separated by commas, if the key exists.
fn list(settings: &Settings, key: &str) -> Result<Option<Vec<String>>, DriverError> {
    let text = optional_text(settings, key)?;
    Ok(text.map(|text| text.split(',').map(|part| part.trim().to_owned()).collect()))
}

/// Returns one number for each joint, if the key exists.
fn numbers(settings: &Settings, key: &str) -> Result<Option<Vec<f64>>, DriverError> {
    let Some(parts) = list(settings, key)? else { return Ok(None) };
    if parts.len() != settings.joints.len() {
        return Err(wrong_number(key, parts.len(), &settings.joints));
    }
    let parse = |part: &String| {
        part.parse::<f64>().ok().filter(|number| number.is_finite()).ok_or_else(|| {
            DriverError::at(
                key,
                format!("'{key}' must be numbers separated by commas; '{part}' is no number"),
            )
        })
    };
    parts.iter().map(parse).collect::<Result<_, _>>().map(Some)
}

fn wrong_number(key: &str, found: usize, joints: &[String]) -> DriverError {
    let words = format!(
        "'{key}' has {found} values separated by commas; the robot has {} joints: {}",
        joints.len(),
        joints.join(", ")
    );
    DriverError::at(key, words)
}
