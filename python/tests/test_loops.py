"""Loops that Python steps: the bits of a run, targets, faults, robots in Python, threads and memory."""

import gc
import resource
import subprocess
import sys
import threading
import time
import traceback

import numpy as np
import opspace
import pytest
from test_runs import differing

TASKS = opspace.tasks()
SHORT = {"duration_s": 2.0, "seed": 3}


def experiment(backend="position", task="panda-compliant", **options):
    return opspace.Experiment(TASKS[task], backend=backend, **{**SHORT, **options})


# Hand of a Panda that follows targets from Python.
REACH = {
    "robot": "panda",
    "duration_s": 4.0,
    "settle_s": 0.5,
    "priority": ["hand", "rest"],
    "start_rad": {"joint2": -0.4, "joint4": -2.0, "joint6": 1.6},
    "task": {
        "hand": {
            "cartesian": {
                "frame": "flange",
                "axes": {axis: "motion" for axis in ("x", "y", "z", "rx", "ry", "rz")},
                "gains": {"frequency_rad_per_s": 12.0, "damping_ratio": 1.0},
                "reference": {"streamed": {"timeout_s": 60.0}},
            }
        },
        "rest": {"joint-posture": {"frequency_rad_per_s": 4.0, "damping_ratio": 1.0}},
    },
}


def streamed(backend="position", **options):
    return opspace.Experiment(REACH, opspace.robots()["panda"], backend=backend, **options)


def drive(loop, simulation, cycles):
    for _ in range(cycles):
        simulation.write(*loop.step(**simulation.read()))


@pytest.mark.parametrize("backend", ["position", "torque"])
def test_run_stepped_in_python_has_the_bits_of_a_run(backend, tmp_path):
    own = experiment(backend)
    expected = own.run()
    simulation = own.simulation()
    run = own.start(tmp_path / "run.mcap", simulation=simulation)
    while not run.over:
        simulation.write(*run.step(**simulation.read()))
    result = run.finish()
    assert result.outcome == "completed"
    # A handle for external forces, which the run of the command line does not have, has a channel of its own.
    channels = [channel for channel in result.log if channel != "external"]
    assert channels == list(expected.log) and len(expected.log["tick"].time_s) > 900
    named = lambda log: {channel: log[channel] for channel in channels}
    assert differing(named(result.log), named(expected.log)) == []
    assert result.summary["metrics"] == expected.summary["metrics"]
    with pytest.raises(opspace.OpspaceError, match="the run is finished"):
        run.finish()


@pytest.mark.parametrize("backend", ["position", "torque"])
def test_robot_in_python_has_the_bits_of_a_run(backend):
    class Robot:
        """The simulated robot behind methods of Python."""

        def __init__(self, simulation):
            self.simulation, self.stops = simulation, 0

        def read(self):
            return self.simulation.read()

        def write(self, kind, values):
            self.simulation.write(kind, values)

        def stop(self):
            self.stops += 1
            self.simulation.stop()

    own = experiment(backend)
    robot = Robot(own.simulation())
    result = own.on(robot)
    expected = own.run()
    assert result.outcome == "completed" and robot.stops >= 1
    mine, theirs = result.log["tick"], expected.log["tick"]
    same = lambda name: np.array_equal(mine[name].view(np.uint64), theirs[name].view(np.uint64))
    assert mine.signals == theirs.signals and [name for name in mine if not same(name)] == []


def test_exception_of_a_robot_keeps_its_traceback_and_the_log(tmp_path):
    class Broken:
        def __init__(self, simulation):
            self.simulation, self.cycles, self.stopped = simulation, 0, False

        def read(self):
            self.cycles += 1
            if self.cycles == 40:
                raise OSError("the cable is loose")
            return self.simulation.read()

        def write(self, kind, values):
            self.simulation.write(kind, values)

        def stop(self):
            self.stopped = True

    own = experiment()
    robot = Broken(own.simulation())
    with pytest.raises(OSError, match="the cable is loose") as raised:
        own.on(robot, log=tmp_path / "run.mcap")
    assert any(frame.name == "read" for frame in traceback.extract_tb(raised.value.__traceback__))
    assert robot.stopped
    log = opspace.read_log(tmp_path / "run.mcap")
    assert log.closed and len(log["tick"].time_s) >= 39


def test_loop_starts_again_after_reset():
    own = experiment()
    loop = own.control_loop()
    first = []
    for kept in range(2):
        simulation = own.simulation()
        commands = []
        for _ in range(300):
            command = loop.step(**simulation.read())
            simulation.write(*command)
            commands.append(None if command[1] is None else command[1].tobytes())
        first.append(commands)
        loop.reset()
    assert first[0] == first[1] and loop.phase == "rest"


@pytest.mark.parametrize("backend", ["position", "torque"])
def test_targets_move_the_hand(backend):
    own = streamed(backend)
    loop, simulation, model = own.control_loop(), own.simulation(), own.model
    drive(loop, simulation, 50)
    model.update(simulation.q)
    position, quaternion = model.pose("flange")
    goal = np.concatenate([position + [0.05, 0.0, -0.05], quaternion])
    loop.target("hand", pose=goal)
    drive(loop, simulation, 2000)
    model.update(simulation.q)
    assert np.abs(model.pose("flange")[0] - goal[:3]).max() < 2e-3
    # A compliant axis yields to a push, and the others do not.
    loop.target("hand", modes={"x": "compliant"}, gains=(14.0, 1.0))
    simulation.push("flange", [5.0, 0.0, 0.0])
    drive(loop, simulation, 500)
    model.update(simulation.q)
    moved = model.pose("flange")[0] - goal[:3]
    assert moved[0] > 0.03 and np.abs(moved[1:]).max() < 5e-3
    simulation.release()


def test_tunable_task_takes_gains_and_modes():
    settings = {"task.hand.cartesian.tunable": True, "task.hand.cartesian.reference": "hold"}
    experiment = streamed(set=settings)
    loop, simulation = experiment.control_loop(), experiment.simulation()
    drive(loop, simulation, 500)
    with pytest.raises(opspace.OpspaceError, match="not `streamed`: it has no input 'pose'"):
        loop.target("hand", pose=np.zeros(3))
    simulation.push("flange", [5.0, 0.0, 0.0])
    deflections = []
    for gains in (14.0, 7.0):
        loop.target("hand", gains=(gains, 1.0))
        drive(loop, simulation, 2000)
        deflections.append(np.array(simulation.q))
    assert not np.allclose(*deflections, atol=1e-4)
    loop.target("hand", modes={"x": "compliant"})
    before = np.array(simulation.q)
    drive(loop, simulation, 500)
    assert np.abs(simulation.q - before).max() > 0.02


def test_mistakes_name_what_is_wrong():
    loop = streamed().control_loop()
    with pytest.raises(opspace.OpspaceError, match="q: expected 7 values, got 6"):
        loop.step(0.0, np.zeros(6))
    with pytest.raises(opspace.OpspaceError, match="dq"):
        loop.step(0.0, np.zeros(7), dq=np.zeros(7))
    with pytest.raises(opspace.OpspaceError, match="no task 'arm' with inputs"):
        loop.target("arm", pose=np.zeros(3))
    with pytest.raises(opspace.OpspaceError, match="no axis 'w'"):
        loop.target("hand", modes={"w": "motion"})
    with pytest.raises(opspace.OpspaceError, match="unit quaternion"):
        loop.target("hand", pose=[0.4, 0.0, 0.5, 2.0, 0.0, 0.0, 0.0])
    for out in (np.zeros(3), np.zeros(7, np.float32), [0.0] * 7):
        with pytest.raises(opspace.OpspaceError, match="out: expected"):
            loop.step(0.0, np.zeros(7), out=out)
    with pytest.raises(opspace.OpspaceError, match="gains: expected a pair"):
        loop.target("hand", gains=20.0)
    with pytest.raises(opspace.OpspaceError, match="modes: expected a dictionary"):
        loop.target("hand", modes=["x"])
    with pytest.raises(opspace.OpspaceError, match="pose: expected finite numbers, got NaN"):
        loop.target("hand", pose=[np.nan] * 3)
    with pytest.raises(opspace.OpspaceError, match="takes no targets"):
        experiment().control_loop().target("flange", pose=np.zeros(3))
    with pytest.raises(opspace.OpspaceError, match="robot: it has no method `stop`"):
        experiment().on(type("Robot", (), {"read": lambda self: {}, "write": lambda self, kind, values: None})())
    simulation = streamed().simulation()
    with pytest.raises(opspace.OpspaceError, match="expected 'position'"):
        simulation.write("force", np.zeros(7))
    with pytest.raises(opspace.OpspaceError, match="frame"):
        simulation.push("nose", [1.0, 0.0, 0.0])
    with pytest.raises(opspace.OpspaceError, match="force: expected 3 values, got 2"):
        simulation.push("flange", [1.0, 0.0])


def test_fault_is_raised_once_and_the_robot_stops():
    own = experiment("torque")
    loop, simulation = own.control_loop(), own.simulation()
    drive(loop, simulation, 20)
    measured = simulation.read()
    measured["q"] = measured["q"] + np.nan
    with pytest.raises(opspace.RobotFault, match="not a finite number") as raised:
        loop.step(**measured)
    assert raised.value.joint == own.joints[0] and raised.value.code > 0
    assert loop.fault.time_s == raised.value.time_s and str(loop.fault) == str(raised.value)
    assert loop.phase in ("stopping", "stopped")
    measured = simulation.read()
    assert loop.step(**measured)[0] in (None, "hold", "torque")


def test_any_thread_may_step_and_another_one_runs_meanwhile():
    own = experiment()
    loop, simulation = own.control_loop(), own.simulation()
    failures = []

    def work():
        try:
            drive(loop, simulation, 100)
        except BaseException as error:  # noqa: BLE001
            failures.append(error)

    for _ in range(3):
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
    assert failures == [] and loop.phase == "control"


@pytest.mark.parametrize("threads", [1, 3])
def test_many_loops_in_one_call_compute_what_each_computes(threads):
    own = streamed("torque")
    count = 5
    loops, alone = own.control_loops(count), [own.control_loop() for _ in range(count)]
    simulations = [own.simulation() for _ in range(count)]
    assert len(loops) == count
    for cycle in range(300):
        if cycle == 100:
            for robot in range(count):
                twist = [0.01 * robot, 0.0, 0.0, 0.0, 0.0, 0.0]
                loops.target(robot, "hand", twist=twist)
                alone[robot].target("hand", twist=twist)
        samples = [simulation.read() for simulation in simulations]
        stacked = {name: np.stack([sample[name] for sample in samples]) for name in samples[0] if name != "time_s"}
        values = loops.step([sample["time_s"] for sample in samples], **stacked, threads=threads)
        for robot in range(count):
            kind, expected = alone[robot].step(**samples[robot])
            simulations[robot].write(kind, expected)
            row = np.full(7, np.nan) if expected is None else expected
            assert np.array_equal(values[robot], row, equal_nan=True)
    assert loops.faults == {} and not np.isnan(values).any()
    stacked["q"][2] = np.nan
    loops.step(samples[0]["time_s"] + 1e-3, **stacked)
    assert list(loops.faults) == [2] and loops.faults[2].joint == "joint1"
    loops.reset(2)
    assert loops.faults == {}
    with pytest.raises(opspace.OpspaceError, match="q: expected 5 rows, got 4"):
        loops.step(0.0, np.zeros((4, 7)))
    with pytest.raises(opspace.OpspaceError, match="there are 5 loops"):
        loops.reset(5)


def test_threads_that_share_objects_do_not_wait_for_ever():
    own = experiment("torque")
    loops, loop, simulation = own.control_loops(50), own.control_loop(), own.simulation()
    run = own.start(simulation=simulation)
    measured = simulation.read()
    rows = {name: np.tile(measured[name], (50, 1)) for name in measured if name != "time_s"}

    def step_all():
        for k in range(40):
            loops.step(measured["time_s"] + 1e-3 * k, **rows)

    def look():
        for _ in range(200):
            assert loops.faults == {} and simulation.q.shape == (7,) and not run.over
            loop.signals()

    def drive_run():
        for _ in range(40):
            simulation.write(*run.step(**simulation.read()))

    threads = [threading.Thread(target=work, daemon=True) for work in (step_all, look, look, drive_run)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=30.0)
    assert not any(thread.is_alive() for thread in threads)


def test_steps_do_not_grow_the_memory():
    own = experiment("torque")
    loop, simulation = own.control_loop(), own.simulation()
    drive(loop, simulation, 600)
    measured, out = simulation.read(), np.empty(len(own.joints))
    begin, period = measured.pop("time_s"), own.period_s

    def steps(first, count):
        for k in range(first, first + count):
            loop.step(begin + k * period, **measured, out=out)

    steps(0, 10_000)
    gc.collect()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    began = time.perf_counter()
    steps(10_000, 100_000)
    each_us = (time.perf_counter() - began) * 10.0
    grown_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    print(f"step with out: {each_us:.2f} us; memory grew by {grown_kb} kB in 100 000 steps")
    assert grown_kb < 512


def test_runs_of_daemon_threads_are_stopped_when_python_exits(tmp_path):
    script = tmp_path / "exits.py"
    script.write_text(
        f"""
import threading, time, opspace
own = opspace.Experiment({str(TASKS["panda-compliant"])!r}, backend="position", duration_s=60.0)
class Robot:
    def __init__(self): self.arm = own.simulation()
    def read(self):
        time.sleep(0.001)
        return self.arm.read()
    def write(self, kind, values): self.arm.write(kind, values)
    def stop(self): open("stopped", "w").close()
threading.Thread(target=lambda: own.on(Robot(), log="run.mcap"), daemon=True).start()
time.sleep(0.5)
"""
    )
    ended = subprocess.run([sys.executable, script], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "stopped").exists() and opspace.read_log(tmp_path / "run.mcap").closed
