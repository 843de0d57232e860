"""Laws of a field as a box sees it."""

from __future__ import annotations

import numpy as np

from tpmscad import fields
from tpmscad.fields.kinds.linear_extension import extend_linearly

LO, HI = np.array([-0.3, 0.1, 0.2]), np.array([0.9, 1.0, 1.6])
FIELD = fields.tpms("gyroid", 1.7) + 0.3 * fields.coordinate("x") * fields.coordinate("y")
POINTS = np.random.default_rng(2).uniform(LO - 0.2, HI + 0.2, (3000, 3))
SEEN = extend_linearly(FIELD, LO, HI)


def beyond(points: np.ndarray) -> np.ndarray:
    return points - np.clip(points, LO, HI)


def test_in_the_box_it_is_the_field_to_the_last_bit() -> None:
    at = (beyond(POINTS) == 0).all(axis=1)
    assert 500 < np.count_nonzero(at) < 2500
    assert np.array_equal(SEEN(POINTS)[at], FIELD(POINTS)[at])
    assert np.array_equal(SEEN.gradient(POINTS)[at], FIELD.gradient(POINTS)[at])


def test_beyond_a_face_it_goes_on_straight_from_the_face() -> None:
    near = np.clip(POINTS, LO, HI)
    straight = FIELD(near) + np.einsum("ni,ni->n", FIELD.gradient(near), POINTS - near)
    assert np.allclose(SEEN(POINTS), straight, atol=1e-13)


def test_its_gradient_is_that_of_its_values_everywhere() -> None:
    h = 1e-6
    differences = np.stack([(SEEN(POINTS + h * e) - SEEN(POINTS - h * e)) / (2 * h) for e in np.eye(3)], axis=-1)
    clear = np.abs(np.minimum(POINTS - LO, HI - POINTS)).min(axis=1) > 2 * h
    assert np.allclose(SEEN.gradient(POINTS)[clear], differences[clear], atol=2e-4)
    value, gradient = SEEN.value_and_gradient(POINTS)
    assert np.array_equal(value, SEEN(POINTS))
    assert np.array_equal(gradient, SEEN.gradient(POINTS))


def test_on_a_grid_it_is_what_it_is_at_its_points() -> None:
    axes = [np.linspace(a - 0.1, b + 0.1, n) for a, b, n in zip(LO, HI, (5, 6, 7), strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    value, gradient = SEEN.value_and_gradient_on_grid(*axes)
    assert np.allclose(value, SEEN(points), atol=1e-13)
    assert np.allclose(gradient, SEEN.gradient(points), atol=1e-9)
