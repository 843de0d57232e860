"""The floors of the house: who may import whom, read from the source of every module."""

from __future__ import annotations

import ast
import functools
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("tpmscad", "cq_plugins")
MAX_LINES = 400

GROUND = {"errors"}
"""Modules that anybody may import; they import nothing of the house."""

ROOMS = {
    "fields": {"numpy", "scipy"},
    "surfaces": {"numpy", "scipy"},
    "splines": {"numpy", "scipy"},
    "topology": {"numpy", "scipy", "numba", "gudhi"},
    "patches": {"fields", "surfaces", "splines", "numpy", "scipy"},
    "trimming": {"patches", "splines", "numpy", "scipy"},
    "blend": {"fields", "splines", "topology", "numpy", "scipy"},
    "kernel": {"patches", "trimming", "fields", "splines", "OCP", "build123d", "numpy", "scipy"},
}
"""What each room may import, beside its own files, the ground and the standard library. The kernel knows the splines as the
values a patch complex is made of."""

UPPER_FLOOR = ("request", "model", "certify", "solids", "parts", "recipe", "metrics", "workflows")
WORKFLOWS = {name: {*UPPER_FLOOR, *ROOMS, "numpy", "scipy"} for name in UPPER_FLOOR}
"""The floor of the public functions, one room: what is asked for, what is given back, how it is certified."""

FACES = {
    "cli": {
        "workflows",
        "solids",
        "parts",
        "recipe",
        "metrics",
        "surfaces",
        "typer",
        "rich",
    },  # the catalogue can be listed without the kernel
    "__main__": {"cli"},
    "tpmscad.build123d": {"workflows", "parts", "build123d"},
    "cq_plugins": {"workflows", "parts", "cadquery"},
}
"""The faces of the program: no mathematics, no kernel calls."""

ALLOWED = {
    **{name: set[str]() for name in GROUND},
    **ROOMS,
    **WORKFLOWS,
    **FACES,
    "__init__": {*WORKFLOWS, *ROOMS},
}

ONLY_IN = {"gudhi": {"tpmscad/topology/reference.py"}}
"""Packages that a single file may import, finer than its room's row above."""

MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def room(path: Path) -> str:
    """The row of the table a file belongs to."""
    return row_of(".".join(path.relative_to(ROOT).with_suffix("").parts))


@functools.cache
def read(source: str) -> tuple[set[str], bool]:
    """Every absolute dotted name imported anywhere in a module, `from a import b` as a.b; whether it has a docstring."""
    tree, names = ast.parse(source), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import in line {node.lineno}"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names, bool(ast.get_docstring(tree))


def row_of(name: str) -> str:
    """The word of the table for an imported name: a room, a module of the house or a foreign package."""
    first, *rest = name.split(".")
    if first != "tpmscad":
        return first
    if rest[:1] == ["build123d"]:
        return "tpmscad.build123d"
    return rest[0] if rest else "__init__"


def offences(path: Path, source: str) -> list[str]:
    """The imports of a module that the table does not allow."""
    here, where = room(path), path.relative_to(ROOT).as_posix()
    if here not in ALLOWED:
        return [f"{where} is in no room of the house: add it to the design first"]
    found = []
    for name in sorted(read(source)[0]):
        row = row_of(name)
        at_home = row == here and name.split(".")[0] in PACKAGES
        if not at_home and row not in ALLOWED[here] | GROUND | sys.stdlib_module_names:
            found.append(f"{where} may not import {name}")
        if where not in ONLY_IN.get(row, {where}):
            found.append(f"{where} may not import {name}; only {', '.join(ONLY_IN[row])}")
    return found


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(ROOT).as_posix())
class TestEveryModule:
    def test_imports_only_from_lower_floors(self, path: Path) -> None:
        assert not offences(path, path.read_text())

    def test_is_one_idea_of_readable_length(self, path: Path) -> None:
        assert len(path.read_text().splitlines()) <= MAX_LINES

    def test_says_what_it_is(self, path: Path) -> None:
        source = path.read_text()
        assert not source.strip() or read(source)[1], "no module docstring"


@pytest.mark.parametrize(
    ("path", "statement"),
    [
        ("tpmscad/fields/tpms.py", "from tpmscad.surfaces import patch"),
        ("tpmscad/splines/fit.py", "import tpmscad.patches.complex"),
        ("tpmscad/patches/layout.py", "from tpmscad import kernel"),
        ("tpmscad/patches/layout.py", "from OCP.gp import gp_Pnt"),
        ("tpmscad/blend/weights.py", "import numba"),
        ("tpmscad/topology/persistence.py", "def f():\n    import gudhi"),
        ("tpmscad/kernel/solid.py", "import cadquery"),
        ("tpmscad/surfaces/gyroid.py", "import tpmscad"),
        ("tpmscad/cli/lattice.py", "from tpmscad.kernel import check"),
        ("tpmscad/cli/lattice.py", "import numpy as np"),
        ("tpmscad/errors.py", "from tpmscad.fields import box"),
        ("cq_plugins/tpms.py", "import build123d"),
        ("tpmscad/kernel/solid.py", "from tpmscad.build123d import Tpms"),
        ("tpmscad/attic.py", "from tpmscad import kernel"),
    ],
)
def test_a_breach_of_the_floors_is_noticed(path: str, statement: str) -> None:
    assert offences(ROOT / path, statement)


def test_import_of_the_package_loads_no_kernel() -> None:
    heavy = {"OCP", "build123d", "cadquery", "numba", "gudhi", "matplotlib"}
    script = f"import sys, tpmscad; print(sorted({heavy} & sys.modules.keys()))"
    answer = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
