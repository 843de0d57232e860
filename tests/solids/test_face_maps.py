"""Maps between two faces of a CAD part: their ends lie on the faces, and walls keep their thickness in mm."""

from __future__ import annotations

import re

import numpy as np
import pytest

import tpmscad
from tpmscad import maps
from tpmscad.errors import InvalidRequest

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

b3d = pytest.importorskip("build123d")

from OCP.BRep import BRep_Tool  # noqa: E402  (after the check that there is a kernel)
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_NurbsConvert  # noqa: E402
from OCP.Geom import Geom_OffsetSurface  # noqa: E402

from tpmscad.kernel.occt.convert import as_face, surface, surface_from_occt  # noqa: E402
from tpmscad.splines import BSplineSurface  # noqa: E402


def plate():
    return b3d.Box(30, 20, 6).faces().sort_by(b3d.Axis.Z)[::5]


def sector():
    """A bent bar: the cylinders inside and outside of 70 degrees of a ring."""
    bar = b3d.revolve(b3d.Plane.XZ * b3d.Pos(20, 0) * b3d.Rectangle(6, 12), axis=b3d.Axis.Z, revolution_arc=70)
    return bar.faces().filter_by(b3d.GeomType.CYLINDER).sort_by(b3d.SortBy.AREA)


def twisted():
    """A loft from a rectangle to a smaller, turned one."""
    with b3d.BuildPart() as part:
        with b3d.BuildSketch(b3d.Plane.XY):
            b3d.Rectangle(30, 20)
        with b3d.BuildSketch(b3d.Plane.XY.offset(8)):
            b3d.Rectangle(22, 16, rotation=15)
        b3d.loft()
    faces = part.part.faces().sort_by(b3d.Axis.Z)
    return faces[0], faces[-1]


def tube():
    ring = b3d.Cylinder(12, 20) - b3d.Cylinder(8, 20)
    return ring.faces().filter_by(b3d.GeomType.CYLINDER).sort_by(b3d.SortBy.AREA)


@pytest.mark.parametrize("make", [plate, sector, twisted, tube])
def test_the_ends_of_the_domain_lie_on_the_faces_and_cover_them(make) -> None:
    faces = make()
    map = maps.between(faces[0], faces[1])
    low, high = map.domain
    rng = np.random.default_rng(1)
    for end, face in ((low[2], faces[0]), (high[2], faces[1])):
        at = low + (np.array(high) - low) * rng.random((40, 3))
        at[:, 2] = end
        points = map(at)
        assert max(face.distance_to(b3d.Vector(*p)) for p in points) < 1e-5
        edges = [low[0], high[0]], [low[1], high[1]]
        corners = np.array([[u, v, end] for u in edges[0] for v in edges[1]])
        vertices = np.array([tuple(v) for v in face.vertices()])
        assert np.linalg.norm(map(corners)[:, None] - vertices, axis=-1).min(axis=1).max() < 1e-5
    assert map.least_jacobian > 0
    assert map.closed == (False, make is tube, False)


def test_faces_without_four_sides_are_refused() -> None:
    disc = b3d.Cylinder(5, 3).faces().sort_by(b3d.Axis.Z)
    with pytest.raises(InvalidRequest, match="face_a has 1 edges: a map needs a face of 4 sides"):
        maps.between(disc[0], disc[-1])
    holed = (b3d.Box(10, 10, 2) - b3d.Cylinder(2, 2)).faces().sort_by(b3d.Axis.Z)
    with pytest.raises(InvalidRequest, match="has 1 holes"):
        maps.between(holed[0], holed[-1])
    with pytest.raises(InvalidRequest, match="face_b holds 6 faces"):
        maps.between(plate()[0], b3d.Box(1, 1, 1))


def wavy(z: float, seed: int, counts: tuple[int, int] = (5, 7)):
    """A face through points of a bumpy sheet of 50 x 90: cubic, C2 at its inner knots."""
    rng = np.random.default_rng(seed)
    x, y = np.linspace(0, 50, counts[0]), np.linspace(0, 90, counts[1])
    rows = [[b3d.Vector(a, b, z + 0.5 * rng.uniform(-1, 1)) for b in y] for a in x]
    return b3d.Face.make_surface_from_array_of_points(rows)


def test_a_polynomial_spline_is_taken_with_its_own_knots_and_points() -> None:
    faces = wavy(0, 1), wavy(10, 2, (6, 5))
    map = maps.between(*faces)
    assert map.face_error == 0
    ends = [surface_from_occt(BRep_Tool.Surface_s(face.wrapped)) for face in faces]
    for axis in range(2):
        own = map.volume.knots[axis] / map.volume.knots[axis][-1]
        missed = []
        for end in ends:
            choices = []
            for knots in (end.knots_u, end.knots_v):
                knots = (knots - knots[0]) / np.ptp(knots)
                choices += [np.abs(own[:, None] - t).min(axis=0).max() for t in (knots, 1 - knots)]
            missed.append(min(choices))
        assert max(missed) < 1e-14
    low, high = (np.array(corner) for corner in map.domain)
    rng = np.random.default_rng(1)
    at = low + (high - low) * rng.random((60, 3))
    for w, face in ((low[2], faces[0]), (high[2], faces[1])):
        at[:, 2] = w
        assert max(face.distance_to(b3d.Vector(*p)) for p in map(at)) < 1e-12


def tilted_pair(face):
    """A face and a copy of it above, closer at one side."""
    return face, face.moved(b3d.Location((0, 0, 9), (2, 0, 0)))


def extruded():
    curve = b3d.Edge.make_spline([(0, 0, 0), (10, 0, 2), (20, 0, -1), (34, 0, 1)])
    return tilted_pair(b3d.Face.extrude(curve, (0, 21, 0)))


def rational():
    """A quarter of a cone, as a rational spline surface."""
    cone = b3d.Solid.make_cone(12, 20, 15, angle=90).faces().filter_by(b3d.GeomType.CONE)[0]
    spline = BRepBuilderAPI_NurbsConvert(cone.wrapped).Shape()
    inner = b3d.Face(as_face(spline))
    return inner, b3d.Solid.make_cone(15, 24, 15, angle=90).faces().filter_by(b3d.GeomType.CONE)[0]


def offset():
    return b3d.Face(
        BRepBuilderAPI_MakeFace(Geom_OffsetSurface(BRep_Tool.Surface_s(wavy(0, 1).wrapped), 2.0), 1e-6).Face()
    ), wavy(10, 2)


def trimmed():
    tool = b3d.Pos(25, 45, 5) * b3d.Rot(0, 0, 10) * b3d.Box(30, 40, 40)
    return tuple((wavy(z, seed, (4, 4)) & tool).faces()[0] for z, seed in ((0, 1), (10, 2)))


@pytest.mark.parametrize(("make", "rtol"), [(extruded, 1e-9), (rational, 1e-9), (offset, 1e-9), (trimmed, 1e-6)])
def test_faces_of_every_kind_are_met_within_what_is_told(make, rtol) -> None:
    faces = make()
    map = maps.between(*faces)
    low, high = (np.array(corner) for corner in map.domain)
    assert map.face_error <= rtol * np.linalg.norm(high - low)
    at = low + (high - low) * np.random.default_rng(1).random((60, 3))
    for w, face in ((low[2], faces[0]), (high[2], faces[1])):
        at[:, 2] = w
        assert max(face.distance_to(b3d.Vector(*p)) for p in map(at)) <= map.face_error + 1e-12


def test_a_knot_that_is_not_smooth_is_named_with_its_place() -> None:
    """A roof whose ridge is a knot: the kernel would split a crease that is extruded, but not one in the poles."""
    poles = np.array([[[x, y, z] for y in (0.0, 20.0)] for x, z in ((0.0, 0.0), (12.0, 3.0), (30.0, 0.0))])
    ridge = BSplineSurface(poles, np.array([0, 0, 0.4, 1, 1]), np.array([0.0, 0, 1, 1]), 1, 1)
    roof = b3d.Face(BRepBuilderAPI_MakeFace(surface(ridge), 1e-6).Face())
    with pytest.raises(InvalidRequest, match=r"face_b is not smooth .* at its knot [uv] = 0\.[46] .* near \(12, "):
        maps.between(b3d.Pos(15, 10, -5) * b3d.Face.make_rect(30, 20), roof)


def test_walls_between_faces_that_are_only_c2_join_with_continuous_curvature() -> None:
    model = tpmscad.lattice(
        "gyroid", cell=5, cells=(2, 1, 1), thickness=0.6, tol=0.05, boundary="natural",
        map=maps.between(*[face.scale(0.4) for face in (wavy(0, 1), wavy(24, 2, (6, 5)))]),
    )  # fmt: skip
    certificate = model.certificate
    assert certificate.met
    assert certificate.tangent_jump_deg < 1e-5
    assert certificate.curvature_jump < 1e-6
    notes = "; ".join(certificate.notes)
    assert "has cells of" in notes
    moved = float(re.search(r"rounded at its knots, by (\S+) mm", notes)[1])
    assert 0 < moved <= 0.025


def test_numbers_of_cells_along_the_wrong_axes_are_told_with_better_ones() -> None:
    with pytest.raises(
        InvalidRequest, match=r"near \(.*where a cell measures .*: cells=\(9, 5, 1\) would be more nearly cubic"
    ):
        tpmscad.lattice(
            "gyroid",
            cell=5,
            cells=(5, 9, 1),
            thickness=2.0,
            tol=0.05,
            boundary="natural",
            map=maps.between(wavy(0, 1), wavy(10, 2)),
        )
