"""A robot behind ROS 2 topics, with nothing of opspace: MuJoCo with its own actuators of positions, velocities or torques, and an
rclpy node.

It does what ros2_control does in a cycle: it publishes the joint states, writes the command that had come before, and lets the
physics go on for a period. The joint states have another order than the URDF, and a joint more.

    foreign_robot.py ur5e.urdf --hz 250 --record motion.csv

The last line of the output has counts as JSON.
"""

import argparse
import collections
import json
import os
import signal
import sys
import threading
import time

import mujoco
import numpy as np

JOINTS = ["base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3"]
# Of the messages: another order, and a joint that is none of the arm.
PUBLISHED = ["elbow", "shoulder", "gripper", "base", "wrist_1", "wrist_2", "wrist_3"]
START = [0.0, -1.5708, -1.5708, -1.5708, 1.5708, 0.0]
GAINS = {name: (200.0, 10.0, 28.0, 0.1) if "wrist" in name else (2000.0, 150.0, 150.0, 0.5) for name in JOINTS}
# Of a robot that accepts efforts; without it nothing would bring it to rest at zero effort. Nms/rad.
DAMPING = {name: 2.0 if "wrist" in name else 10.0 for name in JOINTS}
STEP_S = 2e-4


class Arm:
    """The arm: joints of a URDF with actuators, a push, a board, and a force sensor at the flange.

    One that accepts velocities or efforts carries its weight by itself.
    """

    def __init__(self, urdf, interface, push_n, board_z, interpolates):
        text = open(urdf).read().replace("</robot>", '<mujoco><compiler fusestatic="false" discardvisual="false"/></mujoco></robot>')
        spec = mujoco.MjSpec.from_string(text)
        for joint in spec.joints:
            kp, kv, limit, armature = GAINS[joint.name]
            damping = DAMPING[joint.name] if interface == "effort" else 0.0
            joint.armature, joint.damping, joint.frictionloss = armature, [damping, 0.0, 0.0], 0.0
            actuator = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            if interface == "position":
                actuator.set_to_position(kp=kp, kv=kv)
            elif interface == "velocity":
                actuator.set_to_velocity(kv=kv)
            else:
                actuator.set_to_motor()
            actuator.forcerange = [-limit, limit]
            actuator.forcelimited = True
        for geom in spec.geoms:
            geom.contype, geom.conaffinity = 0, 0
        for body in spec.bodies:
            body.gravcomp = 0.0 if interface == "position" else 1.0
        self.model = spec.compile()
        self.model.opt.timestep = STEP_S
        self.data = mujoco.MjData(self.model)
        self.q = [self.model.joint(name).qposadr[0] for name in JOINTS]
        self.v = [self.model.joint(name).dofadr[0] for name in JOINTS]
        self.flange = self.model.body("flange").id
        self.data.qpos[self.q] = START
        mujoco.mj_forward(self.model, self.data)
        self.torque = np.zeros(len(JOINTS))
        self.command = np.zeros(len(JOINTS))
        if interface == "position":
            # At rest the servos carry the weight.
            self.torque = self.data.qfrc_bias[self.v].copy()
            self.command = np.array(START) + self.torque / np.array([GAINS[name][0] for name in JOINTS])
        self.data.ctrl[:] = self.command
        self.interface, self.interpolates = interface, interpolates
        self.push_n, self.board_z = np.array(push_n), board_z
        self.wrench = np.zeros(6)
        self.force = np.zeros(3)
        self.driven_since = None

    def applied(self):
        """Force of the environment on the flange: a push some time after the first command, and a board."""
        force = np.zeros(3)
        if self.driven_since is not None and np.any(self.push_n):
            # Rises in a quarter of the time, and falls in the last one.
            share = (self.data.time - self.driven_since - 1.0) / 1.5
            force += self.push_n * max(0.0, min(1.0, 4.0 * share, 4.0 * (1.0 - share)))
        if self.board_z is not None:
            velocity = np.zeros(6)
            mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, self.flange, velocity, 0)
            depth = self.board_z - self.data.xpos[self.flange][2]
            if depth > 0.0:
                force[2] += max(0.0, 3000.0 * depth - 50.0 * velocity[5])
        return force

    def go_on(self, period_s):
        """Lets the physics go on for a period."""
        before = self.data.ctrl.copy() if self.interpolates else self.command
        self.data.ctrl[:] = before
        total = np.zeros(len(JOINTS))
        steps = round(period_s / STEP_S)
        for step in range(steps):
            self.data.ctrl[:] = before + (self.command - before) * (step + 1) / steps
            self.force = self.applied()
            self.data.qfrc_applied[:] = 0.0
            mujoco.mj_applyFT(self.model, self.data, self.force, np.zeros(3), self.data.xpos[self.flange], self.flange, self.data.qfrc_applied)
            mujoco.mj_step(self.model, self.data)
            total += self.data.actuator_force
        self.torque = total / steps
        turned = self.data.xmat[self.flange].reshape(3, 3).T
        self.wrench = np.concatenate([turned @ self.force, np.zeros(3)])

    def rest(self):
        """Lets the arm rest without a controller: at its last position, at zero velocity, or on its brakes."""
        if self.interface != "position":
            self.command = np.zeros(len(JOINTS))
        if self.interface == "effort":
            self.model.dof_damping[self.v] = 1e5

    def state(self):
        """Positions, velocities and torques by name, with a gripper."""
        values = zip(JOINTS, self.data.qpos[self.q], self.data.qvel[self.v], self.torque, strict=True)
        by_name = {name: row for name, *row in values} | {"gripper": [0.4, 0.0, 0.0]}
        return np.array([by_name[name] for name in PUBLISHED]).T


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("urdf")
    parser.add_argument("--hz", type=float, default=250.0)
    parser.add_argument("--duration-s", type=float, default=60.0)
    parser.add_argument("--push-n", type=float, nargs=3, default=[0.0, 0.0, 0.0])
    parser.add_argument("--board-z", type=float)
    parser.add_argument("--patient", action="store_true", help="wait for the command that answers each state while there are commands, as a simulator may do")
    parser.add_argument("--late-cycles", type=int, default=0, help="let each command act this number of cycles later")
    parser.add_argument("--record")
    parser.add_argument("--rename-after-s", type=float, help="publish other names of the joints then")
    parser.add_argument("--clock-jump-after-s", type=float, help="let the stamps jump by an hour then")
    parser.add_argument("--silent-after-s", type=float, help="publish no states then")
    parser.add_argument("--nan-after-s", type=float, help="publish positions that are no numbers then")
    parser.add_argument("--wrench-silent-after-s", type=float, help="publish no wrenches then")
    parser.add_argument("--wrench-frame-after-s", type=float, help="publish wrenches in another frame then")
    parser.add_argument("--inactive-after-s", type=float, help="ignore commands then, as without an active controller")
    parser.add_argument("--deaf-after-s", type=float, help="destroy the subscription of the commands then, as a controller that is stopped does")
    parser.add_argument("--restart-after-s", type=float, help="destroy the publisher then, and create another one after 30 ms")
    parser.add_argument("--no-stamps", action="store_true")
    parser.add_argument("--namespace", default="")
    parser.add_argument("--interface", choices=["position", "velocity", "effort"], default="position", help="quantity that the controller passes on")
    parser.add_argument("--trajectories", action="store_true", help="take trajectories of one point, and move to it within a cycle")
    args = parser.parse_args()

    import rclpy
    from geometry_msgs.msg import WrenchStamped
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray, String
    from trajectory_msgs.msg import JointTrajectory
    from rclpy.qos import DurabilityPolicy, QoSProfile

    rclpy.init(args=[])
    node = rclpy.create_node("foreign_robot", namespace=args.namespace)
    publisher = node.create_publisher(JointState, "joint_states", 10)
    wrench_publisher = node.create_publisher(WrenchStamped, "wrist/wrench", 10)
    description = node.create_publisher(String, "robot_description", QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    description.publish(String(data=open(args.urdf).read()))
    arm = Arm(args.urdf, args.interface, args.push_n, args.board_z, args.trajectories)
    arrived = threading.Condition()
    counts = {"states": 0, "pauses": 0, "commands": 0, "late_cycles": 0, "wrong_commands": 0}
    latest = {"command": None, "published_s": None}
    # From the publication of a state to the arrival of the next command, in a process of the same computer.
    latencies = []

    def take(message):
        with arrived:
            if len(message.data) != len(JOINTS) or not np.all(np.isfinite(message.data)):
                counts["wrong_commands"] += 1
                return
            latest["command"] = np.array(message.data)
            if latest["published_s"] is not None:
                latencies.append(time.perf_counter() - latest["published_s"])
                latest["published_s"] = None
            counts["commands"] += 1
            arrived.notify()

    def take_trajectory(message):
        point = dict(zip(message.joint_names, message.points[0].positions, strict=True))
        within_s = message.points[0].time_from_start.sec + 1e-9 * message.points[0].time_from_start.nanosec
        assert len(message.points) == 1 and abs(within_s - 1.0 / args.hz) < 1e-6
        take(Float64MultiArray(data=[point[name] for name in JOINTS]))

    if args.trajectories:
        commands = node.create_subscription(JointTrajectory, "joint_trajectory_controller/joint_trajectory", take_trajectory, 10)
    else:
        commands = node.create_subscription(Float64MultiArray, f"forward_{args.interface}_controller/commands", take, 10)
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    record = open(args.record, "w") if args.record else None
    if record:
        print("time_s,x_m,y_m,z_m,fx_n,fy_n,fz_n," + ",".join(f"{name}_command" for name in JOINTS), file=record)
    period_s = 1.0 / args.hz
    began, wall = time.time(), time.perf_counter()
    cycle, driven_s = 0, None
    # Without commands it waits for none.
    is_idle, answered = True, 0
    waiting = collections.deque()
    print("ready", flush=True)
    while not stop.is_set() and arm.data.time < args.duration_s:
        if is_idle and args.patient and counts["commands"] > answered:
            # Commands begin: those that answer earlier states are waited for.
            is_idle = False
            time.sleep(0.05)
        # The command that has come before this state.
        with arrived:
            answered, command = counts["commands"], latest["command"]
        if command is not None and driven_s is None:
            driven_s = arm.driven_since = arm.data.time
        since = None if driven_s is None else arm.data.time - driven_s
        happens = lambda after: since is not None and after is not None and since > after
        # Publish the state, and the wrench before it.
        stamp = began + arm.data.time + (3600.0 if happens(args.clock_jump_after_s) else 0.0)
        message, wrench = JointState(), WrenchStamped()
        for header in (message.header, wrench.header):
            if not args.no_stamps:
                header.stamp.sec, header.stamp.nanosec = int(stamp), int(stamp % 1.0 * 1e9)
        wrench.header.frame_id = "tool" if happens(args.wrench_frame_after_s) else "flange"
        wrench.wrench.force.x, wrench.wrench.force.y, wrench.wrench.force.z = map(float, arm.wrench[:3])
        position, velocity, effort = arm.state()
        message.name = [f"robot1_{name}" if happens(args.rename_after_s) else name for name in PUBLISHED]
        message.position, message.velocity, message.effort = position.tolist(), velocity.tolist(), effort.tolist()
        if happens(args.nan_after_s):
            message.position[0] = float("nan")
        if happens(args.deaf_after_s):
            args.deaf_after_s = None
            node.destroy_subscription(commands)
            if args.interface != "position":
                # As controllers of velocities and efforts do when they are stopped.
                latest["command"] = np.zeros(len(JOINTS))
        if happens(args.restart_after_s):
            args.restart_after_s = None
            node.destroy_publisher(publisher)
            time.sleep(0.03)
            publisher = node.create_publisher(JointState, "joint_states", 10)
            time.sleep(0.03)
        if not happens(args.silent_after_s):
            if not happens(args.wrench_silent_after_s):
                wrench_publisher.publish(wrench)
            latest["published_s"] = time.perf_counter()
            publisher.publish(message)
            counts["states"] += 1
        waiting.append(command)
        command = waiting.popleft() if len(waiting) > args.late_cycles else None
        if happens(args.inactive_after_s):
            arm.rest()
        elif command is not None:
            arm.command = command
        arm.go_on(period_s)
        cycle += 1
        if record and driven_s is not None:
            values = [arm.data.time - driven_s, *arm.data.xpos[arm.flange], *arm.force, *arm.command]
            print(",".join(f"{value:.9g}" for value in values), file=record)
        wall += period_s
        ahead_s = wall - time.perf_counter()
        if ahead_s > 0.0:
            time.sleep(ahead_s)
        elif args.patient or ahead_s < -10.0 * period_s:
            wall -= ahead_s
            counts["late_cycles"] += 1
        else:
            counts["late_cycles"] += 1
        if not is_idle:
            # No state is overtaken by the next one.
            with arrived:
                is_idle = not arrived.wait_for(lambda: counts["commands"] > answered or stop.is_set(), timeout=0.2)
                counts["pauses"] += is_idle
    if record:
        record.close()
    if latencies:
        median, most, largest = 1e3 * np.quantile(latencies, [0.5, 0.99, 1.0])
        counts |= {"latency_ms": [round(float(value), 3) for value in (median, most, largest)]}
    drift = np.abs(arm.data.qvel[arm.v]).max()
    counts["last_command"] = None if latest["command"] is None else latest["command"].tolist()
    print(json.dumps(counts | {"speed_at_end_rad_per_s": float(drift), "cycles": cycle}), flush=True)
    # Without the destructors of rclpy, which can wait for each other.
    sys.stdout.flush()
    os._exit(0)


main()
