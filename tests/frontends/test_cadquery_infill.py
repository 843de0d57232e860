"""Workplane.tpmsInfill: the solid on the stack is filled, and the chain goes on."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import pytest

import tpmscad
from tests.frontends.test_cadquery import cq

pytestmark = [pytest.mark.kernel, pytest.mark.frontend, pytest.mark.slow]

__all__ = ["cq"]

P: dict[str, Any] = {"surface": "P", "cell": 10, "thickness": 1, "tol": 0.1}


@pytest.fixture(scope="module")
def filled(cq: Any) -> Any:
    return cq.Workplane().cylinder(12, 7).tpmsInfill(**P)


def test_the_keywords_are_those_of_infill(cq: Any) -> None:
    ours = list(inspect.signature(cq.Workplane.tpmsInfill).parameters.values())[1:]
    theirs = list(inspect.signature(tpmscad.infill).parameters.values())[1:]
    theirs = [p for p in theirs if p.name not in ("solid", "box")]  # which choose in a file, and bound a field
    assert [(p.name, p.default, p.kind) for p in ours[:-1]] == [(p.name, p.default, p.kind) for p in theirs]
    assert (ours[-1].name, ours[-1].default) == ("combine", True)


def test_solids_are_kept_and_cleared(cq: Any) -> None:
    two, bar = cq.Workplane().pushPoints([(3.3, 0.2), (-3.1, 0.1)]), cq.Workplane(origin=(0.3, 0.2, 0.1)).box(3, 20, 3)
    bolts = two.cylinder(14, 1, combine=False)
    made = cq.Workplane().cylinder(12, 7).tpmsInfill(**P, keep=bar, clear=bolts).val()
    assert made.intersect(bar.val()).Volume() == pytest.approx(180, rel=1e-6)
    assert made.intersect(bolts.combine().val()).Volume() == pytest.approx(0.0, abs=1e-6)
    with pytest.raises(tpmscad.InvalidRequest, match="2 are on the stack: fill them one at a time"):
        two.box(4, 4, 4, combine=False).tpmsInfill(**P, clear=bolts)


def test_the_stack_holds_the_filled_solid(cq: Any, filled: Any) -> None:
    model = tpmscad.infill(cq.Workplane().cylinder(12, 7), **P)
    assert filled.size() == 1
    assert filled.val().isValid()
    assert filled.val().Volume() == pytest.approx(model.solid.volume, rel=1e-9)
    assert filled.faces("%CYLINDER").size() > 0
    top = filled.faces(">Z")
    assert [f.Center().z for f in top.vals()] == pytest.approx([6.0] * top.size())
    assert filled.end().size() == 1


def test_the_chain_goes_on(cq: Any, tmp_path: Path) -> None:
    part = (
        cq.Workplane()
        .box(14, 14, 12)
        .tpmsInfill(**P, skin=1.0)
        .faces(">Z")
        .workplane()
        .hole(4)
        .edges("|Z and >(1, 1, 0)")
        .fillet(1)
        .union(cq.Workplane(origin=(0, 0, -7)).cylinder(2, 10))
    )
    assert part.val().isValid()
    assert part.solids().size() == 1
    cq.exporters.export(part, str(tmp_path / "part.step"))
    cq.Assembly().add(part, name="core", loc=cq.Location((1, 2, 3))).export(str(tmp_path / "assembly.step"))
    assert tpmscad.check_step(tmp_path / "part.step").ok
    assert tpmscad.check_step(tmp_path / "assembly.step").ok


def test_faces_that_stay_open_may_be_selected(cq: Any) -> None:
    block = cq.Workplane().box(20, 16, 14)
    part = block.tpmsInfill(**P, skin=1.5, open_faces="<Z or >Z")
    assert part.val().isValid()
    assert part.solids().size() == part.shells().size() == 1
    again = block.tpmsInfill(**P, skin=1.5, open_faces=block.faces("<Z or >Z").vals())
    assert again.val().Volume() == pytest.approx(part.val().Volume(), rel=1e-9)


def test_what_cannot_be_filled_is_refused(cq: Any) -> None:
    with pytest.raises(tpmscad.InvalidRequest, match="holds no solid"):
        cq.Workplane().rect(20, 20).tpmsInfill(**P)
    for selector, message in ((">Q", "no selector of faces"), ("%CONE", "selects no face")):
        with pytest.raises(tpmscad.InvalidRequest, match=message):
            cq.Workplane().box(20, 20, 20).tpmsInfill(**P, skin=1, open_faces=selector)


def test_every_solid_on_the_stack_is_filled(cq: Any) -> None:
    boxes = cq.Workplane().rarray(30, 1, 2, 1).box(12, 12, 12)
    combined = boxes.tpmsInfill(**P)
    assert (combined.size(), combined.solids().size()) == (1, 2)
    apart = boxes.solids().tpmsInfill(**P, skin=1.5, open_faces=">Z", combine=False)
    assert apart.size() == 2
    models = apart.tpmsModels()
    assert [solid.Volume() for solid in apart.vals()] == pytest.approx([m.certificate.volume for m in models], rel=1e-9)
    assert [solid.Center().x < 0 for solid in apart.vals()] == [True, False]
