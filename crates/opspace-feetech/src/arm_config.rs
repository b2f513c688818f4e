//! Configuration of an arm: the keys of `[driver]` in robot.toml.

use crate::calibration::{Calibration, MotorCalibration};
use crate::counts::{CountScale, RAD_PER_COUNT};
use opspace_backend::{CommandKind, DriverError, DriverKey, DriverWarning, KeyValue, Measured, Settings};
use std::path::Path;
use std::time::Duration;

/// Keys of `[driver]`.
pub const KEYS: [DriverKey; 19] = [
    DriverKey::new("port", KeyValue::Text, "Serial port, such as `/dev/ttyACM0`.").required(),
    DriverKey::new("baud_hz", KeyValue::Number, "Baud rate, 1200 to 4000000.").with_default("1000000"),
    DriverKey::new(
        "calibration",
        KeyValue::Text,
        "Calibration that LeRobot has written; the path refers to the folder of robot.toml.",
    )
    .required(),
    DriverKey::new("motors", KeyValue::TextsByJoint, "Names of the motors in the calibration.")
        .with_default("names of the joints"),
    DriverKey::new("ids", KeyValue::NumbersByJoint, "Identifiers of the servos, compared with the calibration.")
        .with_default("not compared"),
    DriverKey::new(
        "inverted",
        KeyValue::Texts,
        "Joints whose positive direction is the other one than `drive_mode` of the calibration says.",
    )
    .with_default("none"),
    DriverKey::new(
        "zeros_rad",
        KeyValue::NumbersByJoint,
        "Angles of the joints in the middle of their calibrated ranges, rad.",
    )
    .with_default("0"),
    DriverKey::new("p", KeyValue::Number, "Proportional gain, the content of register P_Coefficient.").required(),
    DriverKey::new(
        "stiffness_at_p",
        KeyValue::Number,
        "The `p` for which `stiffness_nm_per_rad` of the servos is stated: another `p` is refused.",
    )
    .with_default("not compared"),
    DriverKey::new("i", KeyValue::Number, "Integral gain, the content of register I_Coefficient.").required(),
    DriverKey::new("d", KeyValue::Number, "Derivative gain, the content of register D_Coefficient.").required(),
    DriverKey::new("goal_speed_rad_per_s", KeyValue::Number, "Speed limit of the servo's profile.")
        .with_default("no limit"),
    DriverKey::new("acceleration_rad_per_s2", KeyValue::Number, "Acceleration of the servo's profile.")
        .with_default("no limit"),
    DriverKey::new(
        "torque_per_current_nm_per_a",
        KeyValue::Number,
        "Motor torque per motor current, if `measured` of `[interface]` has `\"motor-current\"`.",
    ),
    DriverKey::new(
        "torque_per_load_nm",
        KeyValue::Number,
        "Torque at rest and full voltage, in place of the torque per current: motor torques are those of the duty cycle of the \
         motor voltage.",
    ),
    DriverKey::new(
        "silence_s",
        KeyValue::Number,
        "Duration without complete answers that is a fault; not above `max_dropout_s` of `[safety]`.",
    )
    .with_default("0.2"),
    DriverKey::new(
        "at_end",
        KeyValue::Text,
        "After a run, `\"hold\"` keeps torque on; `\"lower\"` lowers the arm, and switches torque off when it lies.",
    )
    .with_default("`\"hold\"`"),
    DriverKey::new("lowering_speed_rad_per_s", KeyValue::Number, "Speed of each joint that is lowered.")
        .with_default("0.3"),
    DriverKey::new("lowering_s", KeyValue::Number, "Duration after which an arm that does not lie is held.")
        .with_default("20"),
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
        settings.expect_only(&KEYS.map(|key| key.name))?;
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
        let gains = Gains { p: gain(settings, "p")?, i: gain(settings, "i")?, d: gain(settings, "d")? };
        expect_stiffness_of(settings, gains)?;
        let goal_speed_rad_per_s = settings.positive("goal_speed_rad_per_s")?;
        let acceleration_rad_per_s2 = settings.positive("acceleration_rad_per_s2")?;
        acceleration_of(acceleration_rad_per_s2)?;
        let motor_torque = torque_source(settings)?;
        let silence = settings.seconds("silence_s", 0.2)?;
        let at_end = at_end(settings)?;
        // Last: without this file, all other values have been checked.
        let path = settings.path("calibration")?;
        let calibration = read_calibration(&path).map_err(|words| DriverError::at("calibration", words))?;
        Ok(Self {
            servos: servos(settings, &calibration, &path)?,
            period_s: settings.period_s,
            gains,
            goal_speed_rad_per_s,
            acceleration_rad_per_s2,
            measures_velocity: settings.measured.contains(&Measured::Velocity),
            motor_torque,
            silence,
            at_end,
        })
    }
}

/// Content of register Acceleration, whose unit is 100 counts/s²; 0 is no limit.
pub(crate) fn acceleration_of(acceleration_rad_per_s2: Option<f64>) -> Result<i32, DriverError> {
    profile_value("acceleration_rad_per_s2", acceleration_rad_per_s2, 100.0 * RAD_PER_COUNT, 254)
}

/// Content of a register of the servo's profile with this unit and this largest content; 0 is no limit.
pub(crate) fn profile_value(
    key: &str,
    value: Option<f64>,
    unit: f64,
    largest: i32,
) -> Result<i32, DriverError> {
    // Above 0, since 0 is no limit.
    let nearest = value.map_or(0.0, |value| (value / unit).round().max(1.0));
    if nearest > f64::from(largest) {
        let most = f64::from(largest) * unit;
        let words = format!("'{key}' must be at most {most:.4}; leave it out for no limit");
        return Err(DriverError::at(key, words));
    }
    Ok(nearest as i32)
}

/// Warnings about gains that the servos of robot.toml probably do not have.
pub(crate) fn doubts_of_gains(settings: &Settings) -> Result<Vec<DriverWarning>, DriverError> {
    let mut doubts = Vec::new();
    let is_stated = settings.servos.first().is_some_and(|servo| servo.stiffness_nm_per_rad > 0.0);
    if is_stated && !settings.contains(STIFFNESS_AT_P) {
        let words = format!(
            "nothing says for which P the stiffness of [profile] was measured, so that it cannot be compared with p = {}: state \
             {STIFFNESS_AT_P}",
            gain(settings, "p")?
        );
        doubts.push(DriverWarning::at("p", words));
    }
    let i = gain(settings, "i")?;
    if i > 0 && settings.servos.iter().any(|servo| !servo.has_integral) {
        let words = format!(
            "i = {i}, but the servos of [profile] have no integral: the servos would add torques that no transformer knows; \
             state i = 0"
        );
        doubts.push(DriverWarning::at("i", words));
    }
    Ok(doubts)
}

/// Key of the gain for which the stiffness is stated.
const STIFFNESS_AT_P: &str = "stiffness_at_p";

/// Compares P with the one for which robot.toml states the stiffness. Nothing is scaled: the stiffness may be a measured one.
fn expect_stiffness_of(settings: &Settings, gains: Gains) -> Result<(), DriverError> {
    if !settings.contains(STIFFNESS_AT_P) {
        return Ok(());
    }
    let at_p = gain(settings, STIFFNESS_AT_P)?;
    if at_p == gains.p {
        return Ok(());
    }
    if at_p == 0 {
        let words = format!("'{STIFFNESS_AT_P}' must be above 0: a servo whose P is 0 has no stiffness");
        return Err(DriverError::at(STIFFNESS_AT_P, words));
    }
    let stiffnesses = || settings.servos.iter().map(|servo| servo.stiffness_nm_per_rad);
    let in_words = |factor: f64| {
        let (least, most) = stiffnesses()
            .fold((f64::INFINITY, 0.0), |(least, most): (f64, f64), one| (least.min(one), most.max(one)));
        let round = |stiffness: f64| (stiffness * factor * 1e3).round() / 1e3;
        match round(most) {
            most if most == round(least) => format!("{most} Nm/rad"),
            most => format!("{} to {most} Nm/rad", round(least)),
        }
    };
    let p = gains.p;
    let words = match stiffnesses().next() {
        None => format!("p = {p}, but the stiffness is stated for P = {at_p}"),
        Some(_) => format!(
            "p = {p}, but the stiffness in [profile], {}, is stated for P = {at_p}; at P = {p} it would be {}. State this stiffness and \
             {STIFFNESS_AT_P} = {p}, or p = {at_p}",
            in_words(1.0),
            in_words(f64::from(p) / f64::from(at_p))
        ),
    };
    Err(DriverError::at("p", words))
}

/// Source of motor torques, if robot.toml states that they are measured.
fn torque_source(settings: &Settings) -> Result<Option<TorqueSource>, DriverError> {
    const CURRENT: &str = "torque_per_current_nm_per_a";
    const LOAD: &str = "torque_per_load_nm";
    if settings.measured.contains(&Measured::JointTorque) {
        return Err(DriverError::new(
            "these servos measure no joint torques: leave \"joint-torque\" out of `measured`",
        ));
    }
    let is_measured = settings.measured.contains(&Measured::MotorCurrent);
    match (settings.positive(CURRENT)?, settings.positive(LOAD)?) {
        (Some(_), Some(_)) => {
            let words = "motor torques come from the current or from the load: state one of both constants";
            Err(DriverError::at(LOAD, words))
        }
        (None, None) if is_measured => Err(DriverError::new(format!(
            "`measured` of [interface] has \"motor-current\": state {CURRENT} or {LOAD}"
        ))),
        (None, None) => Ok(None),
        (current, _) if !is_measured => {
            let words = "it is without effect: `measured` of [interface] lacks \"motor-current\"";
            Err(DriverError::at(if current.is_some() { CURRENT } else { LOAD }, words))
        }
        (Some(constant), None) => Ok(Some(TorqueSource::Current(constant))),
        (None, Some(constant)) => Ok(Some(TorqueSource::Load(constant))),
    }
}

/// Largest size of a calibration file, bytes: a motor has some 150.
const MAX_FILE: u64 = 100_000;

/// Reads a calibration; an error names the file and the remedy.
fn read_calibration(path: &Path) -> Result<Calibration, String> {
    let name = path.display();
    let metadata = std::fs::metadata(path).map_err(|error| {
        format!("{name}: {error}; LeRobot writes this file when the arm is calibrated (lerobot-calibrate)")
    })?;
    if !metadata.is_file() || metadata.len() > MAX_FILE {
        return Err(format!("{name} is no file of at most {MAX_FILE} bytes"));
    }
    let text = std::fs::read_to_string(path).map_err(|error| format!("{name}: {error}"))?;
    Calibration::from_json(&text).map_err(|error| format!("{name}: {error}"))
}

fn servos(
    settings: &Settings,
    calibration: &Calibration,
    path: &Path,
) -> Result<Vec<ServoConfig>, DriverError> {
    let joints = &settings.joints;
    let motors = settings.texts_by_joint("motors")?;
    let inverted = settings.texts("inverted")?.unwrap_or_default();
    if let Some(unknown) = inverted.iter().find(|name| !joints.iter().any(|joint| joint == *name)) {
        return Err(DriverError::at(
            "inverted",
            format!("unknown joint '{unknown}'; the joints are: {}", joints.join(", ")),
        ));
    }
    let zeros = settings.numbers_by_joint("zeros_rad")?;
    let ids = settings.numbers_by_joint("ids")?;
    let mut servos = Vec::with_capacity(joints.len());
    for (index, joint) in joints.iter().enumerate() {
        let motor = motors[index].unwrap_or(joint);
        let found = calibration.motor(motor).ok_or_else(|| {
            let names: Vec<&str> = calibration.names().collect();
            let words = format!(
                "{} has no motor '{motor}' for joint '{joint}'; its motors are: {}. State the motor of \
                 each joint: motors = {{ {joint} = \"…\" }}",
                path.display(),
                names.join(", ")
            );
            DriverError::at("calibration", words)
        })?;
        if let Some(id) = ids[index]
            && id != f64::from(found.id)
        {
            let words =
                format!("the servo of joint '{joint}' has id {} in {}, not {id}", found.id, path.display());
            return Err(DriverError::at("ids", words));
        }
        let is_inverted = (found.drive_mode == 1) != inverted.contains(&joint.as_str());
        let sign = if is_inverted { -1.0 } else { 1.0 };
        let middle = f64::from(found.range_min + found.range_max) / 2.0;
        let zero_rad = zeros[index].unwrap_or(0.0);
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
    let speed = settings.positive("lowering_speed_rad_per_s")?;
    let duration = settings.seconds("lowering_s", 20.0)?;
    match optional_text(settings, "at_end")?.unwrap_or("hold") {
        "hold" => Ok(AtEnd::Hold),
        "lower" if settings.is_followed => Ok(AtEnd::Hold),
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

fn optional_text<'a>(settings: &'a Settings, key: &str) -> Result<Option<&'a str>, DriverError> {
    if settings.contains(key) { settings.text(key).map(Some) } else { Ok(None) }
}
