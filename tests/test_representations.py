"""What a result prints by itself: a few lines for people, and no traceback through the package for a bad request."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tpmscad import fields
from tpmscad.kernel.measure.shape_report import check_shape

pytestmark = pytest.mark.kernel

MAX_LINES = 10
MAX_CHARACTERS = 400  # of a line: messages of errors are shown whole


def blend() -> Any:
    rods = [fields.rod(fields.tpms(name, 10), 0.0) for name in ("gyroid", "P")]
    halves = [fields.box((0, 0, 0), (9, 10, 10)), fields.box((11, 0, 0), (20, 10, 10))]
    return tpmscad.blend(rods, halves, [fields.box((9, 0, 0), (11, 10, 10))], resolution=(21, 11, 11), progress=False)


def sweep() -> Any:
    rows = [{"surface": "P", "cell": 4, "thickness": t, "tol": 0.2} for t in (0.5, *range(9, 21))]
    return tpmscad.sweep(rows, output=Path("results.csv"), progress=False)


MAKERS: dict[str, Callable[[], Any]] = {
    "blend": blend,
    "sweep": sweep,
    "report": lambda: check_shape(bd.Box(1, 2, 3)),
    "metrics": lambda: tpmscad.measure(bd.Box(1, 2, 3)),
    "print check": lambda: tpmscad.check_print(bd.Box(1, 2, 3)),
    "model": lambda: tpmscad.lattice("P", cell=4, thickness=0.5, tol=0.2),
    "derivatives": lambda: tpmscad.design_derivatives("P", thickness=0.05, elastic=False),
}


@pytest.mark.parametrize("name", MAKERS)
def test_a_result_prints_in_a_few_lines(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = MAKERS[name]()
    for text in (repr(result), str(result)):
        assert len(text.splitlines()) <= MAX_LINES
        assert max(map(len, text.splitlines())) <= MAX_CHARACTERS
        assert "object at 0x" not in text


def test_a_sweep_is_a_table_in_notebooks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    html = sweep()._repr_html_()
    assert html.count("<tr>") == 14
    assert "<th>volume</th>" in html
    assert "<th>E1</th>" not in html
    assert "{" not in html


def test_the_traceback_of_a_bad_request_ends_at_the_call() -> None:
    with pytest.raises(tpmscad.InvalidRequest) as caught:
        tpmscad.lattice("gyroid", cell=10, thickness=20)
    frames = traceback.extract_tb(caught.value.__traceback__)
    assert Path(frames[0].filename).name == Path(__file__).name
    assert len(frames) == 2
    assert caught.value.__context__ is None


def test_the_cause_in_a_function_of_the_caller_is_kept() -> None:
    def field(points: np.ndarray) -> np.ndarray:
        raise ZeroDivisionError("at the origin")

    with pytest.raises(tpmscad.TpmscadError) as caught:
        tpmscad.solidify(field, ((0, 0, 0), (1, 1, 1)), tol=0.1)
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
