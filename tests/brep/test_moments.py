"""Moments of faces against closed forms: a box of planes, a box of bilinear patches, any rigid motion, mirrors included."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.shapes.box_shapes import CORNERS, SIDES, plane_box
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import CylindricalSurface
from tpmscad.brep.moments import integral_properties
from tpmscad.brep.moments.loop_integrals import integrate_pcurves
from tpmscad.brep.welding import weld_patches
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, line_segment
from tpmscad.splines.knots import bezier_knots, restrict_surface

SIZE, IDENTITY, ORIGIN = np.array([2.0, 3.0, 5.0]), np.eye(3), np.zeros(3)


def patch_box(degree: int = 1) -> Brep:
    surfaces = []
    s, t = np.linspace(0, 1, degree + 1), np.linspace(0, 1, degree + 1)
    knots = np.repeat([0.0, 1.0], degree + 1)
    for side in SIDES:
        a, b, c, d = (CORNERS * SIZE)[side]
        poles = (
            np.multiply.outer(np.outer(1 - s, 1 - t), a)
            + np.multiply.outer(np.outer(s, 1 - t), b)
            + np.multiply.outer(np.outer(s, t), c)
            + np.multiply.outer(np.outer(1 - s, t), d)
        )
        surfaces.append(BSplineSurface(poles, knots, knots, degree, degree))
    n = len(surfaces)
    return weld_patches(surfaces, np.arange(n), Motion.identity(n), np.ones(n, int), np.zeros(n, int), ["box"])


def moments_of(
    surface: BSplineSurface, rotation: np.ndarray = IDENTITY, translation: np.ndarray = ORIGIN
) -> integral_properties.FaceMoments:
    """Moments of a whole surface as a face, placed."""
    one = np.ones(1, int)
    place = Motion(rotation[None], translation[None])
    return integral_properties.integrate_faces(weld_patches([surface], 0 * one, place, one, 0 * one, ["a"]))


MOTIONS = {
    "at rest": (IDENTITY, ORIGIN),
    "turned": (Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix(), np.array([0.4, -7.0, 2.5])),
    "mirrored": (np.diag([1.0, -1.0, 1.0]) @ Rotation.from_rotvec([1.3, 0.1, 0.2]).as_matrix(), np.array([1.0, 2, 3])),
}


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_box_of_planes_has_its_volume_area_and_centre_wherever_it_stands(motion: str) -> None:
    rotation, translation = MOTIONS[motion]
    moments = integral_properties.integrate_faces(plane_box(SIZE, rotation, translation))
    assert integral_properties.volume(moments)[0] == pytest.approx(30.0, rel=1e-13)
    assert moments.area.sum() == pytest.approx(62.0, rel=1e-13)
    np.testing.assert_allclose(
        integral_properties.centroid(moments), rotation @ (SIZE / 2) + translation, rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(moments.normal.sum(axis=0), 0, rtol=0, atol=1e-12)


@pytest.mark.parametrize("degree", [1, 2, 5])
def test_a_box_of_patches_equals_the_box_of_planes(degree: int) -> None:
    moments = integral_properties.integrate_faces(patch_box(degree))
    planar = integral_properties.integrate_faces(plane_box(SIZE))
    for name in ("area", "normal", "first", "second"):
        np.testing.assert_allclose(getattr(moments, name), getattr(planar, name), rtol=0, atol=1e-12)


@pytest.mark.parametrize("motion", MOTIONS)
def test_moments_of_moved_patches_are_those_of_patches_with_moved_poles(motion: str) -> None:
    rotation, translation = MOTIONS[motion]
    rng = np.random.default_rng(7)
    knots_u, knots_v = np.array([0, 0, 0, 0.4, 1, 1, 1]), np.array([0, 0, 0, 0, 1, 1, 1, 1.0])
    surface = BSplineSurface(rng.random((4, 4, 3)), knots_u, knots_v, 2, 3)
    placed = moments_of(surface, rotation, translation)
    baked = moments_of(surface.moved(Motion(rotation, translation)))
    for name in ("area", "normal", "first", "second"):
        np.testing.assert_allclose(getattr(placed, name), getattr(baked, name), rtol=1e-12, atol=1e-13)


def test_inner_knots_do_not_blur_the_quadrature() -> None:
    """The same bicubic-by-quadratic patch in one piece and cut along its inner knots."""
    rng = np.random.default_rng(5)
    knots_u, knots_v = np.array([0, 0, 0, 0.3, 0.7, 1, 1, 1]), np.array([0, 0, 0, 0, 0.45, 1, 1, 1, 1.0])
    surface = BSplineSurface(rng.random((5, 5, 3)), knots_u, knots_v, 2, 3)
    pieces = [restrict_surface(surface, u, v) for u in ((0, 0.3), (0.3, 0.7), (0.7, 1)) for v in ((0, 0.45), (0.45, 1))]
    whole, parts = moments_of(surface), [moments_of(p) for p in pieces]
    for name in ("normal", "first", "second"):
        np.testing.assert_allclose(
            getattr(whole, name), sum(getattr(p, name) for p in parts), rtol=0, atol=1e-14, err_msg=name
        )


def test_a_pcurve_of_any_degree_is_split_where_it_crosses_the_inner_knots_of_its_surface() -> None:
    """A straight pcurve has the same integrals in degree 1 and in degree 10; FITPACK's derivatives end at degree 5."""
    rng = np.random.default_rng(6)
    knots_u, knots_v = np.array([0, 0, 0, 0.3, 0.7, 1, 1, 1]), np.array([0, 0, 0, 0, 0.45, 1, 1, 1, 1.0])
    surface = BSplineSurface(rng.random((5, 5, 3)), knots_u, knots_v, 2, 3)
    ends = np.array([[0.1, 0.2], [0.9, 0.8]])
    straight = line_segment(*ends)
    elevated = BSplineCurve(ends[0] + np.linspace(0, 1, 11)[:, None] * (ends[1] - ends[0]), bezier_knots(10), 10)
    low, high = (integrate_pcurves(surface, [(curve, (0.0, 1.0))]) for curve in (straight, elevated))
    np.testing.assert_allclose(high, low, rtol=1e-12, atol=1e-14)


def test_a_face_within_a_large_spline_needs_no_integral_from_the_first_knot() -> None:
    """Moments of a rectangle of the parameter plane, from its loop, against those of the surface cut there."""
    rng = np.random.default_rng(7)
    knots = np.array([0, 0, 0, *np.linspace(0, 1, 9)[1:-1], 1, 1, 1])
    surface = BSplineSurface(rng.random((10, 10, 3)), knots, knots, 2, 2)
    (u0, u1), (v0, v1) = (0.4, 0.9), (0.2, 0.7)
    corners = np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]])
    loop = [(line_segment(a, b), (0.0, 1.0)) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    found = integrate_pcurves(surface, loop, np.full(4, 0.375)).sum(axis=0)
    expected = moments_of(restrict_surface(surface, (u0, u1), (v0, v1)))
    np.testing.assert_allclose(found[1:4], expected.normal[0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(found[4:13].reshape(3, 3), expected.first[0], rtol=0, atol=1e-14)
    np.testing.assert_allclose(found[13:], expected.second[0], rtol=0, atol=1e-14)


def test_a_box_is_one_closed_shell_of_a_sphere() -> None:
    for box in (patch_box(2), plane_box(SIZE)):
        assert connectivity.is_closed(box)
        count, shell = connectivity.label_shells(box)
        assert count == 1
        assert connectivity.euler_characteristic(box, shell).tolist() == [2]
        assert len(box.edges) == 12
        assert len(box.vertices) == 8


def test_a_missing_face_and_a_face_turned_over_are_noticed() -> None:
    box = patch_box()
    turned = box.faces.sense.copy()
    turned[2] = -1
    flipped = replace(box, faces=replace(box.faces, sense=turned))
    assert len(connectivity.find_unmatched_edges(flipped)) == 4


def test_a_loop_that_does_not_leave_the_patchs_first_column_measures_nothing() -> None:
    """Pieces that run along u = u0, where the integral begins, may be all that there is at once."""
    surface = patch_box().carriers[0]
    side = line_segment([0.0, 0.0], [0.0, 1.0])
    np.testing.assert_array_equal(integrate_pcurves(surface, [(side, (0.0, 1.0))]), 0.0)


def test_gaps_between_faces_count_alike_near_the_origin_and_far_from_it() -> None:
    """A face that is too large by 1e-8 has a volume and a centroid of the same error wherever the box is."""
    for place in (np.zeros(3), np.array([1e4, -3e3, 0.0])):
        moments = integral_properties.integrate_faces(plane_box(translation=tuple(place)))
        corner, normal, area = place + SIZE, np.array([1.0, 0.0, 0.0]), 1e-8
        moments.normal[0] += area * normal
        moments.first[0] += area * np.outer(corner, normal)
        moments.second[0] += area * (corner @ normal) * corner
        assert integral_properties.volume(moments)[0] == pytest.approx(SIZE.prod(), rel=1e-9)
        assert integral_properties.centroid(moments) == pytest.approx(place + SIZE / 2, abs=1e-8)


def test_the_volume_of_a_chip_far_from_the_origin_is_not_lost_in_gaps() -> None:
    """A gap of 2e-9 mm2 counts 4e-9 mm3 about the origin, seven times the volume of the chip."""
    size, place = np.array([3e-2, 3e-4, 6e-5]), np.array([-5.9, -3.3, -5.9])
    moments = integral_properties.integrate_faces(plane_box(tuple(size), translation=tuple(place)))
    normal, gap = np.array([0.0, 1.0, 0.0]), 2e-9
    moments.normal[0] += gap * normal
    moments.first[0] += gap * np.outer(place, normal)
    moments.second[0] += gap * (place @ normal) * place
    assert integral_properties.volume(moments)[0] == pytest.approx(size.prod(), rel=0.01)


def test_gaps_between_pcurves_on_a_quadric_count_as_little_as_the_face_is_small() -> None:
    """A triangle far round a cylinder, two of whose pcurves end 1e-8 apart: the gap counts times the face, not the turn."""
    gap, size, radius = 1e-8, 2e-3, 13.0
    cylinder = CylindricalSurface(np.zeros(3), np.array([0.0, 0, 1]), np.array([1.0, 0, 0]), radius)
    corner = np.array([4.3, -6.0])
    ends = [corner, corner + np.array([size, 0]), corner + size, corner + np.array([0, gap])]
    spans = [(line_segment(a, b), (0.0, 1.0)) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    area = integrate_pcurves(cylinder, spans, np.full(3, corner[0]))[:, 0].sum()
    assert area == pytest.approx(0.5 * radius * size**2, abs=2 * gap * radius * size)
    assert abs(integrate_pcurves(cylinder, spans)[:, 0].sum() - area) > 100 * gap * radius * size
