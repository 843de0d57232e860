"""Bad and odd parts: each a clear error, or a valid solid; nothing written on an error."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import build123d as bd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tpmscad

pytestmark = pytest.mark.kernel

P: dict[str, Any] = {"surface": "P", "cell": 10, "thickness": 1, "tol": 0.1}


def open_box() -> bd.Shell:
    return bd.Shell(bd.Box(12, 12, 12).faces()[:5])


BODIES: dict[str, tuple[Any, str]] = {
    "a face": (lambda: bd.Face.make_rect(20, 20), "holds no solid"),
    "an open shell": (open_box, "holds no solid"),
    "a number": (lambda: 3.0, "no body"),
}


@pytest.mark.parametrize("name", BODIES)
def test_what_is_no_body_is_refused(name: str) -> None:
    make, words = BODIES[name]
    with pytest.raises(tpmscad.InvalidRequest, match=words):
        tpmscad.infill(make(), **P)


def test_files_that_hold_no_body_are_refused(tmp_path: Path) -> None:
    (tmp_path / "note.step").write_text("not a STEP file")
    bd.export_step(bd.Compound([bd.Face.make_rect(20, 20)]), tmp_path / "face.step")
    for name, words in (("none.step", "no file"), ("note.step", "not a STEP file"), ("face.step", "no solid")):
        with pytest.raises(tpmscad.InvalidRequest, match=words):
            tpmscad.infill(tmp_path / name, **P)


def test_a_body_where_no_lattice_is_is_refused() -> None:
    rods = {"surface": "P", "cell": 10, "kind": "skeletal", "offset": -1.5, "tol": 0.1}
    with pytest.raises(tpmscad.InvalidRequest, match="no lattice"):
        tpmscad.infill(bd.Pos(0, 0, 0) * bd.Box(12, 0.4, 0.4), **rods)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"cell": -1}, "cell"),
        ({"thickness": None}, "exactly one"),
        ({"thickness": 20}, "thickness"),
        ({"rotation": "xyz"}, "rotation"),
        ({"skin": (1, 1)}, "skin"),
        ({"surface": "gyroidd"}, "gyroid"),
        ({"skin": float("inf")}, "skin"),
    ],
)
def test_what_cannot_be_had_is_refused_by_name(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(tpmscad.InvalidRequest, match=words):
        tpmscad.infill(bd.Box(14, 13, 12), **(P | changed))


odd = st.one_of(st.floats(0.5, 20), st.sampled_from([0.0, -1.0, float("nan"), 1e-9, 1e12]))


@settings(max_examples=12, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
@given(size=st.tuples(odd, odd, odd), cell=odd, thickness=odd, skin=st.one_of(st.none(), odd))
def test_any_box_any_cell_any_wall_any_skin(
    size: tuple[float, float, float], cell: float, thickness: float, skin: float | None
) -> None:
    try:
        body = bd.Box(*size)
    except Exception:  # build123d's own refusal of such a box
        return
    try:
        model = tpmscad.infill(body, "P", cell=max(cell, 6.0), thickness=thickness, skin=skin)
    except tpmscad.TpmscadError:
        return
    assert model.certificate.valid
    assert 0 < model.certificate.volume <= body.volume * (1 + 1e-9)
