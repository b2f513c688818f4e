"""Gymnasium environments whose actions are targets of a Cartesian task.

The policy sees the same interface on a robot that takes torques and on one that takes positions: opspace is between them.

    import gymnasium
    import opspace.gym

    env = gymnasium.make("opspace/Task-v0", task="reach.toml", target="hand", frame="hand")
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from opspace import ControlLoop, Experiment, RobotFault, Simulation

Array = NDArray[np.float64]

ACTIONS = ("pose", "delta-pose", "twist", "delta-pose-and-gains")


class TaskEnv(gymnasium.Env[Array, Array]):
    """Simulated robot whose action is the target of one Cartesian task with a streamed reference.

    task, robot and `options` are arguments of `Experiment`. target: name of the task that the action moves; frame: its frame.

    action: "pose", position (m) and quaternion w, x, y, z, world axes; "delta-pose", translation and rotation vector in [-1, 1],
    times `position_scale_m` and `rotation_scale_rad`, from the present pose of the frame; "twist", linear and angular velocity in
    [-1, 1], times `speed_scale_m_per_s` and `speed_scale_rad_per_s`; "delta-pose-and-gains", the same as "delta-pose" with a
    natural frequency in [-1, 1] at the end, which stands for `frequency_range_rad_per_s` on all axes, with damping ratio 1.

    observation: names of signals of the channel `tick`; the observation has their values one after the other.

    cycles: control cycles in one step. duration_s: episodes are truncated after it; that of the task is not used. reward: function of
    the signals that returns the reward, or the reward and whether the episode is over; without it the reward is 0. A fault of the
    robot ends an episode; `info["fault"]` has its cause. Nothing is rendered.

    Each episode has other noise, drawn from the seed of `reset`; the robot begins at the start of the task.
    """

    metadata: dict[str, Any] = {"render_modes": []}
    observation_space: gymnasium.spaces.Space[Array]
    action_space: gymnasium.spaces.Space[Array]

    def __init__(
        self,
        task: str | PathLike[str] | dict[str, Any],
        target: str,
        frame: str,
        robot: str | PathLike[str] | dict[str, Any] | None = None,
        *,
        action: str = "delta-pose",
        observation: Sequence[str] = ("q", "dq"),
        cycles: int = 20,
        duration_s: float = 10.0,
        position_scale_m: float = 0.05,
        rotation_scale_rad: float = 0.5,
        speed_scale_m_per_s: float = 0.25,
        speed_scale_rad_per_s: float = 1.0,
        frequency_range_rad_per_s: tuple[float, float] = (5.0, 20.0),
        reward: Callable[[dict[str, Array]], float | tuple[float, bool]] | None = None,
        render_mode: None = None,
        **options: Any,
    ) -> None:
        if action not in ACTIONS:
            raise ValueError(f"action: expected one of {', '.join(ACTIONS)}, got {action!r}")
        if render_mode is not None:
            raise ValueError(f"render_mode: expected None, got {render_mode!r}: nothing is rendered")
        if cycles < 1:
            raise ValueError(f"cycles: expected 1 or more, got {cycles}")
        self._arguments = (task, robot, options)
        self._target, self._frame, self._action = target, frame, action
        self._cycles, self._reward = cycles, reward
        self._scales = np.array([position_scale_m] * 3 + [rotation_scale_rad] * 3)
        self._speeds = np.array([speed_scale_m_per_s] * 3 + [speed_scale_rad_per_s] * 3)
        self._frequencies = frequency_range_rad_per_s
        self._names = tuple(observation)
        self._experiment = self._load(options.get("seed"))
        self._model = self._experiment.model
        if frame not in self._model.frames:
            raise ValueError(f"frame: no frame {frame!r}; the frames are: {', '.join(self._model.frames)}")
        self._steps = max(1, round(duration_s / (cycles * self._experiment.period_s)))
        self._step = 0
        self._loop: ControlLoop = self._experiment.control_loop()
        self._loop.target(target)
        self._loop.reset()
        self._simulation: Simulation = self._experiment.simulation()
        self._is_over = True
        self._signals = self._loop.signals()
        unknown = [name for name in self._names if name not in self._signals]
        if unknown:
            raise ValueError(f"observation: no signal {unknown[0]!r}; the signals are: {', '.join(self._signals)}")
        width = sum(self._signals[name].size for name in self._names)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (width,), np.float64)
        sizes = {"pose": 7, "delta-pose": 6, "twist": 6, "delta-pose-and-gains": 7}
        limit = 10.0 if action == "pose" else 1.0
        self.action_space = gymnasium.spaces.Box(-limit, limit, (sizes[action],), np.float64)

    def _load(self, seed: int | None) -> Experiment:
        task, robot, options = self._arguments
        return Experiment(task, robot, **{**options, "seed": seed})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Returns to the start, with other noise; a seed begins a sequence of episodes."""
        super().reset(seed=seed)
        self._experiment = self._load(int(self.np_random.integers(2**31)))
        self._loop.reset()
        self._simulation = self._experiment.simulation()
        self._step, self._is_over = 0, False
        # The first cycles tare force sensors; the episode begins with control.
        while True:
            self._cycle()
            if self._loop.phase != "rest":
                break
        return self._observe(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Sets the target, and simulates the cycles of a step."""
        if self._is_over:
            raise RuntimeError("the episode is over, or was not begun: call reset()")
        if np.shape(action) != self.action_space.shape:
            raise ValueError(f"action: expected shape {self.action_space.shape}, got {np.shape(action)}")
        info: dict[str, Any] = {}
        failed = False
        try:
            self._set(np.asarray(action, np.float64))
            for _ in range(self._cycles):
                self._cycle()
        except RobotFault as fault:
            info["fault"] = fault.cause
            failed = True
        self._step += 1
        observation = self._observe()
        returned = self._reward(self._signals) if self._reward else 0.0
        reward, over = returned if isinstance(returned, tuple) else (returned, False)
        self._is_over = failed or over
        return observation, float(reward), failed or over, self._step >= self._steps, info

    def _cycle(self) -> None:
        self._simulation.write(*self._loop.step(**self._simulation.read()))

    def _observe(self) -> Array:
        self._signals = self._loop.signals()
        return np.concatenate([self._signals[name] for name in self._names])

    def _set(self, action: Array) -> None:
        if self._action == "twist":
            self._loop.target(self._target, twist=action * self._speeds)
            return
        if self._action == "pose":
            length = np.linalg.norm(action[3:])
            quaternion = action[3:] / length if length > 0.0 else np.array([1.0, 0.0, 0.0, 0.0])
            self._loop.target(self._target, pose=np.concatenate([action[:3], quaternion]))
            return
        self._model.update(self._loop.signals()["q"])
        position, quaternion = self._model.pose(self._frame)
        delta = action[:6] * self._scales
        goal = np.concatenate([position + delta[:3], _turned(quaternion, delta[3:])])
        gains = None
        if self._action == "delta-pose-and-gains":
            low, high = self._frequencies
            gains = (low + 0.5 * (float(action[6]) + 1.0) * (high - low), 1.0)
        self._loop.target(self._target, pose=goal, gains=gains)


def _turned(quaternion: Array, rotation: Array) -> Array:
    """Rotates a quaternion w, x, y, z by a rotation vector (rad, world axes)."""
    angle = float(np.linalg.norm(rotation))
    half = 0.5 * angle
    factor = 0.5 if angle < 1e-12 else np.sin(half) / angle
    w, v = np.cos(half), rotation * factor
    turned = np.concatenate([[w * quaternion[0] - v @ quaternion[1:]], w * quaternion[1:] + quaternion[0] * v + np.cross(v, quaternion[1:])])
    return turned / np.linalg.norm(turned)


gymnasium.register(id="opspace/Task-v0", entry_point="opspace.gym:TaskEnv")
