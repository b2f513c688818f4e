//! Gains as functions of time.

use crate::references::ramp::minimum_jerk;
#[cfg(feature = "schema")]
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::Deserialize;
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Deserializer, MapAccess, SeqAccess, Visitor};
#[cfg(feature = "schema")]
use std::borrow::Cow;
use std::fmt;

/// Gain as a function of time: `[[time_s, value], ...]`. Between two points it follows a minimum-jerk ramp; before the first
/// and after the last point it is constant.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(try_from = "Vec<[f64; 2]>")]
pub struct GainProfile {
    points: Vec<[f64; 2]>,
}

impl GainProfile {
    /// Creates a profile from points of time (s) and value.
    ///
    /// # Errors
    /// No point, times that do not increase or are negative, and values that are negative or not finite.
    pub fn new(points: Vec<[f64; 2]>) -> Result<Self, String> {
        if points.is_empty() {
            return Err("expected at least one point [time_s, value]".to_owned());
        }
        if let Some(index) = points.iter().position(|&[_, value]| value.is_nan() || value < 0.0) {
            let [time_s, value] = points[index];
            return Err(format!(
                "point {index}: expected a time and a value of 0 or above, got [{time_s}, {value}]"
            ));
        }
        check_points(&points)?;
        Ok(Self { points })
    }

    /// Value at a time, s.
    #[must_use]
    pub fn at(&self, time_s: f64) -> f64 {
        value_at(&self.points, time_s).unwrap_or(0.0)
    }
}

/// Checks points of time (s) and value: finite, and times of 0 or above that increase.
pub(crate) fn check_points(points: &[[f64; 2]]) -> Result<(), String> {
    for (index, &[time_s, value]) in points.iter().enumerate() {
        if !(time_s >= 0.0 && time_s.is_finite() && value.is_finite()) {
            return Err(format!(
                "point {index}: expected a time of 0 or above and a finite value, got [{time_s}, {value}]"
            ));
        }
        if index > 0 && time_s <= points[index - 1][0] {
            return Err(format!(
                "point {index} at {time_s} s is not after the previous one at {} s: times must increase",
                points[index - 1][0]
            ));
        }
    }
    Ok(())
}

/// Value of points at a time (s), with minimum-jerk ramps between them; `None` without a point.
pub(crate) fn value_at(points: &[[f64; 2]], time_s: f64) -> Option<f64> {
    let after = points.partition_point(|point| point[0] <= time_s);
    Some(match (after.checked_sub(1).map(|before| points[before]), points.get(after)) {
        (Some([from_s, from]), Some(&[to_s, to])) => {
            from + (to - from) * minimum_jerk(time_s - from_s, to_s - from_s)[0]
        }
        (Some([_, value]), None) | (None, Some(&[_, value])) => value,
        (None, None) => return None,
    })
}

impl TryFrom<Vec<[f64; 2]>> for GainProfile {
    type Error = String;

    fn try_from(points: Vec<[f64; 2]>) -> Result<Self, String> {
        Self::new(points)
    }
}

/// One profile for all axes, or profiles of some axes: in a file, `[[time_s, value], ...]` or a table such as
/// `{ x = [[0.0, 400.0], [2.0, 100.0]] }`.
#[derive(Clone, Debug, PartialEq)]
pub enum AxisProfiles {
    /// One profile for all axes.
    All(GainProfile),
    /// One profile per axis, in the order of [`AXIS_NAMES`](crate::AXIS_NAMES); `None` if none was given.
    Each(Box<[Option<GainProfile>; 6]>),
}

impl AxisProfiles {
    /// Profile of an axis, by its index in [`AXIS_NAMES`](crate::AXIS_NAMES).
    ///
    /// # Panics
    /// If `axis` is more than 5.
    #[must_use]
    pub fn get(&self, axis: usize) -> Option<&GainProfile> {
        match self {
            Self::All(profile) => Some(profile),
            Self::Each(profiles) => profiles[axis].as_ref(),
        }
    }

    /// Indices of the axes that have an individual profile.
    pub(crate) fn named(&self) -> impl Iterator<Item = usize> + '_ {
        (0..6).filter(|&axis| matches!(self, Self::Each(profiles) if profiles[axis].is_some()))
    }
}

impl<'de> Deserialize<'de> for AxisProfiles {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ProfilesVisitor)
    }
}

struct ProfilesVisitor;

impl<'de> Visitor<'de> for ProfilesVisitor {
    type Value = AxisProfiles;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("[[time_s, value], ...], or a table such as { x = [[0.0, 400.0], [2.0, 100.0]] }")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Self::Value, A::Error> {
        GainProfile::deserialize(SeqAccessDeserializer::new(list)).map(AxisProfiles::All)
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
        let Each { x, y, z, rx, ry, rz } = Each::deserialize(MapAccessDeserializer::new(map))?;
        Ok(AxisProfiles::Each(Box::new([x, y, z, rx, ry, rz])))
    }
}

/// Profiles of single axes.
#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Each {
    x: Option<GainProfile>,
    y: Option<GainProfile>,
    z: Option<GainProfile>,
    rx: Option<GainProfile>,
    ry: Option<GainProfile>,
    rz: Option<GainProfile>,
}

#[cfg(feature = "schema")]
impl JsonSchema for GainProfile {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "GainProfile".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "type": "array",
            "minItems": 1,
            "items": { "type": "array", "items": { "type": "number", "minimum": 0.0 }, "minItems": 2, "maxItems": 2 },
        })
    }
}

#[cfg(feature = "schema")]
impl JsonSchema for AxisProfiles {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        "AxisProfiles".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let each = generator.subschema_for::<GainProfile>();
        json_schema!({
            "anyOf": [
                each,
                {
                    "type": "object",
                    "properties": { "x": each, "y": each, "z": each, "rx": each, "ry": each, "rz": each },
                    "additionalProperties": false,
                },
            ]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compared: a profile with the minimum-jerk polynomial between its points, and with its first and last value outside.
    #[test]
    fn profile_is_a_minimum_jerk_ramp_between_points() {
        let profile = GainProfile::new(vec![[1.0, 400.0], [3.0, 100.0], [4.0, 600.0]]).expect("valid");
        let blend = |u: f64| 10.0 * u.powi(3) - 15.0 * u.powi(4) + 6.0 * u.powi(5);
        for (time_s, value) in [
            (0.0, 400.0),
            (1.0, 400.0),
            (1.6, 400.0 - 300.0 * blend(0.3)),
            (3.0, 100.0),
            (3.9, 100.0 + 500.0 * blend(0.9)),
            (4.0, 600.0),
            (9.0, 600.0),
        ] {
            assert!(
                (profile.at(time_s) - value).abs() < 1e-11,
                "{} at {time_s} s, not {value}",
                profile.at(time_s)
            );
        }
    }

    #[test]
    fn invalid_profiles_are_refused() {
        for (text, message) in [
            ("p = []", "expected at least one point"),
            ("p = [[0.0, 1.0], [0.0, 2.0]]", "point 1 at 0 s is not after the previous one at 0 s"),
            ("p = [[0.0, -1.0]]", "point 0: expected a time and a value of 0 or above, got [0, -1]"),
            ("p = { x = [[0.0, nan]] }", "point 0: expected a time and a value of 0 or above"),
            (
                "p = { u = [[0.0, 1.0]] }",
                "unknown field `u`, expected one of `x`, `y`, `z`, `rx`, `ry`, `rz`",
            ),
            ("p = 400.0", "invalid type: floating point `400.0`, expected [[time_s, value], ...]"),
        ] {
            #[derive(Debug, Deserialize)]
            struct File {
                #[expect(dead_code, reason = "only read")]
                p: AxisProfiles,
            }
            let error = toml::from_str::<File>(text).expect_err(text);
            assert!(error.message().starts_with(message), "{text}: {}", error.message());
        }
    }
}
