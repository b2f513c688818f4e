//! Drivers, which open a robot for a run.

use crate::backend::Backend;
use crate::capabilities::{Capabilities, ForceSensor, GravityCompensation, Measured};
use crate::command::CommandKind;
use crate::driver_key::{DriverKey, KeyValue};
use crate::fault::DeviceFault;
use crate::observed::{Observed, ObservedTorque};
use std::collections::BTreeMap;
use std::error::Error;
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Longest duration that a setting states, s.
const LONGEST_S: f64 = 3600.0;

/// Interface of a driver, which opens a robot, passes it to a function that runs it, and closes it.
///
/// The backend lives on the driver's stack while `run` is called and may therefore borrow a vendor's handle.
pub trait Driver {
    /// Returns the name of the driver in `[driver]` of robot.toml.
    fn name(&self) -> &str;

    /// Returns the keys of `[driver]` other than `name`, for checks and pages; none if the driver does not declare them.
    fn keys(&self) -> &[DriverKey] {
        &[]
    }

    /// Checks settings like [`with`](Self::with), but opens nothing and needs no robot. Returns warnings: what will refuse the
    /// robot unless it changes before a run, such as a port that is not there, or what is probably not intended. Without an
    /// implementation of the driver's own, its [`keys`](Self::keys) are checked.
    ///
    /// # Errors
    /// If settings are missing or wrong.
    fn check(&self, settings: &Settings) -> Result<Vec<DriverWarning>, DriverError> {
        match self.keys() {
            [] => Ok(Vec::new()),
            keys => settings.expect(keys).map(|()| Vec::new()),
        }
    }

    /// Returns what the backend will declare, if it is known without the robot: it is compared with robot.toml before a run;
    /// `None` if only the robot knows.
    ///
    /// # Errors
    /// If settings are missing or wrong.
    fn capabilities(&self, _settings: &Settings) -> Result<Option<Capabilities>, DriverError> {
        Ok(None)
    }

    /// Opens the robot with these settings, calls `run` once with its backend, and closes the robot.
    ///
    /// # Errors
    /// If settings are missing or wrong, or if the robot cannot be opened.
    fn with(&self, settings: &Settings, run: &mut dyn FnMut(&mut dyn Backend)) -> Result<(), DriverError>;

    /// Returns in words the state in which the robot is left after a run, also after one that a fault ended; `None` if the driver
    /// does not say.
    fn state_after_run(&self, _settings: &Settings) -> Option<String> {
        None
    }

    /// Opens the robot to read it without commanding it, calls `observe` once, and closes it. Torques that are on stay on, unless they
    /// are to be released.
    ///
    /// # Errors
    /// As [`with`](Self::with); a robot that cannot be lowered; a driver that always commands its robot.
    fn observe(
        &self,
        _settings: &Settings,
        _torque: ObservedTorque,
        _observe: &mut dyn FnMut(&mut dyn Observed),
    ) -> Result<(), DriverError> {
        Err(DriverError::new(format!("the driver '{}' reads no robot without commanding it", self.name())))
    }

    /// Searches for devices, at a place such as a port, or everywhere. Writes nothing to them.
    ///
    /// # Errors
    /// A place that cannot be opened; a driver that does not search.
    fn scan(&self, _place: Option<&str>) -> Result<Vec<FoundDevice>, DriverError> {
        Err(DriverError::new(format!("the driver '{}' does not search for devices", self.name())))
    }

    /// Serves simulated devices with the arm behind them, and calls `serve` once with their place and what was written for them; it
    /// returns when they are to end. Programs of others reach them as they would reach real ones. Returns a sentence about how it went.
    ///
    /// # Errors
    /// If settings or options are wrong, or the devices cannot be served; a driver without simulated devices.
    fn simulate(
        &self,
        _settings: &Settings,
        _devices: SimulatedDevices,
        _serve: &mut dyn FnMut(&ServedDevices),
    ) -> Result<String, DriverError> {
        Err(DriverError::new(format!("the driver '{}' has no simulated devices", self.name())))
    }
}

/// Arm and options of devices that a driver simulates.
#[non_exhaustive]
pub struct SimulatedDevices {
    /// Simulated arm without servos: it accepts torques of the motors in each of its periods, and measures positions and
    /// velocities exactly.
    pub arm: Box<dyn Backend + Send>,
    /// Torques of the motors that hold the arm at its start (n; Nm).
    pub holding_torque_nm: Vec<f64>,
    /// Smallest and largest position of each joint (n; rad).
    pub position_ranges_rad: Vec<(f64, f64)>,
    /// Path of a link to the place of the devices, which does not change between simulations; `None` if there is none.
    pub link: Option<PathBuf>,
    /// Options of the simulation, in place of the keys of `[driver]`.
    pub options: Settings,
}

impl SimulatedDevices {
    /// Returns devices with this arm, the torques that hold it at its start (n; Nm), and the ranges of its joints
    /// (n; rad), without a link and options.
    #[must_use]
    pub fn new(
        arm: Box<dyn Backend + Send>,
        holding_torque_nm: Vec<f64>,
        position_ranges_rad: Vec<(f64, f64)>,
    ) -> Self {
        let capabilities = arm.capabilities();
        let options = Settings::new(capabilities.command, capabilities.joints.clone(), capabilities.period_s);
        Self { arm, holding_torque_nm, position_ranges_rad, link: None, options }
    }
}

/// Simulated devices that are served.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct ServedDevices {
    /// Their place, such as the path of a port.
    pub place: String,
    /// Files that were written for them, each with its meaning in words.
    pub written: Vec<(PathBuf, &'static str)>,
}

impl ServedDevices {
    /// Returns devices at a place, for which nothing was written.
    #[must_use]
    pub fn new(place: impl Into<String>) -> Self {
        Self { place: place.into(), written: Vec::new() }
    }
}

/// Device that a driver has found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundDevice {
    /// Its place, as keys of `[driver]`.
    pub place: String,
    /// Its kind and state.
    pub description: String,
}

/// Settings with which a driver opens a robot: the kind of command, and the joints, period, measured quantities and force
/// sensors stated in robot.toml, for its [`Capabilities`]; and the other keys of `[driver]`.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Settings {
    /// Kind of the commands that will be written.
    pub command: CommandKind,
    /// Joint names, in the order of the model (n).
    pub joints: Vec<String>,
    /// Interface period, s.
    pub period_s: f64,
    /// Force sensors, in the order of [`Sample::wrenches`](crate::Sample::wrenches).
    pub force_sensors: Vec<ForceSensor>,
    /// Quantities that samples contain, as `measured` of `[interface]` states them.
    pub measured: Vec<Measured>,
    /// Side that compensates gravity, as robot.toml states it, for a driver that cannot know.
    pub gravity_compensated_by: GravityCompensation,
    /// True if robot.toml states brakes, for a driver that cannot know.
    pub has_brakes: bool,
    /// Position servos of the joints, as robot.toml states them (n); empty if it states none.
    pub servos: Vec<StatedServo>,
    /// Folder of robot.toml, to which relative paths refer; empty for the working folder.
    pub folder: PathBuf,
    /// True if another run follows at once: a robot that is let go of after a run is held in between.
    pub is_followed: bool,
    values: BTreeMap<String, Setting>,
}

/// Position servo of a joint, as robot.toml states it, for a driver that writes gains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StatedServo {
    /// Stiffness, Nm/rad (N/m).
    pub stiffness_nm_per_rad: f64,
    /// True if its law has an integral.
    pub has_integral: bool,
}

/// Value of a key in `[driver]`.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Setting {
    /// A string.
    Text(String),
    /// An integer or floating-point number.
    Number(f64),
    /// true or false.
    Flag(bool),
    /// An array.
    List(Vec<Setting>),
    /// A table.
    Table(BTreeMap<String, Setting>),
}

impl Settings {
    /// Returns settings without force sensors and keys, of a robot that measures positions, whose controller compensates gravity,
    /// and that has brakes if it accepts torques.
    #[must_use]
    pub fn new(command: CommandKind, joints: Vec<String>, period_s: f64) -> Self {
        Self {
            command,
            joints,
            period_s,
            force_sensors: Vec::new(),
            measured: vec![Measured::Position],
            gravity_compensated_by: GravityCompensation::Controller,
            has_brakes: command == CommandKind::Torque,
            servos: Vec::new(),
            folder: PathBuf::new(),
            is_followed: false,
            values: BTreeMap::new(),
        }
    }

    /// Sets the measured quantities.
    #[must_use]
    pub fn measuring(self, measured: &[Measured]) -> Self {
        Self { measured: measured.to_vec(), ..self }
    }

    /// Sets the side that compensates gravity.
    #[must_use]
    pub fn with_gravity_compensated_by(self, gravity_compensated_by: GravityCompensation) -> Self {
        Self { gravity_compensated_by, ..self }
    }

    /// Sets whether the robot has brakes.
    #[must_use]
    pub fn with_brakes(self, has_brakes: bool) -> Self {
        Self { has_brakes, ..self }
    }

    /// Sets the position servos of the joints (n).
    #[must_use]
    pub fn with_servos(self, servos: Vec<StatedServo>) -> Self {
        Self { servos, ..self }
    }

    /// Sets the folder of robot.toml.
    #[must_use]
    pub fn in_folder(self, folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into(), ..self }
    }

    /// Sets the force sensors.
    #[must_use]
    pub fn with_force_sensors(self, force_sensors: Vec<ForceSensor>) -> Self {
        Self { force_sensors, ..self }
    }

    /// Sets the value of a key.
    #[must_use]
    pub fn with(mut self, key: impl Into<String>, value: Setting) -> Self {
        self.values.insert(key.into(), value);
        self
    }

    /// Returns the string value of a key.
    ///
    /// # Errors
    /// If the key is missing or not a string.
    pub fn text(&self, key: &str) -> Result<&str, DriverError> {
        match self.value(key)? {
            Setting::Text(text) => Ok(text),
            other => Err(wrong(key, "a string", other)),
        }
    }

    /// Returns the path that a key states; a relative one refers to the folder of robot.toml.
    ///
    /// # Errors
    /// If the key is missing or not a string.
    pub fn path(&self, key: &str) -> Result<PathBuf, DriverError> {
        self.text(key).map(|path| self.folder.join(Path::new(path)))
    }

    /// Returns the strings of an array; `None` if the key is missing.
    ///
    /// # Errors
    /// If the value is not an array of strings.
    pub fn texts(&self, key: &str) -> Result<Option<Vec<&str>>, DriverError> {
        self.list(key, "an array of strings", |setting| match setting {
            Setting::Text(text) => Some(text.as_str()),
            _ => None,
        })
    }

    /// Returns the numbers of an array; `None` if the key is missing.
    ///
    /// # Errors
    /// If the value is not an array of numbers.
    pub fn numbers(&self, key: &str) -> Result<Option<Vec<f64>>, DriverError> {
        self.list(key, "an array of numbers", |setting| match setting {
            Setting::Number(number) => Some(*number),
            _ => None,
        })
    }

    /// Returns the number of each joint (n), from an array of n numbers, or from a table by the names of joints; `None` for a joint
    /// that the table leaves out, and for all joints if the key is missing.
    ///
    /// # Errors
    /// If the value is neither of these, a number is not finite, or a joint is unknown.
    pub fn numbers_by_joint(&self, key: &str) -> Result<Vec<Option<f64>>, DriverError> {
        let numbers =
            self.by_joint(key, "an array of numbers, or a table by joint", |setting| match setting {
                Setting::Number(number) => Some(*number),
                _ => None,
            })?;
        if numbers.iter().flatten().any(|number| !number.is_finite()) {
            return Err(DriverError::at(key, format!("'{key}' must have finite numbers")));
        }
        Ok(numbers)
    }

    /// Returns the string of each joint (n), like [`numbers_by_joint`](Self::numbers_by_joint).
    ///
    /// # Errors
    /// If the value is no array of n strings and no table of strings, or a joint is unknown.
    pub fn texts_by_joint(&self, key: &str) -> Result<Vec<Option<&str>>, DriverError> {
        self.by_joint(key, "an array of strings, or a table by joint", |setting| match setting {
            Setting::Text(text) => Some(text.as_str()),
            _ => None,
        })
    }

    fn by_joint<'a, T>(
        &'a self,
        key: &str,
        expected: &str,
        element: impl Fn(&'a Setting) -> Option<T>,
    ) -> Result<Vec<Option<T>>, DriverError> {
        let joints = &self.joints;
        let element = |value| element(value).map(Some).ok_or_else(|| wrong(key, expected, value));
        match self.values.get(key) {
            None => Ok(joints.iter().map(|_| None).collect()),
            Some(Setting::List(values)) if values.len() == joints.len() => {
                values.iter().map(element).collect()
            }
            Some(Setting::List(values)) => {
                let (found, names) = (values.len(), joints.join(", "));
                let words =
                    format!("'{key}' has {found} values; the robot has {} joints: {names}", joints.len());
                Err(DriverError::at(key, words))
            }
            Some(Setting::Table(values)) => {
                if let Some(unknown) = values.keys().find(|name| !joints.contains(name)) {
                    let words = format!(
                        "'{key}' has an unknown joint '{unknown}'; the joints are: {}",
                        joints.join(", ")
                    );
                    return Err(DriverError::at(key, words));
                }
                joints.iter().map(|joint| values.get(joint).map_or(Ok(None), &element)).collect()
            }
            Some(other) => Err(wrong(key, expected, other)),
        }
    }

    fn list<'a, T>(
        &'a self,
        key: &str,
        expected: &str,
        element: impl Fn(&'a Setting) -> Option<T>,
    ) -> Result<Option<Vec<T>>, DriverError> {
        match self.values.get(key) {
            None => Ok(None),
            Some(Setting::List(values)) => {
                let element = |value| element(value).ok_or_else(|| wrong(key, expected, value));
                values.iter().map(element).collect::<Result<_, _>>().map(Some)
            }
            Some(other) => Err(wrong(key, expected, other)),
        }
    }

    /// Returns the numeric value of a key.
    ///
    /// # Errors
    /// If the key is missing or not a number.
    pub fn number(&self, key: &str) -> Result<f64, DriverError> {
        match self.value(key)? {
            Setting::Number(number) => Ok(*number),
            other => Err(wrong(key, "a number", other)),
        }
    }

    /// Returns a finite number above zero; `None` if the key is missing.
    ///
    /// # Errors
    /// If the value is not such a number.
    pub fn positive(&self, key: &str) -> Result<Option<f64>, DriverError> {
        if !self.contains(key) {
            return Ok(None);
        }
        match self.number(key)? {
            number if number.is_finite() && number > 0.0 => Ok(Some(number)),
            number => Err(DriverError::at(key, format!("'{key}' must be above 0, not {number}"))),
        }
    }

    /// Returns a duration above zero and of at most an hour, which the key states in seconds; `default_s` if the key is missing.
    ///
    /// # Errors
    /// If the value is not such a number.
    pub fn seconds(&self, key: &str, default_s: f64) -> Result<Duration, DriverError> {
        match self.positive(key)?.unwrap_or(default_s) {
            number if number <= LONGEST_S => Ok(Duration::from_secs_f64(number)),
            number => {
                Err(DriverError::at(key, format!("'{key}' must be at most {LONGEST_S} s, not {number}")))
            }
        }
    }

    /// Returns the boolean value of a key; false if the key is missing.
    ///
    /// # Errors
    /// If the value is neither true nor false.
    pub fn flag(&self, key: &str) -> Result<bool, DriverError> {
        match self.values.get(key) {
            None => Ok(false),
            Some(Setting::Flag(flag)) => Ok(*flag),
            Some(other) => Err(wrong(key, "true or false", other)),
        }
    }

    /// Returns true if the settings contain a key, for keys that may be missing.
    #[must_use]
    pub fn contains(&self, key: &str) -> bool {
        self.values.contains_key(key)
    }

    /// Checks that the settings contain only keys that the driver knows.
    ///
    /// # Errors
    /// If a key is not among `known`. The error names the first of them and lists the known keys.
    pub fn expect_only(&self, known: &[&str]) -> Result<(), DriverError> {
        match self.values.keys().find(|key| !known.contains(&key.as_str())) {
            None => Ok(()),
            Some(key) => {
                Err(DriverError::at(key, format!("unknown key '{key}'; the keys are: {}", known.join(", "))))
            }
        }
    }

    /// Checks the settings against the keys of a driver: none is unknown, none that is required is missing, and each has a value of
    /// its kind.
    ///
    /// # Errors
    /// The first key that is not so.
    pub fn expect(&self, keys: &[DriverKey]) -> Result<(), DriverError> {
        let names: Vec<&str> = keys.iter().map(|key| key.name).collect();
        self.expect_only(&names)?;
        for key in keys {
            if !self.contains(key.name) {
                match key.is_required {
                    true => self.value(key.name)?,
                    false => continue,
                };
            }
            match key.value {
                KeyValue::Text => self.text(key.name).map(drop)?,
                KeyValue::Number => self.number(key.name).map(drop)?,
                KeyValue::Flag => self.flag(key.name).map(drop)?,
                KeyValue::Texts => self.texts(key.name).map(drop)?,
                KeyValue::Numbers => self.numbers(key.name).map(drop)?,
                KeyValue::TextsByJoint => self.texts_by_joint(key.name).map(drop)?,
                KeyValue::NumbersByJoint => self.numbers_by_joint(key.name).map(drop)?,
            }
        }
        Ok(())
    }

    fn value(&self, key: &str) -> Result<&Setting, DriverError> {
        self.values.get(key).ok_or_else(|| DriverError::at(key, format!("the key '{key}' is missing")))
    }
}

fn wrong(key: &str, expected: &str, found: &Setting) -> DriverError {
    let found = match found {
        Setting::Text(text) => format!("\"{text}\""),
        Setting::Number(number) => number.to_string(),
        Setting::Flag(flag) => flag.to_string(),
        Setting::List(_) => "an array".to_owned(),
        Setting::Table(_) => "a table".to_owned(),
    };
    DriverError::at(key, format!("'{key}' must be {expected}, not {found}"))
}

/// Reason why a robot cannot be opened.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct DriverError {
    /// Key of `[driver]` with the wrong value; `None` if the error concerns no key.
    pub key: Option<String>,
    /// Reason, a sentence without a full stop.
    pub words: String,
}

impl DriverError {
    /// Returns the error of a robot that cannot be reached.
    #[must_use]
    pub fn new(words: impl Into<String>) -> Self {
        Self { key: None, words: words.into() }
    }

    /// Returns the error of a key with a wrong value.
    #[must_use]
    pub fn at(key: impl Into<String>, words: impl Into<String>) -> Self {
        Self { key: Some(key.into()), words: words.into() }
    }
}

/// Warning about settings with which a robot may be opened.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct DriverWarning {
    /// Key of `[driver]` that it concerns.
    pub key: String,
    /// Warning, a sentence without a full stop.
    pub words: String,
}

impl DriverWarning {
    /// Returns a warning about the value of a key.
    #[must_use]
    pub fn at(key: impl Into<String>, words: impl Into<String>) -> Self {
        Self { key: key.into(), words: words.into() }
    }
}

impl fmt::Display for DriverWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.words)
    }
}

impl fmt::Display for DriverError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.words)
    }
}

impl Error for DriverError {}

impl From<DeviceFault> for DriverError {
    fn from(fault: DeviceFault) -> Self {
        Self::new(fault.to_string())
    }
}

#[cfg(feature = "serde")]
impl<'de> serde::Deserialize<'de> for Setting {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct AnySetting;

        impl<'s> serde::de::Visitor<'s> for AnySetting {
            type Value = Setting;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a string, a number, true or false, or an array or table of these")
            }

            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Setting, E> {
                Ok(Setting::Text(text.to_owned()))
            }

            fn visit_f64<E: serde::de::Error>(self, number: f64) -> Result<Setting, E> {
                Ok(Setting::Number(number))
            }

            fn visit_i64<E: serde::de::Error>(self, number: i64) -> Result<Setting, E> {
                Ok(Setting::Number(number as f64))
            }

            fn visit_bool<E: serde::de::Error>(self, flag: bool) -> Result<Setting, E> {
                Ok(Setting::Flag(flag))
            }

            fn visit_seq<A: serde::de::SeqAccess<'s>>(self, mut elements: A) -> Result<Setting, A::Error> {
                let mut list = Vec::new();
                while let Some(element) = elements.next_element()? {
                    list.push(element);
                }
                Ok(Setting::List(list))
            }

            fn visit_map<A: serde::de::MapAccess<'s>>(self, mut entries: A) -> Result<Setting, A::Error> {
                let mut table = BTreeMap::new();
                while let Some((key, value)) = entries.next_entry()? {
                    table.insert(key, value);
                }
                Ok(Setting::Table(table))
            }
        }

        deserializer.deserialize_any(AnySetting)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Setting {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Setting".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({
            "description": "A string, a number, true or false, or an array or table of these.",
            "type": ["string", "number", "boolean", "array", "object"],
            "items": { "type": ["string", "number", "boolean"] },
            "additionalProperties": { "type": ["string", "number", "boolean"] }
        })
    }
}
