"""Betti numbers of solids that only touch, where they touch, and figures that no solid can have."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("OCP")

from tpmscad.brep.deviation import Deviation
from tpmscad.brep.edge_continuity import EdgeContinuity
from tpmscad.brep.solid_properties import SolidPiece, measure_solid
from tpmscad.kernel.body_import.body_brep import brep_from_shape
from tpmscad.kernel.boolean.solid_trees import SolidSet, combine_sets, list_solids, make_box_set, make_quadric_set
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.measure.solid_topology import measure_topology
from tpmscad.results.certificate import PatchMeasures, _certify, certify_kernel_solids
from tpmscad.trimming.operands.polyhedra import box

pytestmark = pytest.mark.kernel

LO, HI = np.full(3, -9.0), np.full(3, 9.0)
UNION, INTERSECTION = -1, +1
Triple = tuple[float, float, float]


def block(lo: Triple, hi: Triple, complement: bool = False) -> SolidSet:
    return SolidSet(make_box_set(np.array(lo), np.array(hi)).shape, complement)


def ball(x: float, radius: float, complement: bool = False) -> SolidSet:
    made = make_quadric_set("sphere", np.array([x, 0.0, 0.0]), np.zeros(3), radius, LO, HI, int(10 * radius))
    return SolidSet(made.shape, complement)


def bar(z: float, axis: Triple) -> SolidSet:
    made = make_quadric_set("cylinder", np.array([0.0, 0.0, z]), np.array(axis), 1.0, LO / 9, HI / 9, int(z + 2))
    return made


TOUCHING = {
    "balls from outside": (UNION, [ball(0, 3), ball(5, 2)], (2, 0, 0), ["point"]),
    "a ball from within": (INTERSECTION, [ball(0, 3), ball(1.5, 1.5, True)], (1, 0, 1), ["point"]),
    "a ball on a block": (UNION, [block((-1, -1, -1), (1, 1, 1)), ball(2.5, 1.5)], (2, 0, 0), ["point"]),
    "blocks at an edge": (UNION, [block((0, 0, 0), (1, 1, 1)), block((1, 1, 0.5), (2, 2, 3))], (2, 0, 0), ["edge"]),
    "blocks at a vertex": (UNION, [block((0, 0, 0), (1, 1, 1)), block((1, 1, 1), (2, 2, 2))], (2, 0, 0), ["point"]),
    "voids at a vertex": (
        INTERSECTION,
        [block((-1, -1, -1), (3, 3, 3)), block((0, 0, 0), (1, 1, 1), True), block((1, 1, 1), (2, 2, 2), True)],
        (1, 0, 2),
        ["point"],
    ),
    "dents at a vertex": (
        INTERSECTION,
        [block((0, 0, 0), (2, 2, 2)), block((-1, -1, -1), (1, 1, 1), True), block((1, 1, 1), (3, 3, 3), True)],
        (1, 0, 0),
        ["point"],
    ),
    "a cylinder on a block": (UNION, [block((-4, -4, -1), (4, 4, 0)), bar(1, (1, 0, 0))], (2, 0, 0), ["edge"]),
    "cylinders across": (UNION, [bar(1, (1, 0, 0)), bar(-1, (0, 1, 0))], (2, 0, 0), ["point"]),
    "balls apart": (UNION, [ball(0, 3), ball(5.1, 2)], (2, 0, 0), []),
    "balls that overlap": (UNION, [ball(0, 3), ball(4.9, 2)], (1, 0, 0), []),
}


@pytest.mark.parametrize("name", TOUCHING)
def test_solids_that_only_touch_count_as_apart_and_say_where(name: str) -> None:
    sign, sets, betti, kinds = TOUCHING[name]
    solids = list_solids(combine_sets(sign, sets).shape)
    found = measure_topology(solids)
    assert found.betti == betti
    assert [contact.kind for contact in found.contacts] == kinds
    assert all(euler <= 2 and euler % 2 == 0 for euler in found.euler)
    assert check_shape(solids[0]).closed
    certificate = certify_kernel_solids(solids, BOX.brep, MEASURES)
    assert certificate.met
    assert any("only touches itself" in note for note in certificate.notes) == bool(kinds)


def test_a_boundary_that_touches_itself_counts_as_opened_there() -> None:
    sign, sets, betti, _ = TOUCHING["dents at a vertex"]
    measured = measure_solid(brep_from_shape(combine_sets(sign, sets).shape))
    assert measured.betti == betti
    assert [contact.near for contact in measured.contacts] == [(1.0, 1.0, 1.0)]


BOX = build_solids(box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)))
SOUND = measure_solid(BOX.brep)
MEASURES = PatchMeasures(0.1, Deviation(0.0, 0.0, 0.0, 0.0), "field", EdgeContinuity(0.0, 0.0, 0.0, 0))
NAN = float("nan")


def certify(properties: dict[str, Any], measures: dict[str, Any]) -> Any:
    return _certify(
        BOX.brep,
        replace(SOUND, **properties),
        replace(MEASURES, **measures),
        valid=True,
        edge_gap=0.0,
        n_faces=6,
        checks=(),
        notes=(),
        dropped=(),
    )


def test_a_box_has_what_a_solid_can_have() -> None:
    assert certify({}, {}).met


@pytest.mark.parametrize(
    ("properties", "measures", "message"),
    [
        ({"volume": -6.0}, {}, "no solid has the volume -6"),
        ({"volume": NAN}, {}, "no solid has the volume nan"),
        ({"area": 15.0}, {}, "the area 15 is not that of a solid of volume 6"),
        ({"pieces": (SolidPiece(5.0, (0.0, 0.0, 0.0)),)}, {}, "more than that of all pieces"),
        ({"betti": (2, -1, 0)}, {}, "1 pieces and 1 shells do not have the Betti numbers"),
        ({"betti": (1, 1, 0)}, {}, "do not bound a solid with 1 tunnels"),
        ({"euler": (3,)}, {}, "Euler characteristics are 3 do not bound"),
        ({}, {"deviation": Deviation(0.0, NAN, 0.0, 0.0)}, "rms deviation cannot be nan"),
        ({}, {"continuity": EdgeContinuity(0.0, -1.0, 0.0, 0)}, "tangent_jump_deg across edges cannot be -1"),
        ({}, {"bounds": {"of the deviation": -1.0}}, "the bound of the deviation cannot be -1"),
        ({}, {"figures": {"volume of the field": NAN}}, "volume of the field is not known"),
    ],
)
def test_figures_that_no_solid_can_have_are_shortfalls(
    properties: dict[str, Any], measures: dict[str, Any], message: str
) -> None:
    certificate = certify(properties, measures)
    assert not certificate.met
    assert any(message in shortfall for shortfall in certificate.shortfalls), certificate.shortfalls
