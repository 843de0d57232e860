"""What a result prints by itself: a few lines for people, and no traceback through the package for a bad request."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tpmscad import fields
from tpmscad.files._export_infill import InfillFile
from tpmscad.files._export_instances import InstancedFile
from tpmscad.files._export_slabs import SlabFiles
from tpmscad.files.slab_files import SlabFile
from tpmscad.kernel.body_import.cad_body import BodyFile
from tpmscad.kernel.measure.shape_report import StepReport, check_shape
from tpmscad.kernel.measure.solid_list import SolidEntry
from tpmscad.meshing.volume_mesh import VolumeMesh
from tpmscad.result_display import MAX_LINES, fit_lines, list_names
from tpmscad.results.triangulated_infill import TriangulatedInfill
from tpmscad.simulation.properties import HomogenizedProperties
from tpmscad.studies._permeability import ChannelPermeability

pytestmark = pytest.mark.kernel

MANY = 40
NOTES = tuple(f"note {i}" for i in range(MANY))
MAX_CHARACTERS = 400  # of a line: messages of errors are shown whole


def blend() -> Any:
    rods = [fields.rod(fields.tpms(name, 10), 0.0) for name in ("gyroid", "P")]
    halves = [fields.box((0, 0, 0), (9, 10, 10)), fields.box((11, 0, 0), (20, 10, 10))]
    return tpmscad.blend(rods, halves, [fields.box((9, 0, 0), (11, 10, 10))], resolution=(21, 11, 11), progress=False)


def sweep() -> Any:
    rows = [{"surface": "P", "cell": 4, "thickness": t, "tol": 0.2} for t in (0.5, *range(9, 21))]
    return tpmscad.sweep(rows, output=Path("results.csv"), progress=False)


@cache
def lattice() -> Any:
    return tpmscad.lattice("P", cell=4, thickness=0.5, tol=0.2)


def crowded_certificate() -> Any:
    return dataclasses.replace(lattice().certificate, met=False, shortfalls=("missed", "missed, too"), notes=NOTES)


def flow_estimate() -> Any:
    return tpmscad.estimate_flow(
        "gyroid", cell=4, thickness=0.4, velocity=0.1, length=48.0, density=1000.0, viscosity=1e-3, permeability=0.05,
        conductivity=0.6, specific_heat=4180.0,
    )  # fmt: skip


def body_file() -> Any:
    solids = [SolidEntry(i + 1, "part", (1.0, 2.0, 3.0), 6.0, {"plane": 6}, 1e-7) for i in range(MANY)]
    return BodyFile("part.step", tuple(solids), (), (), None, NOTES)


def slab_files() -> Any:
    slabs = [SlabFile(f"s{i}.step", (0.0, 0.0, i), (1, 2, 1), 3.25, 9.0, 8, 1, 10**6, "", 1.5) for i in range(MANY)]
    return SlabFiles(Path(), tuple(slabs), (), Path("slabs.json"), ())


def volume_mesh() -> Any:
    points = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    groups = {f"body {i}": np.array([0]) for i in range(MANY)}
    return VolumeMesh(points, {"tetra": np.array([[0, 1, 2, 3]])}, cell_groups=groups)


def triangles() -> Any:
    points = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    sides = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    return TriangulatedInfill("part", points, sides, np.zeros(4, np.int64), 0.1, 1, 2, NOTES)


MAKERS: dict[str, Callable[[], Any]] = {
    "certificate": crowded_certificate,
    "crowded model": lambda: dataclasses.replace(lattice(), certificate=crowded_certificate()),
    "instances": lambda: InstancedFile(Path("p.step"), (3, 2, 1), crowded_certificate(), 10**6),
    "infill file": lambda: InfillFile(Path("p.step"), 9, 4, 3, 13, 99, 5.5, 9.0, 10**6, (crowded_certificate(),)),
    "body file": body_file,
    "slabs": slab_files,
    "step report": lambda: StepReport("a.step", check_shape(bd.Box(1, 2, 3)), ("mm",), NOTES, (), body_file().solids),
    "volume mesh": volume_mesh,
    "triangles": triangles,
    "layers": lambda: lattice().slices(1.0),
    "flow": flow_estimate,
    "stiffness": lambda: HomogenizedProperties(
        "gyroid", np.diag([3.0, 3, 3, 1, 1, 1]), np.eye(3), 0.2, 1e-3, np.eye(6), np.eye(3), 1.0, 0.3, 10, 30, 1.0
    ),
    "permeability": lambda: ChannelPermeability("gyroid", np.eye(3), 0.9 * np.eye(3), 0.4, 10, 1.0),
    "blend": blend,
    "sweep": sweep,
    "report": lambda: check_shape(bd.Box(1, 2, 3)),
    "metrics": lambda: tpmscad.measure(bd.Box(1, 2, 3)),
    "print check": lambda: tpmscad.check_print(bd.Box(1, 2, 3)),
    "model": lattice,
}


@pytest.mark.parametrize("name", MAKERS)
def test_a_result_prints_in_a_few_lines(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = MAKERS[name]()
    for text in (repr(result), str(result)):
        assert len(text.splitlines()) <= MAX_LINES
        assert max(map(len, text.splitlines())) <= MAX_CHARACTERS
        assert "object at 0x" not in text


def test_every_public_function_returns_what_has_a_text_of_its_own() -> None:
    functions = [f for name in tpmscad.__all__ if inspect.isfunction(f := getattr(tpmscad, name))]
    functions += [f for _, f in inspect.getmembers(tpmscad.Model, inspect.isfunction) if not f.__name__.startswith("_")]
    results = {
        kind
        for function in functions
        if dataclasses.is_dataclass(
            kind := inspect.unwrap(function).__globals__.get(function.__annotations__["return"])
        )
    }
    assert len(results) >= 14
    for kind in results:
        assert "__repr__" in vars(kind), kind
        assert not kind.__dataclass_params__.repr, kind


class Table(HTMLParser):
    """The cells of the rows of a page, which is well formed."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.rows: list[list[str]] = []
        self.feed(page)
        assert not self.open

    def handle_starttag(self, tag: str, attributes: Any) -> None:
        if tag == "img":
            return
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data


TABLES = {
    "certificate": (MANY + 5, "note", "note 7"),
    "instances": (MANY + 6, "note", "note 7"),
    "metrics": (6, "pieces", "1"),
    "print check": (5, "cavities", "yes"),
    "body file": (MANY + 1, "7", "part"),
    "step report": (MANY + 1, "7", "part"),
    "slabs": (MANY + 1, "s7.step", "0, 0, 7"),
    "stiffness": (12, "xy", "0"),
    "permeability": (3, "y", "0"),
    "flow": (12, "Darcy 1856", ""),
}
"""Rows of the table of a result in notebooks, and the first two cells of one."""


@pytest.mark.parametrize("name", TABLES)
def test_results_that_are_tables_are_tables_in_notebooks(name: str) -> None:
    rows = Table(MAKERS[name]()._repr_html_()).rows
    count, title, value = TABLES[name]
    assert len(rows) == count
    assert any(row[0] == title and row[1].startswith(value) for row in rows), rows


def test_lines_that_give_way_are_counted() -> None:
    lines = [f"line {i}" for i in range(MANY)]
    said = fit_lines(lines, ".lines", tail=["the end"]).splitlines()
    assert len(said) == MAX_LINES
    assert said[-2:] == [f"and {MANY - MAX_LINES + 2} more lines: see .lines", "the end"]
    assert fit_lines(lines[:9], ".lines", tail=["the end"]).splitlines() == [*lines[:9], "the end"]
    assert list_names(("a", "b", "c"), 2) == "a, b and 1 more"


def test_a_sweep_is_a_table_in_notebooks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    html = sweep()._repr_html_()
    assert html.count("<tr>") == 14
    assert "<th>volume</th>" in html
    assert "<th>E1</th>" not in html
    assert "{" not in html
