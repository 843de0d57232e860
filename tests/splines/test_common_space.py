"""Two surfaces in one spline space, and surfaces with turned parameters: the points stay, knots and degrees are those of both."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad._typing import Array
from tpmscad.splines import BSplineSurface, bezier_knots, to_common_space
from tpmscad.splines.knots import map_to_unit_square, turn_surface

RNG = np.random.default_rng(3)
T, S = np.linspace(0, 1, 23), np.linspace(0, 1, 17)


def clamped(degree: int, inner: list[float]) -> Array:
    return np.array([0.0] * (degree + 1) + inner + [1.0] * (degree + 1))


def surface(u: tuple[int, list[float]], v: tuple[int, list[float]]) -> BSplineSurface:
    knots = clamped(*u), clamped(*v)
    net = RNG.normal(size=(len(knots[0]) - u[0] - 1, len(knots[1]) - v[0] - 1, 3))
    return BSplineSurface(net, *knots, u[0], v[0])


def test_surfaces_of_one_space_have_the_points_that_they_had() -> None:
    first = surface((3, [0.2, 0.5, 0.5]), (1, []))
    second = surface((5, [0.5, 0.7]), (2, [0.4]))
    a, b = to_common_space(first, second)
    for old, new in ((first, a), (second, b)):
        np.testing.assert_allclose(new.grid(T, S), old.grid(T, S), rtol=0, atol=1e-13)
    assert (a.degree_u, a.degree_v) == (b.degree_u, b.degree_v) == (5, 2)
    np.testing.assert_array_equal(a.knots_u, b.knots_u)
    np.testing.assert_array_equal(a.knots_v, b.knots_v)


def test_the_common_space_is_as_smooth_at_a_knot_as_the_rougher_surface_and_no_rougher() -> None:
    a, _ = to_common_space(surface((3, [0.2, 0.5, 0.5]), (1, [])), surface((5, [0.5, 0.7]), (2, [0.4])))
    # the cubic is C2 at 0.2 and C1 at 0.5, the quintic C4 at 0.5 and 0.7; a line joins a parabola that is C1 at 0.4
    np.testing.assert_array_equal(a.knots_u, clamped(5, [0.2] * 3 + [0.5] * 4 + [0.7]))
    np.testing.assert_array_equal(a.knots_v, clamped(2, [0.4]))


def test_knots_that_differ_by_round_off_are_one() -> None:
    a, _ = to_common_space(surface((3, [0.3]), (1, [])), surface((3, [0.1 + 0.2]), (1, [])))
    assert len(a.knots_u) == 9


def test_surfaces_over_different_domains_are_refused() -> None:
    line = bezier_knots(1)
    with pytest.raises(ValueError, match="have no common spline space"):
        to_common_space(surface((1, []), (1, [])), BSplineSurface(np.zeros((2, 2, 3)), 2 * line, line, 1, 1))


def test_turned_parameters_reach_the_same_points() -> None:
    plain = surface((3, [0.2, 0.6]), (2, [0.9]))
    points = plain.grid(T, S)
    for reverse_u in (False, True):
        for reverse_v in (False, True):
            s, t = (1 - T if reverse_u else T), (1 - S if reverse_v else S)
            np.testing.assert_allclose(turn_surface(plain, reverse_u, reverse_v).grid(s, t), points, rtol=0, atol=1e-14)
            swapped = turn_surface(plain, reverse_u, reverse_v, swap=True)
            np.testing.assert_allclose(swapped.grid(t, s), points.swapaxes(0, 1), rtol=0, atol=1e-14)


def test_the_unit_square_is_a_scaled_domain() -> None:
    plain = surface((3, [0.2, 0.6]), (2, [0.9]))
    moved = BSplineSurface(plain.poles, 7 + 3.3 * plain.knots_u, -2 + 0.1 * plain.knots_v, 3, 2)
    unit = map_to_unit_square(moved)
    assert unit.domain == ((0.0, 1.0), (0.0, 1.0))
    np.testing.assert_allclose(unit.grid(T, S), plain.grid(T, S), rtol=0, atol=1e-13)
