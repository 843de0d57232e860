"""Unions and intersections of exact solids and complements, and the edges at which faces meet."""

from __future__ import annotations

from dataclasses import astuple
from itertools import product

import numpy as np
import pytest

pytest.importorskip("OCP")

import build123d as bd
from OCP.TopoDS import TopoDS_Shape

from tpmscad import fields
from tpmscad.kernel.boolean.solid_trees import (
    SolidSet,
    combine_sets,
    group_apart,
    list_solids,
    make_box_set,
    make_quadric_set,
)
from tpmscad.kernel.boolean.sphere_frames import ACROSS, SKEW, choose_sphere_frame
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.creases import measure_creases
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import solids_of
from tpmscad.solids.matter.strut_boundaries import bound_struts_in_box

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


def segment(distance: float) -> float:
    """Area of the part of a disc of radius 0.5 beyond a chord."""
    return 0.25 * np.arccos(2 * distance) - distance * np.sqrt(0.25 - distance**2)


@pytest.mark.parametrize(
    ("point", "axis", "volume"),
    [
        ((0, 4, 7), (0, 0, 1), np.pi / 16 * 4),  # along an edge of the box, a quarter of it inside
        ((9, -0.3, 2), (1, 0, 0), segment(0.3) * 4),  # the axis misses the box
        ((4.2, 9, 2), (0, -1, 0), segment(0.2) * 4),
        ((1, 1, 2), (1, 1, 0), np.pi / 4 * np.sqrt(32) - 2 * 2 / 3 * 0.5**3 * 2),  # less two corners
    ],
)
def test_cylinders_reach_through_the_box_and_no_farther_than_they_must(
    point: tuple[float, ...], axis: tuple[float, ...], volume: float
) -> None:
    direction = np.array(axis) / np.linalg.norm(axis)
    found = make_quadric_set("cylinder", np.array(point, float), direction, 0.5, LO, HI, 3)
    assert sum(check_shape(each).volume for each in list_solids(within_box(found))) == pytest.approx(volume, rel=1e-8)
    assert np.abs(np.array(enclosing_box(found.shape)) - MIDDLE).max() < 4


def test_the_seam_of_a_sphere_is_crossed_by_nothing_if_it_can_be() -> None:
    """Corners of a box cut the ball three times: edges that end on the seam would be read on the wrong side of it."""
    centre, radius = np.array([1.0, 1.2, 0.9]), 1.5
    t = np.linspace(0, np.pi, 500)[:, None]

    def cuts(frame: tuple[np.ndarray, np.ndarray]) -> int:
        seam = centre + radius * (np.cos(t) * frame[0] + np.sin(t) * frame[1])
        return int(np.count_nonzero(np.diff(np.sign(seam), axis=0)))

    poles, across = choose_sphere_frame(centre, radius, lambda points: points.T)
    assert poles @ across == pytest.approx(0)
    assert cuts((poles, across)) == 0
    assert cuts((np.array(SKEW), np.array(ACROSS))) > 0


def test_shapes_of_a_group_are_apart() -> None:
    struts = [
        make_quadric_set("cylinder", np.array(at, float), np.array(axis, float), 0.2, LO, HI, k).shape
        for k, (at, axis) in enumerate(product([(1, 1, 1), (3, 3, 3)], np.eye(3)))
    ]
    groups = group_apart(struts)
    assert [len(solids_of(group)) for group in groups] == [2, 2, 2]
    volume = check_shape(list_solids(within_box(combine_sets(-1, [SolidSet(s) for s in struts])))[0]).volume
    # three tubes of a node less what they share: 16/3 r^3 each two of them, 8 (2 - sqrt 2) r^3 all three
    node = 3 * np.pi * 0.04 * 4 - (3 * 16 / 3 - 8 * (2 - np.sqrt(2))) * 0.2**3
    assert volume == pytest.approx(node, rel=1e-8)


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


@pytest.mark.parametrize("tilt_deg", [20.0, 50.0])
def test_the_sharpest_wedge_is_found_along_an_edge(tilt_deg: float) -> None:
    tilt = np.radians(tilt_deg)
    rod = make_quadric_set("cylinder", MIDDLE, UP, 0.5, LO, HI, 0)
    plane = make_quadric_set("plane", MIDDLE, np.array([np.sin(tilt), 0.0, np.cos(tilt)]), 0.0, LO, HI, 1)
    found = measure_creases(list_solids(within_box(combine_sets(+1, [rod, plane]))))
    assert found.sharpest_deg == pytest.approx(90 - tilt_deg, abs=1e-3)


def test_smooth_joints_are_no_creases() -> None:
    slot = bd.extrude(bd.SlotOverall(6, 2), 1).solid().wrapped
    assert measure_creases([slot]).count == 8  # two ends of four edges each; the four seams between them are smooth


def test_creases_by_classes_of_edges_are_those_of_all_edges() -> None:
    field = fields.strut_lattice("octet", 10.0, 1.0, (2, 2, 1))
    box = np.zeros(3), np.array([20.0, 20, 10])
    built = build_solids(bound_struts_in_box(field, *box))
    by_classes, one_by_one = (measure_creases(of, box) for of in (built, built.solids))
    np.testing.assert_allclose(astuple(by_classes), astuple(one_by_one), rtol=1e-9)
