"""A curved face's moments as line integrals along the pieces of its loops (Green), over S_u x S_v, before it is placed:

    int_D f du dv = loop int F dv,   F(u, v) = int_{u0}^{u} f(s, v) ds,   counter-clockwise loops,

exact to round-off for polynomial patches; the area's square root converges with the order of the rule. On quadrics all integrands
are trigonometric polynomials of u, of order three at most, so F has a closed form there.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from tpmscad.patches.carriers import Circle, EdgeCurve, Ellipse, Quadric, Sphere, Torus
from tpmscad.patches.complex import Array
from tpmscad.patches.conics import TURN
from tpmscad.splines.bspline import Curve, Surface, design

COLUMNS = 16
"""Area, N (3), M (9), Q (3), as in `measure`."""

LONE_SPAN, MANY_SPANS = 18, 10
"""Gauss points of a loop curve's only span, and of each of several. Measured on degree-9 gyroid patches in a cylinder: 16 for
each span move no face's moment by more than 3e-14 (cell 1)."""

ARC = np.pi / 2
"""Angle along a curve, or along a loop on a quadric, over which MANY_SPANS take all integrands (order four) to round-off."""

ORDER = 3
"""Of the integrands on a quadric as trigonometric polynomials of u: x (x . n) holds three directions across the axis."""

AT_ONCE = 4000
"""Nodes of loops evaluated at once; each takes some twenty points of the surface."""

Pieces = Sequence[tuple[Curve, tuple[float, float]]]
"""Parameter curves and the spans of them that are meant."""


def curved_pieces(surface: Surface | Quadric, pieces: Pieces) -> Array:
    """The line integral of F dv along each piece: (n, COLUMNS)."""
    u, v, rise, of = _nodes(surface, pieces)
    result = np.zeros((len(pieces), COLUMNS))
    for start in range(0, len(u), AT_ONCE):
        at = slice(start, start + AT_ONCE)
        inner = (
            _on_spline(surface, u[at], v[at]) if isinstance(surface, Surface) else _on_quadric(surface, u[at], v[at])
        )
        np.add.at(result, of[at], rise[at, None] * inner)
    return result


def _nodes(surface: Surface | Quadric, pieces: Pieces) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """u, v, and v' times weight at the Gauss nodes of all pieces, and which piece each is of; none where v' = 0."""
    found, of = [], []
    for i, (pcurve, span) in enumerate(pieces):
        nodes, weights = span_rule(pcurve, span, _breaks(surface, pcurve, span))
        rise = weights * pcurve(nodes, 1)[:, 1]
        if rise.any():
            found.append(np.column_stack([pcurve(nodes), rise]))
            of.append(np.full(len(nodes), i))
    if not found:
        return np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, np.int64)
    u, v, rise = np.concatenate(found).T
    return u, v, rise, np.concatenate(of)


def _breaks(surface: Surface | Quadric, pcurve: Curve, span: tuple[float, float]) -> Array:
    if isinstance(surface, Surface):
        return _knot_crossings(surface, pcurve, span)
    angles = pcurve.poles if isinstance(surface, Sphere | Torus) else pcurve.poles[:, :1]
    pieces = int(np.ceil(np.abs(np.diff(angles, axis=0)).sum() / ARC))
    return np.linspace(*pcurve.domain, pieces + 1)


def _knot_crossings(surface: Surface, pcurve: Curve, span: tuple[float, float]) -> Array:
    """Where the parameter curve passes an inner knot of the surface, where derivatives may jump."""
    found = []
    for axis, knots in ((0, surface.knots_u), (1, surface.knots_v)):
        inner = np.unique(knots)[1:-1]
        if len(inner):
            piecewise = PPoly.from_spline((pcurve.knots, pcurve.poles[:, axis], pcurve.degree))
            found += [piecewise.solve(knot, extrapolate=False) for knot in inner]
    at = np.concatenate([np.zeros(0), *found])
    return at[np.isfinite(at) & (at > span[0]) & (at < span[1])]


def span_rule(curve: EdgeCurve, span: tuple[float, float], also: Array | None = None) -> tuple[Array, Array]:
    """Composite Gauss nodes and weights on a piece of the curve, broken at its knots and at further parameters."""
    low, high = span
    knots = np.arange(low, high, ARC) if isinstance(curve, Circle | Ellipse) else curve.knots
    inside = np.unique(knots if also is None else np.concatenate([knots, also]))
    breaks = np.concatenate([[low], inside[(inside > low) & (inside < high)], [high]])
    x, w = gauss(LONE_SPAN if len(breaks) == 2 else MANY_SPANS)
    half = 0.5 * np.diff(breaks)[:, None]
    return (breaks[:-1, None] + half + half * x).ravel(), (half * w).ravel()


@lru_cache(maxsize=64)
def gauss(points: int) -> tuple[Array, Array]:
    """Nodes in [-1, 1] and weights."""
    x, w = leggauss(points)
    return x, w


def _on_quadric(quadric: Quadric, u: Array, v: Array) -> Array:
    """F at the pairs (u, v): (n, COLUMNS)."""
    samples = np.arange(2 * ORDER + 1) * TURN / (2 * ORDER + 1)
    x = quadric(samples, v[:, None])
    n = np.cross(quadric(samples, v[:, None], 1, 0), quadric(samples, v[:, None], 0, 1))
    return _columns(x, n, to_antiderivative(u, samples))


def to_antiderivative(u: Array, samples: Array) -> Array:
    """Matrix from samples of a trigonometric polynomial to its integral from 0 to u: (len(u), 2 ORDER + 1).

    Of order ORDER and sampled at equal steps of a turn, it is the sum of its samples times D(s - s_k), with
    D(s) = (1 + 2 sum_m cos m s) / (2 ORDER + 1).
    """
    m = np.arange(1, ORDER + 1)
    step = u[:, None, None] - samples[:, None]
    waves = (np.sin(m * step) + np.sin(m * samples[:, None])) / m
    return np.asarray((u[:, None] + 2.0 * waves.sum(axis=-1)) / len(samples))


def _on_spline(surface: Surface, u: Array, v: Array) -> Array:
    """F at the pairs (u, v): (n, COLUMNS). Across each knot cell by Gauss, in all of them up to u."""
    poles = np.swapaxes(surface.poles, 0, 1).reshape(surface.poles.shape[1], -1)
    ruled, slope = (
        (design(surface.knots_v, surface.degree_v, v, order) @ poles).reshape(len(v), -1, 3) for order in (0, 1)
    )
    x, w = gauss(2 * surface.degree_u + 1)
    breaks = np.unique(surface.knots_u)
    result = np.zeros((len(u), COLUMNS))
    for low, high in zip(breaks[:-1], breaks[1:], strict=True):
        at = np.flatnonzero(u > low)
        if len(at) == 0:
            continue
        half = 0.5 * (np.minimum(u[at], high) - low)
        inner = ((low + half)[:, None] + half[:, None] * x).ravel()
        rows, along = (
            design(surface.knots_u, surface.degree_u, inner, order).reshape(len(at), len(x), -1) for order in (0, 1)
        )
        points, normal = rows @ ruled[at], np.cross(along @ ruled[at], rows @ slope[at])
        result[at] += _columns(points, normal, half[:, None] * w)
    return result


def _columns(x: Array, n: Array, weights: Array) -> Array:
    """Sums over the points x (n, m, 3) with normals n, weighted (n, m): (n, COLUMNS)."""
    area = (np.sqrt((n * n).sum(-1)) * weights).sum(axis=1)
    weighted = n * weights[:, :, None]
    first = np.swapaxes(x, 1, 2) @ weighted
    cone = (x * weighted).sum(-1)
    second = (cone[:, None, :] @ x)[:, 0]
    return np.concatenate([area[:, None], weighted.sum(axis=1), first.reshape(-1, 9), second], axis=1)
