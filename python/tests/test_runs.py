"""Runs: the command line's and Python's, files and dictionaries, results, logs and replays."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import opspace
import pytest
import typed_use

PROGRAM = Path(sys.executable).with_name("opspace")
TASKS = opspace.tasks()
ROBOTS = opspace.robots()


def differing(one, other):
    """Signals of two logs that differ in a bit. Computing times are the only signals that may."""
    assert list(one) == list(other)
    names = []
    for channel in one:
        assert one[channel].signals == other[channel].signals
        assert np.array_equal(one[channel].time_s, other[channel].time_s)
        if channel != "timing":
            same = lambda name: np.array_equal(
                one[channel][name].view(np.uint64), other[channel][name].view(np.uint64)
            )
            names += [f"{channel}.{name}" for name in one[channel] if not same(name)]
    return names


@pytest.fixture(scope="module")
def run():
    return opspace.Experiment(TASKS["panda-compliant"], duration_s=2.5, seed=3).run()


@pytest.mark.parametrize("backend", ["position", "torque"])
@pytest.mark.parametrize("task", ["compliant-x", "panda-compliant"])
def test_the_command_line_logs_the_same_bits(task, backend, tmp_path):
    command = [PROGRAM, "run", TASKS[task], "--backend", backend, "--duration-s", "2.5", "--set", "seed=5"]
    subprocess.run([*command, "--out", tmp_path, "-q"], check=True, stdout=subprocess.DEVNULL)
    own = opspace.Experiment(TASKS[task], backend=backend, set=["seed=5"], duration_s=2.5).run()
    other = opspace.read_log(tmp_path / "run.mcap")
    signals = sum(len(other[channel]) for channel in other)
    print(f"{task}, {backend}: {signals} signals, {len(other['tick'].time_s)} cycles")
    assert len(other["tick"].time_s) > 400 and signals > 30
    assert differing(own.log, other) == []
    summary = json.loads((tmp_path / "summary.json").read_text())
    of_time = ("timing", "overrides")
    assert {k: v for k, v in own.summary.items() if k not in of_time} == {
        k: v for k, v in summary.items() if k not in of_time
    }


def test_program_has_its_exit_codes(tmp_path):
    run = lambda *args: subprocess.run([PROGRAM, *args], capture_output=True, text=True, cwd=tmp_path)
    assert run("--version").stdout.split() == ["opspace", opspace.__version__]
    assert run("check", TASKS["planar-2-link-reach"]).returncode == 0
    bad = run("check", "nope.toml")
    assert bad.returncode == 2 and "nope.toml" in bad.stderr
    assert run("nope").returncode == 2
    module = [sys.executable, "-m", "opspace", "--version"]
    assert subprocess.run(module, capture_output=True, text=True, cwd=tmp_path).stdout == run("--version").stdout


def test_dictionaries_are_the_files_they_came_from(tmp_path, monkeypatch):
    """A task and a robot as dictionaries against their files."""
    monkeypatch.chdir(ROBOTS["planar-2-link"])
    task = tomllib.loads(TASKS["planar-2-link-reach"].read_text())
    robot = tomllib.loads(Path("robot.toml").read_text())
    own = opspace.Experiment(task, robot, duration_s=1.5).run()
    files = opspace.Experiment(TASKS["planar-2-link-reach"], duration_s=1.5).run()
    assert differing(own.log, files.log) == []


def test_settings_are_texts_or_a_dictionary():
    one = opspace.Experiment(TASKS["panda-compliant"], set=["seed=7", "task.flange.axes.y=compliant"])
    settings = {"seed": np.int64(7), "task.flange.axes.y": "compliant"}
    other = opspace.Experiment(TASKS["panda-compliant"], set=settings)
    assert one.seed == other.seed == 7
    assert "y = \"compliant\"" in other.run().log.attachments["task.toml"].decode()


def test_result_has_summary_and_outcome(run):
    assert run.outcome == "completed" and run.fault is None and run.log_path is None
    assert run.summary["seed"] == 3 and run.summary["metrics"]["position_rms_m"] < 1e-3
    assert run.summary is not run.summary
    assert run.log is run.log


def test_result_shows_itself(run):
    html = run._repr_html_()
    assert html.count("<svg") == len(run.figures()) > 5
    assert "<table>" in html and "completed" in html
    assert all(svg.startswith("<svg") for _, svg in run.figures())
    assert "completed" in repr(run)


def test_log_has_arrays_without_copies(run):
    tick = run.log["tick"]
    n = len(run.summary["joint_order"])
    assert tick["q"].shape == (len(tick.time_s), n) and tick["phase"].shape == tick.time_s.shape
    assert np.shares_memory(tick["q"], tick.rows) and np.shares_memory(tick["phase"], tick.rows)
    assert tick.rows.shape == (len(tick.time_s), len(tick.columns))
    assert tick["q"].dtype == np.float64 and tick.units("q") == ["rad"] * n
    assert tick.elements("q") == run.summary["joint_order"]
    assert tick.columns[tick.columns.index("q.joint1")] == "q.joint1"
    assert run.log.damage is None and run.log.closed and run.log.dropped == 0
    with pytest.raises(KeyError, match="no signal 'nope'.*q_desired"):
        tick["nope"]
    with pytest.raises(KeyError, match="no channel 'nope'.*tick"):
        run.log["nope"]


def test_log_is_a_data_frame(run):
    pytest.importorskip("pandas")
    frame = run.log.to_pandas()
    assert frame.index.name == "time_s"
    assert np.array_equal(frame["q.joint2"], run.log["tick"]["q"][:, 1])


def test_run_writes_files(tmp_path):
    experiment = opspace.Experiment(TASKS["planar-2-link-reach"], duration_s=1.5)
    result = experiment.run(log=tmp_path / "run.mcap")
    assert Path(result.log_path) == tmp_path / "run.mcap"
    with pytest.raises(opspace.OpspaceError, match="run.mcap"):
        experiment.run(log=tmp_path / "run.mcap")
    experiment.run(log=tmp_path / "run.mcap", overwrite=True)
    replayed = opspace.replay(tmp_path / "run.mcap")
    assert replayed and replayed.equal and replayed.compared == replayed.logged > 100
    in_folder = experiment.run(folder=tmp_path / "folder")
    assert sorted(path.name for path in (tmp_path / "folder").iterdir()) == ["report.html", "run.mcap", "summary.json"]
    assert differing(in_folder.log, result.log) == []
    with pytest.raises(opspace.OpspaceError):
        experiment.run(folder=tmp_path / "folder")
    with pytest.raises(opspace.OpspaceError, match="either"):
        experiment.run(log="a", folder="b")


def test_damaged_logs_are_read_and_said_to_be(tmp_path):
    whole = opspace.Experiment(TASKS["planar-2-link-reach"], duration_s=1.5).run(log=tmp_path / "a.mcap")
    data = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "b.mcap").write_bytes(data[: len(data) // 2])
    cut = opspace.read_log(tmp_path / "b.mcap")
    assert cut.damage and not cut.closed
    assert 0 < len(cut["tick"].time_s) < len(whole.log["tick"].time_s)
    (tmp_path / "c.mcap").write_text("no log")
    for path in ("c.mcap", "nope.mcap"):
        with pytest.raises(opspace.OpspaceError, match=path) as raised:
            opspace.read_log(tmp_path / path)
        assert raised.value.file == str(tmp_path / path)


def test_faults_are_results():
    """A watchdog that permits almost no difference of torques."""
    settings = {"robot.safety.watchdog.torque_deviation_share": 1e-6}
    result = opspace.Experiment(TASKS["panda-compliant"], set=settings).run()
    fault = result.fault
    assert result.outcome == "faulted" and isinstance(fault, opspace.RobotFault)
    assert fault.joint in result.summary["joint_order"] and fault.joint in fault.cause
    assert fault.code == result.log["tick"]["fault"].max() and fault.time_s == result.summary["fault_time_s"]
    assert fault.cause == result.summary["faulted"] and fault.cause in str(fault)


def test_typed_use_runs(tmp_path):
    assert np.isfinite(typed_use.use(tmp_path))


def test_every_task_of_the_package_is_read():
    assert {"asimo-arm", "panda", "planar-2-link", "ur5e"} <= set(ROBOTS)
    assert all((folder / "robot.toml").is_file() for folder in ROBOTS.values())
    for path in TASKS.values():
        assert opspace.Experiment(path).joints
