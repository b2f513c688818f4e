//! Values per joint, given by joint names.

use crate::error::{ControlError, Reason};
use opspace_model::Model;
#[cfg(feature = "schema")]
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Deserializer, Error, IntoDeserializer, MapAccess, Visitor};
use serde::{Deserialize, Serialize};
#[cfg(feature = "schema")]
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;

/// One value for all joints, or one value per joint name: in a file, a number or a table `{ shoulder = 1.0, elbow = 2.0
/// }`.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum PerJoint<T> {
    /// One value for all joints.
    All(T),
    /// One value per joint name.
    Each(BTreeMap<String, T>),
}

impl<T: Copy> PerJoint<T> {
    /// Returns one value per joint, in the order of q. `key` is the path of the values in the file.
    ///
    /// # Errors
    /// A name that is not the name of a joint; a joint without a value.
    pub fn resolve(&self, model: &Model, key: &str) -> Result<Vec<T>, ControlError> {
        let map = match self {
            Self::All(value) => return Ok(vec![*value; model.n()]),
            Self::Each(map) => map,
        };
        indices(model, key, map)?;
        (model.joints().iter())
            .map(|joint| {
                let missing = || ControlError::new(key, Reason::MissingJoint { joint: joint.name.clone() });
                map.get(&joint.name).copied().ok_or_else(missing)
            })
            .collect()
    }
}

/// Returns the index and the value of each joint named in `map`, in the order of the map.
pub(crate) fn indices<'a, T>(
    model: &Model,
    key: &str,
    map: &'a BTreeMap<String, T>,
) -> Result<Vec<(usize, &'a T)>, ControlError> {
    (map.iter())
        .map(|(name, value)| match model.joint(name) {
            Ok(joint) => Ok((joint, value)),
            Err(unknown) => Err(ControlError::new(format!("{key}.{name}"), unknown)),
        })
        .collect()
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for PerJoint<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(PerJointVisitor(PhantomData))
    }
}

struct PerJointVisitor<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de>> Visitor<'de> for PerJointVisitor<T> {
    type Value = PerJoint<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number for all joints, or a table with one per joint: { shoulder = 1.0, elbow = 2.0 }")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Self::Value, E> {
        T::deserialize(value.into_deserializer()).map(PerJoint::All)
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Self::Value, E> {
        T::deserialize(value.into_deserializer()).map(PerJoint::All)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Self::Value, E> {
        T::deserialize(value.into_deserializer()).map(PerJoint::All)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut values = BTreeMap::new();
        while let Some((name, value)) = map.next_entry::<String, T>()? {
            values.insert(name, value);
        }
        Ok(PerJoint::Each(values))
    }
}

#[cfg(feature = "schema")]
impl<T: JsonSchema> JsonSchema for PerJoint<T> {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        format!("PerJoint_{}", T::schema_name()).into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let each = generator.subschema_for::<T>();
        json_schema!({ "anyOf": [each, { "type": "object", "additionalProperties": each }] })
    }
}
