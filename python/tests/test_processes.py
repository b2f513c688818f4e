"""Threads, processes, signals and memory."""

import gc
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import opspace
import pytest
from sweep import last_positions

PROGRAM = Path(sys.executable).with_name("opspace")
TASK = opspace.tasks()["panda-compliant"]
SHORT = {"duration_s": 1.6}


def seeded(seed):
    return opspace.Experiment(TASK, seed=seed, **SHORT)


def test_experiment_is_pickled():
    """A copy runs to the same bits, with changed settings and without its files."""
    experiment = opspace.Experiment(
        TASK, backend="torque", set=["task.flange.axes.y=compliant"], seed=4, **SHORT
    )
    copy = pickle.loads(pickle.dumps(experiment))
    assert repr(copy) == repr(experiment)
    assert np.array_equal(last_positions(copy), last_positions(experiment))
    # A dictionary stays one: its errors name keys.
    assert pickle.loads(pickle.dumps(copy)).seed == 4


def test_result_is_pickled():
    result = seeded(1).run()
    copy = pickle.loads(pickle.dumps(result))
    assert copy.summary == result.summary and copy.outcome == "completed"
    assert np.array_equal(copy.log["tick"].rows, result.log["tick"].rows, equal_nan=True)


@pytest.mark.parametrize("method", ["spawn", "fork"])
def test_sweep_over_processes(method):
    """Seeds in processes of their own against the same in this one."""
    experiments = [seeded(seed) for seed in range(3)]
    with multiprocessing.get_context(method).Pool(2) as pool:
        swept = pool.map_async(last_positions, experiments).get(timeout=60)
    assert np.array_equal(swept, [last_positions(experiment) for experiment in experiments])


def test_another_thread_runs_while_a_run_computes():
    """A counter in Python goes on during a run, a check and a batch."""
    experiment = opspace.Experiment(TASK, duration_s=4.0)
    model = experiment.model
    states = np.zeros((100_000, model.n))
    for compute in (experiment.run, experiment.check, lambda: model.batch(states)):
        thread = threading.Thread(target=compute)
        longest, count, before = 0.0, 0, time.perf_counter()
        thread.start()
        while thread.is_alive():
            now = time.perf_counter()
            longest, before, count = max(longest, now - before), now, count + 1
        print(f"{compute}: {count} turns, longest pause {longest * 1e3:.1f} ms")
        assert count > 200


def test_threads_share_objects():
    """Several threads use one experiment and one model, each with results of its own."""
    experiment = seeded(2)
    alone = last_positions(experiment)
    model = experiment.model
    model.update(np.zeros(model.n))
    with ThreadPoolExecutor(4) as pool:
        runs = list(pool.map(last_positions, [experiment] * 4))
        poses = list(pool.map(model.pose, ["flange"] * 100))
    assert all(np.array_equal(run, alone) for run in runs)
    assert all(np.array_equal(position, poses[0][0]) for position, _ in poses)


INTERRUPTED = """
import os, signal, sys, threading, time
import opspace
# A shell lets programs in its background ignore the signal, and Python then keeps to that.
signal.signal(signal.SIGINT, signal.default_int_handler)
experiment = opspace.Experiment(sys.argv[1], duration_s=600.0)
def interrupt():
    time.sleep(0.7)
    print("sent", time.monotonic(), flush=True)
    os.kill(os.getpid(), signal.SIGINT)
threading.Thread(target=interrupt).start()
try:
    experiment.run(log=sys.argv[2])
except KeyboardInterrupt:
    print("stopped", time.monotonic(), flush=True)
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_ctrl_c_stops_a_run_and_closes_its_log(tmp_path):
    path = tmp_path / "run.mcap"
    command = [sys.executable, "-c", INTERRUPTED, TASK, path]
    # Elsewhere than beside the sources, which Python would import.
    lines = subprocess.run(
        command, check=True, capture_output=True, text=True, timeout=60, cwd=tmp_path
    ).stdout.split()
    assert lines[::2] == ["sent", "stopped"]
    print(f"stopped and closed after {float(lines[3]) - float(lines[1]):.3f} s")
    log = opspace.read_log(path)
    assert log.closed and log.damage is None and log.metadata["opspace.outcome"]
    stops = log["tick"]["stop_requested"]
    assert stops.max() == 1 and stops[0] == 0
    assert opspace.replay(path)


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_ctrl_c_stops_the_program(tmp_path):
    command = [PROGRAM, "run", TASK, "--duration-s", "600", "--out", tmp_path, "-q"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    time.sleep(1.5)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode not in (0, -signal.SIGINT) and "Traceback" not in said, (process.returncode, said)
    assert opspace.read_log(tmp_path / "run.mcap").closed


FORKED = """
import multiprocessing, sys, threading, time
import opspace
experiment = opspace.Experiment(sys.argv[1], duration_s=60.0)
short = opspace.Experiment(sys.argv[1], duration_s=2.0)
thread = threading.Thread(target=experiment.run, daemon=True)
thread.start()
time.sleep(0.5)
def refused(queue):
    try:
        short.run()
        queue.put("ran")
    except opspace.OpspaceError as error:
        queue.put(str(error))
fork = multiprocessing.get_context("fork")
queue = fork.Queue()
process = fork.Process(target=refused, args=(queue,))
process.start()
print(queue.get(timeout=20), flush=True)
process.join()
import os
os._exit(0)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_fork_during_a_run_is_refused(tmp_path):
    command = [sys.executable, "-W", "ignore", "-c", FORKED, TASK]
    said = subprocess.run(
        command, check=True, capture_output=True, text=True, timeout=60, cwd=tmp_path
    ).stdout
    assert "was forked while another thread" in said


def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="no /proc")
def test_memory_does_not_grow():
    experiment = seeded(1)
    model = experiment.model
    q = np.zeros(model.n)

    def use():
        for _ in range(4):
            len(experiment.run().log["tick"]["q"])
        for _ in range(20_000):
            model.update(q)
            model.jacobian("flange"), model.mass_matrix, model.pose("flange")
        model.batch(np.zeros((2000, model.n)), frame="flange")
        pickle.loads(pickle.dumps(experiment))
        with pytest.raises(opspace.OpspaceError):
            model.update(q[1:])
        gc.collect()

    use()
    use()
    before = resident_bytes()
    for _ in range(4):
        use()
    grown = resident_bytes() - before
    print(f"grown by {grown / 1e6:.2f} MB")
    # A log that were kept would be 24 MB.
    assert grown < 8e6
