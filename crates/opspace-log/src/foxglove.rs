//! Foxglove message types that a log contains, as protobuf: `foxglove.JointStates`, `foxglove.FrameTransforms`,
//! `foxglove.PoseInFrame`, `foxglove.SceneUpdate` and `foxglove.Log` (<https://docs.foxglove.dev/docs/sdk/schemas>);
//! and the text message of ROS 2 in which viewers expect a URDF.
//!
//! The definitions in the folder `foxglove` are those of the crate `foxglove` (MIT), which also contains a server for
//! live viewers and fifty more types. The tests compare definitions and messages with that crate. As required by
//! proto3, zero numbers and empty texts are omitted, unless their field is optional.

use prost::encoding::{bool, bytes, double, int32, string, uint32};

/// Message type that viewers support.
pub(crate) trait Message: Encode {
    /// Type of the message.
    const KIND: Kind;
}

/// Type of messages of a topic.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kind {
    /// Full name of the type.
    pub name: &'static str,
    /// Encoding of its definition, and of the messages.
    pub encodings: [&'static str; 2],
    /// Definition: for protobuf a serialized `FileDescriptorSet`.
    pub definition: &'static [u8],
}

impl Kind {
    const fn protobuf(name: &'static str, definition: &'static [u8]) -> Self {
        Self { name, encodings: ["protobuf", "protobuf"], definition }
    }
}

/// Message that can be written.
pub(crate) trait Encode {
    /// Appends the message to `out`.
    fn encode(&self, out: &mut Vec<u8>);
}

/// `std_msgs/msg/String` of ROS 2.
#[derive(Clone, Debug, Default)]
pub(crate) struct RosText(pub String);

/// `foxglove.PoseInFrame`.
#[derive(Clone, Debug, Default)]
pub(crate) struct PoseInFrame {
    pub timestamp: Timestamp,
    pub frame_id: String,
    pub pose: Pose,
}

/// `foxglove.Pose`.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pose {
    /// Position x, y, z, m.
    pub position: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
}

/// `foxglove.SceneUpdate`: an entity replaces the former one with the same id.
#[derive(Clone, Debug, Default)]
pub(crate) struct SceneUpdate {
    pub entities: Vec<SceneEntity>,
}

/// `foxglove.SceneEntity`.
#[derive(Clone, Debug, Default)]
pub(crate) struct SceneEntity {
    pub timestamp: Timestamp,
    pub frame_id: String,
    pub id: String,
    pub arrows: Vec<Arrow>,
    pub cubes: Vec<Cube>,
    pub spheres: Vec<Sphere>,
    pub cylinders: Vec<Cylinder>,
    pub lines: Vec<Line>,
}

/// `foxglove.ArrowPrimitive`, which points along x of its pose.
#[derive(Clone, Debug, Default)]
pub(crate) struct Arrow {
    pub pose: Pose,
    /// Length and diameter of the shaft, then of the head, m.
    pub sizes: [f64; 4],
    /// Red, green, blue and opacity, 0 to 1.
    pub color: [f64; 4],
}

/// `foxglove.CubePrimitive`: a box, centred at its pose.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cube {
    pub pose: Pose,
    /// Size along x, y and z, m.
    pub size: [f64; 3],
    /// Red, green, blue and opacity, 0 to 1.
    pub color: [f64; 4],
}

/// `foxglove.SpherePrimitive`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sphere {
    /// Centre.
    pub pose: Pose,
    /// Diameters along x, y and z, m.
    pub size: [f64; 3],
    /// Red, green, blue and opacity, 0 to 1.
    pub color: [f64; 4],
}

/// `foxglove.CylinderPrimitive` with equal ends.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cylinder {
    /// Middle; z is its axis.
    pub pose: Pose,
    /// Diameters along x and y, and length, m.
    pub size: [f64; 3],
    /// Red, green, blue and opacity, 0 to 1.
    pub color: [f64; 4],
}

/// `foxglove.LinePrimitive` of type `LINE_STRIP`, with a thickness in pixels.
#[derive(Clone, Debug, Default)]
pub(crate) struct Line {
    /// Thickness, pixels.
    pub thickness: f64,
    /// Points, m.
    pub points: Vec<[f64; 3]>,
    /// Red, green, blue and opacity, 0 to 1.
    pub color: [f64; 4],
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
    const KIND: Kind = Kind::protobuf("foxglove.JointStates", include_bytes!("foxglove/JointStates.bin"));
}

impl Encode for JointStates {
    fn encode(&self, out: &mut Vec<u8>) {
        nested(1, out, |out| self.timestamp.encode(out));
        for joint in &self.joints {
            nested(2, out, |out| joint.encode(out));
        }
    }
}

impl Message for FrameTransforms {
    const KIND: Kind =
        Kind::protobuf("foxglove.FrameTransforms", include_bytes!("foxglove/FrameTransforms.bin"));
}

impl Encode for FrameTransforms {
    fn encode(&self, out: &mut Vec<u8>) {
        for transform in &self.transforms {
            nested(1, out, |out| transform.encode(out));
        }
    }
}

impl Message for PoseInFrame {
    const KIND: Kind = Kind::protobuf("foxglove.PoseInFrame", include_bytes!("foxglove/PoseInFrame.bin"));
}

impl Encode for PoseInFrame {
    fn encode(&self, out: &mut Vec<u8>) {
        nested(1, out, |out| self.timestamp.encode(out));
        text(2, &self.frame_id, out);
        nested(3, out, |out| self.pose.encode(out));
    }
}

impl Message for SceneUpdate {
    const KIND: Kind = Kind::protobuf("foxglove.SceneUpdate", include_bytes!("foxglove/SceneUpdate.bin"));
}

impl Encode for SceneUpdate {
    fn encode(&self, out: &mut Vec<u8>) {
        for entity in &self.entities {
            nested(2, out, |out| entity.encode(out));
        }
    }
}

impl Message for RosText {
    const KIND: Kind =
        Kind { name: "std_msgs/msg/String", encodings: ["ros2msg", "cdr"], definition: b"string data\n" };
}

impl Encode for RosText {
    /// Common Data Representation, little endian: a header, and the text with its length and a final zero.
    fn encode(&self, out: &mut Vec<u8>) {
        out.extend([0, 1, 0, 0]);
        out.extend((self.0.len() as u32 + 1).to_le_bytes());
        out.extend(self.0.as_bytes());
        out.push(0);
    }
}

impl Message for Warning {
    const KIND: Kind = Kind::protobuf("foxglove.Log", include_bytes!("foxglove/Log.bin"));
}

impl Encode for Warning {
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

impl Pose {
    fn encode(&self, out: &mut Vec<u8>) {
        nested(1, out, |out| numbers(&self.position, out));
        nested(2, out, |out| numbers(&self.orientation, out));
    }
}

impl SceneEntity {
    fn encode(&self, out: &mut Vec<u8>) {
        nested(1, out, |out| self.timestamp.encode(out));
        text(2, &self.frame_id, out);
        text(3, &self.id, out);
        for arrow in &self.arrows {
            nested(7, out, |out| {
                nested(1, out, |out| arrow.pose.encode(out));
                (2..).zip(&arrow.sizes).for_each(|(tag, size)| number(tag, *size, out));
                nested(6, out, |out| numbers(&arrow.color, out));
            });
        }
        for cube in &self.cubes {
            nested(8, out, |out| {
                nested(1, out, |out| cube.pose.encode(out));
                nested(2, out, |out| numbers(&cube.size, out));
                nested(3, out, |out| numbers(&cube.color, out));
            });
        }
        for sphere in &self.spheres {
            nested(9, out, |out| {
                nested(1, out, |out| sphere.pose.encode(out));
                nested(2, out, |out| numbers(&sphere.size, out));
                nested(3, out, |out| numbers(&sphere.color, out));
            });
        }
        for cylinder in &self.cylinders {
            nested(10, out, |out| {
                nested(1, out, |out| cylinder.pose.encode(out));
                nested(2, out, |out| numbers(&cylinder.size, out));
                // Ratios of the ends to the size.
                [3, 4].into_iter().for_each(|tag| number(tag, 1.0, out));
                nested(5, out, |out| numbers(&cylinder.color, out));
            });
        }
        for line in &self.lines {
            nested(11, out, |out| {
                number(3, line.thickness, out);
                bool::encode(4, &true, out);
                line.points.iter().for_each(|point| nested(5, out, |out| numbers(point, out)));
                nested(6, out, |out| numbers(&line.color, out));
            });
        }
    }
}

/// Appends the field `tag`, whose content is the message that `encode` appends.
fn nested(tag: u32, out: &mut Vec<u8>, encode: impl FnOnce(&mut Vec<u8>)) {
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
    (1..).zip(values).for_each(|(tag, value)| number(tag, *value, out));
}

fn number(tag: u32, value: f64, out: &mut Vec<u8>) {
    if value != 0.0 {
        double::encode(tag, &value, out);
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
        assert_eq!((schema.name.as_str(), schema.encoding.as_str()), (M::KIND.name, "protobuf"));
        assert_eq!(&*schema.data, M::KIND.definition);
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

    fn their_pose(pose: Pose) -> Option<messages::Pose> {
        let ([x, y, z], [i, j, k, w]) = (pose.position, pose.orientation);
        Some(messages::Pose {
            position: Some(Vector3 { x, y, z }),
            orientation: Some(Quaternion { x: i, y: j, z: k, w }),
        })
    }

    const POSE: Pose = Pose { position: [0.1, 0.0, -0.3], orientation: [0.5, -0.5, 0.5, 0.5] };

    #[test]
    fn poses_are_foxgloves() {
        for timestamp in TIMES {
            let own = PoseInFrame { timestamp, frame_id: "world".to_owned(), pose: POSE };
            let theirs = messages::PoseInFrame {
                timestamp: foreign(timestamp),
                frame_id: own.frame_id.clone(),
                pose: their_pose(POSE),
            };
            is_foxgloves(&own, &theirs);
        }
    }

    /// Compares an entity with each primitive, and one without any.
    #[test]
    fn scenes_are_foxgloves() {
        let color = [0.9, 0.0, 0.2, 1.0];
        let full = SceneEntity {
            timestamp: TIMES[1],
            frame_id: "world".to_owned(),
            id: "wall".to_owned(),
            arrows: vec![Arrow { pose: POSE, sizes: [0.5, 0.02, 0.1, 0.04], color }],
            cubes: vec![Cube { pose: POSE, size: [0.01, 1.0, 1.0], color }],
            spheres: vec![Sphere { pose: POSE, size: [0.1; 3], color }],
            cylinders: vec![Cylinder { pose: POSE, size: [0.1, 0.1, 0.5], color }],
            lines: vec![Line { thickness: 2.0, points: vec![[0.0, 1.0, 2.0], [0.0; 3]], color }],
        };
        let [r, g, b, a] = color;
        let theirs = messages::SceneEntity {
            timestamp: foreign(TIMES[1]),
            frame_id: "world".to_owned(),
            id: "wall".to_owned(),
            arrows: vec![messages::ArrowPrimitive {
                pose: their_pose(POSE),
                shaft_length: 0.5,
                shaft_diameter: 0.02,
                head_length: 0.1,
                head_diameter: 0.04,
                color: Some(messages::Color { r, g, b, a }),
            }],
            cubes: vec![messages::CubePrimitive {
                pose: their_pose(POSE),
                size: Some(Vector3 { x: 0.01, y: 1.0, z: 1.0 }),
                color: Some(messages::Color { r, g, b, a }),
            }],
            spheres: vec![messages::SpherePrimitive {
                pose: their_pose(POSE),
                size: Some(Vector3 { x: 0.1, y: 0.1, z: 0.1 }),
                color: Some(messages::Color { r, g, b, a }),
            }],
            cylinders: vec![messages::CylinderPrimitive {
                pose: their_pose(POSE),
                size: Some(Vector3 { x: 0.1, y: 0.1, z: 0.5 }),
                bottom_scale: 1.0,
                top_scale: 1.0,
                color: Some(messages::Color { r, g, b, a }),
            }],
            lines: vec![messages::LinePrimitive {
                thickness: 2.0,
                scale_invariant: true,
                points: vec![
                    messages::Point3 { x: 0.0, y: 1.0, z: 2.0 },
                    messages::Point3 { x: 0.0, y: 0.0, z: 0.0 },
                ],
                color: Some(messages::Color { r, g, b, a }),
                ..messages::LinePrimitive::default()
            }],
            ..messages::SceneEntity::default()
        };
        let empty =
            messages::SceneEntity { timestamp: foreign(TIMES[0]), ..messages::SceneEntity::default() };
        let entities = vec![full, SceneEntity::default()];
        let theirs =
            messages::SceneUpdate { entities: vec![theirs, empty], ..messages::SceneUpdate::default() };
        is_foxgloves(&SceneUpdate { entities }, &theirs);
    }

    /// Compares a text with the bytes that ROS 2 serializes for it.
    #[test]
    fn text_is_that_of_ros() {
        let mut bytes = Vec::new();
        super::Encode::encode(&RosText("<r/>".to_owned()), &mut bytes);
        assert_eq!(bytes, b"\0\x01\0\0\x05\0\0\0<r/>\0");
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
