"""A robot by Cyclone DDS, without ROS and rclpy: types and topics written out. Its joints follow the commands at once.

    cyclone_robot.py FOLDER

reads /tf too, records commands and /tf as a bag in FOLDER, and prints counts as JSON when the commands have ended.

    cyclone_robot.py --frame

is no robot: it publishes the frame `table` on /tf_static, 0.2 m above `pedestal`, until its input ends.
"""

import json
import sys
import threading
import time
from dataclasses import dataclass

from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

JOINTS = ["base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3"]
START = [0.0, -1.5708, -1.5708, -1.5708, 1.5708, 0.0]
PERIOD_S = 0.004


@dataclass
class Time_(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header_(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time_
    frame_id: str


@dataclass
class JointState_(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    header: Header_
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
class Dimension_(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayDimension_"):
    label: str
    size: uint32
    stride: uint32


@dataclass
class Layout_(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayLayout_"):
    dim: sequence[Dimension_]
    data_offset: uint32


@dataclass
class Array_(IdlStruct, typename="std_msgs::msg::dds_::Float64MultiArray_"):
    layout: Layout_
    data: sequence[float64]


@dataclass
class Vector3_(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion_(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Transform_(IdlStruct, typename="geometry_msgs::msg::dds_::Transform_"):
    translation: Vector3_
    rotation: Quaternion_


@dataclass
class TransformStamped_(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header_
    child_frame_id: str
    transform: Transform_


@dataclass
class TFMessage_(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[TransformStamped_]


@dataclass
class Wrench_(IdlStruct, typename="geometry_msgs::msg::dds_::Wrench_"):
    force: Vector3_
    torque: Vector3_


@dataclass
class WrenchStamped_(IdlStruct, typename="geometry_msgs::msg::dds_::WrenchStamped_"):
    header: Header_
    wrench: Wrench_


participant = DomainParticipant(0)
if sys.argv[1] == "--frame":
    kept = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
    frames = DataWriter(participant, Topic(participant, "rt/tf_static", TFMessage_, qos=kept), qos=kept)
    placement = Transform_(Vector3_(0.0, 0.0, 0.2), Quaternion_(0.0, 0.0, 0.0, 1.0))
    frames.write(TFMessage_([TransformStamped_(Header_(Time_(0, 0), "pedestal"), "table", placement)]))
    print("ready", flush=True)
    sys.stdin.read()
    sys.exit()
quality = Qos(Policy.Reliability.Reliable(duration(milliseconds=100)), Policy.History.KeepLast(10))
states = DataWriter(participant, Topic(participant, "rt/joint_states", JointState_, qos=quality))
wrenches = DataWriter(participant, Topic(participant, "rt/wrist/wrench", WrenchStamped_, qos=quality))
readers = {
    "/forward_position_controller/commands": DataReader(participant, Topic(participant, "rt/forward_position_controller/commands", Array_, qos=quality)),
    "/tf": DataReader(participant, Topic(participant, "rt/tf", TFMessage_, qos=quality)),
}
store = get_typestore(Stores.ROS2_JAZZY)
types = {"/forward_position_controller/commands": "std_msgs/msg/Float64MultiArray", "/tf": "tf2_msgs/msg/TFMessage"}
q, counts, frames, last = list(START), {"commands": 0}, set(), [time.monotonic()]
writer = Writer(sys.argv[1], version=9, storage_plugin=StoragePlugin.MCAP)
writer.open()
connections = {topic: writer.add_connection(topic, name, typestore=store) for topic, name in types.items()}


def read():
    waiting = WaitSet(participant)
    for reader in readers.values():
        waiting.attach(ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any))
    while True:
        waiting.wait(duration(seconds=1))
        for topic, reader in readers.items():
            for message in reader.take(20):
                if not hasattr(message, "serialize"):
                    continue
                # The bytes of a message without a leading encapsulation of its own.
                writer.write(connections[topic], time.time_ns(), message.serialize())
                if topic == "/tf":
                    frames.update(transform.child_frame_id for transform in message.transforms)
                elif len(message.data) == len(q):
                    q[:] = message.data
                    counts["commands"] += 1
                    last[0] = time.monotonic()


threading.Thread(target=read, daemon=True).start()
print("ready", flush=True)
began, cycle = time.monotonic(), 0
while time.monotonic() - began < 30.0 and (not counts["commands"] or time.monotonic() - last[0] < 1.0):
    now = time.time()
    header = Header_(Time_(int(now), int(now % 1.0 * 1e9)), "flange")
    zero = Vector3_(0.0, 0.0, 0.0)
    wrenches.write(WrenchStamped_(header, Wrench_(zero, zero)))
    states.write(JointState_(header, JOINTS, list(q), [0.0] * len(q), [0.0] * len(q)))
    cycle += 1
    time.sleep(max(0.0, began + cycle * PERIOD_S - time.monotonic()))
writer.close()
print(json.dumps(counts | {"frames": sorted(frames), "states": cycle}))
