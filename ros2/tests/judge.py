"""Judge of opspace-ros2: programs of others on both sides of the topics.

    judge.py PROGRAM PROJECT [--only WORD] [--beside N]

starts the foreign robot (rclpy on Fast DDS, MuJoCo), runs PROGRAM against it, and compares with the same arm driven directly;
provokes each fault; streams targets from rclpy; speaks to the program by Cyclone DDS; and reads what it publishes with rosbags.
Each scenario runs in a process and a network of its own, with the loopback alone, and some run at the same time.

A robot that waits for its commands lets a busy machine change durations alone. A scenario may fail on one if it depends on a latency, of
a robot that does not wait, of targets or of discovery, or if the program found that a sample came much too late by the computer's
clock: then it is repeated once, and says so. Others are not repeated.

`--here latencies` measures latencies, and judges nothing. It is no part of the whole.

Exit code 75 if no namespace can be created.
"""

import argparse
import concurrent.futures
import contextlib
import csv
import json
import math
import os
import re
import shutil
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
parser.add_argument("--beside", type=int, default=3, help="number of scenarios that run at the same time")
parser.add_argument("--here", help="the scenario to run in this process and network")
args = parser.parse_args()

# The library of MuJoCo is that of this Python.
os.environ["PATH"] = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
TESTS = args.project / "ros2" / "tests"
FOLDER = Path(tempfile.mkdtemp(prefix="opspace-ros2-"))
START = [0.0, -1.5708, -1.5708, -1.5708, 1.5708, 0.0]
failures = []
# What the program says when this machine has stood still.
STOOD_STILL = "by the computer's clock, a sample came more than"
standstills = []
# Number of times for which a scenario is repeated in which that happened; one that depends on a latency is repeated once.
REPEATS = 2


def check(is_good, text):
    print(("ok      " if is_good else "FAILED  ") + text, flush=True)
    if not is_good:
        failures.append(text)


# Scenarios by name, and the names of those that depend on a latency.
SCENARIOS, IMPATIENT = {}, set()


def scenario(function, name=None, is_patient=True):
    """Enters a scenario."""
    name = name or function.__name__
    SCENARIOS[name] = function
    if not is_patient:
        IMPATIENT.add(name)
    return function


def impatient(function):
    """Enters a scenario that depends on a latency."""
    return scenario(function, is_patient=False)


class Robot:
    """The foreign robot, in a process of its own."""

    def __init__(self, *options, domain=0):
        self.record = FOLDER / f"robot-{time.monotonic_ns()}.csv"
        command = [sys.executable, TESTS / "foreign_robot.py", args.project / "robots/ur5e/ur5e.urdf", "--record", self.record]
        environment = os.environ | {"ROS_DOMAIN_ID": str(domain)}
        self.process = subprocess.Popen([*map(str, command), *map(str, options)], stdout=subprocess.PIPE, text=True, env=environment)
        assert self.process.stdout.readline().strip() == "ready"

    def end(self, rest_s=1.2):
        """Ends it after its arm has come to rest, and returns its counts."""
        time.sleep(rest_s)
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
    standstills.extend(line for line in said.splitlines() if STOOD_STILL in line)
    return process.returncode, said, out


def rows(out, *columns):
    """Columns of the log of a run."""
    text = subprocess.run([args.program, "log", "export", str(out), "--out", "-"], capture_output=True, text=True, check=True).stdout
    reader = csv.DictReader(text.splitlines())
    return np.array([[float(row[name] or "nan") for name in columns] for row in reader])


def directly(task, *options):
    """Motion of the flange of the same arm, simulated with the same rate and delay: displacement in x, rms errors of y and z."""
    code, said, out = end(start(task, "--simulate", "--plant", "mujoco", *options))
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


def setting(**values):
    """Options that set keys of robot.toml; a double underscore is a dot."""
    return [part for key, value in values.items() for part in ("--set", f"robot.{key.replace('__', '.')}={json.dumps(value)}")]


# Options of the robot and of the program. Those that accept velocities or efforts compensate their weight.
OWN_GRAVITY = setting(interface__gravity_compensated_by="robot")
INTERFACES = {
    "position": ([], []),
    "velocity": (["--interface", "velocity"], [*OWN_GRAVITY, *setting(interface__command="velocity")]),
    "effort": (
        ["--interface", "effort"],
        [
            *OWN_GRAVITY,
            *setting(interface__command="torque", driver__zero_effort_holds=True),
            *setting(joint_defaults__friction__viscous_nms_per_rad=10.0, group__wrist__friction__viscous_nms_per_rad=2.0),
        ],
    ),
}
LATE = setting(**{"profile__topics-250hz__delay_servo_ticks": 60})


def compared(name, task, robot_options, options):
    """Runs a task over topics and directly, with these options, and compares them."""
    direct = directly(task, *options)
    robot = Robot("--patient", *robot_options)
    code, said, out = end(start(task, *options))
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


def control_scenario(name, task, robot_options, options):
    def run():
        """A task over topics is as directly: x yields as much, y and z err at most twice as much."""
        compared(name, task, [*TASKS[task], *robot_options], options)

    scenario(run, f"control_{name}")


for task in TASKS:
    for interface, (of_robot, of_program) in INTERFACES.items():
        control_scenario(f"{interface}_{task}", task, of_robot, of_program)
    control_scenario(f"late_{task}", task, ["--late-cycles", 2], LATE)
TRAJECTORIES = setting(interface__setpoints="interpolated", driver__command_type="joint-trajectory")
control_scenario("trajectories_hold", "hold", ["--trajectories"], TRAJECTORIES)


# A motion of 0.2 m, which begins at once.
MOTION = ["--set", "task.flange.cartesian.reference={ point-to-point = { position = { offset_m = [0.0, 0.2, 0.0] }, duration_s = 2.0 } }"]


def ends_of(interface):
    of_robot, of_program = INTERFACES[interface]

    def run():
        """However the program ends while the arm moves, its last command is zero; if it is killed, the last one remains."""
        import rclpy

        node = rclpy.create_node("observer")
        for way, number in (("SIGTERM", signal.SIGTERM), ("SIGHUP", signal.SIGHUP), ("SIGKILL", signal.SIGKILL)):
            robot = Robot("--patient", *TASKS["compliant-x"], *of_robot)
            started = start("compliant-x", *of_program)
            wait_for_commands(node, f"forward_{interface}_controller/commands")
            # It is pushed, and moves.
            time.sleep(1.6)
            started[0].send_signal(number)
            code, said, _ = end(started)
            counts = robot.end(rest_s=3.0)
            is_zero = max(map(abs, counts["last_command"])) == 0.0
            speed = counts["speed_at_end_rad_per_s"]
            if number == signal.SIGKILL:
                check(not is_zero, f"{interface}, {way}: the last command remains, as the pages say")
                continue
            check(code == 130, f"{interface}, {way}: the run is interrupted (exit code {code})")
            check(is_zero and speed < 0.02, f"{interface}, {way}: the last command is zero, and the arm rests ({speed:.2g} rad/s)")
            if code != 130:
                print(said)
        for name, options in {"states-silent": ["--silent-after-s", 1.5], "controller-gone": ["--deaf-after-s", 1.5]}.items():
            robot = Robot("--patient", *TASKS["compliant-x"], *of_robot, *options)
            counts = ended(f"{interface}, {name}", name, robot, start("compliant-x", *of_program), rest_s=3.0)
            check(max(map(abs, counts["last_command"])) == 0.0, f"{interface}, {name}: the last command is zero")
        robot = Robot("--patient", *of_robot, "--inactive-after-s", 0.5)
        ended(f"{interface}, not-following", "not-following", robot, start("hold", *of_program, *MOTION))
        node.destroy_node()

    scenario(run, f"ends_{interface}")


for interface in ("velocity", "effort"):
    ends_of(interface)


@scenario
def delay_refused():
    """A stiff task at the delay of three cycles is refused before the first command."""
    code, said, _ = end(start("hold", *LATE, "--set", "task.flange.cartesian.gains.frequency_rad_per_s=150"))
    check(code == 2 and "gains-too-high" in said and "would be unstable" in said, f"a task that cannot be stable at this delay is refused (exit code {code})")
    if code != 2:
        print(said)


@scenario
def effort_refused():
    """An effort interface of which nothing says that the arm holds at zero effort is refused."""
    options = [*INTERFACES["effort"][1], *setting(driver__zero_effort_holds=False)]
    code, said, _ = end(start("hold", *options))
    check(code == 2 and "zero_effort_holds = true" in said, f"effort: refused without zero_effort_holds (exit code {code})")


def identified(late):
    def run():
        """A joint is identified over topics, with the delay of the robot and its gains."""
        robot = Robot("--patient", "--late-cycles", late, "--duration-s", 600)
        out = FOLDER / "identified"
        # Without SCHED_FIFO: with it, a scenario beside this one stood still for 0.9 s, each time, on two processors.
        folder = FOLDER / f"robot-{time.monotonic_ns()}"
        folder.mkdir()
        text = (TESTS / "robot/robot.toml").read_text().replace("[driver]\n", '[driver]\nreal_time = "off"\n')
        text = re.sub(r'(?m)^urdf = "(.*)"$', lambda found: f'urdf = "{(TESTS / "robot" / found[1]).resolve()}"', text)
        (folder / "robot.toml").write_text(text)
        command = [args.program, "identify", folder / "robot.toml", "--joint", "wrist_3", "--out", out, "--force"]
        done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
        print(f"        {robot.end()}")
        check(done.returncode in (0, 1), f"identification, {late} cycles late: it comes to its end (exit code {done.returncode})")
        written = out / "servo.toml"
        text = written.read_text() if written.exists() else ""
        print("        " + "\n        ".join((done.stdout + done.stderr).splitlines()[-12:]))
        check(f"delay_servo_ticks = {20 * (late + 1)}" in text, f"identification: the delay is {20 * (late + 1)} servo ticks")
        found = [float(value) for key in ("stiffness_nm_per_rad", "damping_nms_per_rad") for value in re.findall(rf"{key} = ([0-9.]+)", text)]
        is_good = len(found) == 2 and np.allclose(found, [200.0, 10.0], rtol=0.02)
        check(is_good, f"identification: the gains are those of the robot within 2 %: {found} Nm/rad, Nms/rad")

    scenario(run, f"identification_{late}_cycles_late")


identified(0)
identified(2)


# ---- faults ----


@scenario
def faults_of_the_robot():
    """Each fault of the robot stops the run, with its name, and the arm holds."""
    for name, options in {
        "states-silent": ["--silent-after-s", 1.0],
        "clock-jumped": ["--clock-jump-after-s", 1.0],
        "joints-missing": ["--rename-after-s", 1.0],
        "driver-gone": ["--restart-after-s", 1.0],
        "not-following": ["--inactive-after-s", 1.0],
        "controller-gone": ["--deaf-after-s", 1.0],
        "wrench-silent": ["--wrench-silent-after-s", 1.0],
        "wrench-malformed": ["--wrench-frame-after-s", 1.0],
        "state-malformed": ["--nan-after-s", 1.0],
    }.items():
        # An arm that is pushed along its compliant axis: setpoints move.
        robot = Robot("--patient", "--push-n", 3, 0, 0, *options)
        ended(name, name, robot, start("compliant-x"))


@scenario
def faults_of_others():
    """Other programs on the topics stop the run, with the name of the fault, and the arm holds."""
    import rclpy
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    node = rclpy.create_node("intruder")
    doubled = JointState(name=["base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3"], position=START, velocity=[0.0] * 6, effort=[0.0] * 6)
    doubled.header.stamp = node.get_clock().now().to_msg()
    # The header of little-endian CDR, and too few bytes for a state.
    unreadable = bytes([0, 1, 0, 0, 1, 2, 3, 4])
    for name, kind, topic, message in (
        ("second-commander", Float64MultiArray, "forward_position_controller/commands", None),
        ("second-state-publisher", JointState, "joint_states", doubled),
        ("client-failed", JointState, "joint_states", unreadable),
    ):
        robot = Robot("--patient")
        started = start("compliant-x")
        wait_for_commands(node, "forward_position_controller/commands")
        publisher = node.create_publisher(kind, topic, 10)
        if message is not None:
            time.sleep(0.3)
            publisher.publish(message)
        ended(name, name, robot, started)
        node.destroy_publisher(publisher)

    # A killed driver: nobody takes leave. Another one after that, within the silence that is allowed.
    publisher = node.create_publisher(JointState, "joint_states", 10)
    for name, is_restarted in (("states-silent", False), ("driver-restarted", True)):
        robot = Robot("--patient")
        started = start("compliant-x", *setting(driver__silence_s=1.0))
        wait_for_commands(node, "forward_position_controller/commands")
        robot.process.kill()
        if is_restarted:
            time.sleep(0.75)
            doubled.header.stamp = node.get_clock().now().to_msg()
            publisher.publish(doubled)
        code, said, _ = end(started)
        check(code == 1 and f"{name}:" in said, f"a killed driver: {name} (exit code {code})")
        if f"{name}:" not in said:
            print(said)
    node.destroy_node()


def wait_for_commands(node, topic):
    """Waits until the program commands."""
    from std_msgs.msg import Float64MultiArray

    import rclpy

    arrived = []
    subscription = node.create_subscription(Float64MultiArray, topic, arrived.append, 10)
    began = time.monotonic()
    while not arrived and time.monotonic() - began < 15.0:
        rclpy.spin_once(node, timeout_sec=0.1)
    node.destroy_subscription(subscription)
    assert arrived, "the program commands nothing"


def ended(name, fault, robot, started, **options):
    """Waits for the end with a fault, and returns the counts of the robot."""
    code, said, out = end(started)
    counts = robot.end(**options)
    check(code == 1 and f"{fault}:" in said, f"{name}: the run ends with 1 and says so (exit code {code})")
    if f"{fault}:" not in said:
        print(said)
    check(counts["speed_at_end_rad_per_s"] < 0.02, f"{name}: the arm holds ({counts['speed_at_end_rad_per_s']:.2g} rad/s)")
    return counts


def refused(text, *options):
    code, said, _ = end(start("hold", *options))
    check(code == 2 and text in said, f"refused at the start: {text}")
    if text not in said:
        print(said)


@scenario
def late_and_elsewhere():
    """A robot that comes later is waited for; domain and namespace are honoured."""
    refused("no state comes on /joint_states", "--set", "robot.driver.discovery_s=2")
    refused("Topics with joint states in domain 0: none", "--set", "robot.driver.discovery_s=2")
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


@impatient
def starts_are_refused():
    """What is wrong before the start is an error with what is there."""
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
    # It is refused, or stopped in its first cycles: the other program may be found later than the robot.
    code, said, _ = end(start("hold"))
    is_refused = code == 2 and "1 other publishers on /forward_position_controller/commands" in said
    is_stopped = code == 1 and "second-commander" in said and "STOPPED at 0.0" in said
    check(is_refused or is_stopped, f"another program that publishes commands at the start is found (exit code {code})")
    if not (is_refused or is_stopped):
        print(said)
    node.destroy_publisher(publisher)
    node.destroy_node()
    found = subprocess.run([args.program, "driver", "scan", "--driver", "ros2"], capture_output=True, text=True, check=False)
    check("/joint_states" in found.stdout and "wrist_3" in found.stdout, "a search lists the states with their joints")
    urdf = FOLDER / f"described-{time.monotonic_ns()}.urdf"
    written = subprocess.run([args.program, "description", str(urdf)], capture_output=True, text=True, check=False)
    same = urdf.exists() and urdf.read_text() == (args.project / "robots/ur5e/ur5e.urdf").read_text()
    check(written.returncode == 0 and same, "the description of the robot is written to a file")
    robot.end()


@impatient
def states_without_stamps():
    """States without stamps need the clock of their arrival."""
    # At 50 Hz, as this robot does not wait for its commands.
    slow = [part for key in ("servo_ticks_per_cycle", "delay_servo_ticks") for part in ("--set", f"robot.profile.topics-250hz.{key}=100")]
    robot = Robot("--no-stamps", "--hz", 50)
    refused("states have no stamps", *slow)
    code, said, _ = end(start("hold", *slow, "--controller", "ik", "--set", 'robot.driver.clock="arrival"', "--set", "robot.driver.silence_s=0.4"))
    check(code == 0, f"states without stamps: the clock of their arrival (exit code {code})")
    if code != 0:
        print(said)
    robot.end()


# ---- targets, outputs and services ----


class Operator:
    """A program of rclpy that gives targets to the task `flange`, calls services, and sees the outputs."""

    def __init__(self):
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
        from rclpy.executors import SingleThreadedExecutor
        from std_msgs.msg import Bool, Float64MultiArray, String
        from std_srvs.srv import Trigger

        self.node = rclpy.create_node("operator")
        self.seen = {}
        keep = lambda name: lambda message: self.seen.setdefault(name, []).append(message)
        for name, kind, topic in (
            ("state", PoseStamped, "/opspace/flange/state"),
            ("reference", PoseStamped, "/opspace/flange/reference"),
            ("velocity", TwistStamped, "/opspace/flange/velocity"),
            ("error", Float64MultiArray, "/opspace/flange/error"),
            ("wrench", WrenchStamped, "/opspace/wrist/wrench"),
            ("diagnostics", DiagnosticArray, "/diagnostics"),
        ):
            self.node.create_subscription(kind, topic, keep(name), 10)
        self.poses = self.node.create_publisher(PoseStamped, "/opspace/flange/pose", 10)
        self.twists = self.node.create_publisher(TwistStamped, "/opspace/flange/twist", 10)
        self.clutch = self.node.create_publisher(Bool, "/opspace/flange/clutch", 10)
        self.gains = self.node.create_publisher(Float64MultiArray, "/opspace/flange/gains", 10)
        self.modes = self.node.create_publisher(String, "/opspace/flange/modes", 10)
        self.services = {name: self.node.create_client(Trigger, f"/opspace/{name}") for name in ("start", "stop", "hold", "tare")}
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        threading.Thread(target=self.executor.spin, daemon=True).start()

    def end(self):
        self.executor.shutdown()
        self.node.destroy_node()

    def wait(self, condition, longest_s):
        """Waits for a condition; returns false if it is not met."""
        began = time.monotonic()
        while not condition() and time.monotonic() - began < longest_s:
            time.sleep(0.05)
        return condition()

    def found(self, started):
        """Waits for the states of the task; ends the program without them."""
        if self.wait(lambda: "state" in self.seen, 20.0):
            time.sleep(0.5)
            return True
        check(False, "targets: the states of the task are published")
        started[0].kill()
        print(end(started)[1])
        return False

    def place(self):
        position = self.seen["state"][-1].pose.position
        return np.array([position.x, position.y, position.z])

    def phase(self):
        return self.seen["diagnostics"][-1].status[0].message

    def send(self, position, frame=""):
        from geometry_msgs.msg import PoseStamped

        message = PoseStamped()
        message.header.frame_id = frame
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.pose.position.x, message.pose.position.y, message.pose.position.z = map(float, position)
        message.pose.orientation = self.seen["state"][0].pose.orientation
        self.poses.publish(message)

    def lead(self, goal, seconds, dropout=None, **options):
        """Sends poses on the way to a goal at 20 Hz, none during the dropout, and the goal for a second more."""
        origin, count = self.place(), int(20 * seconds)
        for number in range(count):
            share = 0.5 - 0.5 * math.cos(math.pi * (number + 1) / count)
            if dropout is None or not dropout[0] <= number / 20 < dropout[1]:
                self.send(origin + share * (np.array(goal) - origin), **options)
            time.sleep(0.05)
        for _ in range(20):
            self.send(goal, **options)
            time.sleep(0.05)

    def call(self, name):
        from std_srvs.srv import Trigger

        future = self.services[name].call_async(Trigger.Request())
        answer = future.result() if self.wait(future.done, 5.0) else None
        check(answer is not None and answer.success, f"services: {name} ({answer and answer.message})")

    def clutched(self):
        """The clutch: a displacement counts, not the place."""
        from std_msgs.msg import Bool

        self.clutch.publish(Bool(data=False))
        time.sleep(0.2)
        before = self.place()
        self.send(before + [0.3, 0.0, 0.0])
        time.sleep(0.3)
        moved = np.linalg.norm(self.place() - before)
        check(moved < 1e-3, f"targets: nothing is followed with an open clutch ({1e3 * moved:.2f} mm)")
        self.clutch.publish(Bool(data=True))
        time.sleep(0.1)
        for number in range(20):
            self.send(before + [0.3, 0.0, 0.001 * (number + 1)])
            time.sleep(0.05)
        time.sleep(0.2)
        moved = self.place() - before
        check(abs(moved[2] - 0.019) < 2e-3 and abs(moved[0]) < 2e-3, f"targets: with a closed clutch displacements are followed ({1e3 * moved[2]:.1f} mm up)")

    def held(self):
        """Holds the robot for a while, and lets control go on."""
        self.call("hold")
        check(self.wait(lambda: self.phase() == "held", 3.0), "services: the phase is held")
        before = self.place()
        time.sleep(1.0)
        moved = np.linalg.norm(self.place() - before)
        check(moved < 2e-4, f"services: the arm holds ({1e3 * moved:.3f} mm in 1 s)")
        self.call("start")
        check(self.wait(lambda: self.phase() != "held", 3.0), "services: the robot is not held any more")

    def stopped(self, started, robot):
        """Stops the program, and returns the folder of the run."""
        self.call("stop")
        code, said, out = end(started)
        counts = robot.end()
        check(code == 130, f"services: the run is interrupted (exit code {code})")
        if code != 130:
            print(said)
        check(counts["speed_at_end_rad_per_s"] < 0.02, f"services: the arm holds ({counts['speed_at_end_rad_per_s']:.2g} rad/s)")
        replayed = subprocess.run([args.program, "replay", str(out)], capture_output=True, text=True, check=False)
        check(replayed.returncode == 0, "targets: the log is replayed bit for bit")
        return out


@impatient
def targets_are_followed():
    """Poses from rclpy at 20 Hz with dropouts; gains, modes, clutch, frames; services; outputs."""
    from diagnostic_msgs.msg import DiagnosticArray
    from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
    from std_msgs.msg import Float64MultiArray, String

    operator = Operator()
    node, seen = operator.node, operator.seen

    # The bytes as they come, for rosbags.
    from rosbags.highlevel import AnyReader
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    folder = FOLDER / f"outputs-{time.monotonic_ns()}"
    bag = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    bag.open()
    for kind, topic in ((PoseStamped, "/opspace/flange/state"), (WrenchStamped, "/opspace/wrist/wrench"), (DiagnosticArray, "/diagnostics")):
        connection = bag.add_connection(topic, f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}", typestore=store)
        node.create_subscription(kind, topic, lambda raw, connection=connection: bag.write(connection, time.time_ns(), raw), 10, raw=True)

    frame = subprocess.Popen([sys.executable, str(TESTS / "cyclone_robot.py"), "--frame"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert frame.stdout.readline().strip() == "ready"
    robot = Robot("--patient")
    started = start("streamed")
    if not operator.found(started):
        robot.end()
        frame.kill()
        return
    names = set(node.get_node_names())
    check({"opspace", "opspace_driver", "opspace_outputs"} <= names, f"targets: the nodes are in the graph of rclpy: {sorted(names)}")
    home = operator.place()
    goal = home + [0.0, 0.08, 0.05]
    operator.lead(goal, 2.0, dropout=(0.8, 1.4))
    away = np.linalg.norm(operator.place() - goal)
    check(away < 1e-3, f"targets: poses at 20 Hz with a dropout of 0.6 s are followed ({1e3 * away:.2f} mm at the end)")
    reference = seen["reference"][-1].pose.position
    check(abs(reference.y - goal[1]) < 1e-3, f"targets: the reference is published ({1e3 * (reference.y - goal[1]):.2f} mm)")

    # A frame of the URDF, and an unknown one.
    operator.lead(home + [0.0, 0.05, 0.0], 1.0, frame="pedestal")
    operator.send(home, frame="nowhere")
    time.sleep(0.4)
    away = np.linalg.norm(operator.place() - (home + [0.0, 0.05, 0.0]))
    check(away < 1e-3, f"targets: poses in a frame of the URDF are followed, one in an unknown frame is not ({1e3 * away:.2f} mm)")
    operator.lead(home + [0.0, 0.03, -0.2], 1.0, frame="table")
    away = np.linalg.norm(operator.place() - (home + [0.0, 0.03, 0.0]))
    check(away < 1e-3, f"targets: poses in a frame of /tf_static are followed ({1e3 * away:.2f} mm)")
    old = PoseStamped()
    old.header.stamp.sec = 1
    operator.poses.publish(old)
    operator.clutched()

    # Velocities.
    before = operator.place()
    for _ in range(20):
        message = TwistStamped()
        message.header.stamp = node.get_clock().now().to_msg()
        message.twist.linear.y = -0.03
        operator.twists.publish(message)
        time.sleep(0.05)
    time.sleep(0.3)
    moved = operator.place() - before
    check(-0.05 < moved[1] < -0.02, f"targets: velocities are followed ({1e3 * moved[1]:.1f} mm in 1 s at 30 mm/s)")

    operator.gains.publish(Float64MultiArray(data=[20.0] * 6 + [1.0] * 6))
    operator.modes.publish(String(data="x=sideways"))
    operator.gains.publish(Float64MultiArray(data=[20.0]))
    time.sleep(1.3)
    diagnostics = {value.key: value.value for value in seen["diagnostics"][-1].status[0].values}
    check(int(diagnostics["targets_refused"]) >= 4 and int(diagnostics["targets_accepted"]) > 60, f"targets: refused ones are counted: {diagnostics}")
    operator.held()
    operator.call("tare")
    time.sleep(1.0)
    out = operator.stopped(started, robot)
    stale = rows(out, "flange.target_stale").sum()
    check(stale > 20, f"targets: the log has the dropouts ({stale:.0f} cycles)")
    operator.end()
    frame.kill()
    bag.close()
    counted = {}
    with AnyReader([folder], default_typestore=store) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
            counted[connection.topic] = counted.get(connection.topic, 0) + 1
    check(counted.get("/opspace/flange/state", 0) > 300 and len(counted) == 3, f"rosbags reads the bytes of a recording in MCAP: {counted}")


def targets_of(interface):
    of_robot, of_program = INTERFACES[interface]

    def run():
        """Poses, clutch, hold and stop of an arm that accepts velocities or efforts."""
        operator = Operator()
        robot = Robot("--patient", *of_robot)
        started = start("streamed", *of_program)
        if operator.found(started):
            goal = operator.place() + [0.0, 0.05, 0.03]
            operator.lead(goal, 1.0)
            away = np.linalg.norm(operator.place() - goal)
            check(away < 1e-3, f"targets, {interface}: poses are followed ({1e3 * away:.2f} mm at the end)")
            operator.clutched()
            operator.held()
            operator.lead(goal + [0.01, 0.0, 0.0], 1.0)
            operator.stopped(started, robot)
        else:
            robot.end()
        operator.end()

    scenario(run, f"targets_{interface}", is_patient=False)


for interface in ("velocity", "effort"):
    targets_of(interface)


# ---- programs of others ----


@impatient
def cyclone_and_rosbags_agree():
    """Cyclone DDS plays the robot and reads /tf; a recording of the topics is read by rosbags."""
    bag = FOLDER / f"topics-{time.monotonic_ns()}"
    peer = subprocess.Popen([sys.executable, str(TESTS / "cyclone_robot.py"), str(bag)], stdout=subprocess.PIPE, text=True)
    assert peer.stdout.readline().strip() == "ready"
    code, said, out = end(start("hold", "--controller", "ik"))
    lines = peer.communicate(timeout=30)[0].strip().splitlines()
    found = json.loads(lines[-1])
    check(code == 0, f"Cyclone DDS: the run is complete (exit code {code})")
    if code != 0:
        print(said)
    print(f"        {found}")
    check(found["commands"] > 800, f"Cyclone DDS: {found['commands']} commands arrived")
    check("opspace/flange" in found["frames"], f"Cyclone DDS: /tf has {found['frames']}")
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        messages = [reader.deserialize(raw, connection.msgtype) for connection, _, raw in reader.messages() if connection.topic == "/forward_position_controller/commands"]
        frames = [reader.deserialize(raw, connection.msgtype) for connection, _, raw in reader.messages() if connection.topic == "/tf"]
    check(len(messages) > 800 and np.allclose(messages[0].data, START, atol=0.1), f"rosbags reads {len(messages)} commands of {kinds}")
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


# ---- scenarios ----


def here(name):
    """Runs a scenario in this process and network."""
    import rclpy

    # Before other programs of the machine, where that is allowed; what it starts inherits it.
    with contextlib.suppress(PermissionError):
        os.nice(-10)
    rclpy.init(args=[])
    for repeats_left in reversed(range(REPEATS + 1)):
        failures.clear()
        standstills.clear()
        SCENARIOS[name]()
        is_repeated = standstills or (name in IMPATIENT and repeats_left == REPEATS)
        if not (failures and is_repeated and repeats_left):
            return
        print(f"once more, since {len(failures)} checks have failed: {failures} {standstills[:1]}", flush=True)


# A network and a shared memory without anybody else.
APART = ["unshare", *([] if os.getuid() == 0 else ["--map-root-user"]), "--net", "--mount", "--ipc", "sh", "-c"]
LOOPBACK = "ip link set lo up && ip link set lo multicast on && ip route add 224.0.0.0/4 dev lo && mount -t tmpfs tmpfs /dev/shm"


def apart(name):
    """Runs a scenario in a process and a network of its own; returns its exit code and output, and its duration in s."""
    began = time.monotonic()
    command = [*APART, f'{LOOPBACK} && exec "$@"', "sh", sys.executable, __file__, args.program, args.project, "--here", name]
    done = subprocess.run([str(part) for part in command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    return done.returncode, done.stdout, time.monotonic() - began


def main():
    if subprocess.run([*APART, LOOPBACK], check=False).returncode != 0:
        print("no network namespace can be created: the topics of ROS 2 are not judged")
        return 75
    names = [name for name in SCENARIOS if args.only in name]
    # The longest first.
    names.sort(key=lambda name: not name.startswith("identification"))
    failed, lines = [], 0
    with concurrent.futures.ThreadPoolExecutor(args.beside) as pool:
        running = {pool.submit(apart, name): name for name in names}
        for finished in concurrent.futures.as_completed(running):
            name = running[finished]
            code, said, duration_s = finished.result()
            print(f"{name}: {SCENARIOS[name].__doc__} ({duration_s:.0f} s)\n{said}", end="", flush=True)
            lines += said.count("ok      ")
            if code != 0:
                failed.append(name)
    FOLDER.rmdir()
    print(f"{len(names)} scenarios, {lines} checks passed; {len(failed)} scenarios failed: {', '.join(failed) or 'none'}")
    return 1 if failed or not names else 0


if args.here is None:
    sys.exit(main())
if args.here == "latencies":
    SCENARIOS["latencies"] = latencies
try:
    here(args.here)
finally:
    sys.stdout.flush()
    # Without the destructors of rclpy, which can wait for each other.
    import traceback

    if sys.exc_info()[0] is not None:
        traceback.print_exc()
        failures.append("an exception")
    sys.stderr.flush()
    if not failures:
        shutil.rmtree(FOLDER, ignore_errors=True)
    os._exit(1 if failures else 0)
