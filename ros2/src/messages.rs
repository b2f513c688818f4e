//! Messages of ROS 2 that the node sends and receives, in the order of their fields on the wire.

use ros2_client::{Message, MessageTypeName};
use serde::{Deserialize, Serialize};

/// Message with the name of its type.
pub trait Named: Message + Clone + 'static {
    /// Package and name of the type.
    const TYPE: (&'static str, &'static str);

    /// Name of the type, for topics.
    #[must_use]
    fn type_name() -> MessageTypeName {
        MessageTypeName::new(Self::TYPE.0, Self::TYPE.1)
    }
}

macro_rules! named {
    ($($message:ident $package:literal $name:literal)*) => {
        $(
            impl Message for $message {}

            impl Named for $message {
                const TYPE: (&'static str, &'static str) = ($package, $name);
            }
        )*
    };
}

named! {
    JointState "sensor_msgs" "JointState"
    Float64MultiArray "std_msgs" "Float64MultiArray"
    JointTrajectory "trajectory_msgs" "JointTrajectory"
    WrenchStamped "geometry_msgs" "WrenchStamped"
    PoseStamped "geometry_msgs" "PoseStamped"
    TwistStamped "geometry_msgs" "TwistStamped"
    TfMessage "tf2_msgs" "TFMessage"
    DiagnosticArray "diagnostic_msgs" "DiagnosticArray"
    Text "std_msgs" "String"
    Flag "std_msgs" "Bool"
}

impl Message for TriggerRequest {}
impl Message for TriggerResponse {}

/// Time, `builtin_interfaces/Time`; also a duration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Seconds.
    pub sec: i32,
    /// Nanoseconds of the second.
    pub nanosec: u32,
}

impl Stamp {
    /// Returns a time after the epoch, s; those beyond 2038 are the largest.
    #[must_use]
    pub fn from_seconds(time_s: f64) -> Self {
        let sec = time_s.floor();
        Self { sec: sec as i32, nanosec: ((time_s - sec) * 1e9) as u32 }
    }

    /// Returns the time of the computer's clock.
    #[must_use]
    pub fn now() -> Self {
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        Self { sec: i32::try_from(now.as_secs()).unwrap_or(i32::MAX), nanosec: now.subsec_nanos() }
    }

    /// Time since another stamp, s; exact to a nanosecond.
    #[must_use]
    pub fn since_s(self, other: Self) -> f64 {
        (f64::from(self.sec) - f64::from(other.sec))
            + (f64::from(self.nanosec) - f64::from(other.nanosec)) * 1e-9
    }
}

/// Header, `std_msgs/Header`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Time of the message.
    pub stamp: Stamp,
    /// Name of the frame in whose axes the message is.
    pub frame_id: String,
}

/// State of joints.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointState {
    /// Time of the measurement.
    pub header: Header,
    /// Names of the joints (n).
    pub name: Vec<String>,
    /// Positions, rad or m (n, or 0).
    pub position: Vec<f64>,
    /// Velocities, rad/s or m/s (n, or 0).
    pub velocity: Vec<f64>,
    /// Efforts, Nm or N (n, or 0).
    pub effort: Vec<f64>,
}

/// Dimension of an array.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MultiArrayDimension {
    /// Name.
    pub label: String,
    /// Number of elements.
    pub size: u32,
    /// Distance of elements.
    pub stride: u32,
}

/// Layout of an array.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MultiArrayLayout {
    /// Dimensions.
    pub dim: Vec<MultiArrayDimension>,
    /// Index of the first element.
    pub data_offset: u32,
}

/// Array of numbers; controllers read its data alone.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Float64MultiArray {
    /// Layout.
    pub layout: MultiArrayLayout,
    /// Elements.
    pub data: Vec<f64>,
}

/// Trajectory of joints.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectory {
    /// Time at which it begins; zero is the time of its arrival.
    pub header: Header,
    /// Names of the joints (n).
    pub joint_names: Vec<String>,
    /// Points.
    pub points: Vec<JointTrajectoryPoint>,
}

/// Point of a trajectory.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectoryPoint {
    /// Positions, rad or m (n).
    pub positions: Vec<f64>,
    /// Velocities, rad/s or m/s (n, or 0).
    pub velocities: Vec<f64>,
    /// Accelerations, rad/s² or m/s² (n, or 0).
    pub accelerations: Vec<f64>,
    /// Efforts, Nm or N (n, or 0).
    pub effort: Vec<f64>,
    /// Time since the begin of the trajectory.
    pub time_from_start: Stamp,
}

/// Vector.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vector3 {
    /// First component.
    pub x: f64,
    /// Second component.
    pub y: f64,
    /// Third component.
    pub z: f64,
}

impl From<Vector3> for [f64; 3] {
    fn from(vector: Vector3) -> Self {
        [vector.x, vector.y, vector.z]
    }
}

impl From<[f64; 3]> for Vector3 {
    fn from([x, y, z]: [f64; 3]) -> Self {
        Self { x, y, z }
    }
}

/// Unit quaternion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// First imaginary part.
    pub x: f64,
    /// Second imaginary part.
    pub y: f64,
    /// Third imaginary part.
    pub z: f64,
    /// Real part.
    pub w: f64,
}

impl Default for Quaternion {
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

/// Force and moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Wrench {
    /// Force, N.
    pub force: Vector3,
    /// Moment, Nm.
    pub torque: Vector3,
}

/// Force and moment in a frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct WrenchStamped {
    /// Time and frame.
    pub header: Header,
    /// Force and moment.
    pub wrench: Wrench,
}

/// Position and orientation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Position, m.
    pub position: Vector3,
    /// Orientation.
    pub orientation: Quaternion,
}

/// Pose in a frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseStamped {
    /// Time and frame.
    pub header: Header,
    /// Pose.
    pub pose: Pose,
}

/// Velocities.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// Linear velocity, m/s.
    pub linear: Vector3,
    /// Angular velocity, rad/s.
    pub angular: Vector3,
}

/// Velocities in a frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TwistStamped {
    /// Time and frame.
    pub header: Header,
    /// Velocities.
    pub twist: Twist,
}

/// Placement of a frame in its parent.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TransformStamped {
    /// Time, and name of the parent.
    pub header: Header,
    /// Name of the frame.
    pub child_frame_id: String,
    /// Placement.
    pub transform: Transform,
}

/// Translation and rotation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// Translation, m.
    pub translation: Vector3,
    /// Rotation.
    pub rotation: Quaternion,
}

/// Placements of frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TfMessage {
    /// Placements.
    pub transforms: Vec<TransformStamped>,
}

/// Diagnostics of several devices.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// Time.
    pub header: Header,
    /// Diagnostics.
    pub status: Vec<DiagnosticStatus>,
}

/// Diagnostics of a device.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// 0 good, 1 a warning, 2 an error, 3 no longer reported.
    pub level: u8,
    /// Name of the device.
    pub name: String,
    /// Its state, in words.
    pub message: String,
    /// Identifier of the hardware.
    pub hardware_id: String,
    /// Values by name.
    pub values: Vec<KeyValue>,
}

/// Value with a name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct KeyValue {
    /// Name.
    pub key: String,
    /// Value.
    pub value: String,
}

/// Text.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Text {
    /// The text.
    pub data: String,
}

/// Truth value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Flag {
    /// The value.
    pub data: bool,
}

/// Request of the service `std_srvs/Trigger`: a message without fields, which has one byte on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerRequest {
    /// Byte without a meaning.
    pub structure_needs_at_least_one_member: u8,
}

/// Response of the service `std_srvs/Trigger`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerResponse {
    /// True if it was done.
    pub success: bool,
    /// Result in words, or the reason why it was not done.
    pub message: String,
}
