"""The examples in CadQuery run, and make one valid solid, its STEP file and a picture."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

import tpmscad

pytestmark = [pytest.mark.kernel, pytest.mark.frontend]

FOLDER = Path(__file__).parents[2] / "examples"


def test_a_sandwich_panel_is_one_valid_solid(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("cadquery")
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.chdir(tmp_path)
    found = importlib.import_module("cadquery_panel").main()
    assert found["valid"]
    assert found["pieces"] == 1
    assert tpmscad.check_step("cadquery_panel.step").ok
    assert Path("cadquery_panel.png").stat().st_size > 10_000
