"""Judge of opspace-ros2: programs of others on both sides of the topics.

    judge.py PROGRAM PROJECT [--only WORD]

starts the foreign robot (rclpy on Fast DDS, MuJoCo), runs PROGRAM against it, and compares with the same arm driven directly;
provokes each fault; streams targets from rclpy; speaks to the program by Cyclone DDS; and reads what it publishes with rosbags.
Run it in a network namespace of its own, with the loopback up and multicast on it.
"""

import argparse
import csv
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

parser = argparse.ArgumentParser()
parser.add_argument("program")
parser.add_argument("project", type=Path)
parser.add_argument("--only", default="", help="part of the names of the scenarios")
args = parser.parse_args()

# The library of MuJoCo is that of this Python.
os.environ["PATH"] = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
TESTS = args.project / "ros2" / "tests"
FOLDER = Path(tempfile.mkdtemp(prefix="opspace-ros2-"))
START = [0.0, -1.5708, -1.5708, -1.5708, 1.5708, 0.0]
failures = []


def check(is_good, text):
    print(("ok      " if is_good else "FAILED  ") + text, flush=True)
    if not is_good:
        failures.append(text)


class Robot:
    """The foreign robot, in a process of its own."""

    def __init__(self, *options, domain=0):
        self.record = FOLDER / f"robot-{time.monotonic_ns()}.csv"
        command = [sys.executable, TESTS / "foreign_robot.py", args.project / "robots/ur5e/ur5e.urdf", "--record", self.record]
        environment = os.environ | {"ROS_DOMAIN_ID": str(domain)}
        self.process = subprocess.Popen([*map(str, command), *map(str, options)], stdout=subprocess.PIPE, text=True, env=environment)
        assert self.process.stdout.readline().strip() == "ready"

    def end(self):
        """Ends it after its arm has come to rest, and returns its counts."""
        time.sleep(0.7)
        self.process.send_signal(signal.SIGINT)
        lines = self.process.communicate(timeout=20)[0].strip().splitlines()
        return json.loads(lines[-1]) if lines else {}

    def motion(self):
        """Rows of time, position of the flange, and force on it."""
        rows = list(csv.reader(open(self.record)))[1:]
        return np.array([[float(value) for value in row[:7]] for row in rows if len(row) == 13])


def start(task, *options):
    """Starts the program."""
    out = FOLDER / f"run-{time.monotonic_ns()}"
    command = [args.program, "run", TESTS / "tasks" / f"{task}.toml", "--out", out, *options]
    process = subprocess.Popen([str(part) for part in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return process, out


def end(started, longest_s=60.0):
    """Waits for the program, and returns its exit code, its output and its folder."""
    process, out = started
    said = process.communicate(timeout=longest_s)[0]
    return process.returncode, said, out


def rows(out, *columns):
    """Columns of the log of a run."""
    text = subprocess.run([args.program, "log", "export", str(out), "--out", "-"], capture_output=True, text=True, check=True).stdout
    reader = csv.DictReader(text.splitlines())
    return np.array([[float(row[name] or "nan") for name in columns] for row in reader])


def directly(task, *options):
    """Motion of the flange of the same arm, simulated with the same rate and delay: displacement in x, rms errors of y and z."""
    plant = ["--plant", "mujoco"] if subprocess.run([sys.executable, "-c", "import mujoco"], check=False).returncode == 0 else []
    code, said, out = end(start(task, "--simulate", *plant, *options))
    assert code == 0, said
    logged = rows(out, "phase", "flange.position.x_m", "flange.position.y_m", "flange.position.z_m")
    # While the controller commands.
    return figures(logged[logged[:, 0] == 1.0][:, 1:])


def figures(position):
    """Largest displacement in x, and rms distances of y and z from the start, m."""
    moved = position - position[0]
    return np.array([np.abs(moved[:, 0]).max(), *np.sqrt((moved[:, 1:] ** 2).mean(axis=0))])


# ---- control ----


# What the robot does in each task.
TASKS = {"compliant-x": ["--push-n", 2, 0, 0], "hold": ["--push-n", 0, 10, 0], "press": ["--board-z", 0.4679]}
LONGEST_S = {"compliant-x": 6.0, "hold": 4.0, "press": 6.0}


def compared(name, task, robot_options, of_direct, of_topics):
    """Runs a task over topics and directly, with these options, and compares them."""
    direct = directly(task, *of_direct)
    robot = Robot("--patient", *robot_options)
    code, said, out = end(start(task, *of_topics))
    counts = robot.end()
    motion = robot.motion()
    during = motion[motion[:, 0] <= LONGEST_S[task]]
    topics = figures(during[:, 1:4])
    mm = lambda values: ", ".join(f"{1e3 * value:.3f}" for value in values)
    check(code == 0, f"{name}: the run is complete (exit code {code})")
    if code != 0:
        print(said)
    print(f"        x, y, z over topics {mm(topics)} mm, directly {mm(direct)} mm; {counts}")
    if task == "compliant-x":
        check(abs(topics[0] / direct[0] - 1.0) < 0.1, f"{name}: x yields by {1e3 * topics[0]:.1f} mm, directly by {1e3 * direct[0]:.1f} mm")
    for axis, letter in ((1, "y"), (2, "z")):
        check(topics[axis] <= 2.0 * direct[axis] + 2e-5, f"{name}: the error of {letter} is at most twice the direct one")
    if task == "press":
        force = during[during[:, 0] > 5.0][:, 6].mean()
        check(abs(force - 20.0) < 0.5, f"{name}: the board is pressed with {force:.2f} N")
    check(counts["wrong_commands"] == 0, f"{name}: all commands were finite and whole")
    check(counts["speed_at_end_rad_per_s"] < 0.02, f"{name}: the arm holds after the end ({counts['speed_at_end_rad_per_s']:.2g} rad/s)")
    replayed = subprocess.run([args.program, "replay", str(out)], capture_output=True, text=True, check=False)
    check(replayed.returncode == 0, f"{name}: the log is replayed bit for bit")


def control_is_as_direct():
    """Compliant-x, press and hold: x yields as directly, y and z err at most twice as much."""
    trajectories = ["--set", 'robot.interface.setpoints="interpolated"']
    over_trajectories = [*trajectories, "--set", 'robot.driver.command_type="joint-trajectory"', "--set", 'robot.driver.commands="joint_trajectory_controller/joint_trajectory"']
    for task, options in TASKS.items():
        compared(task, task, options, [], [])
    compared("hold by trajectories", "hold", [*TASKS["hold"], "--trajectories"], trajectories, over_trajectories)


def delays_of_several_cycles():
    """A robot whose commands act three cycles after their states, as declared: tasks are as directly; an unstable one is refused."""
    late = ["--set", "robot.profile.topics-250hz.delay_servo_ticks=60"]
    for task, options in TASKS.items():
        compared(f"{task}, three cycles late", task, ["--late-cycles", 2, *options], late, late)
    # A stiff task at this delay: refused before the first command.
    code, said, _ = end(start("hold", *late, "--set", "task.flange.cartesian.gains.frequency_rad_per_s=150"))
    check(code == 2 and "gains-too-high" in said and "would be unstable" in said, f"a task that cannot be stable at this delay is refused (exit code {code})")
    if code != 2:
        print(said)


def servos_are_identified():
    """A joint is identified over topics, with the delay of the robot."""
    for late in (0, 2):
        robot = Robot("--patient", "--late-cycles", late, "--duration-s", 600)
        out = FOLDER / f"identified-{late}"
        command = [args.program, "identify", TESTS / "robot/robot.toml", "--joint", "wrist_3", "--out", out, "--force", "--json", FOLDER / f"identified-{late}.json"]
        done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
        robot.end()
        check(done.returncode in (0, 1), f"identification, {late} cycles late: it comes to its end (exit code {done.returncode})")
        written = out / "servo.toml"
        text = written.read_text() if written.exists() else ""
        print("        " + "\n        ".join((done.stdout + done.stderr).splitlines()[-12:]))
        check(f"delay_servo_ticks = {20 * (late + 1)}" in text, f"identification: the delay is {20 * (late + 1)} servo ticks")


# ---- faults ----


def faults_have_names():
    """Each fault stops the run, with its name, and the arm holds."""
    for name, options in {
        "states-silent": ["--silent-after-s", 1.0],
        "clock-jumped": ["--clock-jump-after-s", 1.0],
        "joints-missing": ["--rename-after-s", 1.0],
        "driver-gone": ["--restart-after-s", 1.0],
        "not-following": ["--inactive-after-s", 1.0],
        "controller-gone": ["--deaf-after-s", 1.0],
    }.items():
        # An arm that is pushed along its compliant axis: setpoints move.
        robot = Robot("--patient", "--push-n", 3, 0, 0, *options)
        ended(name, "compliant-x", robot)
    import rclpy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    node = rclpy.create_node("intruder")
    robot = Robot("--patient")
    started = start("compliant-x")
    wait_for_commands(node)
    publisher = node.create_publisher(Float64MultiArray, "forward_position_controller/commands", 10)
    ended("second-commander", None, robot, started)
    node.destroy_publisher(publisher)

    robot = Robot("--patient")
    started = start("compliant-x")
    wait_for_commands(node)
    publisher = node.create_publisher(JointState, "joint_states", 10)
    time.sleep(0.3)
    doubled = JointState(name=["base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3"], position=START, velocity=[0.0] * 6, effort=[0.0] * 6)
    doubled.header.stamp = node.get_clock().now().to_msg()
    publisher.publish(doubled)
    ended("second-state-publisher", None, robot, started)
    node.destroy_publisher(publisher)

    robot = Robot("--patient")
    started = start("compliant-x")
    wait_for_commands(node)
    robot.process.kill()
    code, said, _ = end(started)
    check(code == 1 and "states-silent" in said, "a killed driver: states-silent")
    node.destroy_node()


def wait_for_commands(node):
    """Waits until the program commands."""
    from std_msgs.msg import Float64MultiArray

    import rclpy

    arrived = []
    subscription = node.create_subscription(Float64MultiArray, "forward_position_controller/commands", arrived.append, 10)
    began = time.monotonic()
    while not arrived and time.monotonic() - began < 15.0:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_subscription(subscription)
    assert arrived, "the program commands nothing"


def ended(name, task, robot, started=None):
    code, said, out = end(started or start(task))
    counts = robot.end()
    check(code == 1 and f"{name}:" in said, f"{name}: the run ends with 1 and says so (exit code {code})")
    if f"{name}:" not in said:
        print(said)
    check(counts["speed_at_end_rad_per_s"] < 0.02, f"{name}: the arm holds ({counts['speed_at_end_rad_per_s']:.2g} rad/s)")


def refused(text, *options):
    code, said, _ = end(start("hold", *options))
    check(code == 2 and text in said, f"refused at the start: {text}")
    if text not in said:
        print(said)


def starts_are_refused():
    """What is wrong before the start is an error with what is there."""
    refused("no state comes on /joint_states", "--set", "robot.driver.discovery_s=2")
    checked = subprocess.run([args.program, "check", str(TESTS / "tasks/hold.toml")], capture_output=True, text=True, check=False)
    check(checked.returncode == 0, "the task is checked")
    started = start("hold")
    time.sleep(3.0)
    robot = Robot("--patient")
    code, said, _ = end(started)
    check(code == 0, f"a robot that comes later is waited for (exit code {code})")
    robot.end()
    robot = Robot("--patient", "--namespace", "left/arm", domain=7)
    place = ["--set", "robot.driver.domain=7", "--set", 'robot.driver.namespace="left/arm"']
    code, said, _ = end(start("hold", *place))
    check(code == 0, f"domain and namespace are honoured (exit code {code})")
    refused("no state comes on /left/arm/joint_states", *place[2:], "--set", "robot.driver.discovery_s=2")
    robot.end()
    robot = Robot("--hz", 125)
    refused("comes every 8.", "--set", "robot.driver.discovery_s=4")
    robot.end()
    robot = Robot()
    refused("nothing subscribes to /arm_controller/commands", "--set", "robot.driver.discovery_s=2", "--set", 'robot.driver.commands="arm_controller/commands"')
    refused("no wrench comes on /other/wrench", "--set", "robot.driver.discovery_s=2", "--set", 'robot.driver.wrenches=["other/wrench"]')
    refused("has type std_msgs::msg::dds_::Float64MultiArray_", "--set", 'robot.driver.command_type="joint-trajectory"', "--set", 'robot.driver.commands="forward_position_controller/commands"')
    refused("must be \"stamp\" or \"arrival\"", "--set", 'robot.driver.clock="stamps"')
    refused("unknown key 'topic'", "--set", 'robot.driver.topic="x"')

    import rclpy
    from std_msgs.msg import Float64MultiArray

    node = rclpy.create_node("earlier_commander")
    publisher = node.create_publisher(Float64MultiArray, "forward_position_controller/commands", 10)
    refused("1 other publishers on /forward_position_controller/commands")
    node.destroy_publisher(publisher)
    node.destroy_node()
    found = subprocess.run([args.program, "driver", "scan", "--driver", "ros2"], capture_output=True, text=True, check=False)
    check("/joint_states" in found.stdout and "wrist_3" in found.stdout, "a search lists the states with their joints")
    urdf = FOLDER / "described.urdf"
    written = subprocess.run([args.program, "description", str(urdf)], capture_output=True, text=True, check=False)
    same = urdf.exists() and urdf.read_text() == (args.project / "robots/ur5e/ur5e.urdf").read_text()
    check(written.returncode == 0 and same, "the description of the robot is written to a file")
    robot.end()
    # At 50 Hz, as this robot does not wait for its commands.
    slow = [part for key in ("servo_ticks_per_cycle", "delay_servo_ticks") for part in ("--set", f"robot.profile.topics-250hz.{key}=100")]
    robot = Robot("--no-stamps", "--hz", 50)
    refused("states have no stamps", *slow)
    code, said, _ = end(start("hold", *slow, "--controller", "ik", "--set", 'robot.driver.clock="arrival"', "--set", "robot.driver.silence_s=0.3"))
    check(code == 0, f"states without stamps: the clock of their arrival (exit code {code})")
    if code != 0:
        print(said)
    robot.end()


# ---- targets, outputs and services ----


def targets_are_followed():
    """Poses from rclpy at 20 Hz with dropouts; gains, modes, clutch, frames; services; outputs."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import Bool, Float64MultiArray, String
    from std_srvs.srv import Trigger

    node = rclpy.create_node("operator")
    seen = {}
    keep = lambda name: lambda message: seen.setdefault(name, []).append(message)
    for name, kind, topic in (
        ("state", PoseStamped, "/opspace/flange/state"),
        ("reference", PoseStamped, "/opspace/flange/reference"),
        ("velocity", TwistStamped, "/opspace/flange/velocity"),
        ("error", Float64MultiArray, "/opspace/flange/error"),
        ("wrench", WrenchStamped, "/opspace/wrist/wrench"),
        ("diagnostics", DiagnosticArray, "/diagnostics"),
    ):
        node.create_subscription(kind, topic, keep(name), 10)
    poses = node.create_publisher(PoseStamped, "/opspace/flange/pose", 10)
    twists = node.create_publisher(TwistStamped, "/opspace/flange/twist", 10)
    clutch = node.create_publisher(Bool, "/opspace/flange/clutch", 10)
    gains = node.create_publisher(Float64MultiArray, "/opspace/flange/gains", 10)
    modes = node.create_publisher(String, "/opspace/flange/modes", 10)
    services = {name: node.create_client(Trigger, f"/opspace/{name}") for name in ("start", "stop", "hold", "tare")}
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()

    # The bytes as they come, for rosbags.
    from rosbags.highlevel import AnyReader
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    bag = Writer(FOLDER / "outputs", version=9, storage_plugin=StoragePlugin.MCAP)
    bag.open()
    for kind, topic in ((PoseStamped, "/opspace/flange/state"), (WrenchStamped, "/opspace/wrist/wrench"), (DiagnosticArray, "/diagnostics")):
        connection = bag.add_connection(topic, f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}", typestore=store)
        node.create_subscription(kind, topic, lambda raw, connection=connection: bag.write(connection, time.time_ns(), raw), 10, raw=True)

    frame = subprocess.Popen([sys.executable, str(TESTS / "cyclone_robot.py"), "--frame"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert frame.stdout.readline().strip() == "ready"
    robot = Robot("--patient")
    started = start("streamed")
    began = time.monotonic()
    while "state" not in seen and time.monotonic() - began < 20.0:
        time.sleep(0.05)
    time.sleep(0.5)
    if "state" not in seen:
        check(False, "targets: the states of the task are published")
        started[0].kill()
        print(end(started)[1])
        robot.end()
        frame.kill()
        return

    def state():
        pose = seen["state"][-1].pose
        return np.array([pose.position.x, pose.position.y, pose.position.z]), pose.orientation

    names = set(node.get_node_names())
    check({"opspace", "opspace_driver", "opspace_outputs"} <= names, f"targets: the nodes are in the graph of rclpy: {sorted(names)}")
    home, orientation = state()

    def send(position, frame="", stamped=True):
        message = PoseStamped()
        message.header.frame_id = frame
        if stamped:
            message.header.stamp = node.get_clock().now().to_msg()
        message.pose.position.x, message.pose.position.y, message.pose.position.z = map(float, position)
        message.pose.orientation = orientation
        poses.publish(message)

    def lead(goal, seconds, dropout=None, **options):
        """Sends poses on the way to a goal at 20 Hz, none during the dropout, and the goal for a second more."""
        origin, count = state()[0], int(20 * seconds)
        for number in range(count):
            share = 0.5 - 0.5 * math.cos(math.pi * (number + 1) / count)
            if dropout is None or not dropout[0] <= number / 20 < dropout[1]:
                send(origin + share * (np.array(goal) - origin), **options)
            time.sleep(0.05)
        for _ in range(20):
            send(goal, **options)
            time.sleep(0.05)

    goal = home + [0.0, 0.08, 0.05]
    lead(goal, 2.0, dropout=(0.8, 1.4))
    away = np.linalg.norm(state()[0] - goal)
    check(away < 1e-3, f"targets: poses at 20 Hz with a dropout of 0.6 s are followed ({1e3 * away:.2f} mm at the end)")
    reference = seen["reference"][-1].pose.position
    check(abs(reference.y - goal[1]) < 1e-3, f"targets: the reference is published ({1e3 * (reference.y - goal[1]):.2f} mm)")

    # A frame of the URDF, and an unknown one.
    lead(home + [0.0, 0.05, 0.0], 1.0, frame="pedestal")
    send(home, frame="nowhere")
    time.sleep(0.4)
    away = np.linalg.norm(state()[0] - (home + [0.0, 0.05, 0.0]))
    check(away < 1e-3, f"targets: poses in a frame of the URDF are followed, one in an unknown frame is not ({1e3 * away:.2f} mm)")
    lead(home + [0.0, 0.03, -0.2], 1.0, frame="table")
    away = np.linalg.norm(state()[0] - (home + [0.0, 0.03, 0.0]))
    check(away < 1e-3, f"targets: poses in a frame of /tf_static are followed ({1e3 * away:.2f} mm)")
    old = PoseStamped()
    old.header.stamp.sec = 1
    poses.publish(old)

    # The clutch: a displacement counts, not the place.
    clutch.publish(Bool(data=False))
    time.sleep(0.2)
    before = state()[0]
    send(before + [0.3, 0.0, 0.0])
    time.sleep(0.3)
    moved = np.linalg.norm(state()[0] - before)
    check(moved < 1e-3, f"targets: nothing is followed with an open clutch ({1e3 * moved:.2f} mm)")
    clutch.publish(Bool(data=True))
    time.sleep(0.1)
    for number in range(20):
        send(before + [0.3, 0.0, 0.001 * (number + 1)])
        time.sleep(0.05)
    time.sleep(0.2)
    moved = state()[0] - before
    check(abs(moved[2] - 0.019) < 2e-3 and abs(moved[0]) < 2e-3, f"targets: with a closed clutch displacements are followed ({1e3 * moved[2]:.1f} mm up)")

    # Velocities.
    before = state()[0]
    for _ in range(20):
        message = TwistStamped()
        message.header.stamp = node.get_clock().now().to_msg()
        message.twist.linear.y = -0.03
        twists.publish(message)
        time.sleep(0.05)
    time.sleep(0.3)
    moved = state()[0] - before
    check(-0.05 < moved[1] < -0.02, f"targets: velocities are followed ({1e3 * moved[1]:.1f} mm in 1 s at 30 mm/s)")

    gains.publish(Float64MultiArray(data=[20.0] * 6 + [1.0] * 6))
    modes.publish(String(data="x=sideways"))
    gains.publish(Float64MultiArray(data=[20.0]))
    time.sleep(1.3)
    diagnostics = {value.key: value.value for value in seen["diagnostics"][-1].status[0].values}
    check(int(diagnostics["targets_refused"]) >= 4 and int(diagnostics["targets_accepted"]) > 60, f"targets: refused ones are counted: {diagnostics}")

    def call(name):
        future = services[name].call_async(Trigger.Request())
        began = time.monotonic()
        while not future.done() and time.monotonic() - began < 5.0:
            time.sleep(0.02)
        return future.result() if future.done() else None

    held = call("hold")
    check(held is not None and held.success, f"services: hold ({held and held.message})")
    began = time.monotonic()
    while seen["diagnostics"][-1].status[0].message != "held" and time.monotonic() - began < 3.0:
        time.sleep(0.05)
    check(seen["diagnostics"][-1].status[0].message == "held", "services: the phase is held")
    gone_on = call("start")
    check(gone_on is not None and gone_on.success, f"services: start ({gone_on and gone_on.message})")
    tared = call("tare")
    check(tared is not None and tared.success, f"services: tare ({tared and tared.message})")
    time.sleep(1.0)
    stopped = call("stop")
    check(stopped is not None and stopped.success, f"services: stop ({stopped and stopped.message})")
    code, said, out = end(started)
    counts = robot.end()
    check(code == 130, f"services: the run is interrupted (exit code {code})")
    if code != 130:
        print(said)
    check(counts["speed_at_end_rad_per_s"] < 0.02, f"services: the arm holds ({counts['speed_at_end_rad_per_s']:.2g} rad/s)")
    replayed = subprocess.run([args.program, "replay", str(out)], capture_output=True, text=True, check=False)
    check(replayed.returncode == 0, "targets: the log is replayed bit for bit")
    stale = rows(out, "flange.target_stale").sum()
    check(stale > 20, f"targets: the log has the dropouts ({stale:.0f} cycles)")
    executor.shutdown()
    node.destroy_node()
    frame.kill()
    bag.close()
    counted = {}
    with AnyReader([FOLDER / "outputs"], default_typestore=store) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
            counted[connection.topic] = counted.get(connection.topic, 0) + 1
    check(counted.get("/opspace/flange/state", 0) > 300 and len(counted) == 3, f"rosbags reads the bytes of a recording in MCAP: {counted}")


# ---- programs of others ----


def cyclone_and_rosbags_agree():
    """Cyclone DDS plays the robot and reads /tf; a recording of the topics is read by rosbags."""
    peer = subprocess.Popen([sys.executable, str(TESTS / "cyclone_robot.py"), str(FOLDER / "topics")], stdout=subprocess.PIPE, text=True)
    assert peer.stdout.readline().strip() == "ready"
    code, said, out = end(start("hold", "--set", "robot.driver.not_following_rad=0"))
    lines = peer.communicate(timeout=30)[0].strip().splitlines()
    found = json.loads(lines[-1])
    check(code == 0, f"Cyclone DDS: the run is complete (exit code {code})")
    if code != 0:
        print(said)
    print(f"        {found}")
    check(found["commands"] > 900, f"Cyclone DDS: {found['commands']} commands arrived")
    check("opspace/flange" in found["frames"], f"Cyclone DDS: /tf has {found['frames']}")
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([FOLDER / "topics"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        messages = [reader.deserialize(raw, connection.msgtype) for connection, _, raw in reader.messages() if connection.topic == "/forward_position_controller/commands"]
        frames = [reader.deserialize(raw, connection.msgtype) for connection, _, raw in reader.messages() if connection.topic == "/tf"]
    check(len(messages) > 900 and np.allclose(messages[0].data, START, atol=0.1), f"rosbags reads {len(messages)} commands of {kinds}")
    check(len(frames) > 50 and frames[-1].transforms[0].header.frame_id == "world", f"rosbags reads {len(frames)} messages of /tf")


def latencies():
    """Time from the publication of a state to the arrival of its command, idle and with as many busy processes as processors."""
    for name, burners in (("idle", 0), ("loaded", os.cpu_count())):
        busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(burners)]
        robot = Robot()
        code, said, _ = end(start("hold"))
        counts = robot.end()
        for process in busy:
            process.kill()
        said = [line for line in said.splitlines() if line.startswith("ros2:")]
        print(f"        {name}: exit code {code}; median, 99 %, largest latency {counts.get('latency_ms')} ms; {said}", flush=True)


try:
    import rclpy

    rclpy.init(args=[])
    for part in (control_is_as_direct, delays_of_several_cycles, servos_are_identified, faults_have_names, starts_are_refused, targets_are_followed, cyclone_and_rosbags_agree, latencies):
        if args.only not in part.__name__:
            continue
        # On a machine that is busy for a moment, a robot that waits for nobody goes on without its controller.
        for attempt in range(2):
            before = len(failures)
            began = time.monotonic()
            print(f"{part.__name__}: {part.__doc__}", flush=True)
            part()
            print(f"        {time.monotonic() - began:.0f} s", flush=True)
            if len(failures) == before:
                break
            if attempt == 0:
                print(f"once more, since {len(failures) - before} checks have failed: {failures[before:]}", flush=True)
                del failures[before:]
    print(f"{len(failures)} failures")
    for failure in failures:
        print(f"  {failure}")
finally:
    sys.stdout.flush()
    # Without the destructors of rclpy, which can wait for each other.
os._exit(1 if failures else 0)
