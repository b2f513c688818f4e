"""Operational-space control for robots that take torques, and for robots that take only positions.

Units are SI: rad and Nm, or m and N for prismatic joints. Vectors are in world axes, linear rows come before angular rows, and
quaternions are w, x, y, z.

    import opspace

    result = opspace.Experiment(opspace.tasks()["panda-compliant"]).run()
    result.log["tick"]["q"]          # (T, n), rad
"""

import atexit as _atexit
import os as _os
from pathlib import Path as _Path

from opspace import _opspace
from opspace._opspace import (
    Batch,
    Channel,
    ControlLoop,
    ControlLoops,
    Experiment,
    Finding,
    Log,
    Model,
    OpspaceError,
    Replay,
    Result,
    RobotFault,
    Run,
    Simulation,
    __version__,
    read_log,
    replay,
)

__all__ = [
    "Batch",
    "Channel",
    "ControlLoop",
    "ControlLoops",
    "Experiment",
    "Finding",
    "Log",
    "Model",
    "OpspaceError",
    "Replay",
    "Result",
    "RobotFault",
    "Run",
    "Simulation",
    "__version__",
    "read_log",
    "replay",
    "robots",
    "tasks",
]

_FILES = _Path(__file__).parent / "files"


def robots() -> dict[str, _Path]:
    """Returns the robots of the package: the path of the folder of each, by name."""
    return {path.parent.name: path.parent for path in sorted(_FILES.glob("robots/*/robot.toml"))}


def tasks() -> dict[str, _Path]:
    """Returns the tasks of the package: the path of the file of each, by name."""
    return {path.stem: path for path in sorted(_FILES.glob("tasks/*.toml"))}


_atexit.register(_opspace._stop_all)
if hasattr(_os, "register_at_fork"):
    _os.register_at_fork(after_in_child=_opspace._forked)
