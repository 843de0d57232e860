"""TpmsInfill in build123d: an operation on the part being built, or on the shape given, after which modelling goes on."""

from __future__ import annotations

import copy
import inspect
from typing import Any

import build123d as bd
import pytest

import tpmscad
from tpmscad.build123d import TpmsInfill

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

P: dict[str, Any] = {"cell": 10, "thickness": 1, "tol": 0.1}
BOLT = bd.Pos(1, 0.5, 0) * bd.Cylinder(2, 14)


@pytest.fixture(scope="module")
def filled() -> TpmsInfill:
    return TpmsInfill(bd.Cylinder(7, 12), "P", **P, clear=BOLT)


def test_the_keywords_are_those_of_infill_with_mode() -> None:
    _, body, surface, *ours = inspect.signature(TpmsInfill.__init__).parameters.values()
    assert (body.name, surface.name) == ("body", "surface")
    theirs = list(inspect.signature(tpmscad.infill).parameters.values())[2:]
    assert [*((p.name, p.default, p.kind) for p in theirs)] == [(p.name, p.default, p.kind) for p in ours[:-1]]
    assert (ours[-1].name, ours[-1].default) == ("mode", bd.Mode.REPLACE)


def test_it_holds_what_infill_makes(filled: TpmsInfill) -> None:
    model = tpmscad.infill(bd.Cylinder(7, 12), "P", **P, clear=BOLT)
    assert filled.is_valid
    assert not filled & BOLT
    assert filled.certificate.met
    assert filled.volume == pytest.approx(model.solid.volume, rel=1e-9)
    assert (filled.surface, filled.cell, filled.skin, filled.label) == ("P", 10, None, model.name)


def test_placing_keeps_the_certificate(filled: TpmsInfill) -> None:
    for placed in (bd.Pos(1, 2, 3) * filled, copy.deepcopy(filled)):
        assert placed.is_valid
        assert placed.certificate is filled.certificate
        assert placed.clear is BOLT


def test_in_a_builder_it_replaces_the_part_and_building_goes_on() -> None:
    with bd.BuildPart() as built:
        bd.Box(11, 11, 11)
        whole = TpmsInfill("P", **P, skin=1.0)
        bd.Hole(2)
        bd.fillet(built.edges().filter_by(bd.Axis.Z).sort_by(bd.Axis.X)[-1], 1)
        with bd.Locations((0, 0, -6)):
            bd.Cylinder(8, 2)
    assert built.part.is_valid
    assert len(built.part.solids()) == 1
    assert whole.certificate.betti[2] == 2


def test_faces_of_the_part_being_built_may_stay_open() -> None:
    with bd.BuildPart() as built:
        bd.Box(12, 11, 11)
        ends = built.faces().sort_by(bd.Axis.Z)
        whole = TpmsInfill("P", **P, skin=1.5, open_faces=[ends[0], ends[-1]])
    assert whole.open_faces == (ends[0], ends[-1])
    assert built.part.is_valid
    assert len(built.part.solids()) == len(built.part.shells()) == 1


def test_a_single_open_face_or_selector_needs_no_list() -> None:
    box = bd.Box(5, 5, 5)
    top = box.faces().sort_by(bd.Axis.Z)[-1]
    by_face, by_selector = (
        TpmsInfill(box, "P", cell=5, thickness=0.5, tol=0.1, skin=0.6, open_faces=f) for f in (top, ">Z")
    )
    assert by_face.open_faces == (top,)
    assert by_selector.open_faces == (">Z",)
    assert by_face.volume == pytest.approx(by_selector.volume, rel=1e-9)


def test_what_cannot_be_filled_is_refused() -> None:
    with pytest.raises(tpmscad.InvalidRequest, match="no part"), bd.BuildPart():
        TpmsInfill("P", **P)
    with pytest.raises(RuntimeError, match="BuildPart"), bd.BuildSketch():
        TpmsInfill(bd.Cylinder(7, 12), "P", **P)
