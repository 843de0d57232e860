"""Corrected surfaces pass through the points given, keep their continuation, seams and poles, and move by no more than asked."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad._typing import Array
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.brep.surface_correction import absorb_continuation, correct_surface
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.knots import greville_abscissae, uniform_knots

RNG = np.random.default_rng(2)
T = np.linspace(0.0, 1.0, 241)


def bumpy(degrees: tuple[int, int], spans: tuple[int, int]) -> FreeFormSurface:
    """A surface of 10 x 4 with bumps of 0.3 that goes on by 0.2."""
    knots = [uniform_knots(n, p) for p, n in zip(degrees, spans, strict=True)]
    u, v = (greville_abscissae(k, p) for k, p in zip(knots, degrees, strict=True))
    poles = np.stack(np.broadcast_arrays(10 * u[:, None], 4 * v, 0.0), axis=-1)
    poles[..., 2] = 0.3 * np.sin(3 * u[:, None]) * np.cos(2 * v)
    return FreeFormSurface(BSplineSurface(poles, *knots, *degrees), continuation=0.2)


def tube(pole: bool = False) -> FreeFormSurface:
    """A surface closed along u, of degrees 5 and 4; with `pole` its side of high v is one point, where it is flat."""
    degree, n = 5, 12
    period = np.arange(-2 * n, 2 * n + 1) / n
    angle = 2 * np.pi * np.arange(n) / n
    ring = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    from scipy.interpolate import BSpline

    endless = period[2 * n - degree : 3 * n + degree + 1]
    knots = uniform_knots(n, degree)
    closed = BSpline(endless, ring[np.arange(n + degree) % n], degree)
    sites = greville_abscissae(knots, degree)
    from tpmscad.splines.basis import design_matrix

    circle = np.linalg.solve(design_matrix(knots, degree, sites), closed(sites))
    knots_v = uniform_knots(3, 4)
    v = greville_abscissae(knots_v, 4)
    radius = 3.0 * (1.0 - v) if pole else 3.0 + 0.5 * np.sin(2 * v)
    height = -((1.0 - v) ** 2) if pole else 5.0 * v
    poles = circle[:, None] * radius[:, None] + np.array([0.0, 0.0, 1.0]) * height[:, None]
    return FreeFormSurface(BSplineSurface(poles, knots, knots_v, degree, 4), (True, False))


def borders(surface: FreeFormSurface, sides: str) -> Array:
    (u0, u1), (v0, v1) = surface.domain
    along_u, along_v = u0 + (u1 - u0) * T, v0 + (v1 - v0) * T
    lines = {
        "b": (along_u, 0 * T + v0),
        "t": (along_u, 0 * T + v1),
        "l": (0 * T + u0, along_v),
        "r": (0 * T + u1, along_v),
    }
    return np.concatenate([surface(*lines[side]) for side in sides])


def shifted(points: Array, gap: float) -> Array:
    """Points moved by at most `gap`, smoothly in space."""
    x, y, z = points.T
    off = np.stack([np.cos(y + z), np.sin(0.7 * x), np.sin(0.4 * x + 0.8 * y)], axis=1)
    return points + gap / np.sqrt(3) * off


@pytest.mark.parametrize(("degrees", "spans"), [((3, 4), (4, 2)), ((5, 3), (1, 3)), ((9, 2), (2, 1))])
@pytest.mark.parametrize("gap", [1e-6, 1e-3])
def test_it_passes_through_the_points_and_moves_no_farther_than_they_are(degrees, spans, gap: float) -> None:
    surface = bumpy(degrees, spans)
    points = shifted(borders(surface, "btlr"), gap)
    assert np.abs(surface.distance(points)).max() > 0.3 * gap
    found = correct_surface(surface, points, 1e-9)
    off = np.abs(found.surface.distance(points)).max()
    assert off < max(1e-3 * gap, 1e-9)
    assert off <= found.left * (1 + 1e-9)
    assert found.move < 1.5 * gap
    uv = RNG.random((500, 2))
    moved = np.linalg.norm(found.surface(*uv.T) - surface(*uv.T), axis=1)
    assert moved.max() <= 1.05 * found.move
    between = shifted(surface(0 * T[:-1], 0.5 * (T[1:] + T[:-1])), gap)
    assert np.abs(found.surface.distance(between)).max() < max(2e-3 * gap, 1e-9)


def test_the_continuation_becomes_a_part_of_the_domain() -> None:
    surface = bumpy((3, 4), (4, 2))
    wide = absorb_continuation(surface)
    (u0, u1), (v0, v1) = wide.domain
    assert u0 < -0.015
    assert u1 > 1.015
    assert v0 < -0.04
    assert v1 > 1.04
    uv = RNG.random((100, 2))
    np.testing.assert_allclose(wide(*uv.T), surface(*uv.T), atol=1e-13)
    edge, step = np.array([[u0, 0.3], [0.0, 0.3]]), 1e-3  # the same polynomial on both sides of the old border
    beyond = [wide(-2 * step, 0.3), wide(-step, 0.3), wide(0.0, 0.3), wide(step, 0.3), wide(2 * step, 0.3)]
    assert np.linalg.norm(np.diff(np.array(beyond), 4, axis=0)) < 1e-11
    assert np.linalg.norm(wide(*edge[0]) - wide(*edge[1])) == pytest.approx(0.2, rel=0.05)


def test_a_closed_surface_stays_closed_and_smooth() -> None:
    surface = tube()
    points = shifted(borders(surface, "bt"), 1e-3)
    found = correct_surface(surface, points, 1e-9)
    assert found.surface.closed == (True, False)
    assert np.abs(found.surface.distance(points)).max() < 1e-6
    t = np.linspace(0, 1, 31)
    spline = found.surface.spline
    for order in range(4):
        low, high = spline(0 * t, t, order, 0), spline(0 * t + 1, t, order, 0)
        assert np.abs(low - high).max() < 1e-9 * max(1.0, np.abs(low).max())


def test_a_pole_keeps_its_place_and_its_tangent_plane() -> None:
    surface = tube(pole=True)
    before = surface.feet(np.array([[0.0, 0.0, 0.5]]))
    points = shifted(borders(surface, "b"), 1e-3)
    found = correct_surface(surface, points, 1e-9)
    assert np.abs(found.surface.distance(points)).max() < 1e-6
    spline = found.surface.spline
    assert np.ptp(spline.poles[:, -1], axis=0).max() < 1e-14
    np.testing.assert_allclose(spline.poles[0, -1], surface.spline.poles[0, -1], atol=1e-14)
    after = found.surface.feet(np.array([[0.0, 0.0, 0.5]]))
    np.testing.assert_allclose(after.gradient, before.gradient, atol=1e-9)
