"""Sections of closed triangle meshes: areas in closed form, orientation, holes, levels through points, and open meshes."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad.brep.loops import signed_area
from tpmscad.brep.sections.mesh_sections import cut_mesh, measure_sections
from tpmscad.errors import TrimmingError

manifold3d = pytest.importorskip("manifold3d")


def arrays(solid: manifold3d.Manifold) -> tuple[np.ndarray, np.ndarray]:
    made = solid.to_mesh64()
    return np.array(made.vert_properties), np.asarray(made.tri_verts, np.int64)


def test_a_hollow_ball_has_rings_of_its_own_area() -> None:
    ball = manifold3d.Manifold.sphere(1.0, 256).rotate((11, 23, 5))
    points, triangles = arrays(ball - manifold3d.Manifold.sphere(0.5, 128))
    levels = np.linspace(-0.93, 0.91, 31)
    found = cut_mesh(points, triangles, levels, 1e-9)
    expected = np.pi * (1 - levels**2 - np.maximum(0.25 - levels**2, 0))
    assert found.areas == pytest.approx(expected, rel=2e-3)
    assert measure_sections(points, triangles, levels) == pytest.approx(found.areas, rel=1e-12)
    for level, (contours, area, length) in zip(levels, found, strict=True):
        areas = [signed_area(contour) for contour in contours]
        assert len(areas) == (2 if abs(level) < 0.4999 else 1)
        assert sum(a > 0 for a in areas) == 1
        assert sum(areas) == pytest.approx(area)
        radii = [np.sqrt(1 - level**2)] + [np.sqrt(max(0.25 - level**2, 0.0))] * (len(areas) - 1)
        assert length == pytest.approx(2 * np.pi * sum(radii), rel=2e-3)


def test_points_are_left_out_within_the_error() -> None:
    points, triangles = arrays(manifold3d.Manifold.cylinder(1.0, 1.0, 1.0, 400))
    every, some = (cut_mesh(points, triangles, np.array([0.3]), error) for error in (0.0, 1e-3))
    assert len(some.points) < 0.2 * len(every.points)
    (((contour,), area, _),) = some
    a, b = contour, np.roll(contour, -1, axis=0)
    middles = np.linalg.norm(0.5 * (a + b), axis=1)
    assert 1 - middles.min() < 1.1e-3
    assert area == pytest.approx(np.pi, rel=1e-4)


def test_planes_through_points_and_faces_have_one_section() -> None:
    """A plane in the bottom of a box has its section, one in its top none; one through an edge of a prism is cut cleanly."""
    points, triangles = arrays(manifold3d.Manifold.cube((2, 3, 1)))
    found = cut_mesh(points, triangles, np.array([0.0, 0.5, 1.0]), 0.0)
    assert sorted(found.areas.tolist()) == pytest.approx([0.0, 6.0, 6.0])
    turned, triangles = arrays(manifold3d.Manifold.cube((1, 1, 1)))
    turned = turned @ np.array([[1, 0, 0], [0, np.sqrt(0.5), np.sqrt(0.5)], [0, -np.sqrt(0.5), np.sqrt(0.5)]])
    middle = float(np.sort(turned[:, 2])[len(turned) // 2])
    assert cut_mesh(turned, triangles, np.array([middle]), 0.0).areas[0] == pytest.approx(np.sqrt(2))


def test_an_open_mesh_is_refused() -> None:
    points, triangles = arrays(manifold3d.Manifold.sphere(1.0, 16))
    with pytest.raises(TrimmingError, match="open"):
        cut_mesh(points, triangles[1:], np.linspace(-0.9, 0.9, 200), 0.0)
