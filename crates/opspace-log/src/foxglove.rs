//! Three Foxglove message types that a log contains, as protobuf: `foxglove.JointStates`, `foxglove.FrameTransforms`
//! and `foxglove.Log` (<https://docs.foxglove.dev/docs/sdk/schemas>).
//!
//! The definitions in the folder `foxglove` are those of the crate `foxglove` (MIT), which also contains a server for
//! live viewers and fifty more types. The tests compare definitions and messages with that crate. As required by
//! proto3, zero numbers and empty texts are omitted, unless their field is optional.

use prost::encoding::{bytes, double, int32, string, uint32};

/// Message type that viewers support.
pub(crate) trait Message {
    /// Full name of the type.
    const NAME: &'static str;
    /// Serialized `FileDescriptorSet` that defines the type.
    const DEFINITION: &'static [u8];

    /// Appends the message to `out`.
    fn encode(&self, out: &mut Vec<u8>);
}

/// `google.protobuf.Timestamp`.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Timestamp {
    /// Time since 1970, whole seconds.
    pub sec: u32,
    /// Remaining nanoseconds.
    pub nsec: u32,
}

/// `foxglove.JointStates`.
#[derive(Clone, Debug, Default)]
pub(crate) struct JointStates {
    pub timestamp: Timestamp,
    pub joints: Vec<JointState>,
}

/// `foxglove.JointState`.
#[derive(Clone, Debug, Default)]
pub(crate) struct JointState {
    pub name: String,
    /// Position, rad or m.
    pub position: Option<f64>,
    /// Velocity, rad/s or m/s.
    pub velocity: Option<f64>,
    /// Torque or force, N·m or N.
    pub effort: Option<f64>,
}

/// `foxglove.FrameTransforms`.
#[derive(Clone, Debug, Default)]
pub(crate) struct FrameTransforms {
    pub transforms: Vec<FrameTransform>,
}

/// `foxglove.FrameTransform`: placement of the child in the parent.
#[derive(Clone, Debug, Default)]
pub(crate) struct FrameTransform {
    pub timestamp: Timestamp,
    pub parent_frame_id: String,
    pub child_frame_id: String,
    /// Translation x, y, z, m.
    pub translation: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub rotation: [f64; 4],
}

/// `foxglove.Log` with level `WARNING`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Warning {
    pub timestamp: Timestamp,
    pub message: String,
    /// Name of the process.
    pub name: String,
}

impl Message for JointStates {
    const NAME: &'static str = "foxglove.JointStates";
    const DEFINITION: &'static [u8] = include_bytes!("foxglove/JointStates.bin");

    fn encode(&self, out: &mut Vec<u8>) {
        nested(1, out, |out| self.timestamp.encode(out));
        for joint in &self.joints {
            nested(2, out, |out| joint.encode(out));
        }
    }
}

impl Message for FrameTransforms {
    const NAME: &'static str = "foxglove.FrameTransforms";
    const DEFINITION: &'static [u8] = include_bytes!("foxglove/FrameTransforms.bin");

    fn encode(&self, out: &mut Vec<u8>) {
        for transform in &self.transforms {
            nested(1, out, |out| transform.encode(out));
        }
    }
}

impl Message for Warning {
    const NAME: &'static str = "foxglove.Log";
    const DEFINITION: &'static [u8] = include_bytes!("foxglove/Log.bin");

    fn encode(&self, out: &mut Vec<u8>) {
        /// `foxglove.Log.Level.WARNING`.
        const WARNING: i32 = 3;
        nested(1, out, |out| self.timestamp.encode(out));
        int32::encode(2, &WARNING, out);
        text(3, &self.message, out);
        text(4, &self.name, out);
    }
}

impl Timestamp {
    fn encode(self, out: &mut Vec<u8>) {
        for (tag, value) in [(1, self.sec), (2, self.nsec)] {
            if value != 0 {
                uint32::encode(tag, &value, out);
            }
        }
    }
}

impl JointState {
    fn encode(&self, out: &mut Vec<u8>) {
        text(1, &self.name, out);
        // Field 4 is the acceleration.
        for (tag, value) in [(2, self.position), (3, self.velocity), (5, self.effort)] {
            if let Some(value) = value {
                double::encode(tag, &value, out);
            }
        }
    }
}

impl FrameTransform {
    fn encode(&self, out: &mut Vec<u8>) {
        nested(1, out, |out| self.timestamp.encode(out));
        text(2, &self.parent_frame_id, out);
        text(3, &self.child_frame_id, out);
        nested(4, out, |out| numbers(&self.translation, out));
        nested(5, out, |out| numbers(&self.rotation, out));
    }
}

/// Appends the field `tag`, whose content is the message that `encode` appends.
pub(crate) fn nested(tag: u32, out: &mut Vec<u8>, encode: impl FnOnce(&mut Vec<u8>)) {
    let mut message = Vec::new();
    encode(&mut message);
    bytes::encode(tag, &message, out);
}

fn text(tag: u32, value: &String, out: &mut Vec<u8>) {
    if !value.is_empty() {
        string::encode(tag, value, out);
    }
}

/// Appends the numbers as fields 1, 2, …
fn numbers(values: &[f64], out: &mut Vec<u8>) {
    for (tag, value) in (1..).zip(values) {
        if *value != 0.0 {
            double::encode(tag, value, out);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use foxglove::Encode;
    use foxglove::messages::{self, Quaternion, Vector3, log::Level};

    /// Compares the name, the definition and the bytes with those of the crate `foxglove`.
    #[track_caller]
    fn is_foxgloves<M: Message, F: Encode + prost::Message>(own: &M, foreign: &F) {
        let schema = F::get_schema().expect("a schema");
        assert_eq!((schema.name.as_str(), schema.encoding.as_str()), (M::NAME, "protobuf"));
        assert_eq!(&*schema.data, M::DEFINITION);
        let mut bytes = Vec::new();
        own.encode(&mut bytes);
        assert_eq!(bytes, foreign.encode_to_vec());
    }

    const TIMES: [Timestamp; 3] = [
        Timestamp { sec: 0, nsec: 0 },
        Timestamp { sec: u32::MAX, nsec: 999_999_999 },
        Timestamp { sec: 7, nsec: 0 },
    ];

    fn foreign(time: Timestamp) -> Option<messages::Timestamp> {
        Some(messages::Timestamp::new(time.sec, time.nsec))
    }

    /// Compares joints with all values, without values, and with values that proto3 may omit.
    #[test]
    fn joint_states_are_foxgloves() {
        for timestamp in TIMES {
            let joints = vec![
                JointState {
                    name: "elbow".to_owned(),
                    position: Some(1.5),
                    velocity: Some(-0.0),
                    effort: Some(f64::NAN),
                },
                JointState { position: Some(0.0), ..JointState::default() },
            ];
            let joint = |j: &JointState| messages::JointState {
                name: j.name.clone(),
                position: j.position,
                velocity: j.velocity,
                acceleration: None,
                effort: j.effort,
            };
            let theirs = messages::JointStates {
                timestamp: foreign(timestamp),
                joints: joints.iter().map(joint).collect(),
            };
            is_foxgloves(&JointStates { timestamp, joints }, &theirs);
        }
    }

    /// Compares a general placement, and one of zeros.
    #[test]
    fn frame_transforms_are_foxgloves() {
        let placements =
            [([0.1, -0.2, 0.3], [0.5, -0.5, 0.5, 0.5]), ([0.0, -0.0, 0.0], [0.0, -0.0, 0.0, 1.0])];
        let transforms: Vec<FrameTransform> = (TIMES.iter().zip(placements.iter().cycle()))
            .map(|(&timestamp, &(translation, rotation))| FrameTransform {
                timestamp,
                parent_frame_id: "world".to_owned(),
                child_frame_id: "lower arm".repeat(20),
                translation,
                rotation,
            })
            .collect();
        let transform = |t: &FrameTransform| {
            let ([x, y, z], [i, j, k, w]) = (t.translation, t.rotation);
            messages::FrameTransform {
                timestamp: foreign(t.timestamp),
                parent_frame_id: t.parent_frame_id.clone(),
                child_frame_id: t.child_frame_id.clone(),
                translation: Some(Vector3 { x, y, z }),
                rotation: Some(Quaternion { x: i, y: j, z: k, w }),
            }
        };
        let theirs = messages::FrameTransforms { transforms: transforms.iter().map(transform).collect() };
        is_foxgloves(&FrameTransforms { transforms }, &theirs);
    }

    #[test]
    fn warnings_are_foxgloves() {
        for message in ["", "3 records were dropped"] {
            let own =
                Warning { timestamp: TIMES[1], message: message.to_owned(), name: "opspace".to_owned() };
            let theirs = messages::Log {
                timestamp: foreign(own.timestamp),
                level: Level::Warning.into(),
                message: own.message.clone(),
                name: own.name.clone(),
                ..messages::Log::default()
            };
            is_foxgloves(&own, &theirs);
        }
    }
}
