//! What stands in a log beside the rows.

use opspace_backend::Layout;
use opspace_model::Model;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Time 0 of the robot's clock in the log's timestamps, ns: these can't be negative, and a run may begin
/// shortly before 0. The rows hold the exact time in seconds.
pub const TIME_ZERO_NS: u64 = 10_000_000_000;

/// Name of the metadata record that every log has: `version` of opspace, `time_zero_ns`, `clock`.
pub const LOG: &str = "opspace.log";

/// Name of the metadata record of a log that lost rows: `records`, and `gaps`, a JSON list of objects with
/// `from_s`, `to_s` and `records`.
pub const GAPS: &str = "opspace.gaps";

/// What is known before the run. It is written first, so that a log cut short still has it.
#[derive(Clone, Debug, Default)]
pub struct Header {
    /// Named tables: seeds, hashes, overrides.
    pub metadata: Vec<(String, BTreeMap<String, String>)>,
    /// Whole files: the URDF, robot.toml, the task.
    pub attachments: Vec<Attachment>,
    /// With the robot, the log shows where its links are (`/tf`); needs `q` in the channel `tick`.
    pub model: Option<Arc<Model>>,
}

/// A file within the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// File name.
    pub name: String,
    /// Media type, as `application/toml`.
    pub media_type: String,
    /// Content.
    pub data: Vec<u8>,
}

impl Attachment {
    /// A file of that content.
    #[must_use]
    pub fn new(name: impl Into<String>, media_type: impl Into<String>, data: impl Into<Vec<u8>>) -> Self {
        Self { name: name.into(), media_type: media_type.into(), data: data.into() }
    }
}

/// A channel to be recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// What stands in its rows. The channel called `tick` feeds `/joint_states` and `/tf` from its
    /// signals `q`, `dq` and `motor_torque`.
    pub layout: Layout,
    /// How often a row comes, Hz: the ring is sized by it.
    pub rate_hz: f64,
}
