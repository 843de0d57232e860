"""Workplane.struts: it puts what tpmscad.struts makes at the points of a chain."""

from __future__ import annotations

import inspect
from typing import Any

import pytest

import tpmscad

pytestmark = [pytest.mark.kernel, pytest.mark.frontend]

BCC: dict[str, Any] = {"kind": "bcc", "cell": (8, 9, 10), "diameter": 1}


@pytest.fixture(scope="module")
def cq() -> Any:
    """CadQuery with the plug-in; imported here, as tests are collected without it too."""
    import cadquery

    import cq_plugins.tpms  # noqa: F401

    return cadquery


@pytest.fixture(scope="module")
def bcc(cq: Any) -> Any:
    return cq.Workplane().struts(**BCC)


def corners(shape: Any) -> tuple[list[float], list[float]]:
    points = [v.toTuple() for v in shape.Vertices()]
    return [min(c) for c in zip(*points, strict=True)], [max(c) for c in zip(*points, strict=True)]


def test_the_keywords_are_those_of_struts_with_centered_combine_and_clean(cq: Any) -> None:
    ours = inspect.signature(cq.Workplane.struts).parameters
    theirs = inspect.signature(tpmscad.struts).parameters
    assert [*theirs, "centered", "combine", "clean"] == list(ours)[1:]
    assert all(ours[name].default == theirs[name].default and ours[name].kind == theirs[name].kind for name in theirs)


def test_the_stack_holds_the_lattice_and_the_chain_its_model(bcc: Any) -> None:
    (model,) = bcc.faces(">Z").tpmsModels()
    assert model.certificate.met
    assert bcc.val().isValid()
    assert bcc.solids().size() == 1
    assert bcc.val().Volume() == pytest.approx(model.certificate.volume, rel=1e-9)
    low, high = corners(bcc.val())
    assert low == pytest.approx([0, 0, 0], abs=1e-9)
    assert high == pytest.approx([8, 9, 10], abs=1e-9)


def test_every_point_gets_one_centred_along_the_axes_that_say_so(cq: Any) -> None:
    work = cq.Workplane().pushPoints([(0, 0), (30, 40)]).struts(**BCC, centered=(True, True, False), combine=False)
    lows = [corners(v)[0] for v in work.vals()]
    assert lows == [pytest.approx(low, abs=1e-9) for low in ([-4, -4.5, 0], [26, 35.5, 0])]


def test_it_joins_the_part_in_the_chain(cq: Any, bcc: Any) -> None:
    joined = cq.Workplane().box(10, 11, 2).faces(">Z").workplane().struts(**BCC, centered=(True, True, False))
    assert joined.val().isValid()
    assert joined.solids().size() == 1
    assert joined.val().Volume() == pytest.approx(10 * 11 * 2 + bcc.val().Volume(), rel=1e-6)


def test_what_cannot_be_made_is_refused_by_name(cq: Any) -> None:
    with pytest.raises(tpmscad.InvalidRequest, match="combine 'fuse' is none of"):
        cq.Workplane().struts(**BCC, combine="fuse")
    with pytest.raises(tpmscad.InvalidRequest, match="exactly one of diameter, volume_fraction and porosity"):
        cq.Workplane().struts("bcc", cell=10)
