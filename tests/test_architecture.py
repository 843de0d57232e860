"""The architecture of the package: which room may import which, read from the source of every module."""

from __future__ import annotations

import ast
import functools
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("tpmscad", "cq_plugins", "freecad")

GROUND = {
    "_compiled_loops",
    "_lazy_import",
    "_typing",
    "api",
    "array_table",
    "atomic_file",
    "catalogue",
    "errors",
    "fallbacks",
    "file_suffixes",
    "index_ranges",
    "kernel_wheels",
    "memory_limit",
    "minimal_series",
    "parallel",
    "progress_display",
    "result_display",
    "rigid_motion",
    "stage_timer",
    "strut_cells",
}
"""Modules that every room may import; they import nothing of the package but each other."""

MATHEMATICS = {"numpy", "scipy"}
ROOMS: dict[str, set[str]] = {
    "splines": {*MATHEMATICS},
    "topology": {*MATHEMATICS, "gudhi", "matplotlib"},
    "fields": {"topology", "splines", *MATHEMATICS},
    "surfaces": {"fields", "splines", *MATHEMATICS},
    "brep": {"splines", *MATHEMATICS},
    "lattices": {"surfaces", "brep", "splines", *MATHEMATICS},
    "levelset": {"fields", "brep", "splines", *MATHEMATICS},
    "sources": {"lattices", "levelset", "surfaces", "fields", "brep", "splines", *MATHEMATICS},
    "trimming": {"brep", "splines", *MATHEMATICS},
    "erosion": {"trimming", "brep", "splines", *MATHEMATICS},
    "meshing": {"lattices", "brep", "splines", "gmsh", *MATHEMATICS},
    "simulation": {"meshing", "skfem", *MATHEMATICS},
    "blending": {"fields", "topology", "splines", *MATHEMATICS},
    "kernel": {"brep", "trimming", "erosion", "fields", "splines", "OCP", "PIL", "build123d", "numba", *MATHEMATICS},
}
"""What each room may import, besides its own modules, the ground and the standard library."""

MAKERS = ("requests", "results", "solids", "files", "studies")
for name in MAKERS:
    ROOMS[name] = {*ROOMS, *MATHEMATICS}

FACES = {
    "recipe": {*MAKERS, "__init__", "fields", "blending", "numpy", "PIL"},
    "sweeps": {*MAKERS, "recipe", "numpy", "pyarrow"},
    "cli": {*MAKERS, "__init__", "recipe", "sweeps", "maps", "__version__", "typer", "rich"},
    "__main__": {"cli"},
    "tpmscad.build123d": {*MAKERS, "build123d"},
    "cq_plugins": {*MAKERS, "cadquery"},
    "freecad": {"FreeCAD", "FreeCADGui", "Part", "PySide"},
}
"""The faces of the program: no mathematics, no kernel calls."""

ALLOWED = {
    **{name: {"numpy"} for name in GROUND},
    "_compiled_loops": {"numba"},
    "parallel": {"numpy", "threadpoolctl"},
    "progress_display": {"rich", "IPython"},
    **ROOMS,
    **FACES,
    "maps": set(),
    "__init__": set(),
}

CALLED_LATE = {
    "tpmscad/results/model.py": {"files", "studies"},
    "tpmscad/results/domain_results.py": {"files", "studies"},
    "tpmscad/results/result_summary.py": {"studies"},
}
"""Rooms above that methods of results import when they are called."""

FLOORS = {
    "fields": (("tape",), ("periods_and_directions", "data_box", "field"), ("kinds", "data"), ("analysis",)),
    "blending": (("weights",), ("composition",), ("optimise",)),
    "levelset": (("fit", "quadmesh"), ("boundary_level_sets",), ("periodic",)),
    "trimming": (("operands",), ("intersect",), ("classify",), ("rebuild",)),
    "kernel": (
        ("occt", "recognise"),
        ("build",),
        ("step",),
        ("measure",),
        ("body_import", "render", "export"),
        ("boolean", "slicing"),
        ("printability",),
    ),
}
"""Subfolders of a room from the lowest floor up: one imports its own modules and those of the floors below."""

ONLY_IN = {
    "gudhi": {"tpmscad/topology/gudhi_complex.py"},
    "matplotlib": {"tpmscad/topology/diagrams.py"},
    "IPython": {"tpmscad/progress_display.py"},
    "pyarrow": {"tpmscad/sweeps/parameter_table.py"},
    "PIL": {"tpmscad/kernel/render/labels.py", "tpmscad/recipe/image_masks.py"},
}
"""Packages that a single file may import, finer than its room's row above."""

MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def room(path: Path) -> str:
    """The row of the table a file belongs to."""
    return row_of(".".join(path.relative_to(ROOT).with_suffix("").parts))


parse = functools.cache(ast.parse)


@functools.cache
def statements(source: str) -> list[ast.stmt]:
    """Every statement of a module, those within others included; expressions, which are most of a tree, hold none."""
    found: list[ast.stmt] = []
    due: list[ast.AST] = [parse(source)]
    for node in due:
        for name in ("body", "orelse", "finalbody", "handlers", "cases"):
            due += getattr(node, name, [])
        if isinstance(node, ast.stmt):
            found.append(node)
    return found


@functools.cache
def read(source: str) -> tuple[set[str], bool, set[str]]:
    """Every absolute dotted name imported anywhere in a module, `from a import b` as a.b; whether it has a docstring; the names
    that are imported with the module itself.
    """
    tree, names = parse(source), set[str]()
    for node in statements(source):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import in line {node.lineno}"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    early = {
        f"{node.module}.{alias.name}" for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    return names, bool(ast.get_docstring(tree)), early


def row_of(name: str) -> str:
    """The row of the table for an imported name: a room, a module of the package or a foreign package."""
    first, *rest = name.split(".")
    if first != "tpmscad":
        return first
    if rest[:1] == ["build123d"]:
        return "tpmscad.build123d"
    return rest[0] if rest else "__init__"


def floor_of(name: str) -> tuple[str, int] | None:
    """The room and the number of the floor of a dotted name in a subfolder of a room with floors."""
    parts = name.split(".")
    if len(parts) < 3 or parts[0] != "tpmscad" or parts[1] not in FLOORS:
        return None
    for number, folders in enumerate(FLOORS[parts[1]]):
        if parts[2] in folders:
            return parts[1], number
    return None


def offences(path: Path, source: str) -> list[str]:
    """The imports of a module that the tables do not allow."""
    here, where = room(path), path.relative_to(ROOT).as_posix()
    if here not in ALLOWED:
        return [f"{where} is in no room of the package: add it to the design first"]
    floor = floor_of(".".join(path.relative_to(ROOT).with_suffix("").parts))
    breaches = []
    for name in sorted(read(source)[0]):
        row = row_of(name)
        at_home = row == here and name.split(".")[0] in PACKAGES
        if row in CALLED_LATE.get(where, ()) and name not in read(source)[2]:
            continue
        if not at_home and row not in ALLOWED[here] | GROUND | sys.stdlib_module_names:
            breaches.append(f"{where} may not import {name}")
        if where not in ONLY_IN.get(row, {where}):
            breaches.append(f"{where} may not import {name}; only {', '.join(ONLY_IN[row])}")
        other = floor_of(name)
        if floor and at_home:
            if other is None and len(name.split(".")) > 3:
                breaches.append(f"{where} is on a lower floor than {name}")
            if other and other[1] > floor[1]:
                breaches.append(f"{where} is on a lower floor than {name}")
    return breaches


def repeated_stems(paths: list[Path]) -> dict[str, int]:
    """Stems of modules that occur more than once, packages' __init__ excepted."""
    return {stem: n for stem, n in Counter(p.stem for p in paths if p.stem != "__init__").items() if n > 1}


def repeated_classes(sources: list[str]) -> dict[str, int]:
    """Names of classes that are defined more than once."""
    names = Counter(node.name for s in sources for node in statements(s) if isinstance(node, ast.ClassDef))
    return {name: n for name, n in names.items() if n > 1}


def test_every_module_imports_from_lower_floors_only() -> None:
    assert [breach for path in MODULES for breach in offences(path, path.read_text())] == []


def test_every_module_says_what_it_is() -> None:
    sources = {path.relative_to(ROOT).as_posix(): path.read_text() for path in MODULES}
    assert [name for name, source in sources.items() if source.strip() and not read(source)[1]] == []


def test_a_public_function_lives_in_a_private_module_of_its_name() -> None:
    """A module of the very name would hide the function: its import binds the name in the package."""
    names = ast.parse((ROOT / "tpmscad/__init__.pyi").read_text()).body
    homes = {alias.name: node.module for node in names if isinstance(node, ast.ImportFrom) for alias in node.names}
    functions = {name: home for name, home in homes.items() if name.islower() and home != "tpmscad"}
    assert {name: str(home).rpartition(".")[2] for name, home in functions.items()} == {
        name: f"_{name}" for name in functions
    }


def test_no_module_stem_occurs_twice() -> None:
    assert not repeated_stems([path for path in MODULES if path.parts[len(ROOT.parts)] == "tpmscad"])


def test_no_class_name_occurs_twice() -> None:
    assert not repeated_classes([path.read_text() for path in MODULES])


BREACHES = (
    ("tpmscad/fields/tpms.py", "from tpmscad.surfaces import patch"),
    ("tpmscad/levelset/mesh.py", "from tpmscad import kernel"),
    ("tpmscad/levelset/mesh.py", "from OCP.gp import gp_Pnt"),
    ("tpmscad/trimming/operands/body.py", "from tpmscad.trimming.intersect import marching"),
    ("tpmscad/kernel/build/solids.py", "from tpmscad.kernel.step import part21"),
    ("tpmscad/blending/weights.py", "import numba"),
    ("tpmscad/topology/persistence.py", "def f():\n    import gudhi"),
    ("tpmscad/kernel/solid.py", "import cadquery"),
    ("tpmscad/surfaces/gyroid.py", "import tpmscad"),
    ("tpmscad/cli/lattice.py", "import numpy as np"),
    ("tpmscad/errors.py", "from tpmscad.fields import box"),
    ("cq_plugins/tpms.py", "import build123d"),
    ("freecad/tpmscad_workbench/run.py", "import tpmscad"),
    ("tpmscad/kernel/solid.py", "from tpmscad.build123d import Tpms"),
    ("tpmscad/attic.py", "from tpmscad import kernel"),
    ("tpmscad/results/model.py", "from tpmscad.studies._render import render"),
    ("tpmscad/results/certificate.py", "def f():\n    from tpmscad.studies._render import render"),
)
"""Modules that there might be, and statements that they may not hold."""


def test_a_breach_of_the_floors_is_noticed() -> None:
    assert [breach for breach in BREACHES if not offences(ROOT / breach[0], breach[1])] == []


def test_a_repeated_stem_and_a_repeated_class_are_noticed() -> None:
    assert repeated_stems([Path("tpmscad/brep/loops.py"), Path("tpmscad/kernel/loops.py")]) == {"loops": 2}
    assert repeated_classes(["class Grid: ...", "class Grid: ..."]) == {"Grid": 2}


def list_compiled(words: str) -> set[str]:
    """The modules of the cut and of erosion in which a compiled function has one of the words in its name."""
    found = set()
    for room in ("trimming", "erosion"):
        for path in (ROOT / "tpmscad" / room).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.FunctionDef) and re.search(words, node.name):
                    found |= {path.stem for d in node.decorator_list if "njit" in ast.unparse(d)}
    return found


def test_curves_are_traced_and_surfaces_evaluated_in_one_place() -> None:
    """A second tracer, or a second table of surfaces, is a second way to cut."""
    assert list_compiled("trace|march|follow") == {"face_face"}
    assert list_compiled("evaluate_(face|patch|surface)$") == {"patch_polynomials"}


def test_import_of_the_package_loads_no_kernel() -> None:
    heavy = {"OCP", "build123d", "cadquery", "numba", "gudhi", "matplotlib"}
    script = f"import sys, tpmscad; print(sorted({heavy} & sys.modules.keys()))"
    answer = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"
