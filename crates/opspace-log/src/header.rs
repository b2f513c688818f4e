//! Contents of a log in addition to its rows.

use opspace_backend::Layout;
use opspace_model::Model;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Time 0 of the robot's clock in the log's timestamps, ns. Timestamps can't be negative, and a run may begin shortly
/// before 0. The rows contain the exact time in seconds.
pub const TIME_ZERO_NS: u64 = 10_000_000_000;

/// Name of the metadata record of every log: `version` of opspace, `time_zero_ns`, `clock`.
pub const LOG: &str = "opspace.log";

/// Name of the metadata record of a log that lost rows: `records`, and `gaps`, a JSON list of objects with
/// `from_s`, `to_s` and `records`.
pub const GAPS: &str = "opspace.gaps";

/// Data known before the run. They are written first, so that a truncated log still has them.
#[derive(Clone, Debug, Default)]
pub struct Header {
    /// Named tables: seeds, hashes, overrides.
    pub metadata: Vec<(String, BTreeMap<String, String>)>,
    /// Whole files: the URDF, robot.toml, the task.
    pub attachments: Vec<Attachment>,
    /// Model of the robot, for the poses of its links in the log (`/tf`); needs `q` in the channel `tick`.
    pub model: Option<Arc<Model>>,
    /// Scene that viewers show beside the links.
    pub scene: Scene,
}

/// Scene that viewers show beside the poses of the links.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// URDF for the topic `/robot_description`.
    pub robot_description: Option<String>,
    /// Frame in whose coordinates a task's poses are given, by the name of the task; the world for all other tasks.
    pub relative_to: BTreeMap<String, String>,
    /// Walls of the environment, and half-spaces that the robot avoids.
    pub walls: Vec<Wall>,
    /// Capsules of the robot and obstacles.
    pub capsules: Vec<SceneCapsule>,
    /// Forces, shown as arrows.
    pub forces: Vec<ForceArrow>,
    /// Objects that robots hold, and whose poses are true signals.
    pub objects: Vec<SceneObject>,
}

/// Object with the true signals `NAME.position` (m) and, unless it is a ball, `NAME.orientation` (quaternion w, x, y, z).
#[derive(Clone, Debug, PartialEq)]
pub struct SceneObject {
    /// Name.
    pub name: String,
    /// Shape about its position.
    pub shape: ObjectShape,
}

/// Shape of an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ObjectShape {
    /// Box with its size along the axes of the object, m.
    Box([f64; 3]),
    /// Ball with its diameter, m.
    Ball(f64),
}

/// Plane of the environment.
#[derive(Clone, Debug, PartialEq)]
pub struct Wall {
    /// Name.
    pub name: String,
    /// Point of the plane in world coordinates, m.
    pub point_m: [f64; 3],
    /// Outward normal in world axes; any length except 0.
    pub normal: [f64; 3],
}

/// Capsule: all points within a radius of a line segment.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneCapsule {
    /// Name.
    pub name: String,
    /// Link to which it is fixed; the world if `None`.
    pub frame: Option<String>,
    /// First end of the axis in the frame, m.
    pub start_m: [f64; 3],
    /// Second end of the axis in the frame, m.
    pub end_m: [f64; 3],
    /// Radius, m.
    pub radius_m: f64,
}

/// Force on a frame, shown as an arrow.
#[derive(Clone, Debug, PartialEq)]
pub struct ForceArrow {
    /// Name of the channel of its signal.
    pub channel: String,
    /// Name of its signal: N in world axes, in the first three elements.
    pub signal: String,
    /// Name of the frame on whose origin it acts.
    pub frame: String,
}

/// File within the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// File name.
    pub name: String,
    /// Media type, for example `application/toml`.
    pub media_type: String,
    /// Content.
    pub data: Vec<u8>,
}

impl Attachment {
    /// Returns an attachment with that name, media type and content.
    #[must_use]
    pub fn new(name: impl Into<String>, media_type: impl Into<String>, data: impl Into<Vec<u8>>) -> Self {
        Self { name: name.into(), media_type: media_type.into(), data: data.into() }
    }
}

/// Channel to be recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Layout of its rows. The topics for viewers are computed from the signals of the channel named `tick`.
    pub layout: Layout,
    /// Rate of the rows, Hz; it determines the size of the ring.
    pub rate_hz: f64,
}
