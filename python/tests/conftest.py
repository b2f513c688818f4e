"""The tests are for the installed package: the sources beside them must not be imported in its place."""

from pathlib import Path

import opspace

assert Path(__file__).parents[1] not in Path(opspace.__file__).parents, "run `pytest`, not `python -m pytest`"
