//! The six axes of a Cartesian task: modes, directions and per-axis values.

use crate::axis_mode::AxisMode;
use crate::error::Reason;
use crate::orientation;
use crate::tasks::controlled_frame::ControlledFrame;
use nalgebra::Matrix3;
use opspace_backend::quantity::{Positive, exactly};
use opspace_model::{Data, FrameId, Model, UnknownFrame, frame_placement};
#[cfg(feature = "schema")]
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Deserializer, Error, IntoDeserializer, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Serialize, Serializer};
#[cfg(feature = "schema")]
use std::borrow::Cow;
use std::fmt;
use std::marker::PhantomData;

/// Names of the axes: three translations, then the rotations about them.
pub const AXIS_NAMES: [&str; 6] = ["x", "y", "z", "rx", "ry", "rz"];

/// One of [`AXIS_NAMES`], as a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Axis {
    X,
    Y,
    Z,
    Rx,
    Ry,
    Rz,
}

/// Mode of each axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Axes {
    /// Mode along the first task axis.
    #[serde(default)]
    pub x: AxisMode,
    /// Mode along the second task axis.
    #[serde(default)]
    pub y: AxisMode,
    /// Mode along the third task axis.
    #[serde(default)]
    pub z: AxisMode,
    /// Mode about the first task axis.
    #[serde(default)]
    pub rx: AxisMode,
    /// Mode about the second task axis.
    #[serde(default)]
    pub ry: AxisMode,
    /// Mode about the third task axis.
    #[serde(default)]
    pub rz: AxisMode,
}

impl Axes {
    /// Returns axes with x, y and z in one mode and all rotations free.
    #[must_use]
    pub fn position(mode: AxisMode) -> Self {
        Self { x: mode, y: mode, z: mode, ..Self::default() }
    }

    /// Returns axes with the rotations about x, y and z in one mode and all translations free.
    #[must_use]
    pub fn orientation(mode: AxisMode) -> Self {
        Self { rx: mode, ry: mode, rz: mode, ..Self::default() }
    }

    /// Returns axes with all six in one mode.
    #[must_use]
    pub fn pose(mode: AxisMode) -> Self {
        Self { rx: mode, ry: mode, rz: mode, ..Self::position(mode) }
    }

    /// Modes in the order of [`AXIS_NAMES`].
    #[must_use]
    pub fn modes(&self) -> [AxisMode; 6] {
        [self.x, self.y, self.z, self.rx, self.ry, self.rz]
    }

    /// Returns true for each axis in `mode`, in the order of [`AXIS_NAMES`].
    #[must_use]
    pub fn with_mode(&self, mode: AxisMode) -> [bool; 6] {
        self.modes().map(|m| m == mode)
    }

    /// Returns true for each axis that is compliant or in force control, in the order of [`AXIS_NAMES`].
    #[must_use]
    pub fn force_axes(&self) -> [bool; 6] {
        self.modes().map(|mode| matches!(mode, AxisMode::Compliant | AxisMode::Force))
    }

    /// Returns true for each axis that belongs to the task, i.e. is not free, in the order of [`AXIS_NAMES`].
    #[must_use]
    pub fn active_axes(&self) -> [bool; 6] {
        self.modes().map(|m| m != AxisMode::Free)
    }
}

/// Directions of a task's axes.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
pub enum AxesFrameParameter {
    /// The axes of the world.
    #[default]
    #[serde(rename = "world")]
    World,
    /// The axes of the robot's base.
    #[serde(rename = "base")]
    Base,
    /// The axes of the task's own frame, which rotate with it.
    #[serde(rename = "task-frame")]
    TaskFrame,
    /// The axes of a named frame, which rotate with it.
    #[serde(rename = "frame")]
    Frame(String),
    /// The axes of the world rotated by roll, pitch and yaw (fixed axes, in that order), rad.
    #[serde(rename = "rpy_rad")]
    RpyRad(#[serde(deserialize_with = "exactly")] [f64; 3]),
    /// Axes that turn with the surface on which the only `force` axis of x, y and z presses, so that this axis remains normal to it.
    #[serde(rename = "surface")]
    Surface(SurfaceAxesParameters),
}

/// Axes of a task on a surface.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SurfaceAxesParameters {
    /// Axes at the start: those of the world rotated by roll, pitch and yaw (fixed axes, in that order), rad.
    #[serde(default, deserialize_with = "exactly")]
    pub rpy_rad: [f64; 3],
    /// Length of the path over which the axes follow the normal, m.
    #[serde(default = "default_length")]
    pub length_m: Positive,
}

const fn default_length() -> Positive {
    Positive::literal(0.003)
}

/// Task axes of one robot: fixed, or those of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AxesFrame {
    /// Fixed axes in the coordinates of the controlled frame, one per column.
    Fixed(Matrix3<f64>),
    /// Axes of a frame.
    Body(FrameId),
}

impl AxesFrameParameter {
    /// Resolves the axes for a robot and the controlled frame of the task; those of a surface as they are at the start.
    ///
    /// # Errors
    /// An unknown frame.
    pub fn resolve(&self, model: &Model, controlled: ControlledFrame) -> Result<AxesFrame, UnknownFrame> {
        Ok(match self {
            Self::World => AxesFrame::Fixed(Matrix3::identity()),
            Self::RpyRad(rpy) | Self::Surface(SurfaceAxesParameters { rpy_rad: rpy, .. }) => {
                AxesFrame::Fixed(orientation::from_rpy(*rpy))
            }
            Self::Frame(name) => AxesFrame::Body(model.frame_id(name)?),
            Self::TaskFrame => match controlled {
                ControlledFrame::Frame(frame) | ControlledFrame::Relative { frame, .. } => {
                    AxesFrame::Body(frame)
                }
                ControlledFrame::CenterOfMass => AxesFrame::Fixed(Matrix3::identity()),
            },
            Self::Base => match model.frames().iter().find(|frame| frame.body.is_none()) {
                Some(base) => AxesFrame::Body(model.frame_id(&base.name)?),
                None => AxesFrame::Fixed(Matrix3::identity()),
            },
        })
    }
}

impl AxesFrame {
    /// Axes before the first state of the robot is known; the identity for axes that rotate.
    pub(crate) fn at_rest(&self) -> Matrix3<f64> {
        match self {
            Self::Fixed(rotation) => *rotation,
            Self::Body(_) => Matrix3::identity(),
        }
    }

    /// Axes in the coordinates of `controlled`, one per column.
    #[must_use]
    pub fn rotation(&self, model: &Model, data: &Data, controlled: ControlledFrame) -> Matrix3<f64> {
        match self {
            Self::Fixed(rotation) => *rotation,
            Self::Body(frame) => {
                let rotation = frame_placement(model, data, *frame).rotation;
                match controlled {
                    ControlledFrame::Relative { .. } => controlled.coordinates(model, data).tr_mul(&rotation),
                    ControlledFrame::Frame(_) | ControlledFrame::CenterOfMass => rotation,
                }
            }
        }
    }
}

/// One value for all axes, or one value per axis: in a file, a number, `[x, y, z]`, `[x, y, z, rx, ry, rz]`, or a table
/// `{ x = 1.0, rz = 2.0 }`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PerAxis<T> {
    /// One value for all axes.
    All(T),
    /// One value per axis, in the order of [`AXIS_NAMES`]; `None` if none was given.
    Each([Option<T>; 6]),
}

impl<T: Copy> PerAxis<T> {
    /// Value of an axis, by its index in [`AXIS_NAMES`].
    ///
    /// # Panics
    /// If `axis` is more than 5.
    #[must_use]
    pub fn get(&self, axis: usize) -> Option<T> {
        match self {
            Self::All(value) => Some(*value),
            Self::Each(values) => values[axis],
        }
    }

    /// Applies `of` to each value.
    pub(crate) fn map<U>(self, of: impl Fn(T) -> U) -> PerAxis<U> {
        match self {
            Self::All(value) => PerAxis::All(of(value)),
            Self::Each(values) => PerAxis::Each(values.map(|value| value.map(&of))),
        }
    }

    /// Indices of the axes that have an individual value.
    pub(crate) fn named(&self) -> impl Iterator<Item = usize> + '_ {
        (0..6).filter(|&axis| matches!(self, Self::Each(values) if values[axis].is_some()))
    }
}

/// A value of all axes as such, values of single axes as a table.
impl<T: Serialize> Serialize for PerAxis<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::All(value) => value.serialize(serializer),
            Self::Each(values) => {
                let given =
                    AXIS_NAMES.iter().zip(values).filter_map(|(axis, value)| Some((axis, value.as_ref()?)));
                serializer.collect_map(given)
            }
        }
    }
}

impl<'de, T: Deserialize<'de> + Copy> Deserialize<'de> for PerAxis<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(PerAxisVisitor(PhantomData))
    }
}

struct PerAxisVisitor<T>(PhantomData<T>);

impl<'de, T: Deserialize<'de> + Copy> Visitor<'de> for PerAxisVisitor<T> {
    type Value = PerAxis<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number, [x, y, z], [x, y, z, rx, ry, rz], or a table such as { x = 1.0, rz = 2.0 }")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Self::Value, E> {
        T::deserialize(value.into_deserializer()).map(PerAxis::All)
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Self::Value, E> {
        T::deserialize(value.into_deserializer()).map(PerAxis::All)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Self::Value, E> {
        T::deserialize(value.into_deserializer()).map(PerAxis::All)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Self::Value, A::Error> {
        let mut values = [None; 6];
        let mut count = 0;
        while let Some(value) = list.next_element()? {
            if let Some(slot) = values.get_mut(count) {
                *slot = Some(value);
            }
            count += 1;
        }
        if count == 3 || count == 6 {
            Ok(PerAxis::Each(values))
        } else {
            Err(A::Error::invalid_length(count, &"3 numbers [x, y, z] or 6 [x, y, z, rx, ry, rz]"))
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut values = [None; 6];
        while let Some((axis, value)) = map.next_entry::<Axis, T>()? {
            values[axis as usize] = Some(value);
        }
        Ok(PerAxis::Each(values))
    }
}

#[cfg(feature = "schema")]
impl<T: JsonSchema> JsonSchema for PerAxis<T> {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> Cow<'static, str> {
        format!("PerAxis_{}", T::schema_name()).into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let each = generator.subschema_for::<T>();
        json_schema!({
            "anyOf": [
                each,
                { "type": "array", "items": each, "minItems": 3, "maxItems": 3 },
                { "type": "array", "items": each, "minItems": 6, "maxItems": 6 },
                {
                    "type": "object",
                    "properties": { "x": each, "y": each, "z": each, "rx": each, "ry": each, "rz": each },
                    "additionalProperties": false,
                },
            ]
        })
    }
}

/// Returns the value of an axis, or an error if there is none.
pub(crate) fn required<T: Copy>(values: &PerAxis<T>, axis: usize) -> Result<T, Reason> {
    values.get(axis).ok_or(Reason::MissingAxis { axis: AXIS_NAMES[axis] })
}
