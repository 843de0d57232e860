"""Bodies whose edges lie off their faces are read closed: planes and quadrics stay, free-form faces move by about the gap."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("OCP")

import build123d as bd
from OCP.BRepAdaptor import BRepAdaptor_Curve
from scipy.interpolate import make_interp_spline

from benchmarks.made_gaps import BODIES, spoil
from tests.shapes.misfits import volume
from tests.trimming.conftest import Cover, cover
from tests.trimming.network_operands import trim
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import reverse_faces
from tpmscad.brep.carriers import Circle
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import NotQuadric
from tpmscad.kernel.body_import import body_brep
from tpmscad.kernel.body_import.body_brep import brep_from_shape, read_free_form_body
from tpmscad.kernel.body_import.unrolled_faces import ImportedEdge
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.measure.validity import is_brep_valid
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, is_segment
from tpmscad.splines.knots import bezier_knots

pytestmark = pytest.mark.kernel

__all__ = ["cover"]


def made(name: str) -> bd.Shape:
    return BODIES[name](np.random.default_rng(3))


@pytest.mark.parametrize(
    ("name", "grid"),
    [("loft", 1e-3), ("tube", 1e-3), ("turned_spline", 1e-3), ("rounded_block", 1e-3)],
)
def test_a_body_with_rounded_edges_is_read_as_the_clean_one(name: str, grid: float) -> None:
    body = made(name)
    read = read_free_form_body(spoil(body, grid, faces=False))
    assert len(connectivity.find_unmatched_edges(read.brep)) == 0
    assert read.brep.edges.deviation.max() < 3e-8
    moments = integral_properties.integrate_faces(read.brep)
    clean = volume(read_free_form_body(body).brep)
    assert abs(volume(read.brep) - clean) < 2.0 * grid * moments.area.sum()
    (note,) = read.notes
    assert "off its faces" in note
    assert "inaccurate" in note


def test_a_loft_whose_edges_lie_off_its_faces_by_the_kernels_tolerance_is_closed() -> None:
    """The outlines are of unlike kinds: the loft's faces pass by them within the kernel's tolerance, not the cut's."""
    outlines = bd.Ellipse(9, 6).face(), bd.Pos(0, 0, 12) * bd.RectangleRounded(10, 10, 2).face()
    body = bd.loft(outlines).solid()
    read = read_free_form_body(body).brep
    assert len(connectivity.find_unmatched_edges(read)) == 0
    assert read.edges.deviation.max() < 3e-8
    assert volume(read) == pytest.approx(body.volume, rel=1e-5)


def test_planes_and_quadrics_keep_their_places_and_tangent_edges_their_kinds() -> None:
    body = made("rounded_block")
    clean, read = brep_from_shape(body), read_free_form_body(spoil(body, 1e-4, faces=False)).brep
    assert not any(isinstance(c, BSplineSurface) for c in read.carriers)
    assert len(read.faces) == len(clean.faces)
    points = np.random.default_rng(1).uniform(-3, 3, (50, 3))
    for own, other in zip(clean.carriers, read.carriers, strict=True):
        np.testing.assert_array_equal(own.distance(points), other.distance(points))
    assert all(isinstance(c, Circle) or is_segment(c) for c in read.curves)
    assert volume(read) == pytest.approx(volume(clean), rel=1e-5)
    with pytest.raises(NotQuadric):
        brep_from_shape(spoil(body, 1e-4, faces=False))


@pytest.mark.parametrize("grid", [1e-5, 1e-3])
def test_a_free_form_face_moves_by_about_its_gap(grid: float) -> None:
    body = made("turned_spline")
    spoilt = spoil(body, grid, faces=True)
    read = read_free_form_body(spoilt)
    assert read.brep.edges.deviation.max() < 3e-8
    (form,) = {id(f): f for f in read.free_form.values()}.values()
    (before,) = {id(f): f for f in read_free_form_body(body).free_form.values()}.values()
    uv = np.random.default_rng(2).uniform(*np.array(before.domain).T, (200, 2))
    off = np.abs(form.distance(before(*uv.T)))
    assert off.max() < 4.0 * grid  # the faces were rounded by up to grid, and moved by up to as much


def test_a_gap_that_is_too_wide_is_refused_with_its_place_and_size() -> None:
    with pytest.raises(NotQuadric, match=r"(near|shares|misses)"):
        read_free_form_body(spoil(made("rounded_block"), 0.3, faces=False))


def test_volumes_of_faces_with_edges_of_high_degree_are_those_of_their_curves() -> None:
    """The edge of this fillet has a degree for which six Gauss points per span were 5e-5 off."""
    body = BODIES["fillet_between_free_forms"](np.random.default_rng(0))
    top = body.faces().filter_by(bd.GeomType.PLANE).sort_by(bd.Axis.Z)[-1]
    (edge,) = top.edges()
    curve = BRepAdaptor_Curve(edge.wrapped)
    t = np.linspace(curve.FirstParameter(), curve.LastParameter(), 20001)
    x, y = np.array([curve.Value(s).Coord()[:2] for s in t.tolist()]).T
    area = 0.5 * abs(float(x[:-1] @ y[1:] - x[1:] @ y[:-1]))
    assert face_moments([top.wrapped])[0, 0] == pytest.approx(area, rel=1e-7)


@pytest.mark.slow
def test_the_distance_of_an_edge_from_its_face_is_measured_between_the_knots_of_both() -> None:
    """The edge touches its face at 33 even points and waves between them, within each span of its curve."""
    t = np.linspace(0.0, 1.0, 257)
    points = np.column_stack([4.0 * t, np.zeros_like(t), 1e-6 * np.sin(32 * np.pi * t)])
    found = make_interp_spline(t, points, 3)
    edge = ImportedEdge(BSplineCurve(np.asarray(found.c), np.asarray(found.t), 3), (0.0, 1.0), 0, 1)
    corners = np.array([[[-1.0, -1, 0], [-1, 1, 0]], [[5, -1, 0], [5, 1, 0]]])
    face = FreeFormSurface(BSplineSurface(corners, bezier_knots(1), bezier_knots(1), 1, 1))
    body = SimpleNamespace(edges=[edge])
    assert body_brep._edge_deviation(body, face, 0, None) == pytest.approx(1e-6, rel=0.02)


def test_a_body_with_gaps_is_cut(cover: Cover) -> None:
    body = bd.Pos(5, 5, 2) * bd.Rotation(20, 35, 50) * made("fillet_between_free_forms")
    read = read_free_form_body(spoil(body, 1e-4, faces=False))
    lattice = cover("P", (1, 1, 1), (0.07, 0.11, 0.19), (None, 0.04))
    parts = [trim(half, read.brep).brep for half in (lattice, reverse_faces(lattice))]
    assert sum(map(volume, parts)) == pytest.approx(volume(read.brep), rel=1e-6)
    for part in parts:
        assert is_brep_valid(part, build_solids(part).known_faces)


def test_a_thread_of_eight_turns_is_read() -> None:
    profile = bd.make_face(bd.Plane.XZ * bd.Polyline((2.5, -0.3), (3.5, -0.05), (3.5, 0.05), (2.5, 0.3), (2.5, -0.3)))
    thread = bd.sweep(profile, path=bd.Helix(pitch=1, height=8, radius=3), is_frenet=True)
    read = read_free_form_body(thread)
    assert len(connectivity.find_unmatched_edges(read.brep)) == 0
    assert read.brep.edges.deviation.max() < 1e-7
    assert volume(read.brep) == pytest.approx(thread.volume, rel=1e-5)  # of the kernel, to five digits
