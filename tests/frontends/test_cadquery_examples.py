"""The examples in CadQuery run, and make one valid solid, its STEP file and a picture."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

import tpmscad

pytestmark = [pytest.mark.kernel, pytest.mark.frontend]

FOLDER = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize(
    ("name", "sizes"), [("cadquery_panel", {}), ("cadquery_bracket", {"length": 20.0, "cell": 10.0, "tol": 0.2})]
)
def test_a_part_is_one_valid_solid(
    name: str, sizes: dict[str, float], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("cadquery")
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.chdir(tmp_path)
    found = importlib.import_module(name).main(**sizes)
    assert found["valid"]
    assert found["pieces"] == 1
    assert tpmscad.check_step(f"{name}.step").ok
    assert Path(f"{name}.png").stat().st_size > 10_000
