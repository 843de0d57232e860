"""The examples of solids of fields run, and what they write meets its certificate."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

from tpmscad.kernel.measure.shape_report import check_step

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

FOLDER = Path(__file__).parents[2] / "examples"


def test_a_graded_wall(tmp_path: Path) -> None:
    found = runpy.run_path(str(FOLDER / "solidify_graded.py"))["main"](tmp_path / "wall.step", cells=1)
    assert found["met"]
    assert check_step(tmp_path / "wall.step").ok


def test_a_block_fitted_on_a_dask_cluster_is_the_one_made_here(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="Dask is not installed")
    found = runpy.run_path(str(FOLDER / "solidify_dask.py"))["main"](tmp_path / "block.step", cells=1, tol=0.1)
    assert found["met"]
    assert check_step(tmp_path / "block.step").ok


def test_without_dask_the_example_says_what_it_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(SystemExit, match="pip install dask distributed"):
        runpy.run_path(str(FOLDER / "solidify_dask.py"))["main"]()
