"""Laws of the distances of cubic sides from a level set."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from tests.levelset.test_collapses import full_mesh, normals
from tests.shapes.cut_fields import FIELDS, HI, LO
from tpmscad import fields
from tpmscad.levelset.quadmesh.quality import SIDE_PARAMETERS, measure_side_distances
from tpmscad.levelset.quadmesh.simplification.greedy_simplification import simplify_mesh
from tpmscad.levelset.quadmesh.vectors import normalize


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def side_distance(field: fields.Field, ends: np.ndarray, at_ends: np.ndarray, fixed: np.ndarray) -> float:
    """The definition, by SciPy's cubic."""
    held = fixed[0] & fixed[1]
    chord = ends[1] - ends[0]
    tangents = []
    for normal in np.where(held, 0.0, at_ends):
        axis = unit(normal)
        tangents.append(np.linalg.norm(chord) * unit(chord - (chord @ axis) * axis))
    points = CubicHermiteSpline([0, 1], ends, np.array(tangents))(SIDE_PARAMETERS)
    value, gradient = field.value_and_gradient(points)
    return float((np.abs(value) / np.linalg.norm(np.where(held, 0.0, gradient), axis=1)).max())


@pytest.mark.parametrize("name", ["gyroid", "iwp", "ball cut by the box"])
def test_distances_are_those_of_hermite_cubics_the_worst_of_each_polygon(name: str) -> None:
    mesh, field = full_mesh(name), FIELDS[name]
    at = normals(mesh, name)
    found = measure_side_distances(field, mesh.vertices, at, mesh.fixed, mesh.corners)
    for row, corners in zip(found[::7], mesh.corners[::7], strict=True):
        ring = corners[corners >= 0]
        sides = [np.array([a, b]) for a, b in zip(ring, np.roll(ring, -1), strict=True)]
        wanted = max(side_distance(field, mesh.vertices[s], at[s], mesh.fixed[s]) for s in sides)
        assert row == pytest.approx(wanted, rel=1e-9, abs=1e-14)


def test_sides_on_a_plane_are_on_the_level_set() -> None:
    plane = fields.halfspace((0.1, 0.2, 0.3), (0.3, -0.5, 0.8))
    along = np.linalg.svd(np.array([[0.3, -0.5, 0.8]]))[2][1:]
    vertices = np.array([0.1, 0.2, 0.3]) + np.array([[0, 0], [1, 0.1], [0.9, 0.8], [0, 1]]) @ along
    at = normalize(plane.gradient(vertices))
    found = measure_side_distances(plane, vertices, at, np.zeros((4, 3), bool), np.array([[0, 1, 2, 3]]))
    assert found.max() < 1e-14


@pytest.mark.slow
def test_merged_polygons_keep_the_limit_and_a_narrow_one_leaves_more_of_them() -> None:
    name = "gyroid"
    mesh, field = full_mesh(name), FIELDS[name]
    known = measure_side_distances(field, mesh.vertices, normals(mesh, name), mesh.fixed, mesh.corners)
    sizes = []
    for limit in (np.inf, known.max()):
        small = simplify_mesh(mesh, field, LO, HI, 1.6, limit).mesh()[0]
        distance = measure_side_distances(field, small.vertices, normals(small, name), small.fixed, small.corners)
        assert distance.max() <= limit
        sizes.append(len(small.corners))
    assert sizes[0] < sizes[1] < len(mesh.corners)
