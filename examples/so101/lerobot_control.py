"""LeRobot reads and writes the servos of an SO-101, and opspace computes the setpoints.

    python lerobot_control.py TASK.toml PORT CALIBRATION.json

Needs `pip install lerobot[feetech] opspace`. The calibration is the file that LeRobot has written.
"""

import json, math, sys, time
import opspace
from lerobot.motors import Motor, MotorCalibration, MotorNormMode
from lerobot.motors.feetech import FeetechMotorsBus

experiment = opspace.Experiment(sys.argv[1])
loop, joints = experiment.control_loop(), experiment.joints
calibration = {name: MotorCalibration(**values) for name, values in json.load(open(sys.argv[3])).items()}
motors = {name: Motor(calibration[name].id, "sts3215", MotorNormMode.DEGREES) for name in joints}
bus = FeetechMotorsBus(sys.argv[2], motors, {name: calibration[name] for name in joints})
bus.connect()
for register, value in [("P_Coefficient", 16), ("I_Coefficient", 0), ("D_Coefficient", 32)]:
    for name in joints:
        bus.write(register, name, value)
bus.enable_torque()

late, begun = 0, time.monotonic()
due, end = begun, begun + experiment.duration_s
while due < end:
    time.sleep(max(0.0, due - time.monotonic()))
    time_s, degrees = time.monotonic() - begun, bus.sync_read("Present_Position", joints, num_retry=3)
    kind, setpoints = loop.step(time_s, [math.radians(degrees[name]) for name in joints])
    if kind == "position":
        bus.sync_write("Goal_Position", {name: math.degrees(q) for name, q in zip(joints, setpoints)})
    # A cycle that is late is left out: what follows it keeps the period.
    late += time.monotonic() > due + loop.period_s
    due = max(due + loop.period_s, time.monotonic())
print(f"{late} late cycles; torques {loop.signals()['torque_desired'].round(3)} Nm")
bus.disconnect(disable_torque=False)
