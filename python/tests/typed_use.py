"""Use of the package that pyright accepts in strict mode; a test runs it too."""

# pyright: strict

from pathlib import Path

import numpy as np
import opspace


def use(folder: Path) -> float:
    model = opspace.Model.from_robot(opspace.robots()["panda"])
    model.update(np.zeros(model.n))
    out = np.empty((6, model.n))
    jacobian = model.jacobian(model.frames[-1], out=out)
    position, quaternion = model.pose(model.frames[-1])
    batch = model.batch(np.zeros((3, model.n)), frame=model.frames[-1])
    assert batch.jacobian is not None
    lengths: list[int] = [len(position), len(quaternion), len(batch.jacobian)]
    assert lengths == [3, 4, 3]

    experiment = opspace.Experiment(
        opspace.tasks()["panda-compliant"],
        backend="torque",
        set={"task.flange.axes.x": "compliant"},
        seed=2,
        duration_s=2.0,
    )
    keys = [finding.key for finding in experiment.check()]
    assert keys == []
    result = experiment.run(log=folder / "run.mcap")
    fault = result.fault
    if fault is not None:
        raise fault
    log = opspace.read_log(folder / "run.mcap")
    last: float = float(log["tick"]["q"][-1, 0])
    units: dict[str, list[str]] = {name: log["tick"].units(name) for name in log["tick"]}
    assert units["q"] == ["rad"] * model.n
    assert bool(opspace.replay(folder / "run.mcap"))
    loop, simulation = experiment.control_loop(), experiment.simulation()
    kind, values = loop.step(**simulation.read(), out=np.empty(model.n))
    simulation.write(kind, values)
    run = experiment.start(simulation=experiment.simulation())
    assert not run.over and run.finish().outcome == "interrupted"
    try:
        opspace.Experiment({"robot": "panda"})
    except opspace.OpspaceError as error:
        assert error.line is None
    return last + float(jacobian[0, 0])
