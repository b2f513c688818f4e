//! Numbers that a file may hold: what is out of range is refused where it stands.
//!
//! That every number is finite is checked once for a whole file, before these.

use schemars::JsonSchema;
use serde::Deserialize;

/// A number above zero.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd, Deserialize, JsonSchema)]
#[serde(try_from = "f64")]
pub struct Positive(#[schemars(range(min = 0.0))] f64);

/// A number not below zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Deserialize, JsonSchema)]
#[serde(try_from = "f64")]
pub struct NonNegative(#[schemars(range(min = 0.0))] f64);

/// A whole number above zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize, JsonSchema)]
#[serde(try_from = "u32")]
pub struct Count(#[schemars(range(min = 1))] u32);

impl TryFrom<f64> for Positive {
    type Error = String;

    fn try_from(value: f64) -> Result<Self, String> {
        if value.is_finite() && value > 0.0 {
            Ok(Self(value))
        } else {
            Err(format!("expected a number above 0, got {value}"))
        }
    }
}

impl TryFrom<f64> for NonNegative {
    type Error = String;

    fn try_from(value: f64) -> Result<Self, String> {
        if value.is_finite() && value >= 0.0 {
            Ok(Self(value))
        } else {
            Err(format!("expected a number not below 0, got {value}"))
        }
    }
}

impl TryFrom<u32> for Count {
    type Error = String;

    fn try_from(value: u32) -> Result<Self, String> {
        if value > 0 { Ok(Self(value)) } else { Err("expected a whole number above 0, got 0".to_owned()) }
    }
}

impl Positive {
    /// The number.
    #[must_use]
    pub const fn get(self) -> f64 {
        self.0
    }

    /// For defaults in code.
    ///
    /// # Panics
    /// If `value` is not above zero (at compile time in a `const`).
    #[must_use]
    pub const fn literal(value: f64) -> Self {
        assert!(value > 0.0);
        Self(value)
    }
}

impl From<Positive> for NonNegative {
    fn from(value: Positive) -> Self {
        Self(value.0)
    }
}

impl NonNegative {
    /// The number.
    #[must_use]
    pub const fn get(self) -> f64 {
        self.0
    }

    /// For defaults in code.
    ///
    /// # Panics
    /// If `value` is below zero (at compile time in a `const`).
    #[must_use]
    pub const fn literal(value: f64) -> Self {
        assert!(value >= 0.0);
        Self(value)
    }
}

impl Count {
    /// The number.
    #[must_use]
    pub const fn get(self) -> u32 {
        self.0
    }
}
