"""The stubs: the same names and arguments as the native module."""

import ast
import inspect
from pathlib import Path

import opspace
from opspace import _opspace


def stub():
    return ast.parse(Path(opspace.__file__).with_name("_opspace.pyi").read_text()).body


def arguments(function):
    """Names of the arguments, without the object or class itself."""
    args = function.args
    return [arg.arg for arg in [*args.posonlyargs, *args.args, *args.kwonlyargs] if arg.arg not in ("self", "cls")]


def own_arguments(function):
    signature = inspect.signature(function)
    return [name for name in signature.parameters if name not in ("self", "cls")]


def test_names_are_those_of_the_module():
    public = {name for name in vars(_opspace) if not name.startswith("_")}
    described = {node.name for node in stub() if isinstance(node, ast.ClassDef | ast.FunctionDef)}
    assert public == {name for name in described if not name.startswith("_")}
    assert set(opspace.__all__) - {"__version__", "robots", "tasks"} == public - {"main"}


def test_members_are_those_of_the_classes():
    compared = 0
    for node in stub():
        if not isinstance(node, ast.ClassDef) or node.name.startswith("_"):
            continue
        own = getattr(_opspace, node.name)
        fields = {part.target.id for part in node.body if isinstance(part, ast.AnnAssign)}
        methods = [part for part in node.body if isinstance(part, ast.FunctionDef)]
        described = fields | {method.name for method in methods if not method.name.startswith("_")}
        assert described == {name for name in vars(own) if not name.startswith("_")}, node.name
        for method in methods:
            is_property = any(getattr(d, "id", "") == "property" for d in method.decorator_list)
            if method.name == "__new__":
                assert arguments(method) == own_arguments(own), node.name
            elif not is_property and not method.name.startswith("__"):
                assert arguments(method) == own_arguments(getattr(own, method.name)), (node.name, method.name)
            compared += 1
        assert own.__doc__, node.name
    assert compared > 60


def test_public_members_have_documentation():
    for name in ("Model", "Experiment", "Result", "Log", "Channel", "Batch", "Finding", "Replay", "ControlLoop", "ControlLoops", "Run", "Simulation"):
        own = getattr(opspace, name)
        missing = [member for member in vars(own) if not member.startswith("_") and not getattr(own, member).__doc__]
        assert missing == [], name
