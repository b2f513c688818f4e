"""Tasks and metrics in Python: their values, their errors, replay and pickling."""

import pickle
import traceback

import numpy as np
import opspace
import pytest
from python_entries import Distance, Position, Range
from test_loops import drive

HOLD = {
    "robot": "panda",
    "duration_s": 2.0,
    "settle_s": 0.5,
    "priority": ["hand", "rest"],
    "start_rad": {"joint2": -0.7854, "joint4": -2.3562, "joint6": 1.5708, "joint7": 0.7854},
    "environment": {
        "someone": {"pushes": {"frame": "flange", "push": [{"at_s": 0.8, "duration_s": 0.5, "force_n": [8.0, 0.0, 0.0]}]}}
    },
}
REST = {"joint-posture": {"frequency_rad_per_s": 6.0, "damping_ratio": 1.0}}
GAINS = {"frequency_rad_per_s": 15.0, "damping_ratio": 1.0}


def experiment(hand, backend="torque", **options):
    task = {**HOLD, "task": {"hand": hand, "rest": REST}}
    return opspace.Experiment(task, opspace.robots()["panda"], backend=backend, seed=2, **options)


def distance(backend="position", metrics=None, **changes):
    to = {"point-to-point": {"goal": {"offset_rad": 0.1}, "duration_s": 1.0}}
    keys = {"frame": "flange", "point_m": [0.0, 0.0, 0.3], "reference": to, "gains": GAINS, **changes}
    return experiment({"distance": keys}, backend, tasks={"distance": Distance}, metrics=metrics)


def test_task_of_three_elements_is_a_cartesian_task():
    """Compared: the motion under a push with that of the built-in task that holds the same frame in place."""
    built_in = experiment(
        {"cartesian": {"frame": "flange", "axes": dict.fromkeys("xyz", "motion"), "gains": GAINS, "reference": "hold"}}
    )
    own = experiment({"position": {"frame": "flange", "gains": GAINS}}, tasks={"position": Position})
    a, b = (run.run().log["tick"] for run in (built_in, own))
    moved = np.abs(a["hand.error"][:, :3]).max()
    assert moved > 1e-3
    assert np.abs(a["hand.error"][:, :3] - b["hand.error"]).max() < 1e-6 * moved
    assert b.elements("hand.value") == ["x", "y", "z"] and b.units("hand.value") == ["m"] * 3


@pytest.mark.parametrize("backend", ["position", "torque"])
def test_task_follows_its_reference(backend, tmp_path):
    own = distance(backend, {"first_joint_range_rad": Range})
    result = own.run(tmp_path / "run.mcap")
    tick = result.log["tick"]
    value = tick["hand.value"][tick["phase"] == 1]
    assert abs(value[-1] - value[0] - 0.1) < 3e-3
    settled = tick["q"][(tick.time_s >= 0.5), 0]
    assert abs(result.summary["metrics"]["first_joint_range_rad"] - np.ptp(settled)) < 0.02 * np.ptp(settled)
    assert opspace.replay(tmp_path / "run.mcap", tasks={"distance": Distance}).equal
    with pytest.raises(opspace.OpspaceError, match="distance"):
        opspace.replay(tmp_path / "run.mcap")
    again = pickle.loads(pickle.dumps(result))
    assert again.experiment.run().summary["metrics"] == result.summary["metrics"]


def test_loop_stepped_by_python():
    own = distance()
    loop, simulation = own.control_loop(), own.simulation()
    drive(loop, simulation, 300)
    before = loop.signals()["hand.value"]
    drive(loop, simulation, 1500)
    assert abs(loop.signals()["hand.value"] - before - 0.1) < 5e-3


class Failing(Distance):
    calls = 0

    def value(self, model):
        Failing.calls += 1
        if Failing.calls > 900:
            raise ZeroDivisionError("of the task")
        return super().value(model)


def failing():
    Failing.calls = 0
    keys = {"frame": "flange", "point_m": [0.0, 0.0, 0.3], "gains": GAINS}
    return experiment({"distance": keys}, "position", tasks={"distance": Failing})


def test_exception_of_a_task_stops_the_robot(tmp_path):
    with pytest.raises(ZeroDivisionError, match="of the task") as raised:
        failing().run(tmp_path / "run.mcap")
    assert any(frame.name == "value" for frame in traceback.extract_tb(raised.value.__traceback__))
    log = opspace.read_log(tmp_path / "run.mcap")
    assert log.closed and "fault" in log.metadata["opspace.outcome"], log.metadata
    own = failing()
    loop, simulation = own.control_loop(), own.simulation()
    with pytest.raises(ZeroDivisionError):
        drive(loop, simulation, 2000)
    assert loop.fault is not None
    # The setpoints of the stop follow, and no second exception.
    for _ in range(100):
        simulation.write(*loop.step(**simulation.read()))
    assert Failing.calls == 901
    # The next run is not concerned.
    assert distance().run().outcome == "completed"


def test_values_that_are_not_finite_stop_the_robot():
    class Undefined(Distance):
        def jacobian(self, model):
            jacobian = super().jacobian(model)
            return jacobian * np.nan if np.abs(model.dq).max() > 0.05 else jacobian

    keys = {"frame": "flange", "point_m": [0.0, 0.0, 0.3], "gains": GAINS}
    result = experiment({"distance": keys}, tasks={"distance": Undefined}).run()
    assert result.outcome == "faulted" and "finite" in result.fault.cause, result.fault


def test_mistakes_of_classes_are_named():
    class Flat(Distance):
        def jacobian(self, model):
            return np.zeros(6)

    class Wide(Distance):
        elements = [("x", "m")] * 7

    class Nothing:
        pass

    keys = {"frame": "flange", "point_m": [0.0, 0.0, 0.3], "gains": GAINS}
    with pytest.raises(opspace.OpspaceError, match=r"jacobian: expected shape \(1, 7\) or 7 values, got 6 values"):
        experiment({"distance": keys}, tasks={"distance": Flat}).run()
    with pytest.raises(opspace.OpspaceError, match="elements: expected one to six pairs"):
        experiment({"distance": keys}, tasks={"distance": Wide})
    with pytest.raises(opspace.OpspaceError, match="tasks: the class of 'distance' has no method `value`"):
        experiment({"distance": keys}, tasks={"distance": Nothing})
    with pytest.raises(KeyError, match="nowhere") as raised:
        experiment({"distance": {**keys, "frame": "nowhere"}}, tasks={"distance": Distance})
    assert any(frame.name == "__init__" for frame in traceback.extract_tb(raised.value.__traceback__))
    with pytest.raises(opspace.OpspaceError, match="frequency_rad_per_s"):
        distance(gains={"damping_ratio": 1.0})
    with pytest.raises(opspace.OpspaceError, match="expected one reference for each of distance, got 2"):
        experiment({"distance": {**keys, "references": ["hold", "hold"]}}, tasks={"distance": Distance})
    with pytest.raises(opspace.OpspaceError, match="the task kind 'cartesian' already exists"):
        experiment({"distance": keys}, tasks={"distance": Distance, "cartesian": Distance})
    with pytest.raises(opspace.OpspaceError, match="unknown task kind 'distanse'|distanse"):
        experiment({"distanse": keys}, tasks={"distance": Distance})


def test_metrics_are_metrics_of_the_run():
    class Broken(Range):
        def finish(self):
            raise LookupError("of the metric")

    task = {**HOLD, "expect": {"first_joint_range_rad": {"at_most": 1e-6}}}
    task["task"] = {"hand": {"position": {"frame": "flange", "gains": GAINS}}, "rest": REST}
    options = {"tasks": {"position": Position}, "seed": 2}
    robot = opspace.robots()["panda"]
    result = opspace.Experiment(task, robot, metrics={"first_joint_range_rad": Range}, **options).run()
    assert "first_joint_range_rad" in str(result.summary["missed_expectations"])
    with pytest.raises(LookupError, match="of the metric"):
        opspace.Experiment(task, robot, metrics={"first_joint_range_rad": Broken}, **options).run()
    with pytest.raises(opspace.OpspaceError, match="first_joint_range_rad"):
        opspace.Experiment(task, robot, **options)
    with pytest.raises(opspace.OpspaceError, match="'Range rad' is not a key"):
        opspace.Experiment(task, robot, metrics={"Range rad": Range}, **options)
