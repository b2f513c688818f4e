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
    /// Layout of its rows. `/joint_states` and `/tf` are computed from the signals `q`, `dq` and `motor_torque` of the
    /// channel named `tick`.
    pub layout: Layout,
    /// Rate of the rows, Hz; it determines the size of the ring.
    pub rate_hz: f64,
}
