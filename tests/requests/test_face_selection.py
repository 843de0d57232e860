"""Selectors of faces: the plane faces at one end of an axis, however many there are, and nothing else."""

from __future__ import annotations

from typing import Any

import pytest

bd = pytest.importorskip("build123d")

from tpmscad.kernel.body_import.cad_body import read_body  # noqa: E402
from tpmscad.kernel.occt.exploration import faces_of  # noqa: E402
from tpmscad.requests.face_selection import resolve_face_selectors  # noqa: E402

pytestmark = pytest.mark.kernel

BOX = bd.Pos(1, 2, 3) * bd.Box(7, 5, 3)
TWO_FEET = bd.Box(10, 4, 2) + bd.Pos(-4, 0, -2) * bd.Box(2, 4, 2) + bd.Pos(4, 0, -2) * bd.Box(2, 4, 2)


@pytest.mark.parametrize("axis", "XYZ")
@pytest.mark.parametrize("sign", "<>")
def test_a_selector_finds_the_faces_that_build123d_finds(axis: str, sign: str) -> None:
    for shape in (BOX, TWO_FEET):
        body = read_body(shape)
        centers = [bd.Face(face).center() for face in faces_of(body.shape)]
        heights = [getattr(center, axis) * (1 if sign == ">" else -1) for center in centers]
        expected = [k for k, height in enumerate(heights) if height > max(heights) - 1e-6]
        assert list(resolve_face_selectors(body, [f"{sign}{axis}"])) == expected
    assert len(resolve_face_selectors(read_body(TWO_FEET), ["<z"])) == 2


def test_numbers_and_faces_pass_and_a_single_selector_needs_no_list() -> None:
    body = read_body(BOX)
    top = resolve_face_selectors(body, ">Z")
    assert resolve_face_selectors(body, (4, ">Z")) == (4, *top)
    face = object()
    assert resolve_face_selectors(body, (face,)) == resolve_face_selectors(body, face) == (face,)
    assert resolve_face_selectors(body, 4) == (4,)


@pytest.mark.parametrize(
    ("selection", "count"),
    [
        (">Z", 1),
        (">z,<Z", 2),
        ("|Z", 2),
        ("#Z", 6),
        ("+X", 2),
        ("-X or >Z", 2),
        (["|Y", 6, "0"], 4),
        ("0, 2", 2),
        (3, 1),
    ],
)
def test_faces_are_selected_by_place_direction_and_number(selection: Any, count: int) -> None:
    ell = bd.extrude(bd.Polygon((0, 0), (20, 0), (20, 10), (10, 10), (10, 20), (0, 20)), 8)
    body = read_body(ell)
    assert len(set(resolve_face_selectors(body, selection))) == count
