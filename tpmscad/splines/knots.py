"""Knot insertion, and what follows from it: splitting, restricting, degree elevation. The surface stays the same to round-off.

Pieces of one surface share the poles of their common border bit for bit, and so do pieces of two surfaces that share a border.
"""

from __future__ import annotations

from math import comb

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.bspline import BSplineSurface


def insert_knot(poles: Array, knots: Array, degree: int, t: float, times: int = 1) -> tuple[Array, Array]:
    """Poles (N + times, ...) and knots after inserting the knot t, which must be inside the domain, so many times (Boehm)."""
    for _ in range(times):
        k = int(np.searchsorted(knots, t, side="right")) - 1
        repeats = int(np.count_nonzero(knots == t))
        if not knots[degree] < t < knots[-degree - 1] or repeats >= degree:
            raise ValueError(
                f"a knot at {t} can't be inserted: outside ({knots[degree]}, {knots[-degree - 1]}) or full"
            )
        i = np.arange(k - degree + 1, k - repeats + 1)
        ratio = ((t - knots[i]) / (knots[i + degree] - knots[i])).reshape(-1, *(1,) * (poles.ndim - 1))
        mixed = (1 - ratio) * poles[i - 1] + ratio * poles[i]
        poles = np.concatenate([poles[: k - degree + 1], mixed, poles[k - repeats :]])
        knots = np.insert(knots, k + 1, t)
    return poles, knots


def split_surface(surface: BSplineSurface, direction: int, t: float) -> tuple[BSplineSurface, BSplineSurface]:
    """The surface in two at u = t (direction 0) or v = t (1), each on its part of the domain."""
    poles, knots, degree = _direction_arrays(surface, direction)
    repeats = int(np.count_nonzero(knots == t))
    poles, knots = insert_knot(poles, knots, degree, t, degree - repeats)
    first = int(np.searchsorted(knots, t))
    border = first - 1  # the pole that the surface at t interpolates
    low = _replace_direction(surface, direction, poles[: border + 1], np.append(knots[: first + degree], t))
    high = _replace_direction(surface, direction, poles[border:], np.insert(knots[first:], 0, t))
    return low, high


def restrict_surface(surface: BSplineSurface, u: tuple[float, float], v: tuple[float, float]) -> BSplineSurface:
    """The piece of the surface on [u0, u1] x [v0, v1], a rectangle in its domain."""
    for direction, (low, high) in enumerate((u, v)):
        start, end = surface.domain[direction]
        if not start <= low < high <= end:
            raise ValueError(f"[{low}, {high}] is not an interval in [{start}, {end}]")
        if low > start:
            surface = split_surface(surface, direction, low)[1]
        if high < end:
            surface = split_surface(surface, direction, high)[0]
    return surface


def elevate_degree(surface: BSplineSurface, degree_u: int, degree_v: int) -> BSplineSurface:
    """The same one-span (Bezier) surface with poles for higher degrees."""
    for direction, degree in ((0, degree_u), (1, degree_v)):
        poles, knots, old = _direction_arrays(surface, direction)
        if len(poles) != old + 1 or degree < old:
            raise ValueError(
                f"degree {old} with {len(poles)} poles can't be elevated to {degree}: one span, upwards only"
            )
        matrix = _elevation_matrix(old, degree)
        raised = np.einsum("ij,j...->i...", matrix, poles)
        domain = float(knots[old]), float(knots[-old - 1])
        raised_knots = np.repeat(np.array(domain), degree + 1)
        raised = raised if direction == 0 else raised.swapaxes(0, 1)
        knots_u, knots_v = (raised_knots, surface.knots_v) if direction == 0 else (surface.knots_u, raised_knots)
        pu, pv = (degree, surface.degree_v) if direction == 0 else (surface.degree_u, degree)
        surface = BSplineSurface(raised, knots_u, knots_v, pu, pv)
    return surface


def _elevation_matrix(low: int, high: int) -> Array:
    """Bernstein coefficients of degree `high` from those of degree `low`: (high + 1, low + 1)."""
    return np.array(
        [
            [
                comb(low, j) * comb(high - low, i - j) / comb(high, i) if 0 <= i - j <= high - low else 0.0
                for j in range(low + 1)
            ]
            for i in range(high + 1)
        ]
    )


def _direction_arrays(surface: BSplineSurface, direction: int) -> tuple[Array, Array, int]:
    if direction == 0:
        return surface.poles, surface.knots_u, surface.degree_u
    return surface.poles.swapaxes(0, 1), surface.knots_v, surface.degree_v


def _replace_direction(surface: BSplineSurface, direction: int, poles: Array, knots: Array) -> BSplineSurface:
    if direction == 0:
        return BSplineSurface(poles.copy(), knots, surface.knots_v, surface.degree_u, surface.degree_v)
    return BSplineSurface(poles.swapaxes(0, 1).copy(), surface.knots_u, knots, surface.degree_u, surface.degree_v)
