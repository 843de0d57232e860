"""Inserting knots, splitting, restricting and elevating don't change the surface."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.knots import (
    bezier_knots,
    elevate_degree,
    insert_knot,
    restrict_surface,
    split_surface,
    uniform_knots,
)


def some_surface(seed: int = 0, degree_u: int = 3, degree_v: int = 5, smoothness: int | None = None) -> BSplineSurface:
    ku, kv = uniform_knots(4, degree_u, None, (-1.0, 2.0)), uniform_knots(3, degree_v, smoothness, (0.5, 1.0))
    rng = np.random.default_rng(seed)
    return BSplineSurface(
        rng.normal(size=(len(ku) - degree_u - 1, len(kv) - degree_v - 1, 3)), ku, kv, degree_u, degree_v
    )


@settings(max_examples=25, deadline=None)
@given(st.floats(0.01, 0.99), st.sampled_from([0, 1]), st.integers(1, 4), st.integers(2, 6))
def test_both_halves_of_a_split_are_the_surface(part: float, direction: int, degree_u: int, degree_v: int) -> None:
    whole = some_surface(1, degree_u, degree_v)
    (low, high) = whole.domain[direction]
    cut = low + part * (high - low)
    for half, (a, b) in zip(split_surface(whole, direction, cut), ((low, cut), (cut, high)), strict=True):
        assert half.domain[direction] == (a, b)
        assert half.domain[1 - direction] == whole.domain[1 - direction]
        (u0, u1), (v0, v1) = half.domain
        u, v = np.linspace(u0, u1, 9), np.linspace(v0, v1, 7)
        np.testing.assert_allclose(half.grid(u, v), whole.grid(u, v), atol=1e-12)


@pytest.mark.parametrize("direction", [0, 1])
def test_a_split_at_a_knot_of_any_multiplicity_is_one_too(direction: int) -> None:
    whole = some_surface(2, 3, 5, smoothness=2)
    knots = (whole.knots_u, whole.knots_v)[direction]
    for cut in np.unique(knots)[1:-1]:
        first, second = split_surface(whole, direction, float(cut))
        u, v = np.linspace(*second.domain[0], 9), np.linspace(*second.domain[1], 7)
        np.testing.assert_allclose(second.grid(u, v), whole.grid(u, v), atol=1e-12)
        side, opposite = ((1, 3), (2, 0))[direction]
        np.testing.assert_array_equal(first.side(side).poles, second.side(opposite).poles[::-1])


def test_a_restriction_is_the_surface_on_the_rectangle() -> None:
    whole = some_surface(3)
    piece = restrict_surface(whole, (-0.7, 1.1), (0.5, 0.8))
    assert piece.domain == ((-0.7, 1.1), (0.5, 0.8))
    u, v = np.linspace(-0.7, 1.1, 9), np.linspace(0.5, 0.8, 7)
    np.testing.assert_allclose(piece.grid(u, v), whole.grid(u, v), atol=1e-12)
    with pytest.raises(ValueError, match="interval"):
        restrict_surface(whole, (-2.0, 0.0), (0.5, 0.8))


def test_elevation_keeps_the_surface() -> None:
    rng = np.random.default_rng(4)
    low = BSplineSurface(rng.normal(size=(4, 6, 3)), bezier_knots(3), bezier_knots(5, (2.0, 3.0)), 3, 5)
    high = elevate_degree(low, 7, 6)
    assert high.poles.shape == (8, 7, 3)
    u, v = np.linspace(0, 1, 9), np.linspace(2, 3, 7)
    np.testing.assert_allclose(high.grid(u, v), low.grid(u, v), atol=1e-13)
    with pytest.raises(ValueError, match="one span"):
        elevate_degree(some_surface(), 5, 7)


def test_a_knot_outside_or_full_is_refused() -> None:
    whole = some_surface(5)
    with pytest.raises(ValueError, match="inserted"):
        insert_knot(whole.poles, whole.knots_u, 3, 2.0)
    with pytest.raises(ValueError, match="inserted"):
        insert_knot(whole.poles, whole.knots_u, 3, 0.5, 4)
