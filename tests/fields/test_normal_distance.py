"""Distances to level sets and walls of a thickness, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.fields.analysis.isometries import find_isometries
from tpmscad.fields.kinds.foot_point_search import POINTS_PER_BATCH

RNG = np.random.default_rng(5)


def test_the_distance_to_a_distorted_ball_is_that_to_the_ball() -> None:
    """The field is no distance: its slope varies from place to place, and its level set is a sphere of radius 2."""
    phi = fields.from_function(lambda x, y, z: (x * x + y * y + z * z - 4) * (2 + np.sin(x)))
    points = RNG.uniform(-3, 3, (500, 3))
    points = points[np.linalg.norm(points, axis=1) > 0.2]
    expected = np.linalg.norm(points, axis=1) - 2
    value, gradient = fields.normal_distance(phi).value_and_gradient(points)
    np.testing.assert_allclose(value, expected, rtol=0, atol=1e-8)
    np.testing.assert_allclose(gradient, points / np.linalg.norm(points, axis=1, keepdims=True), rtol=0, atol=1e-6)


def test_the_sides_of_a_wall_lie_half_its_thickness_from_the_level_set() -> None:
    phi = fields.tpms("lidinoid", 10.0)
    points = RNG.uniform(0, 10, (400, 3))
    for _ in range(30):
        value, gradient = phi.value_and_gradient(points)
        square = np.maximum(np.einsum("ni,ni->n", gradient, gradient), 1e-3)
        points = points - 0.7 * (value / square)[:, None] * gradient
    points = points[np.abs(phi(points)) < 1e-9]
    normal = phi.gradient(points)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    wall = fields.wall(phi, 0.4)
    assert len(points) > 300
    for distance in (-0.25, -0.1, 0.0, 0.1, 0.25):
        np.testing.assert_allclose(wall(points + distance * normal), abs(distance) - 0.2, rtol=0, atol=1e-9)


def test_a_graded_wall_is_as_thick_as_its_thickness_there() -> None:
    wall = fields.wall(fields.halfspace((0, 0, 0), (0, 0, 1)), fields.ramp("x", (0, 10), (1.0, 2.0), smooth=False))
    assert float(wall((5.0, 0.0, 0.75))) == pytest.approx(0.0, abs=1e-12)
    assert float(wall((0.0, 3.0, -0.5))) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "count"), [("lidinoid", 96), ("split_p", 48), ("fischer_koch_s", 48), ("octo", 48), ("gyroid", 48)]
)
def test_the_isometries_are_those_of_the_space_group(name: str, count: int) -> None:
    """General positions of Ia-3d, Ia-3, I-43d, Pm-3m and I4_132 in the International Tables."""
    assert len(find_isometries(fields.tpms(name, 7.0))) == count
    assert len(find_isometries(fields.tpms(name, (7.0, 7.0, 9.0)))) * 3 == count


def test_axes_of_symmetry_have_the_distance_of_the_points_beside_them() -> None:
    """On the axes of Schwarz P the descent along the gradient ends at a saddle between the parts of the surface."""
    distance = fields.normal_distance(fields.tpms("schwarz_p", 10.0))
    on_axis = np.array([[0.0, 5.25, 0.0], [0.0, 0.0, 4.5], [5.0, 5.0, 0.25]])
    beside = distance(on_axis + 1e-4)
    np.testing.assert_allclose(distance(on_axis), beside, rtol=0, atol=1e-3)
    assert (np.abs(distance(on_axis)) > 1.5).all()


def test_the_distance_of_a_point_does_not_depend_on_the_points_it_is_evaluated_with() -> None:
    distance = fields.normal_distance(fields.tpms("gyroid", 5.0))
    points = RNG.uniform(0, 5, (POINTS_PER_BATCH + 500, 3))
    value, normal = distance.value_and_gradient(points)
    chosen = RNG.permutation(len(points))[:40]
    for k in chosen:
        alone, slope = distance.value_and_gradient(points[k])
        assert alone == value[k]
        assert np.array_equal(slope, normal[k])
