//! Number types for values in files. A value out of range is refused when the file is read, at its position in the
//! file.
//!
//! The feature `serde` adds their serialization and deserialization, the feature `schema` also their JSON Schemas with the
//! ranges (schemars).

#[cfg(feature = "schema")]
use schemars::JsonSchema;
#[cfg(feature = "serde")]
use serde::{
    Deserialize, Deserializer, Serialize,
    de::{Error, IgnoredAny, SeqAccess, Visitor},
};

/// A number above zero.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
#[cfg_attr(feature = "serde", derive(Deserialize, Serialize), serde(try_from = "f64"))]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(extend("exclusiveMinimum" = 0)))]
pub struct Positive(f64);

/// A number that is zero or above.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
#[cfg_attr(feature = "serde", derive(Deserialize, Serialize), serde(try_from = "f64"))]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(extend("minimum" = 0)))]
pub struct NonNegative(f64);

/// A number from 0 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
#[cfg_attr(feature = "serde", derive(Deserialize, Serialize), serde(try_from = "f64"))]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(extend("minimum" = 0, "maximum" = 1)))]
pub struct Fraction(f64);

/// An integer above zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(Deserialize, Serialize), serde(try_from = "u32"))]
#[cfg_attr(feature = "schema", derive(JsonSchema), schemars(extend("minimum" = 1)))]
pub struct Count(u32);

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

impl TryFrom<f64> for Fraction {
    type Error = String;

    fn try_from(value: f64) -> Result<Self, String> {
        if (0.0..=1.0).contains(&value) {
            Ok(Self(value))
        } else {
            Err(format!("expected a number from 0 to 1, got {value}"))
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
    /// Returns the number.
    #[must_use]
    pub const fn get(self) -> f64 {
        self.0
    }

    /// Returns a constant, for defaults in code.
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
    /// Returns the number.
    #[must_use]
    pub const fn get(self) -> f64 {
        self.0
    }

    /// Returns a constant, for defaults in code.
    ///
    /// # Panics
    /// If `value` is below zero (at compile time in a `const`).
    #[must_use]
    pub const fn literal(value: f64) -> Self {
        assert!(value >= 0.0);
        Self(value)
    }
}

impl Fraction {
    /// Returns the number.
    #[must_use]
    pub const fn get(self) -> f64 {
        self.0
    }

    /// Returns a constant, for defaults in code.
    ///
    /// # Panics
    /// If `value` is not from 0 to 1 (at compile time in a `const`).
    #[must_use]
    pub const fn literal(value: f64) -> Self {
        assert!(value >= 0.0 && value <= 1.0);
        Self(value)
    }
}

impl Count {
    /// Returns the number.
    #[must_use]
    pub const fn get(self) -> u32 {
        self.0
    }

    /// Returns a constant, for defaults in code.
    ///
    /// # Panics
    /// If `value` is zero (at compile time in a `const`).
    #[must_use]
    pub const fn literal(value: u32) -> Self {
        assert!(value > 0);
        Self(value)
    }
}

/// Reads exactly N values. Without it, the TOML reader ignores surplus values.
///
/// # Errors
/// If there are fewer or more than N values.
#[cfg(feature = "serde")]
pub fn exactly<'de, D, T, const N: usize>(deserializer: D) -> Result<[T; N], D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    struct Exactly<T, const N: usize>(std::marker::PhantomData<T>);

    impl<'de, T: Deserialize<'de>, const N: usize> Visitor<'de> for Exactly<T, N> {
        type Value = [T; N];

        fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            write!(f, "{N} values")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut values: A) -> Result<[T; N], A::Error> {
            let mut read = Vec::with_capacity(N);
            while read.len() < N {
                match values.next_element()? {
                    Some(value) => read.push(value),
                    None => return Err(A::Error::invalid_length(read.len(), &self)),
                }
            }
            let mut count = N;
            while values.next_element::<IgnoredAny>()?.is_some() {
                count += 1;
            }
            if count > N {
                return Err(A::Error::invalid_length(count, &self));
            }
            read.try_into().map_err(|_| A::Error::invalid_length(count, &self))
        }
    }

    deserializer.deserialize_seq(Exactly(std::marker::PhantomData))
}
