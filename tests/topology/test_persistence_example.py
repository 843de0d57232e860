"""The example that draws persistence diagrams runs, holds what it checks, and draws its figure."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "persistence_diagrams.py"


@pytest.mark.slow
def test_the_example_holds_what_it_checks_and_draws_it(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib").use("Agg")
    example = runpy.run_path(str(EXAMPLE))
    diagrams = example["main"]()
    assert list(diagrams) == ["before", "after"]
    errors = example["report"](diagrams, tmp_path / "picture.png")
    assert errors["before"] > errors["after"] == 0
    assert (tmp_path / "picture.png").stat().st_size > 10_000
