"""Homogenised properties as columns of a sweep, and plots of its columns."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import pytest

import tpmscad
from tpmscad.errors import InvalidRequest
from tpmscad.sweeps._sweep import SweepResults
from tpmscad.sweeps.design_runs import FIGURES, PROPERTIES

pytestmark = pytest.mark.kernel

P_CELL: dict[str, Any] = {"surface": "schwarz_p", "cell": 10.0, "tol": 0.3, "thickness": 1.0, "boundary": "natural"}
NOT_MEASURED = dict.fromkeys(FIGURES)


def make_results(*rows: dict[str, Any]) -> SweepResults:
    """Results as a sweep returns them: every row has all columns."""
    columns = {name: None for row in rows for name in row} | NOT_MEASURED
    return SweepResults(Path("results.csv"), tuple({**columns, **row} for row in rows), 0)


RESULTS = make_results(
    {"surface": "gyroid", "cells": (2, 1, 1), "thickness": 2.0, "porosity": 0.4, "E1": 0.3, "met": True},
    {"surface": "schwarz_p", "cells": 1, "thickness": 1.0, "porosity": 0.8, "E1": 0.1, "met": True},
    {"surface": "gyroid", "cells": 1, "thickness": 1.0, "porosity": 0.7, "E1": 0.1, "met": True},
    {"surface": "gyroid", "cells": 1, "thickness": 3.0, "porosity": 0.2, "E1": 0.6, "met": False},
    {"surface": "gyroid", "cells": 1, "thickness": 0.1, "porosity": 0.9, "met": True},
)


@pytest.fixture
def pyplot() -> Any:
    """The module matplotlib.pyplot, without windows; its figures are closed afterwards."""
    pytest.importorskip("matplotlib").use("Agg")
    module = importlib.import_module("matplotlib.pyplot")
    yield module
    module.close("all")


@pytest.mark.slow
def test_properties_are_those_of_homogenize_and_are_computed_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("skfem")
    monkeypatch.chdir(tmp_path)
    (plain,) = tpmscad.sweep([P_CELL]).rows
    assert [plain[name] for name in PROPERTIES] == [None] * len(PROPERTIES)
    results = tpmscad.sweep([P_CELL], properties=True)
    (row,) = results.rows
    assert results.reused == 0
    found = tpmscad.homogenize("schwarz_p", volume_fraction=1 - row["porosity"], poisson_ratio=0.3)
    expected = {
        **found.engineering_constants,
        "bulk_modulus": found.bulk_modulus,
        "conductivity": found.conductivity[0, 0],
    }
    for name, value in expected.items():
        assert row[name] == pytest.approx(value, rel=5e-3), name
    assert 0 < row["property_error"] < 4e-3
    again = tpmscad.sweep([P_CELL], properties=True)
    assert (again.reused, again.rows) == (1, results.rows)
    assert tpmscad.sweep([P_CELL]).rows == results.rows


def test_a_filled_body_has_no_properties_and_nothing_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("skfem")
    monkeypatch.chdir(tmp_path)
    table = [P_CELL, {"body": "part.step", "surface": "gyroid", "cell": 5, "thickness": 0.5}]
    with pytest.raises(InvalidRequest, match=r"row 2, column body: .*leave out properties"):
        tpmscad.sweep(table, properties=True)
    monkeypatch.setitem(sys.modules, "skfem", None)
    with pytest.raises(InvalidRequest, match=r"tpmscad\[simulation\]"):
        tpmscad.sweep([P_CELL], properties=True)
    assert not list(tmp_path.iterdir())


def test_a_plot_has_a_line_for_each_value_in_the_order_of_x(pyplot: Any) -> None:
    axes = RESULTS.plot("porosity", "E1", by="surface")
    lines = {line.get_label(): line.get_xydata().tolist() for line in axes.get_lines()}
    assert lines == {"gyroid": [[0.4, 0.3], [0.7, 0.1]], "schwarz_p": [[0.8, 0.1]]}
    assert len({(line.get_marker(), line.get_color()) for line in axes.get_lines()}) == 2
    assert axes.get_xlabel() == "porosity"
    assert axes.get_ylabel() == "Young's modulus $E_1$ / that of the solid"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["gyroid", "schwarz_p"]
    assert RESULTS.plot("thickness", "E1", ax=axes) is axes
    assert axes.get_lines()[-1].get_xdata().tolist() == [1.0, 1.0, 2.0]
    assert axes.get_xlabel() == "thickness, mm"
    axes.figure.canvas.draw()


def test_a_column_of_groups_may_hold_anything(pyplot: Any) -> None:
    axes = RESULTS.plot("porosity", "E1", by="cells")
    assert [line.get_label() for line in axes.get_lines()] == ["2,1,1", "1"]


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: RESULTS.plot("porosty", "E1"), "no column 'porosty'; did you mean 'porosity'"),
        (lambda: RESULTS.plot("porosity", "weight"), "no column 'weight'; the columns are surface, cells, .*E1"),
        (lambda: RESULTS.plot("cells", "E1"), r"column 'cells' holds \(2, 1, 1\), which is no number"),
        (lambda: RESULTS.plot("met", "E1"), "column 'met' holds True"),
        (lambda: RESULTS.plot("porosity", "smallest_wall"), "no design that is met .*metrics=True"),
        (lambda: RESULTS.plot("porosity", 3), 'y 3 must be text, as in y="E1"'),
    ],
)
def test_a_column_that_cannot_be_drawn_is_refused(call: Any, said: str) -> None:
    with pytest.raises(InvalidRequest, match=said):
        call()


def test_a_plot_names_the_extra_that_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(InvalidRequest, match=r"tpmscad\[plot\]"):
        RESULTS.plot("porosity", "E1")
