"""MuJoCo's own position actuators, driven by opspace: the torques that come out, and how far a compliant hand yields.

MuJoCo's steps are of 0.2 ms, so that its implicit treatment of kv does not change what the gains mean.
"""

import copy

import arms
import mujoco
import numpy as np
import opspace
import opspace.mujoco
import pytest

STEP_S = 2e-4
PUSH_N = 4.0


def chain(links, *, gains, axes, base=(0.0, 0.0, 0.3)):
    """Links of length and mass, one after the other, with the axis and gains (kp, kv, limit, armature, friction) of each joint."""
    open_bodies, actuators = "", ""
    place = " ".join(map(str, base))
    for number, ((length, mass), axis, (kp, kv, limit, armature, friction)) in enumerate(zip(links, axes, gains, strict=True)):
        kind = "slide" if axis.startswith("slide ") else "hinge"
        axis = axis.removeprefix("slide ")
        span = "-0.3 0.3" if kind == "slide" else "-3 3"
        open_bodies += (
            f'<body name="link{number}" pos="{place}"><joint name="j{number}" type="{kind}" axis="{axis}" range="{span}" '
            f'limited="true" armature="{armature}" frictionloss="{friction}"/>'
            f'<inertial pos="{length / 2} 0 0" mass="{mass}" diaginertia="{mass * 1e-3} {mass * length**2 / 12 + 1e-4} '
            f'{mass * length**2 / 12 + 1e-4}"/>'
        )
        actuators += f'<position name="a{number}" joint="j{number}" kp="{kp}" kv="{kv}" forcerange="-{limit} {limit}"/>'
        place = f"{length} 0 0"
    end = f'<site name="tip" pos="{links[-1][0]} 0 0"/>' + "</body>" * len(links)
    return f'<mujoco><compiler angle="radian" balanceinertia="true"/><worldbody>{open_bodies}{end}</worldbody><actuator>{actuators}</actuator></mujoco>'


def six():
    """The six hinges of `arms.SIX` with gains."""
    names = [("pan", 2000, 100, 150), ("lift", 2000, 100, 150), ("elbow", 2000, 100, 150), ("w1", 500, 25, 28), ("w2", 500, 25, 28), ("w3", 500, 25, 28)]
    lines = "".join(
        f'<position joint="{joint}" kp="{kp}" kv="{kv}" forcerange="-{limit} {limit}"/>' for joint, kp, kv, limit in names
    )
    in_radians = arms.SIX.replace('<mujoco model="six">', '<mujoco model="six"><compiler angle="radian"/>')
    return in_radians.replace("</mujoco>", f"<actuator>{lines}</actuator></mujoco>")


def base_and_arm():
    """Two slides and a hinge of one body, which carries an arm, with an eccentric joint and a finger that an equality moves."""
    return """<mujoco><compiler angle="radian"/><worldbody><body name="base" pos="0 0 0.2">
      <joint name="x" type="slide" axis="1 0 0" range="-1 1" limited="true" armature="2"/>
      <joint name="y" type="slide" axis="0 1 0" range="-1 1" limited="true" armature="2"/>
      <joint name="turn" axis="0 0 1" range="-3 3" limited="true" armature="0.5" ref="0.3"/>
      <inertial pos="0.02 0 0.1" mass="12" diaginertia="0.3 0.3 0.4"/>
      <body name="upper" pos="0.1 0 0.2" quat="0.9 0.1 0.3 0">
        <joint name="lift" axis="0 1 0" pos="0.03 0 0.02" range="-3 3" limited="true" armature="0.1" ref="-0.2"/>
        <inertial pos="0.2 0.01 0" mass="2" diaginertia="0.01 0.03 0.03"/>
        <body name="fore" pos="0.4 0 0" quat="0.8 0 -0.6 0">
          <joint name="elbow" axis="0 1 0" range="-3 3" limited="true" armature="0.1"/>
          <inertial pos="0.15 0 0.01" mass="1.2" diaginertia="0.005 0.015 0.015"/><site name="tip" pos="0.3 0 0"/>
          <body name="finger" pos="0.3 0.02 0"><joint name="finger" type="slide" axis="0 1 0" armature="0.01" range="-1 1" limited="true"/>
            <inertial pos="0 0 0.02" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/></body>
        </body></body></body></worldbody>
      <equality><joint joint1="finger" joint2="elbow" polycoef="0.01 0.02 0 0 0"/></equality>
      <actuator><position joint="x" kp="20000" kv="1500" forcerange="-900 900"/><position joint="y" kp="20000" kv="1500" forcerange="-900 900"/>
      <position joint="turn" kp="3000" kv="150" forcerange="-200 200"/><position joint="lift" kp="150" kv="6" gear="3" forcerange="-50 50"/>
      <position joint="elbow" kp="400" kv="15" forcerange="-60 60"/></actuator></mujoco>"""


Y, Z, X = "0 1 0", "0 0 1", "1 0 0"
SMALL = (8.9, 0.6, 1.9, 0.028, 0.0)
# Model, frame, axes of the task, start.
ARMS = {
    "two in a plane": (
        chain([(0.5, 3.0), (0.4, 2.0)], axes=[Y, Y], gains=[(800, 40, 80, 0.2, 0), (400, 20, 40, 0.1, 0)]),
        "tip", "xz", [0.5, 0.9],
    ),
    "three in a plane": (
        chain([(0.4, 3.0), (0.3, 2.0), (0.2, 1.0)], axes=[Y] * 3, gains=[(1200, 60, 90, 0.2, 0), (700, 30, 50, 0.1, 0), (200, 8, 20, 0.05, 0)]),
        "tip", "xz", [0.4, 0.8, 0.5],
    ),
    "scara": (
        chain([(0.35, 4.0), (0.3, 3.0), (0.02, 1.0), (0.05, 0.3)], axes=[Z, Z, f"slide {Z}", Z],
              gains=[(1500, 80, 100, 0.3, 0), (800, 40, 60, 0.2, 0), (9000, 500, 200, 3.0, 0), (40, 1.5, 10, 0.02, 0)]),
        "tip", "xyz", [0.4, 0.9, 0.0, 0.2],
    ),
    "five, small and without damping of the servo": (
        chain([(0.05, 0.1), (0.116, 0.1), (0.135, 0.1), (0.06, 0.06), (0.06, 0.06)], axes=[Z, Y, Y, Y, X],
              gains=[(8.9, 0.0, 1.9, 0.028, 0)] * 5),
        "tip", "xyz", [0.2, -0.9, 1.3, 0.4, 0.1],
    ),
    "six": (six(), "flange", "xyz", [-1.5708, -1.5708, 1.5708, -1.5708, -1.5708, 0.0]),
    "a base and its arm": (base_and_arm(), "tip", "xyz", [0.1, -0.1, 0.5, 0.4, 0.7]),
    "seven": (
        chain([(0.1, 4.0), (0.2, 3.5), (0.2, 3.0), (0.2, 2.5), (0.2, 2.0), (0.1, 1.0), (0.1, 0.5)], axes=[Z, Y, X, Y, X, Y, X],
              gains=[(2000, 200, 300, 0.3, 0)] * 4 + [(1000, 60, 100, 0.1, 0)] * 3),
        "tip", "xyz", [0.0, -1.0, 0.0, 1.6, 0.0, 0.5, 0.0],
    ),
}


def compiled(xml):
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.timestep = STEP_S
    return model


def task(robot, frame, axes, start, *, compliant):
    joints = opspace.Model.from_robot(robot).joints
    reference = "hold" if compliant else {
        "sinusoid": {axis: [{"amplitude_m": 0.02, "frequency_hz": 0.7}] for axis in (axes[0], axes[-1])}
    }
    return {
        "duration_s": 3.0,
        "settle_s": 0.5,
        "priority": ["hand", "rest"],
        "start_rad": dict(zip(joints, start, strict=True)),
        "task": {
            "hand": {
                "cartesian": {
                    "frame": frame,
                    "axes": {axis: "compliant" if compliant and axis == "x" else "motion" for axis in axes},
                    "gains": {"frequency_rad_per_s": 14.0, "damping_ratio": 1.0},
                    "reference": reference,
                }
            },
            "rest": {"joint-posture": {"frequency_rad_per_s": 4.0, "damping_ratio": 1.0}},
        },
    }


class Pushed(opspace.mujoco.Arm):
    """Arm whose actuator torques are kept, and that is pushed along x after a second."""

    def __init__(self, model, experiment, frame, push_n):
        super().__init__(model, experiment)
        self.site, self.push_n = model.site(frame), push_n
        self.torques, self.positions = [], []

    def applied(self, data):
        if data.time > 1.0 and self.push_n:
            force, moment = np.array([self.push_n, 0.0, 0.0]), np.zeros(3)
            data.qfrc_applied[:] = 0.0
            point = data.site_xpos[self.site.id]
            mujoco.mj_applyFT(self.model, data, force, moment, point, self.site.bodyid[0], data.qfrc_applied)

    def read(self):
        measured = super().read()
        self.torques.append(self.torque())
        self.positions.append(self.data.site_xpos[self.site.id].copy())
        return measured


def run(name, folder, *, hz=1000.0, backend="position", controller=None, compliant=False, push_n=0.0):
    xml, frame, axes, start = ARMS[name]
    model = compiled(xml)
    robot = opspace.mujoco.write_robot(model, folder / "arm", cycle_hz=hz, velocity_limit_rad_per_s=20.0)
    if backend == "torque":
        # The same arm with motors.
        model = copy.copy(model)
        model.actuator_gainprm[:, 0], model.actuator_biasprm[:] = 1.0, 0.0
    experiment = opspace.Experiment(
        task(robot, frame, axes, start, compliant=compliant), robot, backend=backend, controller=controller
    )
    arm = Pushed(model, experiment, frame, push_n)
    result = experiment.on(arm)
    assert result.outcome == "completed", (name, result.fault)
    return result, arm


def errors(result, arm):
    """Torque errors of the joints and desired torques, rms over the time after the ramp, Nm."""
    tick = result.log["tick"]
    desired = tick["torque_desired"]
    # The command of a cycle acts in the next one.
    count = min(len(desired), len(arm.torques) - 1)
    actual, desired = np.array(arm.torques[1 : count + 1]), desired[:count]
    used = np.isfinite(desired).all(axis=1) & (tick.time_s[:count] > 0.8)
    assert used.sum() > 100
    rms = lambda values: np.sqrt((values**2).mean(axis=0))
    return rms((actual - desired)[used]), rms(desired[used])


@pytest.mark.parametrize("name", ARMS)
def test_dynamics_of_the_written_robot_are_those_of_the_model(name, tmp_path):
    xml, frame, _, start = ARMS[name]
    model = compiled(xml)
    robot = opspace.Model.from_robot(opspace.mujoco.write_robot(model, tmp_path / "arm"))
    other = opspace.Model.from_mujoco(model, joints=robot.joints)
    for q in (np.array(start), np.linspace(-0.25, 0.25, robot.n)):
        robot.update(q)
        other.update(q)
        scale = np.abs(other.mass_matrix).max()
        assert np.abs(robot.mass_matrix - other.mass_matrix).max() < 1e-11 * scale
        assert np.abs(robot.gravity - other.gravity).max() < 1e-11 * max(1.0, np.abs(other.gravity).max())
        assert np.abs(robot.pose(frame)[0] - other.pose(frame)[0]).max() < 1e-12


@pytest.mark.parametrize(("hz", "bound"), [(1000.0, 0.05), (100.0, 0.10)])
@pytest.mark.parametrize("name", ARMS)
def test_actuators_produce_the_desired_torques(name, hz, bound, tmp_path):
    error, desired = errors(*run(name, tmp_path, hz=hz))
    pooled = np.sqrt((error**2).sum() / (desired**2).sum())
    # Of joints that have something to do.
    shares = np.where(desired > 1e-3 * desired.max(), error / np.maximum(desired, 1e-12), 0.0)
    worst = shares.argmax()
    print(f"{name}, {hz:g} Hz: pooled {100 * pooled:.3f} %, worst joint {worst}: {error[worst]:.3g} of {desired[worst]:.3g} Nm")
    assert pooled < bound


@pytest.mark.parametrize("name", ARMS)
def test_a_compliant_hand_yields_as_with_motors(name, tmp_path):
    push_n = 0.4 if "small" in name else PUSH_N
    moved = {}
    for kind, options in {
        "servos": {},
        "motors": {"backend": "torque"},
        "ik": {"controller": "ik"},
    }.items():
        _, arm = run(name, tmp_path / kind, compliant=True, push_n=push_n, **options)
        positions = np.array(arm.positions)
        before, after = (int(seconds / 0.001) for seconds in (0.99, 1.6))
        moved[kind] = (positions[after] - positions[before])[0]
    print(f"{name}: {push_n} N along x for 0.6 s: " + ", ".join(f"{kind} {1e3 * x:.1f} mm" for kind, x in moved.items()))
    assert abs(moved["servos"] - moved["motors"]) < 0.1 * abs(moved["motors"])
    assert abs(moved["motors"]) > 0.01 and abs(moved["ik"]) < 0.3 * abs(moved["motors"])


def test_models_that_are_no_position_robots_are_refused(tmp_path):
    bare = ARMS["two in a plane"][0].replace('kp="', 'inheritrange="0" kp="')
    motor = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody><actuator><motor joint="j"/></actuator></mujoco>'
    )
    with pytest.raises(opspace.OpspaceError, match="no position actuator"):
        opspace.mujoco.write_robot(motor, tmp_path / "arm")
    with pytest.raises(opspace.OpspaceError, match="expected a mujoco.MjModel, got str"):
        opspace.mujoco.write_robot("arm.xml", tmp_path / "arm")
    model = compiled(bare)
    with pytest.raises(opspace.OpspaceError, match="measured"):
        opspace.mujoco.write_robot(model, tmp_path / "arm", measured="position")
    opspace.mujoco.write_robot(model, tmp_path / "twice")
    with pytest.raises(opspace.OpspaceError, match="overwrite=True"):
        opspace.mujoco.write_robot(model, tmp_path / "twice")
    with pytest.raises(opspace.OpspaceError, match="whole number of steps"):
        opspace.mujoco.write_robot(model, tmp_path / "arm", cycle_hz=700.0)
    model.body_gravcomp[1] = 1.0
    with pytest.raises(opspace.OpspaceError, match="gravcomp"):
        opspace.mujoco.write_robot(model, tmp_path / "arm")
