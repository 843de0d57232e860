"""Eroded bodies as arrangements of offset faces: closed forms, the coarea law, validity, and the depth of their boundaries."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import build123d as bd
import numpy as np
import pytest
from manifold3d import CrossSection, JoinType

from benchmarks.cores import make_wing
from benchmarks.small_bodies import FREE_FORM_BODIES
from tests.shapes.misfits import volume
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.connectivity import find_unmatched_edges, label_shells
from tpmscad.brep.foot_surface import find_point_sides
from tpmscad.brep.moments import integral_properties
from tpmscad.erosion.eroded_body import erode_body
from tpmscad.erosion.sheets import make_tube
from tpmscad.kernel.body_import.body_brep import read_free_form_body
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.measure.skin_depth import SkinDepth, measure_skin_thickness
from tpmscad.kernel.occt.exploration import faces_of, solids_of, unwrap
from tpmscad.solids.skins.offset_skin import GREATEST_TURN
from tpmscad.splines.bspline import BSplineSurface, line_segment

pytestmark = pytest.mark.kernel

PI = np.pi


def eroded(body: Any, skin: float) -> Brep:
    """The part of a body deeper than a skin."""
    read = read_free_form_body(read_body(body).shape, greatest_turn=GREATEST_TURN)
    return erode_body(read.brep, read.free_form, skin)


def area(brep: Brep) -> float:
    return float(integral_properties.integrate_faces(brep).area.sum())


def assert_valid_and_deep(body: Any, brep: Brep, skin: float, solids: int = 1) -> None:
    """Valid by the kernel's full check, the number of solids, and by its distances nowhere thinner or thicker than the skin."""
    assert len(find_unmatched_edges(brep)) == 0
    made = build_solids(brep).solids
    assert len(made) == solids
    assert all(check_shape(solid).valid for solid in made)
    depth = SkinDepth(solids_of(unwrap(body))[0], faces_of(unwrap(body)))
    measured = measure_skin_thickness([face for solid in made for face in faces_of(solid)], depth)
    assert measured.least == pytest.approx(skin, rel=1e-6)
    assert measured.greatest == pytest.approx(skin, rel=1e-6)


def pocketed() -> bd.Part:
    """A blind pocket: four concave edges and four corners at its bottom."""
    return bd.Box(30, 26, 22) - bd.Pos(0, 0, 6) * bd.Box(12, 10, 12)


def pocketed_volume(t: float) -> float:
    """What is left of it: beside the pocket and below it, without the quarter tubes and eighths of balls round its edges."""
    height = 11 - t
    round_edges = PI * t**2 / 4 * (2 * (12 + 10) + 4 * height) + 2 / 3 * PI * t**3
    pocket = 12 * 10 * height + 2 * t * (12 + 10) * height + 12 * 10 * t + round_edges
    return (30 - 2 * t) * (26 - 2 * t) * (22 - 2 * t) - pocket


def boss() -> bd.Part:
    """A boss on a plate: the tubes round two of its concave edges are tangent at each of its corners."""
    return bd.Box(16, 16, 4) + bd.Pos(0, 0, 3.5) * bd.Box(5, 4, 3)


def boss_volume(t: float) -> float:
    """Plate, boss, and what is over the plate beside the boss: t^2 less a quarter disc along its sides, and its corners."""
    a, b = 5 - 2 * t, 4 - 2 * t
    beside = 2 * (a + b) * (1 - PI / 4) * t**2 + 4 * (5 / 3 - PI / 2) * t**3
    return (16 - 2 * t) ** 2 * (4 - 2 * t) + 3 * a * b + beside


def bored_volume(t: float) -> float:
    return float(((20 - 2 * t) * (18 - 2 * t) - PI * (3 + t) ** 2) * (16 - 2 * t))


def ellipse_perimeter(a: float, b: float) -> float:
    angle = 2 * PI * (np.arange(400) + 0.5) / 400
    return float(np.hypot(a * np.sin(angle), b * np.cos(angle)).mean() * 2 * PI)


def parallel_ellipse_volume(t: float) -> float:
    """Steiner's formula for the inner parallel curve of an ellipse, without folds up to b^2 / a = 1.48."""
    a, b = 3.9, 2.4
    return (PI * a * b - ellipse_perimeter(a, b) * t + PI * t**2) * (5 - 2 * t)


def folded_ellipse_volume(t: float) -> float:
    """Beyond that the parallel curve crosses itself on the long axis: the area on one side of the axis, up to the crossing."""
    a, b = 3.9, 2.4

    def point(s: np.ndarray) -> np.ndarray:
        normal = np.stack([b * np.cos(s), a * np.sin(s)]) / np.hypot(b * np.cos(s), a * np.sin(s))
        return np.stack([a * np.cos(s), b * np.sin(s)]) - t * normal

    crossing = float(np.arcsin(np.sqrt(((t * a / b) ** 2 - b**2) / (a**2 - b**2))))
    x, w = np.polynomial.legendre.leggauss(60)
    half = 0.5 * (PI / 2 - crossing)
    nodes, weights = crossing + half * (x + 1), half * w
    step = 1e-6
    slope = (point(nodes + step) - point(nodes - step))[0] / (2 * step)
    return float(-4 * (point(nodes)[1] * slope * weights).sum()) * (5 - 2 * t)


CLOSED_FORMS: dict[str, tuple[Callable[[], Any], Callable[[float], float], tuple[float, ...]]] = {
    "box": (lambda: bd.Box(7, 6, 5), lambda t: (7 - 2 * t) * (6 - 2 * t) * (5 - 2 * t), (0.3, 2.4)),
    "sphere": (lambda: bd.Sphere(4), lambda t: 4 / 3 * PI * (4 - t) ** 3, (0.5, 3.6)),
    "torus": (lambda: bd.Torus(9, 4), lambda t: 2 * PI**2 * 9 * (4 - t) ** 2, (0.5, 3.5)),
    "cone": (
        lambda: bd.Cone(14, 0, 30),
        lambda t: PI / 3 * (14 / 30) ** 2 * (30 - t - t * np.hypot(14, 30) / 14) ** 3,
        (1.2, 7.0),
    ),
    "bored block": (lambda: bd.Box(20, 18, 16) - bd.Cylinder(3, 20), bored_volume, (0.7, 2.9)),
    "blind pocket": (pocketed, pocketed_volume, (0.83, 2.8)),
    "boss": (boss, boss_volume, (0.4, 1.1)),
    "elliptic prism": (FREE_FORM_BODIES["ellipse"], parallel_ellipse_volume, (1.2,)),
    "elliptic prism with folds": (FREE_FORM_BODIES["ellipse"], folded_ellipse_volume, (2.2,)),
}


@pytest.mark.parametrize("name", CLOSED_FORMS)
def test_an_eroded_body_has_its_closed_form_volume(name: str) -> None:
    make, expected, skins = CLOSED_FORMS[name]
    body = make()
    for skin in skins:
        brep = eroded(body, skin)
        assert volume(brep) == pytest.approx(expected(skin), rel=2e-7)
    assert_valid_and_deep(body, brep, skin)


def test_a_tube_that_ends_where_its_faces_are_tangent_has_a_pole_across_v() -> None:
    def inward(t: np.ndarray) -> np.ndarray:
        angle = np.array([np.zeros_like(t), 1.2 * (1 - t)])
        return np.stack([np.zeros_like(angle), np.sin(angle), -np.cos(angle)], axis=2)

    edge = line_segment(np.zeros(3), np.array([1.0, 0.0, 0.0]), (0.0, 1.0))
    sheet = make_tube(edge, (0.0, 1.0), (0, 1), inward, 0.1, 1.0).sheet
    assert isinstance(sheet.carrier, BSplineSurface)
    assert find_point_sides(sheet.carrier).tolist() == [False, False, True, False]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["turned", "blade"])
def test_the_volume_of_a_free_form_body_falls_with_the_skin_by_its_area(name: str) -> None:
    """The coarea law: -dV / dskin is the area of the boundary. It fails where a part is lost, or a surface is off."""
    body = FREE_FORM_BODIES[name]()
    skin, step = 0.5, 0.01
    middle, thinner, thicker = (eroded(body, s) for s in (skin, skin - step, skin + step))
    assert (volume(thinner) - volume(thicker)) / (2 * step) == pytest.approx(area(middle), rel=1e-4)
    assert_valid_and_deep(body, middle, skin)


def test_a_wing_of_one_face_round_its_leading_edge_is_eroded_as_its_section() -> None:
    skin, wing = 0.8, make_wing()
    outline = wing.edges().filter_by(bd.GeomType.BSPLINE)[0]
    polygon = np.array([(p.X, p.Y) for p in outline.positions(np.linspace(0, 1, 4001))])
    section = CrossSection([polygon[::-1]]).offset(-skin, JoinType.Round, circular_segments=512)
    assert volume(eroded(wing, skin)) == pytest.approx(section.area() * (30 - 2 * skin), rel=2e-6)


@pytest.mark.slow
def test_round_a_concave_edge_in_space_the_skin_is_as_thick_as_elsewhere() -> None:
    body = bd.Cylinder(9, 30) + bd.Rot(0, 90, 0) * bd.Pos(0, 0, 9) * bd.Cylinder(6, 18)
    assert_valid_and_deep(body, eroded(body, 1.0), 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("skin", [2.25, 2.3])
def test_edges_keep_off_the_tail_where_a_sheet_barely_crosses_itself(skin: float) -> None:
    """The skin is 1e-3 and more thicker than a radius of curvature of the spline; a step over the crossing leaves a wrong vertex.

    The crossing is one vertex with two places on the sheet, which loops run through without a step from one to the other.
    """
    body = FREE_FORM_BODIES["cam"]()
    assert_valid_and_deep(body, eroded(body, skin), skin)


def test_edges_end_at_the_corner_of_a_boss_that_stands_over_a_countersink() -> None:
    """The skin is 1/84 of the boss's radius; the two tubes at the corner are tangent to each other there."""
    up = (bd.Align.CENTER, bd.Align.CENTER, bd.Align.MIN)
    boss = bd.Cylinder(23.4, 5.6, align=up)
    bore, countersink = (
        bd.Pos(22, 0, z) * shape
        for z, shape in ((0, bd.Cylinder(8, 6, align=up)), (3.5, bd.Cone(8, 8.5, 0.5, align=up)))
    )
    body = bd.Cylinder(31.8, 4, align=up) + boss - bore - (countersink - boss)
    assert_valid_and_deep(body, eroded(body, 0.279), 0.279)


def test_a_bore_thicker_than_what_is_beside_it_leaves_two_parts() -> None:
    body = bd.Box(30, 24, 18) - bd.Rot(90, 0, 0) * bd.Cylinder(5, 40)
    brep = eroded(body, 2.6)
    assert label_shells(brep)[0] == 2
    assert_valid_and_deep(body, brep, 2.6, solids=2)


def test_nothing_is_deeper_than_half_the_least_width() -> None:
    assert len(eroded(bd.Box(7, 6, 5), 2.6).faces) == 0
    assert len(eroded(FREE_FORM_BODIES["ellipse"](), 2.45).faces) == 0
