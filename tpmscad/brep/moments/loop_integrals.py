"""Moments of curved faces as line integrals along the spans of their pcurves, by Green's theorem.

In the parameter plane,

    int_D f du dv = loop int F dv,   F(u, v) = int_{u0}^{u} f(s, v) ds,   loops counter-clockwise,

with normals S_u x S_v and before placement. Exact to round-off for polynomial patches, but for the area, whose square root
converges with the order of the rule. On quadrics the integrands are trigonometric polynomials of u of order three at most, and F
has a closed form. A *span* is the part of a pcurve that an edge uses.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from tpmscad._typing import Array
from tpmscad.brep.carriers import Circle, EdgeCurve, Ellipse, Quadric, SphericalSurface, ToroidalSurface
from tpmscad.brep.conics import TWO_PI
from tpmscad.splines.basis import design_matrix, power_coefficients
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.splines.curve_batch import evaluate_curves
from tpmscad.splines.quadrature import composite_gauss_legendre, gauss_legendre_unit

N_MOMENTS = 16
"""Columns of an array of moments: A (1), N (3), M (9), Q (3), as in `integral_properties`."""

GAUSS_POINTS_SINGLE_SPAN = 18
"""Gauss points if a pcurve has one knot span: enough for moments to round-off on patches of degree 9, as the next two are."""

GAUSS_POINTS_FEW_SPANS = 10
"""Gauss points on each of several knot spans."""

GAUSS_POINTS_MANY_SPANS = 6
"""Gauss points on each knot span if there are at least `MANY_SPANS_THRESHOLD` of them."""

MIN_AREA_POINTS = 16
"""Least Gauss points on each knot interval along u: the area density contains a square root and is no polynomial."""

MANY_SPANS_THRESHOLD = 4
"""Knot spans from which on fewer Gauss points suffice on each."""

MAX_ARC_RADIANS = np.pi / 2
"""Angle along a conic, or along a pcurve on a quadric, on which the rules integrate trigonometric order four to round-off."""

TRIGONOMETRIC_ORDER = 3
"""Order of the integrands on a quadric as trigonometric polynomials of u: x (x . n) has three radial factors."""

NODES_PER_BATCH = 4000
"""Nodes evaluated per batch; each takes about twenty points of the surface."""

PcurveSpans = Sequence[tuple[BSplineCurve, tuple[float, float]]]
"""Pcurves, each with the span (low, high) to integrate along."""


def integrate_pcurves(surface: BSplineSurface | Quadric, spans: PcurveSpans, first_knots: Array | None = None) -> Array:
    """The line integrals of F dv along n pcurve spans, for the 16 moments: (n, 16).

    `first_knots` (n,): the knots u0 of a spline, or the angles on a quadric, from which F is integrated, one for all spans of a
    face and not beyond any of them; the first knot, or 0, by default. Over a closed loop they make no difference but for the
    work, the rounding, and the gaps of up to 1e-8 between the ends of pcurves, which count times F.
    """
    return integrate_at_nodes(surface, *pcurve_gauss_nodes(surface, spans), len(spans), first_knots)


def integrate_at_nodes(
    surface: BSplineSurface | Quadric,
    u: Array,
    v: Array,
    dv_weights: Array,
    part: NDArray[np.int64],
    n_parts: int,
    first_knots: Array | None = None,
) -> Array:
    """The sums of F dv over quadrature nodes, for the 16 moments and each part of a loop: (n_parts, 16).

    u, v, dv_weights, part (m,): of each node the parameters, the weight times dv/dt, and the part it lies on.
    first_knots (n_parts,): as in `integrate_pcurves`.
    """
    result = np.zeros((n_parts, N_MOMENTS))
    for start in range(0, len(u), NODES_PER_BATCH):
        at = slice(start, start + NODES_PER_BATCH)
        first = None if first_knots is None else first_knots[part[at]]
        inner = (
            _antiderivative_on_spline(surface, u[at], v[at], first)
            if isinstance(surface, BSplineSurface)
            else _antiderivative_on_quadric(surface, u[at], v[at], first)
        )
        np.add.at(result, part[at], dv_weights[at, None] * inner)
    return result


def pcurve_gauss_nodes(
    surface: BSplineSurface | Quadric, spans: PcurveSpans
) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """u, v, weight times dv/dt and span index at the Gauss nodes of all spans; spans along which v is constant have none."""
    curves = [pcurve for pcurve, _ in spans]
    all_knots = (surface.knots_u, surface.knots_v) if isinstance(surface, BSplineSurface) else ()
    inner = [np.unique(knots)[1:-1] for knots in all_knots]
    rules = [_pcurve_rule(_find_breaks(surface, inner, pcurve, span), pcurve, span) for pcurve, span in spans]
    span_of_node = np.repeat(np.arange(len(spans)), [len(nodes) for nodes, _ in rules])
    place, slope = evaluate_curves(curves, span_of_node, np.concatenate([nodes for nodes, _ in rules]), (0, 1))
    dv_weights = slope[:, 1] * np.concatenate([weights for _, weights in rules])
    moving = np.zeros(len(spans), bool)
    moving[span_of_node[dv_weights != 0]] = True
    at = moving[span_of_node]
    return place[at, 0], place[at, 1], dv_weights[at], span_of_node[at]


def _pcurve_rule(breaks: Array, pcurve: BSplineCurve, span: tuple[float, float]) -> tuple[Array, Array]:
    """Gauss nodes and weights on a span of a pcurve, split at its knots and at further breaks."""
    if len(breaks) == 0:
        return _cached_knot_rule(pcurve.knots.tobytes(), *span)
    return composite_curve_rule(pcurve, span, breaks)


@lru_cache(maxsize=4096)
def _cached_knot_rule(knots: bytes, low: float, high: float) -> tuple[Array, Array]:
    """The rule split at knots only, cached: the pcurves of a cut lattice share a dozen knot vectors."""
    breaks = _clip_to_span(np.unique(np.frombuffer(knots)), (low, high))
    return composite_gauss(breaks, GAUSS_POINTS_MANY_SPANS if len(breaks) > MANY_SPANS_THRESHOLD else None)


def _find_breaks(
    surface: BSplineSurface | Quadric, inner: Sequence[Array], pcurve: BSplineCurve, span: tuple[float, float]
) -> Array:
    """The parameters, besides knots, at which to split a span of a pcurve on a surface.

    On a quadric they limit the angle, along u or along both periodic parameters, between consecutive ones. On a spline the pcurve
    crosses one of the `inner` knots (along u and along v) there, across which derivatives may jump.
    """
    if not isinstance(surface, BSplineSurface):
        angles = pcurve.poles if isinstance(surface, SphericalSurface | ToroidalSurface) else pcurve.poles[:, :1]
        pieces = int(np.ceil(np.abs(np.diff(angles, axis=0)).sum() / MAX_ARC_RADIANS))
        return np.linspace(*pcurve.domain, pieces + 1) if pieces > 1 else np.zeros(0)
    found = []
    for axis, knots in enumerate(inner):
        poles = pcurve.poles[:, axis]
        if not ((knots >= poles.min()) & (knots <= poles.max())).any():
            continue
        breaks, coefficients = power_coefficients(pcurve.knots, poles, pcurve.degree)
        last = np.searchsorted(pcurve.knots, breaks[:-1], side="right") - 1
        own = poles[last[:, None] - np.arange(pcurve.degree + 1)]
        crossed = (knots >= own.min(axis=1)[:, None]) & (knots <= own.max(axis=1)[:, None])  # a piece lies in the hull
        for piece, k in np.argwhere(crossed).tolist():
            part = PPoly(coefficients[:, piece : piece + 1], breaks[piece : piece + 2])
            found.append(part.solve(knots[k], extrapolate=False))
    at = np.concatenate([np.zeros(0), *found])
    return at[np.isfinite(at) & (at > span[0]) & (at < span[1])]


def composite_curve_rule(
    curve: EdgeCurve, span: tuple[float, float], breaks: Array | None = None
) -> tuple[Array, Array]:
    """Composite Gauss nodes and weights on a span of a curve, split at its knots and at further breaks."""
    knots = np.arange(*span, MAX_ARC_RADIANS) if isinstance(curve, Circle | Ellipse) else curve.knots
    return composite_gauss(_clip_to_span(np.unique(knots if breaks is None else np.concatenate([knots, breaks])), span))


def composite_gauss(breaks: Array, points: int | None = None) -> tuple[Array, Array]:
    """Gauss nodes and weights between consecutive breaks, with as many points per interval as the moments need."""
    points = points or (GAUSS_POINTS_SINGLE_SPAN if len(breaks) == 2 else GAUSS_POINTS_FEW_SPANS)
    return composite_gauss_legendre(breaks, points)


def _clip_to_span(inside: Array, span: tuple[float, float]) -> Array:
    """The ends of a span and the parameters strictly between them, ascending."""
    low, high = span
    return np.concatenate([[low], inside[(inside > low) & (inside < high)], [high]])


def _antiderivative_on_quadric(quadric: Quadric, u: Array, v: Array, start: Array | None) -> Array:
    """F at the pairs (u, v), from the angles `start` (n,) or 0: (n, 16).

    S = origin + r e(u) + z axis and S_u x S_v = r (z' e(u) - r' axis).
    """
    samples = np.arange(2 * TRIGONOMETRIC_ORDER + 1) * TWO_PI / (2 * TRIGONOMETRIC_ORDER + 1)
    e = np.cos(samples)[:, None] * quadric.x_axis + np.sin(samples)[:, None] * quadric.y_axis
    profile, slope = quadric(0.0, v) - quadric.origin, quadric(0.0, v, 0, 1)
    (r, z), (dr, dz) = ((a @ quadric.x_axis, a @ quadric.axis) for a in (profile, slope))
    x = quadric.origin + r[:, None, None] * e + (z[:, None] * quadric.axis)[:, None]
    n = (r * dz)[:, None, None] * e - ((r * dr)[:, None] * quadric.axis)[:, None]
    weights = antiderivative_matrix(u, samples)
    return sum_moments(x, n, weights if start is None else weights - antiderivative_matrix(start, samples))


def antiderivative_matrix(u: Array, samples: Array) -> Array:
    """Matrix from samples of a trigonometric polynomial to its integral from 0 to u: (len(u), 2 q + 1).

    A polynomial of order q = TRIGONOMETRIC_ORDER, sampled at 2 q + 1 equal steps s_k of a turn, is the sum of its samples times
    D(s - s_k), with the Dirichlet kernel D(s) = (1 + 2 sum_m cos m s) / (2 q + 1).
    """
    m = np.arange(1, TRIGONOMETRIC_ORDER + 1)
    cosines, sines = np.cos(np.outer(m, samples)) / m[:, None], np.sin(np.outer(m, samples)) / m[:, None]
    waves = np.sin(np.outer(u, m)) @ cosines + (1.0 - np.cos(np.outer(u, m))) @ sines
    return np.asarray((u[:, None] + 2.0 * waves) / len(samples))


def _antiderivative_on_spline(surface: BSplineSurface, u: Array, v: Array, first_knot: Array | None) -> Array:
    """F at the pairs (u, v): (n, 16), by Gauss quadrature along u on every knot interval from `first_knot` (n,) up to u."""
    poles = np.swapaxes(surface.poles, 0, 1).reshape(surface.poles.shape[1], -1)
    ruled = np.concatenate(
        [
            (design_matrix(surface.knots_v, surface.degree_v, v, order) @ poles).reshape(len(v), -1, 3)
            for order in (0, 1)
        ],
        axis=2,
    )  # the poles of S and of S_v along u, at every v: (n, U, 6)
    degree = surface.degree_u
    values, slopes, w = _bernstein_rule(degree, max(2 * degree + 1, MIN_AREA_POINTS))
    breaks = np.unique(surface.knots_u)
    result = np.zeros((len(u), N_MOMENTS))
    for low, high in zip(breaks[:-1], breaks[1:], strict=True):
        at = np.flatnonzero(u > low if first_knot is None else (u > low) & (first_knot <= low))
        if len(at) == 0:
            continue
        part = (np.minimum(u[at], high) - low) / (high - low)
        support = slice(
            first := int(np.searchsorted(surface.knots_u, low, side="right")) - 1 - degree, first + degree + 1
        )
        conversion = _bernstein_conversion(surface.knots_u.tobytes(), degree, low, high)[:, support]
        own = _restrict_bernstein(np.tensordot(conversion, ruled[at, support], (1, 1)), part)
        own = own.reshape(degree + 1, -1)
        along = (values @ own).reshape(len(w), -1, 6)
        normal = _cross((slopes @ own).reshape(len(w), -1, 6)[..., :3], along[..., 3:])
        result[at] += sum_moments(np.swapaxes(along[..., :3], 0, 1), np.swapaxes(normal, 0, 1), w)
    return result


@lru_cache(maxsize=64)
def _bernstein_rule(degree: int, points: int) -> tuple[Array, Array, Array]:
    """Bernstein polynomials and their derivatives (points, degree + 1) at Gauss points on [0, 1], and the weights."""
    x, w = gauss_legendre_unit(points)
    unit = np.repeat([0.0, 1.0], degree + 1)
    return design_matrix(unit, degree, x), design_matrix(unit, degree, x, 1), w


@lru_cache(maxsize=1024)
def _bernstein_conversion(knot_bytes: bytes, degree: int, low: float, high: float) -> Array:
    """Matrix from the poles on all knots to the Bernstein coefficients on one knot interval; patches of a lattice share it."""
    knots = np.frombuffer(knot_bytes)
    x = 0.5 - 0.5 * np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
    own = design_matrix(np.repeat([0.0, 1.0], degree + 1), degree, x)
    return np.asarray(np.linalg.solve(own, design_matrix(knots, degree, low + (high - low) * x)))


def _restrict_bernstein(coefficients: Array, part: Array) -> Array:
    """Bernstein coefficients on [0, part], part (n,), from coefficients (p + 1, n, k) on [0, 1], by de Casteljau's algorithm."""
    result = coefficients.copy()
    for j in range(1, len(result)):
        result[j:] = result[j - 1 : -1] + part[:, None] * (result[j:] - result[j - 1 : -1])
    return result


def _cross(a: Array, b: Array) -> Array:
    """The cross product along the last axis (..., 3), faster than `numpy.cross` on large arrays."""
    (x, y, z), (p, q, r) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([y * r - z * q, z * p - x * r, x * q - y * p], axis=-1)


def sum_moments(x: Array, n: Array, weights: Array) -> Array:
    """Moments of n point sets x (n, m, 3) with normals n (area elements) and weights (n, m) or (m,): (n, 16)."""
    area = (np.sqrt((n * n).sum(-1)) * weights).sum(axis=1)
    weighted = n * weights[..., None]
    first = np.swapaxes(x, 1, 2) @ weighted
    cone = (x * weighted).sum(-1)
    second = (cone[:, None, :] @ x)[:, 0]
    return np.concatenate([area[:, None], weighted.sum(axis=1), first.reshape(-1, 9), second], axis=1)
