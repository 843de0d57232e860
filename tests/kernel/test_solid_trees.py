"""Unions and intersections of exact solids and complements, and the edges at which faces meet."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("OCP")

import build123d as bd
from OCP.TopoDS import TopoDS_Shape

from tpmscad.kernel.boolean.solid_trees import SolidSet, combine_sets, list_solids, make_box_set, make_quadric_set
from tpmscad.kernel.measure.creases import measure_creases
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.construction import make_compound

pytestmark = pytest.mark.kernel

LO, HI = np.zeros(3), np.full(3, 4.0)
MIDDLE, UP = np.full(3, 2.0), np.array([0.0, 0.0, 1.0])
BALL = 4 / 3 * np.pi


def ball(x: float, number: int) -> SolidSet:
    return make_quadric_set("sphere", np.array([x, 2.0, 2.0]), np.zeros(3), 1.0, LO, HI, number)


def complement(of: SolidSet) -> SolidSet:
    return SolidSet(of.shape, not of.complement)


def within_box(of: SolidSet) -> TopoDS_Shape:
    return combine_sets(+1, [of, make_box_set(LO, HI)]).shape


LENS = np.pi * (4 + 0.8) * (2 - 0.8) ** 2 / 12
HALF = make_quadric_set("plane", MIDDLE, UP, 0.0, LO, HI, 5)
PAIR = ball(1.6, 0), ball(2.4, 1)


@pytest.mark.parametrize(
    ("found", "volume"),
    [
        (combine_sets(-1, PAIR), 2 * BALL - LENS),
        (combine_sets(+1, PAIR), LENS),
        (combine_sets(+1, [PAIR[0], complement(PAIR[1])]), BALL - LENS),
        (combine_sets(+1, [complement(each) for each in PAIR]), 64 - 2 * BALL + LENS),
        (combine_sets(-1, [PAIR[0], complement(PAIR[1])]), 64 - BALL + LENS),
        (combine_sets(+1, [*PAIR, HALF]), LENS / 2),
        (combine_sets(-1, [*PAIR, complement(HALF)]), 32 + BALL - LENS / 2),
        (make_quadric_set("cylinder", MIDDLE, UP, 1.5, LO, HI, 2), np.pi * 1.5**2 * 4),
    ],
)
def test_every_combination_has_the_volume_of_its_sets(found: SolidSet, volume: float) -> None:
    report = check_shape(make_compound(list_solids(within_box(found))))
    assert report.ok
    assert report.volume == pytest.approx(volume, rel=1e-8)


def test_sets_that_do_not_meet_leave_nothing() -> None:
    apart = combine_sets(+1, [ball(1.0, 0), ball(3.5, 1)])
    assert list_solids(within_box(apart)) == ()


def test_creases_of_a_prism_are_its_edges_and_the_sharpest_wedge_is_its_corner() -> None:
    corners = [(0, 0), (3, 0), (3, 4)]
    prism = bd.extrude(bd.make_face(bd.Polyline(*corners, close=True)), 2).solid().wrapped
    found = measure_creases([prism])
    assert found.count == 9
    assert found.length == pytest.approx(2 * 12 + 3 * 2)
    assert found.shortest == pytest.approx(2)
    assert found.sharpest_deg == pytest.approx(np.degrees(np.arctan2(3, 4)))
    assert (found.inner_curves, found.inner_length) == (9, pytest.approx(30))
    open_box = measure_creases([prism], (np.zeros(3), np.array([5.0, 9.0, 9.0])))
    # the foot, and edges in x = 0 and y = 0, lie in sides of the box; at the corner that is left three edges meet
    assert (open_box.inner_curves, open_box.inner_length) == (3, pytest.approx(2 + 4 + 5))


def test_a_concave_edge_is_a_wedge_of_more_than_half_a_turn() -> None:
    found = measure_creases(list_solids(within_box(combine_sets(-1, PAIR))))
    assert found.sharpest_deg == pytest.approx(180 + 2 * np.degrees(np.arcsin(0.4)), abs=1e-4)
    assert found.length == pytest.approx(2 * np.pi * np.sqrt(1 - 0.16), rel=1e-6)


def test_smooth_joints_are_no_creases() -> None:
    slot = bd.extrude(bd.SlotOverall(6, 2), 1).solid().wrapped
    assert measure_creases([slot]).count == 8  # two ends of four edges each; the four seams between them are smooth
