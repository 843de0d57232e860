"""Struts in build123d: a part object that holds what tpmscad.struts makes, aligned by the box of its cells."""

from __future__ import annotations

import copy
import inspect
from pathlib import Path
from typing import Any

import build123d as bd
import pytest

import tpmscad
from tpmscad.build123d import Struts

pytestmark = pytest.mark.kernel

BCC: dict[str, Any] = {"kind": "bcc", "cell": (8, 9, 10), "diameter": 1}


@pytest.fixture(scope="module")
def bcc() -> Struts:
    return Struts(**BCC)


def corners(part: bd.Shape) -> tuple[list[float], list[float]]:
    points = [tuple(v) for v in part.vertices()]
    return [min(c) for c in zip(*points, strict=True)], [max(c) for c in zip(*points, strict=True)]


def test_the_keywords_are_those_of_struts_with_rotation_align_and_mode() -> None:
    ours = inspect.signature(Struts).parameters
    theirs = inspect.signature(tpmscad.struts).parameters
    assert [*theirs, "rotation", "align", "mode"] == list(ours)
    assert all(ours[name].default == theirs[name].default and ours[name].kind == theirs[name].kind for name in theirs)


def test_the_part_is_the_lattice_about_the_origin(bcc: Struts) -> None:
    model = tpmscad.struts(**BCC)
    assert bcc.is_valid
    assert bcc.certificate.met
    assert bcc.label == bcc.model.name == "bcc struts"
    assert bcc.cell == (8, 9, 10)
    assert bcc.volume == pytest.approx(model.volume, rel=1e-7)
    low, high = corners(bcc)
    assert low == pytest.approx([-4, -4.5, -5], abs=1e-9)
    assert high == pytest.approx([4, 4.5, 5], abs=1e-9)
    assert {face.geom_type for face in bcc.faces()} == {bd.GeomType.CYLINDER, bd.GeomType.PLANE}


def test_it_is_aligned_before_it_is_rotated() -> None:
    part = Struts(**BCC, align=(bd.Align.MIN, bd.Align.CENTER, bd.Align.MAX), rotation=(0, 0, 90))
    low, high = corners(part)
    assert low == pytest.approx([-4.5, 0, -10], abs=1e-9)
    assert high == pytest.approx([4.5, 8, 0], abs=1e-9)


def test_placed_struts_are_written_where_they_are(bcc: Struts, tmp_path: Path) -> None:
    moved = copy.copy(bd.Pos(30, 0, 0) * bcc)
    assert moved.certificate is bcc.certificate
    moved.export(tmp_path / "bcc.step")
    read = bd.import_step(tmp_path / "bcc.step")
    assert read.volume == pytest.approx(bcc.volume, rel=1e-7)
    assert corners(read)[0] == pytest.approx([26, -4.5, -5], abs=1e-6)


def test_a_builder_joins_struts_and_a_plate(bcc: Struts) -> None:
    with bd.BuildPart() as built:
        with bd.Locations((0, 0, -6)):
            bd.Box(10, 11, 2)
        Struts(**BCC)
    assert built.part.is_valid
    assert len(built.part.solids()) == 1
    assert built.part.volume == pytest.approx(bcc.volume + 10 * 11 * 2, rel=1e-6)


def test_what_cannot_be_made_is_refused_by_name() -> None:
    with pytest.raises(tpmscad.InvalidRequest, match="exactly one of diameter, volume_fraction and porosity"):
        Struts("bcc", cell=10)
    with pytest.raises(TypeError, match=r"Struts takes kind by position .* Struts\(\"octet\", cell=10"):
        Struts("bcc", 10, 1)  # type: ignore[call-arg]
