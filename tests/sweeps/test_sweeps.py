"""Sweeps: the same results whoever makes them, resumed after an interruption, with failures as rows."""

from __future__ import annotations

import csv
import math
import pickle
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import build123d as bd
import pytest

import tpmscad
from tests.cli.test_cli import run
from tpmscad import surfaces
from tpmscad.api.arguments import arguments_of
from tpmscad.errors import InvalidRequest, TpmscadError
from tpmscad.sweeps.cell_text import format_cell, parse_cell
from tpmscad.sweeps.design_runs import MAKERS
from tpmscad.sweeps.parameter_table import KEYWORDS, NOT_IN_A_TABLE, read_table
from tpmscad.sweeps.results_table import FIGURES, name_column

pytestmark = pytest.mark.kernel

TOL, CELL = 0.3, 10.0
TABLE: list[dict[str, Any]] = [
    {"surface": "schwarz_p", "cell": CELL, "tol": TOL, "thickness": thickness, "boundary": "natural", "file": file}
    for thickness, file in ((1.0, "p_{thickness}.step"), (9.0, None), (2.0, None))
]
"""Three designs of half a second: one with a file, one that is too thick, and one without a file."""


def read_lines(path: Path) -> list[list[str]]:
    """The results without the seconds, which are the last column."""
    with path.open(newline="") as file:
        return [line[:-1] for line in csv.reader(file)]


class Interrupted(Executor):
    """Runs tasks at once, pickled as for another process, and is interrupted at one of them."""

    def __init__(self, last: int, error: BaseException) -> None:
        self.left, self.error = last, error

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        if self.left == 0:
            future.set_exception(self.error)
        else:
            run, given, options = pickle.loads(pickle.dumps((fn, args, kwargs)))
            future.set_result(pickle.loads(pickle.dumps(run(*given, **options))))
        self.left -= 1
        return future


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_row_holds_what_was_measured_and_a_failure_is_a_row(folder: Path) -> None:
    results = tpmscad.sweep(TABLE)
    thin, thick, wall = results.rows
    for row, thickness in ((thin, 1.0), (wall, 2.0)):
        exact = surfaces.volume_fraction("schwarz_p", "minimal", -thickness / 20, thickness / 20)
        assert row["met"]
        assert 1 - row["porosity"] == pytest.approx(exact, rel=3e-3)
        assert row["volume"] == pytest.approx((1 - row["porosity"]) * CELL**3)
        assert (row["pieces"], row["cavities"], row["error"], row["smallest_wall"]) == (1, 0, None, None)
        assert 0 < row["max_deviation"] <= TOL
    assert (thick["met"], thick["error"], thick["volume"]) == (False, "InvalidRequest", None)
    assert "4.63711" in thick["message"]
    assert results.failures == (thick,)
    assert [row["file"] for row in results.rows] == ["p_1.0.step", None, None]
    assert tpmscad.check_step("p_1.0.step").shape.volume == pytest.approx(thin["volume"])
    assert results.column("thickness") == [1.0, 9.0, 2.0]
    assert "3 designs: 2 met" in str(results)
    assert read_lines(folder / "results.csv")[0][-3:] == ["file", "error", "message"]


def test_an_interrupted_sweep_goes_on_and_ends_in_the_same_table(folder: Path) -> None:
    tpmscad.sweep(TABLE, output="whole.csv")
    whole = read_lines(folder / "whole.csv")
    assert whole[0] == ["surface", "cell", "tol", "thickness", "boundary", *list(FIGURES)[:-1]]
    for error in (KeyboardInterrupt(), SystemExit(143)):
        (folder / "cut.csv").unlink(missing_ok=True)
        with pytest.raises(type(error)):
            tpmscad.sweep(TABLE, Interrupted(2, error), "cut.csv")
        found = read_lines(folder / "cut.csv")
        assert 1 <= len(found) <= 3
        assert all(line in whole for line in found)
        resumed = tpmscad.sweep(TABLE, output="cut.csv")
        assert resumed.reused == len(found) - 1
        assert read_lines(folder / "cut.csv") == whole


def test_a_lost_file_is_made_again_and_other_rows_are_kept(folder: Path) -> None:
    tpmscad.sweep(TABLE)
    before = read_lines(folder / "results.csv")
    (folder / "p_1.0.step").unlink()
    assert tpmscad.sweep(TABLE).reused == 2
    assert read_lines(folder / "results.csv") == before
    fewer = tpmscad.sweep([*TABLE[2:], {**TABLE[2], "phase": (0, 0, 0)}])
    assert fewer.reused == 1
    after = read_lines(folder / "results.csv")
    thicknesses = [line[3] for line in after[1:]]
    assert thicknesses == ["2", "2", "1", "9"]  # the table's rows first, then those of the earlier table


def test_a_task_that_its_executor_gives_up_is_a_failure_of_its_row_and_a_dead_pool_is_an_error(folder: Path) -> None:
    results = tpmscad.sweep(TABLE[1:], Interrupted(1, RuntimeError("the worker died")))
    assert [(row["error"], row["met"]) for row in results.rows][1] == ("RuntimeError", False)
    with pytest.raises(TpmscadError, match="ended before its task"):
        tpmscad.sweep(TABLE, Interrupted(0, BrokenProcessPool("the pool died")), "dead.csv")


def test_nothing_is_made_or_written_of_a_bad_table(folder: Path) -> None:
    with pytest.raises(InvalidRequest, match="row 2, column cell"):
        tpmscad.sweep([TABLE[0], {**TABLE[0], "cell": -1}])
    with pytest.raises(InvalidRequest, match=r"\.csv"):
        tpmscad.sweep(TABLE, output="results.txt")
    assert not list(folder.iterdir())


def test_a_recipe_is_made_with_the_changed_keys(folder: Path) -> None:
    (folder / "ball.toml").write_text(
        'tol = 0.2\ndomain = [[-6, -6, -6], [6, 6, 6]]\n[field]\nkind = "sphere"\ncenter = [0, 0, 0]\nradius = 4\n'
    )
    (ball,) = tpmscad.sweep([{"recipe": "ball.toml", "field.radius": 5, "tol": None}]).rows
    assert ball["volume"] == pytest.approx(4 / 3 * math.pi * 125, rel=5e-3)
    assert ball["porosity"] == pytest.approx(1 - ball["volume"] / 12**3)


CELLS: dict[str, dict[str, Any]] = {
    "lattice": {
        "surface": "gyroid", "cells": (2, 1, 1), "cell": (5, 6, 7), "thickness": 0.5, "offset": (-0.2, 0.3),
        "volume_fraction": 0.3, "porosity": 0.7, "pore_size": 2, "reference": "nodal", "phase": (0.25, 0, 0), "tol": 0.2,
        "kind": "skeletal", "side": "+", "loose": "keep", "boundary": "natural",
    },
    "infill": {
        "body": "part.step", "surface": "gyroid", "cell": 5, "thickness": 0.5, "offset": -0.1, "volume_fraction": 0.3,
        "porosity": 0.7, "pore_size": 2, "reference": "minimal", "phase": (0, 0.25, 0), "tol": 0.2, "kind": "skeletal",
        "side": "+", "loose": "keep", "solid": "largest", "box": ((0, 0, 0), (5, 6, 7)), "rotation": (0, 0, 45), "skin": 1,
        "open_faces": ">Z,<Z", "keep": "bosses.step", "clear": "1",
    },
    "struts": {
        "kind": "octet", "cell": 5, "cells": 2, "diameter": 0.5, "volume_fraction": 0.3, "porosity": 0.7, "node_radius": 0.4,
        "angle": 20, "tol": 0.2, "loose": "keep",
    },
}  # fmt: skip
"""By function: a cell for each of its keywords that a table may have."""


@pytest.mark.parametrize("function", CELLS)
def test_every_keyword_is_a_column_that_is_kept_and_found_again(
    function: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cells = CELLS[function]
    assert (
        cells.keys() == KEYWORDS[function].keys() == arguments_of(getattr(tpmscad, function)).keys() - {*NOT_IN_A_TABLE}
    )
    needed = {name: cells[name] for name, argument in KEYWORDS[function].items() if argument.is_required}
    rows = [needed, *({**needed, name: value} for name, value in cells.items() if name not in needed)]
    taken: list[Any] = []
    failures: list[Exception] = [InvalidRequest("too thick"), KeyError("a"), MemoryError(), OSError(28, "disk full")]

    def fail(parameters: Any) -> Any:
        taken.append(parameters)
        raise failures[len(taken) % len(failures)]

    monkeypatch.setitem(MAKERS, function, fail)
    results = tpmscad.sweep(rows)
    assert [{**row} for row in taken] == [read_table([row]).designs[0].parameters for row in rows]
    assert {row["error"] for row in results.rows} == {"InvalidRequest", "UnexpectedError", "OutOfMemory", "FileError"}
    for row, found in zip(rows, results.rows, strict=True):
        given = {name: found[name_column(name)] for name in cells}
        assert {n: v for n, v in given.items() if v is not None} == {
            n: parse_cell(n, format_cell(v)) for n, v in row.items()
        }
        assert found["porosity"] is None
    names = list(cells)
    with (folder / "table.csv").open("w", newline="") as file:
        csv.writer(file).writerows([names, *([format_cell(row.get(name)) for name in names] for row in rows)])
    assert tpmscad.sweep("table.csv").reused == len(rows) == len(taken)


def test_a_porosity_that_is_asked_for_stands_beside_the_one_measured(folder: Path) -> None:
    table = [{"surface": "schwarz_p", "cell": CELL, "tol": TOL, "porosity": 0.75, "boundary": "natural"}]
    table += [{"kind": "cubic", "tol": 0.1, "cell": CELL, "porosity": 0.9}]
    for reused in (0, 2):
        results = tpmscad.sweep(table)
        assert (results.met, results.reused) == (True, reused)
        assert results.column("requested_porosity") == [0.75, 0.9]
        assert results.column("porosity") == [pytest.approx(0.75, abs=2e-3), pytest.approx(0.9, abs=1e-6)]


@pytest.mark.slow
def test_an_infill_has_the_porosity_and_the_metrics_of_its_body(folder: Path) -> None:
    tpmscad.export_step(bd.Box(6, 6, 6), folder / "box.step")
    row = {"body": "box.step", "surface": "schwarz_p", "cell": 6, "thickness": 0.6, "tol": 0.2}
    (filled,) = tpmscad.sweep([row], metrics=True).rows
    assert filled["porosity"] == pytest.approx(1 - filled["volume"] / 6**3)
    assert filled["smallest_wall"] == pytest.approx(0.6, abs=0.05)
    assert tpmscad.sweep([row], metrics=True).reused == 1


def test_an_exchanger_has_the_figures_of_its_channels(folder: Path) -> None:
    bd.export_step(bd.Box(20, 10, 10), "core.step")
    (folder / "table.csv").write_text(
        "kind,body,surface,cell,thickness,tol,openings\n"
        'domains,core.step,gyroid,10,0.8,0.2,"+=<X,>X; -=<Y,>Y"\n'
        "domains,core.step,gyroid,10,0.8,0.2,sideways\n"
    )
    with pytest.raises(InvalidRequest, match=r"row 2, column openings: .* names no channel"):
        tpmscad.sweep("table.csv")
    rows = (folder / "table.csv").read_text().splitlines()[:2]
    (folder / "table.csv").write_text("\n".join(rows) + "\n")
    (row,) = tpmscad.sweep("table.csv", output="exchangers.csv").rows
    assert row["met"]
    channels = row["volume_plus"] + row["volume_minus"]
    assert row["volume"] + channels == pytest.approx(2000, rel=1e-9)
    assert row["porosity"] == pytest.approx(channels / 2000)
    assert 4 * row["volume_plus"] / row["wetted_area_plus"] == pytest.approx(row["hydraulic_diameter_plus"])
    assert 0 < row["opening_area_plus"] < 2 * 100
    assert tpmscad.sweep("table.csv", output="exchangers.csv").reused == 1


def test_the_command_line_writes_the_results_and_tells_failures(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "t.csv").write_text("surface,cell,tol,thickness,boundary\nP,10,0.3,1,natural\nP,10,0.3,9,natural\n")
    for line, status in (("sweep t.csv -o out.csv --report r.json", 1), ("sweep absent.csv", 2)):
        assert run(line) == status
    said = capsys.readouterr()
    assert "2 designs: 1 met" in said.out
    assert "1 of 2 designs miss the request: see out.csv" in said.err
    assert len(read_lines(folder / "out.csv")) == 3
    assert '"reused": 0' in (folder / "r.json").read_text()
    (folder / "t.csv").write_text("surface,cell,thickness\nP,10,thick\n")
    assert run("sweep t.csv") == 2
    assert "row 1, column thickness" in capsys.readouterr().err
