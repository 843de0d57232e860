"""The blending examples run, and their own checks hold."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "examples"
EXAMPLES = [path for path in sorted(FOLDER.glob("blend_*.py")) if path.stem != "blend_slices"]


@pytest.mark.documentation
@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_holds_what_it_checks_and_draws_it(path, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    pytest.importorskip("matplotlib").use("Agg")
    example = runpy.run_path(str(path))
    results = example["main"]()
    example["picture"](results, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 10_000
