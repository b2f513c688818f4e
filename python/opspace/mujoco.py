"""MuJoCo's own position actuators as a robot.

A `<position>` actuator is a servo: force = kp (ctrl - q) - kv dq. `write_robot` writes robot.urdf and robot.toml of a compiled
model, with these servos; `Arm` is the robot for `Experiment.on`. MuJoCo is then a robot whose drives opspace did not write.

    import mujoco
    import opspace
    import opspace.mujoco

    model = mujoco.MjModel.from_xml_path("arm.xml")
    robot = opspace.mujoco.write_robot(model, "arm", cycle_hz=500.0)
    experiment = opspace.Experiment("task.toml", robot)
    arm = opspace.mujoco.Arm(model, experiment)
    result = experiment.on(arm)
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opspace import Experiment, OpspaceError

Array = NDArray[np.float64]

# Numbers of MuJoCo's types.
_FREE, _BALL, _SLIDE, _HINGE = 0, 1, 2, 3
_OF_JOINT = 0
_FIXED_GAIN, _AFFINE_BIAS = 0, 1
_NO_DYNAMICS = 0

# Cut-off frequency of the servo's derivative, as a multiple of its rate: MuJoCo's velocity is not filtered.
_UNFILTERED = 100.0

# Inertia of a link between two joints of a body, which has none in MuJoCo: it must not be zero.
_BETWEEN = '<inertial><mass value="1e-12"/><inertia ixx="1e-15" ixy="0" ixz="0" iyy="1e-15" iyz="0" izz="1e-15"/></inertial>'

# Counts per turn of an encoder without rounding.
_EXACT = 2_000_000_000

# Quantities that an arm can read.
_MEASURED = ("position", "velocity", "motor-current")

# Displacement over which MuJoCo's friction loss builds up, rad or m.
_PRESLIDING = 0.001


class Servo:
    """Position actuator of a joint.

    joint: its name; index: number of the actuator; gear: transmission ratio from joint to actuator. stiffness_nm_per_rad and
    damping_nms_per_rad: kp and kv at the joint, Nm/rad and Nms/rad (N/m and Ns/m for a slide). torque_limit_nm: largest force at
    the joint, Nm (N); infinite without a limit.
    """

    def __init__(self, model: Any, index: int) -> None:
        joint = int(model.actuator_trnid[index, 0])
        self.joint: str = model.joint(joint).name
        self.index: int = index
        self.gear: float = float(model.actuator_gear[index, 0])
        self.stiffness_nm_per_rad: float = float(model.actuator_gainprm[index, 0]) * self.gear**2
        self.damping_nms_per_rad: float = -float(model.actuator_biasprm[index, 2]) * self.gear**2
        limit = np.inf
        if model.actuator_forcelimited[index]:
            limit = min(limit, float(np.abs(model.actuator_forcerange[index]).min()) * abs(self.gear))
        if model.jnt_actfrclimited[joint]:
            limit = min(limit, float(np.abs(model.jnt_actfrcrange[joint]).min()))
        self.torque_limit_nm: float = limit

    def __repr__(self) -> str:
        return f"Servo({self.joint!r}, kp {self.stiffness_nm_per_rad:g}, kv {self.damping_nms_per_rad:g}, limit {self.torque_limit_nm:g})"


def servos(model: Any) -> list[Servo]:
    """Returns the position actuators of a compiled model, in the order of their joints.

    Actuators that are no position servos of one joint, such as motors and tendons, are left out.
    """
    found: dict[int, Servo] = {}
    for index in range(model.nu):
        gain, bias = model.actuator_gainprm[index], model.actuator_biasprm[index]
        is_position = (
            model.actuator_trntype[index] == _OF_JOINT
            and model.actuator_dyntype[index] == _NO_DYNAMICS
            and model.actuator_gaintype[index] == _FIXED_GAIN
            and model.actuator_biastype[index] == _AFFINE_BIAS
            and gain[0] > 0.0
            and bias[0] == 0.0
            and bias[1] == -gain[0]
            and bias[2] <= 0.0
        )
        joint = int(model.actuator_trnid[index, 0])
        if is_position and model.jnt_type[joint] in (_SLIDE, _HINGE):
            if joint in found:
                raise _error(f"joint '{model.joint(joint).name}' has two position actuators", "keep one of them")
            found[joint] = Servo(model, index)
    return [found[joint] for joint in sorted(found)]


def write_robot(
    model: Any,
    folder: str | PathLike[str],
    *,
    cycle_hz: float | None = None,
    velocity_limit_rad_per_s: float = 3.0,
    measured: tuple[str, ...] = ("position", "velocity", "motor-current"),
    overwrite: bool = False,
) -> Path:
    """Writes robot.urdf and robot.toml of the arm of a compiled model, and returns the folder.

    Joints with a position actuator are those of the robot; others, also those that an equality moves, are locked at `qpos0`. Bodies that hang on a free joint are no part of the robot. Bodies and sites are frames.

    cycle_hz: rate of the control cycle, Hz; it divides that of MuJoCo's steps, which it is by default. velocity_limit_rad_per_s:
    speed at which a run is stopped, which a model of MuJoCo does not state. measured: quantities that `Arm` reads:
    "position", "velocity", "motor-current". overwrite: True if files of the folder are replaced.

    Raises OpspaceError for a model without position actuators, with ball joints or gravity compensation of its own, or a rate
    that does not divide that of the steps.
    """
    if not hasattr(model, "actuator_gainprm"):
        raise _error(f"model: expected a mujoco.MjModel, got {type(model).__name__}", "mujoco.MjModel.from_xml_path reads a file")
    unknown = [name for name in np.atleast_1d(measured) if name not in _MEASURED]
    if isinstance(measured, str) or unknown:
        raise _error(f"measured: expected a tuple of {', '.join(_MEASURED)}, got {measured!r}", 'for example ("position", "velocity")')
    controlled = servos(model)
    if not controlled:
        raise _error("the model has no position actuator of a joint", "use <position> actuators with kp")
    if np.any(model.body_gravcomp != 0.0):
        raise _error("bodies have gravcomp: MuJoCo compensates their weight itself", "remove gravcomp")
    ticks = _ticks(model, cycle_hz)
    folder = Path(folder)
    if not overwrite and (folder / "robot.toml").exists():
        raise _error(f"{folder / 'robot.toml'} exists", "overwrite=True replaces it")
    folder.mkdir(parents=True, exist_ok=True)
    name = folder.name
    (folder / "robot.urdf").write_text(_urdf(model, name, controlled, velocity_limit_rad_per_s))
    (folder / "robot.toml").write_text(_toml(model, controlled, ticks, velocity_limit_rad_per_s, measured))
    return folder


class Arm:
    """Arm of MuJoCo for `Experiment.on`: it writes `ctrl`, and reads `qpos`, `qvel` and `actuator_force`.

    It takes positions if its actuators are servos, and torques if they are motors with a gain of 1. data: state to continue from;
    by default the arm is at rest at the start of the task.
    """

    def __init__(self, model: Any, experiment: Experiment, data: Any = None) -> None:
        import mujoco

        self._step = mujoco.mj_step
        self.model: Any = model
        known = {model.joint(j).name for j in range(model.njnt)}
        missing = [name for name in experiment.joints if name not in known]
        if missing:
            raise _error(f"model: it has no joint '{missing[0]}', which the robot has", "use the model of write_robot")
        joints = np.array([model.joint(name).id for name in experiment.joints])
        self._q, self._v = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        of_joints = {int(joint): index for index, joint in enumerate(model.actuator_trnid[:, 0])}
        self._actuators = np.array([of_joints[int(joint)] for joint in joints])
        self._gears = model.actuator_gear[self._actuators, 0].copy()
        self._ticks = _ticks(model, 1.0 / experiment.period_s)
        self.data: Any = mujoco.MjData(model) if data is None else data
        if data is None:
            self.data.qpos[self._q] = experiment.simulation().q
        mujoco.mj_forward(model, self.data)
        # Before the first command the actuators hold the arm against its weight.
        weight = self.data.qfrc_bias[self._v]
        if experiment.backend == "torque":
            self.data.ctrl[self._actuators] = weight / self._gears
        else:
            stiffness = model.actuator_gainprm[self._actuators, 0] * self._gears**2
            self.data.ctrl[self._actuators] = (self.data.qpos[self._q] + weight / stiffness) * self._gears
        self._torque = weight.copy()
        optional = {"velocity": ("dq", self._velocity), "motor-current": ("motor_torque", self.torque)}
        self._optional = [optional[name] for name in experiment.measured if name in optional]
        self._began = False

    def torque(self) -> Array:
        """Returns the torques of the actuators at the joints, the mean over the last cycle, Nm or N (n)."""
        return self._torque.copy()

    def applied(self, data: Any) -> None:
        """Sets forces in data before each of MuJoCo's steps: a class of yours overrides it to push the arm."""

    def read(self) -> dict[str, Any]:
        """Advances by a control cycle and returns the measurements."""
        if self._began:
            total = np.zeros(len(self._actuators))
            for _ in range(self._ticks):
                self.applied(self.data)
                self._step(self.model, self.data)
                total += self.data.actuator_force[self._actuators]
            self._torque = total / self._ticks * self._gears
        self._began = True
        measured = {name: read() for name, read in self._optional}
        return {"time_s": float(self.data.time), "q": self.data.qpos[self._q].copy(), **measured}

    def write(self, kind: str, values: Array | None) -> None:
        """Writes the command of a cycle; a hold keeps the last one."""
        if values is not None:
            self.data.ctrl[self._actuators] = values * self._gears if kind == "position" else values / self._gears

    def stop(self) -> None:
        """Keeps the last command."""

    def _velocity(self) -> Array:
        return self.data.qvel[self._v].copy()


def _error(message: str, remedy: str) -> OpspaceError:
    error = OpspaceError(f"{message}\nhelp: {remedy}")
    error.help = remedy
    return error


def _ticks(model: Any, cycle_hz: float | None) -> int:
    step_hz = 1.0 / model.opt.timestep
    ticks = step_hz / (step_hz if cycle_hz is None else cycle_hz)
    if ticks < 0.5 or abs(ticks - round(ticks)) > 1e-6 * ticks:
        raise _error(f"a cycle of {cycle_hz} Hz is not a whole number of steps of {step_hz:g} Hz", "choose a divisor of the rate")
    return round(ticks)


def _matrix(quaternion: Array) -> Array:
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _turned(axis: Array, angle: float) -> Array:
    half = 0.5 * angle
    return _matrix(np.concatenate([[np.cos(half)], np.sin(half) * axis / np.linalg.norm(axis)]))


def _numbers(values: Any) -> str:
    return " ".join(f"{float(value):.17g}" for value in values)


def _origin(position: Array, rotation: Array) -> str:
    pitch = np.arctan2(-rotation[2, 0], np.hypot(rotation[0, 0], rotation[1, 0]))
    if np.hypot(rotation[0, 0], rotation[1, 0]) > 1e-9:
        roll = np.arctan2(rotation[2, 1], rotation[2, 2])
        yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    else:
        roll, yaw = 0.0, np.arctan2(-rotation[0, 1], rotation[1, 1])
    return f'<origin xyz="{_numbers(position)}" rpy="{_numbers((roll, pitch, yaw))}"/>'


def _urdf(model: Any, name: str, controlled: list[Servo], velocity: float) -> str:
    by_joint = {servo.joint: servo for servo in controlled}
    text = [f'<robot name="{name}">', '<link name="world"/>']
    links = {0: "world"}

    def link(link_name: str, inside: str = "") -> None:
        text.append(f'<link name="{link_name}">{inside}</link>' if inside else f'<link name="{link_name}"/>')

    def joint(kind: str, joint_name: str, parent: str, child: str, origin: str, inside: str = "") -> None:
        text.append(
            f'<joint name="{joint_name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{origin}{inside}</joint>'
        )

    for body in range(1, model.nbody):
        own = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        parent = links.get(int(model.body_parentid[body]))
        if parent is None or any(model.jnt_type[j] == _FREE for j in own):
            continue
        if any(model.jnt_type[j] == _BALL for j in own):
            raise _error(f"body '{model.body(body).name}' has a ball joint", "use hinges")
        body_name = model.body(body).name or f"body{body}"
        links[body] = body_name
        position, rotation = model.body_pos[body].copy(), _matrix(model.body_quat[body])
        moving = [j for j in own if model.joint(j).name in by_joint]
        for j in moving:
            joint_name = model.joint(j).name
            anchor, axis, reference = model.jnt_pos[j], model.jnt_axis[j], float(model.qpos0[model.jnt_qposadr[j]])
            is_hinge = model.jnt_type[j] == _HINGE
            # Coordinates are those of MuJoCo: the pose of the model is that of `qpos0`.
            position = position + rotation @ anchor
            if is_hinge:
                rotation = rotation @ _turned(axis, -reference)
            else:
                position = position - rotation @ axis * reference
            child = f"{body_name}/{joint_name}"
            link(child, _BETWEEN if j != moving[-1] else "")
            inside = f'<axis xyz="{_numbers(axis)}"/>' + _limit(model, j, by_joint[joint_name], velocity)
            is_limited = model.jnt_limited[j]
            kind = ("revolute" if is_limited else "continuous") if is_hinge else "prismatic"
            joint(kind, joint_name, parent, child, _origin(position, rotation), inside)
            parent, position, rotation = child, -anchor, np.eye(3)
        link(body_name, _inertial(model, body))
        joint("fixed", f"{body_name}/fixed", parent, body_name, _origin(position, rotation))
    taken = set(links.values())
    for site in range(model.nsite):
        parent = links.get(int(model.site_bodyid[site]))
        site_name = model.site(site).name
        if parent is None or not site_name:
            continue
        site_name = f"{site_name}/site" if site_name in taken else site_name
        taken.add(site_name)
        link(site_name)
        joint("fixed", f"{site_name}/fixed", parent, site_name, _origin(model.site_pos[site], _matrix(model.site_quat[site])))
    return "\n".join([*text, "</robot>", ""])


def _inertial(model: Any, body: int) -> str:
    mass, (ixx, iyy, izz) = float(model.body_mass[body]), model.body_inertia[body]
    if mass == 0.0:
        return ""
    origin = _origin(model.body_ipos[body], _matrix(model.body_iquat[body]))
    return (
        f'<inertial>{origin}<mass value="{mass:.17g}"/>'
        f'<inertia ixx="{ixx:.17g}" ixy="0" ixz="0" iyy="{iyy:.17g}" iyz="0" izz="{izz:.17g}"/></inertial>'
    )


def _limit(model: Any, joint: int, servo: Servo, velocity: float) -> str:
    words = [f'velocity="{velocity:.17g}"']
    if np.isfinite(servo.torque_limit_nm):
        words.append(f'effort="{servo.torque_limit_nm:.17g}"')
    if model.jnt_limited[joint]:
        low, high = model.jnt_range[joint]
        words.append(f'lower="{low:.17g}" upper="{high:.17g}"')
    elif model.jnt_type[joint] == _SLIDE:
        words.append('lower="-1000" upper="1000"')
    return f"<limit {' '.join(words)}/>"


def _toml(model: Any, controlled: list[Servo], ticks: int, velocity: float, measured: tuple[str, ...]) -> str:
    servo_hz = 1.0 / model.opt.timestep
    lines = [
        "# Written from a compiled model of MuJoCo: joints with position actuators, their gains, force limits, armature and friction.",
        'urdf = "robot.urdf"',
        'default_profile = "mujoco"',
        'assumed = ["joint_defaults.velocity_limit_rad_per_s"]',
        "",
        "[interface]",
        'command = "position"',
        'setpoints = "held"',
        'gears = "rigid"',
        'on_missed_cycle = "hold-last"',
        'gravity_compensated_by = "controller"',
        f"measured = [{', '.join(repr(name) for name in measured)}]".replace("'", '"'),
        "",
        "# A model of MuJoCo states no speed limit.",
        "[joint_defaults]",
        f"velocity_limit_rad_per_s = {velocity!r}",
        "",
    ]
    for servo in controlled:
        joint = model.joint(servo.joint).id
        dof = int(model.jnt_dofadr[joint])
        lines.append(f'[joint."{servo.joint}"]')
        limit = servo.torque_limit_nm
        # Without a force limit, the largest torque is that of a setpoint at the other end of the range.
        if not np.isfinite(limit):
            low, high = model.jnt_range[joint] if model.jnt_limited[joint] else (-np.pi, np.pi)
            limit = servo.stiffness_nm_per_rad * float(high - low)
        lines += [
            f"torque_limit_nm = {limit!r}",
            f"torque_rate_limit_nm_per_s = {100.0 * limit!r}",
            f"rotor = {{ inertia_kg_m2 = {float(model.dof_armature[dof])!r}, gear_ratio = 1.0, encoder_counts_per_turn = {_EXACT} }}",
            f"friction = {{ coulomb_nm = {float(model.dof_frictionloss[dof])!r}, "
            f"viscous_nms_per_rad = {float(_first(model.dof_damping[dof]))!r}, presliding_rad = {_PRESLIDING} }}",
            "",
        ]
    lines += [
        "[profile.mujoco]",
        f"servo_hz = {servo_hz!r}",
        f"servo_ticks_per_cycle = {ticks}",
        "delay_servo_ticks = 0",
        "# Joints of such models often have no armature: their servos are too stiff for an emulation of the arm.",
        f'transformer = "extrapolation{"+current" if "motor-current" in measured else ""}"',
        "",
        "[profile.mujoco.servo]",
    ]
    for servo in controlled:
        pid = f"stiffness_nm_per_rad = {servo.stiffness_nm_per_rad!r}, damping_nms_per_rad = {servo.damping_nms_per_rad!r}"
        if servo.damping_nms_per_rad > 0.0:
            pid += f", derivative_filter_hz = {_UNFILTERED * servo_hz!r}"
        lines.append(f'"{servo.joint}" = {{ pid = {{ {pid}, gain_uncertainty = 0.0 }} }}')
    lines += [
        "",
        "[safety]",
        "torque_ramp_s = 0.2",
        "tare_s = 0.2",
        "",
        "# The library's own simulation of the same robot.",
        "[simulated]",
        f"physics_hz = {max(servo_hz, 10000.0)!r}",
        "bristle = { stiffness_nm_per_rad = 4000.0, damping_nms_per_rad = 20.0, damping_fade_velocity_rad_per_s = 0.1 }",
        "end_stop = { stiffness_nm_per_rad = 2000.0, damping_nms_per_rad = 20.0 }",
        "brake = { holding_torque_ratio = 1.5, stiffness_nm_per_rad = 20000.0, damping_nms_per_rad = 100.0 }",
        "",
    ]
    return "\n".join(lines)


def _first(value: Any) -> float:
    return float(np.ravel(value)[0])
