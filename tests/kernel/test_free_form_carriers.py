"""Free-form faces of the kernel as carriers: parameters, error, poles, seams, continuation, and feet against the kernel's."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("OCP")

import build123d as bd
from OCP.BRep import BRep_Tool
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
from OCP.BRepTools import BRepTools

from benchmarks.foot_points import FACES, kernel_distances, points_beside, side_faces
from tpmscad._typing import Array
from tpmscad.brep.foot_surface import find_point_sides
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.kernel.body_import.free_form_carriers import ConvertedSurface, convert_free_form
from tpmscad.kernel.occt.bounding_boxes import box_diagonal
from tpmscad.kernel.recognise.edge_curves import UnsupportedFace, fit_pcurve
from tpmscad.splines.bspline import BSplineSurface, line_segment

pytestmark = pytest.mark.kernel

FITTED = {
    "elbow, sweep": (9, 9),
    "blend, rational": (9, 9),
    "ellipsoid, two poles": (9, 9),
    "handle, revolution": (9, 3),
}
"""Degrees of carriers that are no copies of the kernel's poles."""


@pytest.fixture(params=FACES, scope="module")
def case(request: pytest.FixtureRequest) -> tuple[str, object, float, ConvertedSurface]:
    face = FACES[request.param]()
    size = box_diagonal(face)
    return request.param, face, size, convert_free_form(face, size)


def kernel_points(face: object, uv: Array) -> Array:
    surface = BRep_Tool.Surface_s(face)
    return np.array([surface.Value(u, v).Coord() for u, v in uv.tolist()])


def test_the_carrier_has_the_points_of_the_kernel_at_its_parameters(case) -> None:
    name, face, size, converted = case
    assert converted.error <= 1e-10 * size
    box = np.array(BRepTools.UVBounds_s(face)).reshape(2, 2)
    uv = np.random.default_rng(1).uniform(box[:, 0], box[:, 1], (500, 2))
    missed = np.linalg.norm(converted.carrier(*uv.T) - kernel_points(face, uv), axis=1).max()
    assert missed <= max(1.1 * converted.error, 1e-13 * size)
    if name in FITTED:
        spline = converted.carrier.spline
        assert (spline.degree_u, spline.degree_v) == FITTED[name]
    domain = np.array(converted.carrier.domain)
    assert (domain[:, 0] <= box[:, 0] + 1e-9).all()
    assert (domain[:, 1] >= box[:, 1] - 1e-9).all()


def test_no_foot_is_farther_than_the_kernels(case) -> None:
    _, face, size, converted = case
    carrier = converted.carrier
    points, *_ = points_beside(carrier, 60, 0.2 * size, np.random.default_rng(3))
    found = carrier.feet(points)
    theirs, _ = kernel_distances(face, carrier, points)
    assert np.isfinite(theirs).any()
    ours = np.linalg.norm(points - carrier(*found.parameters.T), axis=1)
    assert (ours - theirs).max() <= converted.error + 1e-13 * size


@pytest.mark.parametrize(
    ("name", "closed", "poles"),
    [
        ("cam, extrusion", (True, False), [0, 0, 0, 0]),
        ("wing, sharp nose", (False, False), [0, 0, 0, 0]),
        ("handle, revolution", (True, False), [0, 0, 0, 0]),
        ("elbow, sweep", (True, False), [0, 0, 0, 0]),
        ("tube with a seam", (True, False), [0, 0, 0, 0]),
        ("ellipsoid, two poles", (True, False), [1, 0, 1, 0]),
    ],
)
def test_seams_and_poles_are_found(name: str, closed: tuple[bool, bool], poles: list[int]) -> None:
    face = FACES[name]()
    carrier = convert_free_form(face, box_diagonal(face)).carrier
    assert carrier.closed == closed
    np.testing.assert_array_equal(find_point_sides(carrier.spline), poles)


def test_a_part_of_a_surface_goes_on_by_half_its_range_but_not_to_a_pole() -> None:
    whole = FACES["ellipsoid, two poles"]()
    surface = BRep_Tool.Surface_s(whole)
    _, _, v0, v1 = BRepTools.UVBounds_s(whole)
    middle = 0.5 * (v0 + v1)

    def carrier_of(u: tuple[float, float], v: tuple[float, float], **options: float):
        face = BRepBuilderAPI_MakeFace(surface, *u, *v, 1e-7).Face()
        return convert_free_form(face, 12.0, **options).carrier

    part = carrier_of((1.0, 2.0), (middle, middle + 0.4))
    np.testing.assert_allclose(part.domain, [(0.5, 2.5), (middle - 0.2, middle + 0.6)], atol=1e-12)
    assert part.closed == (False, False)
    np.testing.assert_allclose(
        carrier_of((1.0, 2.0), (middle, middle + 0.4), reach=0.0).domain, [(1, 2), (middle, middle + 0.4)]
    )
    ring = carrier_of((0.0, 4.0), (middle, middle + 0.4))
    assert ring.closed == (True, False)
    assert ring.period[0] == pytest.approx(2 * np.pi)
    near = carrier_of((1.0, 2.0), (v1 - 1.0, v1 - 0.05))
    high = near.domain[1][1]
    assert v1 - 0.05 <= high < v1 - 1e-3


def test_a_mirrored_face_is_the_mirror_image() -> None:
    part = bd.extrude(bd.make_face(bd.Spline((9, 0), (4, 6), (-3, 7), (-9, 2), (-7, -5), (1, -6), periodic=True)), 13)
    points = np.random.default_rng(4).uniform((-8, -8, -2), (8, 8, 14), (50, 3))
    distances = []
    for shape, at in ((part, points), (bd.mirror(part, bd.Plane.YZ), points * [-1, 1, 1])):
        face = side_faces(shape, bd.GeomType.EXTRUSION)[0]
        distances.append(np.abs(convert_free_form(face, 20.0).carrier.distance(at)))
    np.testing.assert_allclose(*distances, atol=1e-9)


def test_planes_quadrics_and_creases_are_refused() -> None:
    with pytest.raises(UnsupportedFace, match="quadric"):
        convert_free_form(bd.Cylinder(1, 2).faces().filter_by(bd.GeomType.CYLINDER)[0].wrapped, 3.0)
    bent = bd.Edge.make_bezier((0, 0, 0), (1, 1, 0), (2, 0, 0)), bd.Edge.make_bezier((2, 0, 0), (3, 2, 0), (4, 0, 0))
    from OCP.Geom import Geom_SurfaceOfLinearExtrusion
    from OCP.GeomConvert import GeomConvert, GeomConvert_CompCurveToBSplineCurve
    from OCP.gp import gp_Dir

    curves = [GeomConvert.CurveToBSplineCurve_s(BRep_Tool.Curve_s(edge.wrapped, 0.0, 1.0)) for edge in bent]
    joined = GeomConvert_CompCurveToBSplineCurve(curves[0])
    assert joined.Add(curves[1], 1e-7)
    surface = Geom_SurfaceOfLinearExtrusion(joined.BSplineCurve(), gp_Dir(0, 0, 1))
    face = BRepBuilderAPI_MakeFace(surface, *surface.Bounds()[:2], 0.0, 3.0, 1e-7).Face()
    with pytest.raises(UnsupportedFace, match="crease at u"):
        convert_free_form(face, 4.0)


def test_a_pcurve_has_the_knots_of_the_surface_that_it_crosses() -> None:
    """A plane whose parameter u changes its speed from 2 to 6: the pcurve of a line has a kink there, and two spans."""
    x, knots = np.array([0.0, 1, 2, 5, 8]), np.array([0.0, 0, 0, 1, 1, 2, 2, 2])
    poles = np.stack([np.stack([x, np.full(5, y), np.zeros(5)], axis=1) for y in (0.0, 1.0)], axis=1)
    surface = FreeFormSurface(BSplineSurface(poles, knots, np.array([0.0, 0, 1, 1]), 2, 1))
    line = line_segment(np.array([0.5, 0.1, 0]), np.array([7, 0.9, 0]), (0.0, 1.0))
    found = fit_pcurve(surface, line, (0.0, 1.0), np.array([1.2, 0.5]), 8.0, 1e-9)
    t = np.linspace(0, 1, 500)
    np.testing.assert_allclose(surface(*found(t).T), line(t), atol=2e-9)
    assert (np.abs(np.unique(found.knots)[:, None] - [1.5 / 6.5]).min(axis=0) < 1e-9).all()
    assert len(np.unique(found.knots)) < 8
