"""Errors: each names the argument, the file or the key, and no panic reaches Python."""

import pickle

import numpy as np
import opspace
import pytest

PANDA = opspace.robots()["panda"]
TASK = opspace.tasks()["panda-compliant"]


@pytest.fixture
def model():
    model = opspace.Model.from_robot(PANDA)
    model.update(np.full(7, 0.1))
    return model


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda m: m.update(np.zeros(6)), "q: expected 7 values, got 6"),
        (lambda m: m.update(np.zeros((7, 1))), r"q: expected 7 values, got shape \(7, 1\)"),
        (lambda m: m.update(0.5), "q: expected 7 values, got one number"),
        (lambda m: m.update(np.zeros(7), np.zeros(8)), "dq: expected 7 values, got 8"),
        (lambda m: m.update(["a"] * 7), "q: expected real numbers, got list"),
        (lambda m: m.update(np.zeros(7, complex)), "q: expected real numbers, got an array of complex128"),
        (lambda m: m.update(None), "q: expected real numbers"),
        (lambda m: m.update([0] * 6 + [np.nan]), "q: value 6 is NaN, which is not finite"),
        (lambda m: m.batch(np.zeros((3, 6))), r"q: expected an array of shape \(N, 7\), got shape \(3, 6\)"),
        (lambda m: m.batch(np.zeros((3, 7)), np.zeros((2, 7))), "dq: expected 3 rows as in q, got 2"),
        (lambda m: m.pose("nope"), "frame: no frame 'nope'; the frames are: link0"),
        (lambda m: m.jacobian("flange", np.zeros((7, 6))), r"out: expected an array of shape \(6, 7\), got"),
        (lambda m: m.jacobian("flange", np.zeros((6, 7), np.float32)), "out: expected an array of 64-bit"),
        (lambda m: m.operational_inertia("flange", [0, 0]), "rows: expected different numbers from 0 to 5"),
        (lambda m: m.operational_inertia("flange", [6]), "rows: expected different numbers from 0 to 5"),
    ],
)
def test_arguments_are_named(model, call, text):
    with pytest.raises(opspace.OpspaceError, match=text) as raised:
        call(model)
    assert raised.value.key == text.split(":")[0]


def test_model_without_state():
    with pytest.raises(opspace.OpspaceError, match="no state") as raised:
        opspace.Model.from_robot(PANDA).mass_matrix
    assert raised.value.help == "call update(q, dq) first"


def test_other_numbers_are_converted(model):
    """Single precision, integers, lists, and arrays with steps, against 64-bit floats."""
    q = np.linspace(-0.5, 0.5, 7, dtype=np.float32)
    model.update(q.astype(float))
    bias = model.bias
    for other in (q, q.tolist(), tuple(q), np.repeat(q, 2)[::2], np.repeat(q.astype(float), 3)[::3]):
        model.update(other)
        assert np.array_equal(model.bias, bias)
    model.update(np.zeros(7, int))


def test_out_is_filled(model):
    jacobian = model.jacobian("flange")
    for out in (np.zeros((6, 7)), np.zeros((7, 6)).T, np.zeros((12, 14))[::2, ::2]):
        assert model.jacobian("flange", out=out) is out
        assert np.array_equal(out, jacobian)
    fixed = np.zeros((6, 7))
    fixed.flags.writeable = False
    with pytest.raises(opspace.OpspaceError, match="out: "):
        model.jacobian("flange", out=fixed)


def test_singular_rows(model):
    """The stretched planar arm cannot move along itself."""
    planar = opspace.Model.from_robot(opspace.robots()["planar-2-link"])
    planar.update([0.3, 0.0])
    with pytest.raises(opspace.OpspaceError, match="rows: .*infinite"):
        planar.operational_inertia("tip", [0, 2])
    with pytest.raises(opspace.OpspaceError, match="rows: .*infinite"):
        planar.operational_inertia("tip")


def test_mistakes_in_files_have_a_place(tmp_path):
    text = TASK.read_text().replace("../robots", str(PANDA.parent))
    lines = text.splitlines()
    number = next(k for k, line in enumerate(lines) if line.startswith("duration_s"))
    lines[number] = "duration_s = -1.0"
    (tmp_path / "task.toml").write_text("\n".join(lines))
    with pytest.raises(opspace.OpspaceError) as raised:
        opspace.Experiment(tmp_path / "task.toml")
    error = raised.value
    assert (error.file, error.line, error.key) == (str(tmp_path / "task.toml"), number + 1, "duration_s")
    assert f"task.toml:{number + 1}: " in str(error)
    copy = pickle.loads(pickle.dumps(error))
    assert (str(copy), copy.line, copy.key) == (str(error), error.line, error.key)
    with pytest.raises(opspace.OpspaceError, match="there is no such file"):
        opspace.Experiment(tmp_path / "nope.toml")
    with pytest.raises(opspace.OpspaceError, match="robot") as raised:
        opspace.Experiment(TASK, robot=tmp_path)
    with pytest.raises(ValueError, match="--set"):
        opspace.Experiment(TASK, set=["duration_s"])


def test_mistakes_in_dictionaries_name_the_key():
    cartesian = {
        "frame": "nope",
        "axes": {"x": "motion"},
        "gains": {"frequency_rad_per_s": 5.0, "damping_ratio": 1.0},
        "reference": "hold",
    }
    task = {"duration_s": 1.0, "priority": ["hand"], "task": {"hand": {"cartesian": cartesian}}}
    with pytest.raises(opspace.OpspaceError, match="this robot has no frame 'nope'") as raised:
        opspace.Experiment(task, opspace.robots()["planar-2-link"])
    error = raised.value
    assert error.key == "task.hand.cartesian.frame" and error.key in str(error)
    assert error.file is None and error.line is None and "link_1" in error.help
    for value, text in ((object(), "type 'object'"), (2**70, "64 bits"), (None, "type 'NoneType'")):
        with pytest.raises(opspace.OpspaceError, match=text) as raised:
            opspace.Experiment({"task": {"hand": {"mass": [1, value]}}}, PANDA)
        assert raised.value.key == "task.task.hand.mass.1"
    loop = {}
    loop["a"] = loop
    with pytest.raises(opspace.OpspaceError, match="nested too deeply"):
        opspace.Experiment(loop)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"backend": "force"}, "backend: expected 'position', 'velocity', 'torque', got 'force'"),
        ({"controller": "pid"}, "controller: expected 'osc', 'ik', 'ik-lead'"),
        ({"duration_s": -1.0}, "duration_s: expected a positive number"),
        ({"allow": ["nope"]}, "allow: "),
        ({"set": "seed=1"}, "set: expected a sequence"),
        ({"profile": "nope"}, "no profile 'nope'"),
        ({"transformer": "nope"}, "nope"),
        ({"controller": "ik", "backend": "torque"}, "commands positions"),
    ],
)
def test_options_are_named(options, text):
    with pytest.raises(opspace.OpspaceError, match=text):
        opspace.Experiment(TASK, **options)


def test_urdf_has_lines(tmp_path):
    urdf = (PANDA / "panda.urdf").read_text()
    assert opspace.Model.from_urdf(urdf).joints == opspace.Model.from_urdf(PANDA / "panda.urdf").joints
    broken = urdf.replace('<mass value="', '<mass value="x', 1)
    with pytest.raises(opspace.OpspaceError) as raised:
        opspace.Model.from_urdf(broken)
    assert raised.value.line == 1 + broken[: broken.index('value="x')].count("\n")
    with pytest.raises(opspace.OpspaceError, match="mujoco.MjModel"):
        opspace.Model.from_mujoco(object())


def test_findings_have_keys():
    """A task that is known to be beyond the robot's reach."""
    findings = opspace.Experiment(opspace.tasks()["panda-unreachable"]).check()
    assert findings and all(finding.code and finding.message for finding in findings)
    assert any(finding.key and finding.file for finding in findings)
    assert findings[0].code in str(findings[0])


def test_panics_are_errors():
    """An object that claims to be a compiled model, with an index beyond its arrays."""

    class Named:
        name = "joint"

    class Broken:
        jnt_type = np.array([3])
        qpos0 = np.zeros(0)
        jnt_qposadr = np.array([3])

        def joint(self, number):
            return Named()

    with pytest.raises(opspace.OpspaceError, match="panicked.*out of bounds") as raised:
        opspace.Model.from_mujoco(Broken())
    assert "report it" in raised.value.help


def test_names_in_place_of_paths_are_explained():
    with pytest.raises(opspace.OpspaceError, match=r"task: there is no `panda-compliant`; opspace.tasks\(\)") as raised:
        opspace.Experiment("panda-compliant")
    assert raised.value.key == "task"
    with pytest.raises(opspace.OpspaceError, match=r"robot: there is no `panda`; opspace.robots\(\)"):
        opspace.Experiment(opspace.tasks()["panda-compliant"], "panda")
    with pytest.raises(opspace.OpspaceError, match="robot: the key `urdf` is missing"):
        opspace.Experiment(opspace.tasks()["panda-compliant"], {"interface": {}})
