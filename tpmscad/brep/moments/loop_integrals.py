"""A curved face's moments as line integrals along the pieces of its loops (Green), over S_u x S_v, before it is placed:

    int_D f du dv = loop int F dv,   F(u, v) = int_{u0}^{u} f(s, v) ds,   counter-clockwise loops,

exact to round-off for polynomial patches; the area's square root converges with the order of the rule. On quadrics all integrands
are trigonometric polynomials of u, of order three at most, so F has a closed form there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from tpmscad._typing import Array
from tpmscad.brep.carriers import Circle, EdgeCurve, Ellipse, Quadric, SphericalSurface, ToroidalSurface
from tpmscad.brep.conics import TWO_PI
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.splines.curve_batch import evaluate_curves
from tpmscad.splines.quadrature import composite_gauss_legendre, gauss_legendre_unit

N_MOMENTS = 16
"""Area, N (3), M (9), Q (3), as in `measure`."""

GAUSS_POINTS_SINGLE_SPAN, GAUSS_POINTS_FEW_SPANS, GAUSS_POINTS_MANY_SPANS = 18, 10, 6
"""Gauss points of a loop curve's only span, of each of several, and of each of FINE or more between knots. Measured on degree-9
gyroid patches in a cylinder: 16 for each span move no face's moment by more than 3e-14 (cell 1), 10 for each of FINE by 6e-15."""

MANY_SPANS_THRESHOLD = 4

MAX_ARC_RADIANS = np.pi / 2
"""Angle along a curve, or along a loop on a quadric, over which MANY_SPANS take all integrands (order four) to round-off."""

TRIGONOMETRIC_ORDER = 3
"""Of the integrands on a quadric as trigonometric polynomials of u: x (x . n) holds three directions across the axis."""

NODES_PER_BATCH = 4000
"""Nodes of loops evaluated at once; each takes some twenty points of the surface."""

PcurveSpans = Sequence[tuple[BSplineCurve, tuple[float, float]]]
"""Parameter curves and the spans of them that are meant."""


def integrate_pcurves(surface: BSplineSurface | Quadric, pieces: PcurveSpans) -> Array:
    """The line integral of F dv along each piece: (n, COLUMNS)."""
    u, v, rise, of = pcurve_gauss_nodes(surface, pieces)
    result = np.zeros((len(pieces), N_MOMENTS))
    for start in range(0, len(u), NODES_PER_BATCH):
        at = slice(start, start + NODES_PER_BATCH)
        inner = (
            _antiderivative_on_spline(surface, u[at], v[at])
            if isinstance(surface, BSplineSurface)
            else _antiderivative_on_quadric(surface, u[at], v[at])
        )
        np.add.at(result, of[at], rise[at, None] * inner)
    return result


def pcurve_gauss_nodes(
    surface: BSplineSurface | Quadric, pieces: PcurveSpans
) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """u, v, and v' times weight at the Gauss nodes of all pieces, and which piece each is of; none where v' = 0."""
    curves = [pcurve for pcurve, _ in pieces]
    breaks = _break_finder(surface)
    rules = [_pcurve_rule(breaks(pcurve, span), pcurve, span) for pcurve, span in pieces]
    of = np.repeat(np.arange(len(pieces)), [len(nodes) for nodes, _ in rules])
    place, slope = evaluate_curves(curves, of, np.concatenate([nodes for nodes, _ in rules]), (0, 1))
    rise = slope[:, 1] * np.concatenate([weights for _, weights in rules])
    moving = np.zeros(len(pieces), bool)
    moving[of[rise != 0]] = True
    at = moving[of]
    return place[at, 0], place[at, 1], rise[at], of[at]


def _pcurve_rule(breaks: Array, pcurve: BSplineCurve, span: tuple[float, float]) -> tuple[Array, Array]:
    return (
        _cached_knot_rule(pcurve.knots.tobytes(), *span)
        if len(breaks) == 0
        else composite_curve_rule(pcurve, span, breaks)
    )


@lru_cache(maxsize=4096)
def _cached_knot_rule(knots: bytes, low: float, high: float) -> tuple[Array, Array]:
    """`span_rule` broken at knots only: the curves cut on a lattice have a dozen knot vectors in all."""
    breaks = _clip_to_span(np.unique(np.frombuffer(knots)), (low, high))
    return (
        composite_gauss(breaks, GAUSS_POINTS_MANY_SPANS)
        if len(breaks) > MANY_SPANS_THRESHOLD
        else composite_gauss(breaks)
    )


def _break_finder(surface: BSplineSurface | Quadric) -> Callable[[BSplineCurve, tuple[float, float]], Array]:
    """What tells where else than at its knots a parameter curve's piece is broken."""
    if not isinstance(surface, BSplineSurface):
        return partial(_angle_breaks, isinstance(surface, SphericalSurface | ToroidalSurface))
    inner = [np.unique(knots)[1:-1] for knots in (surface.knots_u, surface.knots_v)]
    return partial(_knot_crossings, inner) if any(len(k) for k in inner) else _no_breaks


def _no_breaks(pcurve: BSplineCurve, span: tuple[float, float]) -> Array:
    return np.zeros(0)


def _angle_breaks(both: bool, pcurve: BSplineCurve, span: tuple[float, float]) -> Array:
    angles = pcurve.poles if both else pcurve.poles[:, :1]
    pieces = int(np.ceil(np.abs(np.diff(angles, axis=0)).sum() / MAX_ARC_RADIANS))
    return np.linspace(*pcurve.domain, pieces + 1) if pieces > 1 else np.zeros(0)


def _knot_crossings(inner: Sequence[Array], pcurve: BSplineCurve, span: tuple[float, float]) -> Array:
    """Where the parameter curve passes an inner knot of the surface, where derivatives may jump."""
    found = []
    for axis, knots in enumerate(inner):
        if len(knots):
            piecewise = PPoly.from_spline((pcurve.knots, pcurve.poles[:, axis], pcurve.degree))
            found += [piecewise.solve(knot, extrapolate=False) for knot in knots]
    at = np.concatenate([np.zeros(0), *found])
    return at[np.isfinite(at) & (at > span[0]) & (at < span[1])]


def composite_curve_rule(curve: EdgeCurve, span: tuple[float, float], also: Array | None = None) -> tuple[Array, Array]:
    """Composite Gauss nodes and weights on a piece of the curve, broken at its knots and at further parameters."""
    knots = np.arange(*span, MAX_ARC_RADIANS) if isinstance(curve, Circle | Ellipse) else curve.knots
    return composite_gauss(_clip_to_span(np.unique(knots if also is None else np.concatenate([knots, also])), span))


def composite_gauss(breaks: Array, points: int | None = None) -> tuple[Array, Array]:
    """Gauss nodes and weights between consecutive breaks, with as many points per interval as the moments need."""
    points = points or (GAUSS_POINTS_SINGLE_SPAN if len(breaks) == 2 else GAUSS_POINTS_FEW_SPANS)
    return composite_gauss_legendre(breaks, points)


def _clip_to_span(inside: Array, span: tuple[float, float]) -> Array:
    """The ends of the span, and the parameters between them."""
    low, high = span
    return np.concatenate([[low], inside[(inside > low) & (inside < high)], [high]])


def _antiderivative_on_quadric(quadric: Quadric, u: Array, v: Array) -> Array:
    """F at the pairs (u, v): (n, COLUMNS). With e = e(u_k): S = origin + r e + z axis, S_u x S_v = r (z' e - r' axis)."""
    samples = np.arange(2 * TRIGONOMETRIC_ORDER + 1) * TWO_PI / (2 * TRIGONOMETRIC_ORDER + 1)
    e = np.cos(samples)[:, None] * quadric.x_axis + np.sin(samples)[:, None] * quadric.y_axis
    profile, slope = quadric(0.0, v) - quadric.origin, quadric(0.0, v, 0, 1)
    (r, z), (dr, dz) = ((a @ quadric.x_axis, a @ quadric.axis) for a in (profile, slope))
    x = quadric.origin + r[:, None, None] * e + (z[:, None] * quadric.axis)[:, None]
    n = (r * dz)[:, None, None] * e - ((r * dr)[:, None] * quadric.axis)[:, None]
    return sum_moments(x, n, antiderivative_matrix(u, samples))


def antiderivative_matrix(u: Array, samples: Array) -> Array:
    """Matrix from samples of a trigonometric polynomial to its integral from 0 to u: (len(u), 2 ORDER + 1).

    Of order ORDER and sampled at equal steps of a turn, it is the sum of its samples times D(s - s_k), with
    D(s) = (1 + 2 sum_m cos m s) / (2 ORDER + 1).
    """
    m = np.arange(1, TRIGONOMETRIC_ORDER + 1)
    cosines, sines = np.cos(np.outer(m, samples)) / m[:, None], np.sin(np.outer(m, samples)) / m[:, None]
    waves = np.sin(np.outer(u, m)) @ cosines + (1.0 - np.cos(np.outer(u, m))) @ sines
    return np.asarray((u[:, None] + 2.0 * waves) / len(samples))


def _antiderivative_on_spline(surface: BSplineSurface, u: Array, v: Array) -> Array:
    """F at the pairs (u, v): (n, COLUMNS). Across each knot cell by Gauss, in all of them up to u."""
    poles = np.swapaxes(surface.poles, 0, 1).reshape(surface.poles.shape[1], -1)
    ruled = np.concatenate(
        [
            (design_matrix(surface.knots_v, surface.degree_v, v, order) @ poles).reshape(len(v), -1, 3)
            for order in (0, 1)
        ],
        axis=2,
    )  # the poles of S and of S_v along u, at every v: (n, U, 6)
    degree = surface.degree_u
    x, w = gauss_legendre_unit(2 * degree + 1)
    unit = np.repeat([0.0, 1.0], degree + 1)
    values, slopes = (design_matrix(unit, degree, x, order) for order in (0, 1))
    breaks = np.unique(surface.knots_u)
    result = np.zeros((len(u), N_MOMENTS))
    for low, high in zip(breaks[:-1], breaks[1:], strict=True):
        at = np.flatnonzero(u > low)
        if len(at) == 0:
            continue
        part = (np.minimum(u[at], high) - low) / (high - low)
        own = _restrict_bernstein(
            np.tensordot(_bernstein_conversion(surface.knots_u, degree, low, high), ruled[at], (1, 1)), part
        )
        own = own.reshape(degree + 1, -1)
        along = (values @ own).reshape(len(x), -1, 6)
        normal = _cross((slopes @ own).reshape(len(x), -1, 6)[..., :3], along[..., 3:])
        result[at] += sum_moments(np.swapaxes(along[..., :3], 0, 1), np.swapaxes(normal, 0, 1), w)
    return result


def _bernstein_conversion(knots: Array, degree: int, low: float, high: float) -> Array:
    """From the poles along all knots to the Bernstein coefficients on one interval between knots."""
    x = 0.5 - 0.5 * np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
    own = design_matrix(np.repeat([0.0, 1.0], degree + 1), degree, x)
    return np.asarray(np.linalg.solve(own, design_matrix(knots, degree, low + (high - low) * x)))


def _restrict_bernstein(coefficients: Array, part: Array) -> Array:
    """Bernstein coefficients (p + 1, n, k) on [0, 1] to those on [0, part], part (n,): de Casteljau's algorithm."""
    result = coefficients.copy()
    for j in range(1, len(result)):
        result[j:] = result[j - 1 : -1] + part[:, None] * (result[j:] - result[j - 1 : -1])
    return result


def _cross(a: Array, b: Array) -> Array:
    """a x b: (..., 3)."""
    (x, y, z), (p, q, r) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([y * r - z * q, z * p - x * r, x * q - y * p], axis=-1)


def sum_moments(x: Array, n: Array, weights: Array) -> Array:
    """Sums over the points x (n, m, 3) with normals n, weighted (n, m) or (m,): (n, COLUMNS)."""
    area = (np.sqrt((n * n).sum(-1)) * weights).sum(axis=1)
    weighted = n * weights[..., None]
    first = np.swapaxes(x, 1, 2) @ weighted
    cone = (x * weighted).sum(-1)
    second = (cone[:, None, :] @ x)[:, 0]
    return np.concatenate([area[:, None], weighted.sum(axis=1), first.reshape(-1, 9), second], axis=1)
