//! Drivers: the interface through which a program opens a robot for a run.

use crate::backend::Backend;
use crate::command::CommandKind;
use crate::fault::DeviceFault;
use std::collections::BTreeMap;
use std::error::Error;
use std::fmt;

/// Opens a robot, lets it be run, and closes it.
///
/// The backend lives on the driver's stack while `run` is called, so that it may borrow a vendor's handle.
pub trait Driver {
    /// Its name in `[driver]` of robot.toml.
    fn name(&self) -> &str;

    /// Opens the robot with these settings, calls `run` once with it, and closes it.
    ///
    /// # Errors
    /// Settings that are missing or wrong, or a robot that can't be opened.
    fn with(&self, settings: &Settings, run: &mut dyn FnMut(&mut dyn Backend)) -> Result<(), DriverError>;
}

/// Settings with which a driver opens a robot: the kind of command it is opened for, the joints and period that
/// robot.toml states, and the other keys of `[driver]`.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Settings {
    /// The kind of command that will be written.
    pub command: CommandKind,
    /// Joint names in the model's order.
    pub joints: Vec<String>,
    /// Interface period, s.
    pub period_s: f64,
    values: BTreeMap<String, Setting>,
}

/// A value of a key of `[driver]`.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Setting {
    /// A string.
    Text(String),
    /// A number, whole or not.
    Number(f64),
    /// true or false.
    Flag(bool),
}

impl Settings {
    /// Settings without keys.
    #[must_use]
    pub fn new(command: CommandKind, joints: Vec<String>, period_s: f64) -> Self {
        Self { command, joints, period_s, values: BTreeMap::new() }
    }

    /// Sets the value of a key.
    #[must_use]
    pub fn with(mut self, key: impl Into<String>, value: Setting) -> Self {
        self.values.insert(key.into(), value);
        self
    }

    /// The string of a key.
    ///
    /// # Errors
    /// If the key is missing or not a string.
    pub fn text(&self, key: &str) -> Result<&str, DriverError> {
        match self.value(key)? {
            Setting::Text(text) => Ok(text),
            other => Err(wrong(key, "a string", other)),
        }
    }

    /// The number of a key.
    ///
    /// # Errors
    /// If the key is missing or not a number.
    pub fn number(&self, key: &str) -> Result<f64, DriverError> {
        match self.value(key)? {
            Setting::Number(number) => Ok(*number),
            other => Err(wrong(key, "a number", other)),
        }
    }

    /// The flag of a key; false without the key.
    ///
    /// # Errors
    /// If the key is neither true nor false.
    pub fn flag(&self, key: &str) -> Result<bool, DriverError> {
        match self.values.get(key) {
            None => Ok(false),
            Some(Setting::Flag(flag)) => Ok(*flag),
            Some(other) => Err(wrong(key, "true or false", other)),
        }
    }

    /// Refuses keys that the driver does not know.
    ///
    /// # Errors
    /// The first key that is not among `known`, with the keys that are.
    pub fn expect_only(&self, known: &[&str]) -> Result<(), DriverError> {
        match self.values.keys().find(|key| !known.contains(&key.as_str())) {
            None => Ok(()),
            Some(key) => {
                Err(DriverError::at(key, format!("unknown key '{key}'; the keys are: {}", known.join(", "))))
            }
        }
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
    };
    DriverError::at(key, format!("'{key}' must be {expected}, not {found}"))
}

/// The reason for which a robot can't be opened.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct DriverError {
    /// The key of `[driver]` that is wrong, where one is.
    pub key: Option<String>,
    /// The reason, a sentence without a full stop.
    pub words: String,
}

impl DriverError {
    /// A robot that can't be reached.
    #[must_use]
    pub fn new(words: impl Into<String>) -> Self {
        Self { key: None, words: words.into() }
    }

    /// A wrong value of a key.
    #[must_use]
    pub fn at(key: impl Into<String>, words: impl Into<String>) -> Self {
        Self { key: Some(key.into()), words: words.into() }
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

        impl serde::de::Visitor<'_> for AnySetting {
            type Value = Setting;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a string, a number, true or false")
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
            "description": "A string, a number, true or false.",
            "type": ["string", "number", "boolean"]
        })
    }
}
