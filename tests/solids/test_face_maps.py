"""Maps between two faces of a CAD part: their ends lie on the faces, and walls keep their thickness in mm."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import maps
from tpmscad.errors import InvalidRequest

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

b3d = pytest.importorskip("build123d")


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
