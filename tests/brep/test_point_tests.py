"""Points in polygons, intervals and meshes, against slow oracles and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad.brep.loops import pair_with_intervals, points_in_polygons
from tpmscad.brep.winding_numbers import winding_numbers

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], float)
QUADRILATERALS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
BOX = QUADRILATERALS[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)


def crossings_one_by_one(start: np.ndarray, end: np.ndarray, point: np.ndarray) -> int:
    count = 0
    for (x0, y0), (x1, y1) in zip(start, end, strict=True):
        if (y0 > point[1]) != (y1 > point[1]):
            count += x0 + (point[1] - y0) * (x1 - x0) / (y1 - y0) > point[0]
    return count


def test_points_in_polygons_are_those_with_an_odd_number_of_crossings() -> None:
    """Vertices at the heights of points included: half of the points lie on a grid with the vertices."""
    rng = np.random.default_rng(3)
    loops = [rng.integers(-3, 4, (n, 2)).astype(float) for n in (3, 7, 12)]
    start, end = np.concatenate(loops), np.concatenate([np.roll(loop, -1, axis=0) for loop in loops])
    points = np.concatenate([rng.uniform(-4, 4, (60, 2)), rng.integers(-4, 5, (60, 2)) + np.array([0.25, 0.0])])
    expected = [crossings_one_by_one(start, end, p) % 2 == 1 for p in points]
    assert 10 < sum(expected) < 110
    np.testing.assert_array_equal(points_in_polygons(start, end, points), expected)


def test_intervals_are_paired_with_the_values_in_them() -> None:
    rng = np.random.default_rng(4)
    values, low = rng.integers(0, 10, 20).astype(float), rng.integers(0, 10, 15).astype(float)
    high = low + rng.integers(0, 4, 15)
    found = set(zip(*(a.tolist() for a in pair_with_intervals(values, low, high)), strict=True))
    assert found == {(i, j) for i in range(15) for j in range(20) if low[i] <= values[j] < high[i]}


@pytest.mark.parametrize("sense", [1, -1])
def test_the_winding_number_is_one_inside_a_mesh_and_counts_its_sense(sense: int) -> None:
    points = np.random.default_rng(5).uniform([-0.5, -0.5, -0.5], [1.5, 2.5, 3.5], (400, 3))
    inside = ((points > 0) & (points < [1, 2, 3])).all(axis=1)
    assert 50 < inside.sum() < 350
    np.testing.assert_array_equal(winding_numbers(CORNERS, BOX[:, ::sense], points), sense * inside)


def test_two_meshes_about_one_point_add_up() -> None:
    vertices, triangles = np.concatenate([CORNERS, 0.5 * CORNERS]), np.concatenate([BOX, BOX[:, ::-1] + 8])
    points = np.array([[0.2, 0.4, 0.6], [0.7, 1.5, 2.0], [2.0, 1.0, 1.0]])
    assert winding_numbers(vertices, triangles, points).tolist() == [0, 1, 0]
