"""The package `opspace` in a node of rclpy, for those who have ROS: joint states in, positions out, poses as targets.

python rclpy_node.py task.toml log.mcap      # robot.toml: measured = ["position", "velocity", "motor-current"], a force sensor
"""

import sys

import opspace
import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray


class Controller(Node):
    def __init__(self, task, log):
        super().__init__("opspace")
        experiment = opspace.Experiment(task)
        self.run, self.joints, self.wrench = experiment.start(log), experiment.joints, [0.0] * 6
        self.commands = self.create_publisher(Float64MultiArray, "forward_position_controller/commands", 1)
        self.create_subscription(JointState, "joint_states", self.cycle, 1)
        self.create_subscription(WrenchStamped, "wrist/wrench", self.feel, 1)
        self.create_subscription(PoseStamped, "target_pose", self.aim, 1)

    def feel(self, message):
        force, torque = message.wrench.force, message.wrench.torque
        self.wrench = [force.x, force.y, force.z, torque.x, torque.y, torque.z]

    def aim(self, message):
        p, q = message.pose.position, message.pose.orientation
        self.run.target("flange", pose=[p.x, p.y, p.z, q.w, q.x, q.y, q.z])

    def cycle(self, state):
        at = [state.name.index(joint) for joint in self.joints]
        q, dq, torque = ([values[i] for i in at] for values in (state.position, state.velocity, state.effort))
        time_s = state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec
        kind, values = self.run.step(time_s, q, dq=dq, motor_torque=torque, wrenches=self.wrench)
        if kind == "position":
            self.commands.publish(Float64MultiArray(data=values))
        if self.run.over:
            print(self.run.finish().outcome)
            raise SystemExit


rclpy.init()
rclpy.spin(Controller(*sys.argv[1:3]))
