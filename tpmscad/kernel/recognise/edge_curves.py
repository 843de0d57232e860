"""Edge curves that lie on the surfaces of their faces to round-off, and their pcurves.

Lines, circles and ellipses are kept, and splines that run along a line or a circle are replaced by it. Any other edge (a
cylinder through a cone, say) is accurate to the kernel's tolerance only: its points are projected onto both surfaces by Newton's
method, parametrised by arc length and interpolated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.optimize import brentq

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.carriers import ConicalSurface, EdgeCurve, Quadric, SphericalSurface
from tpmscad.brep.conics import TWO_PI
from tpmscad.brep.free_form_surface import BodyCarrier, FreeFormSurface
from tpmscad.splines.adaptive_curve_fit import FIT_DEGREE, fit_adaptively, make_knots_and_sites
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineCurve, line_segment
from tpmscad.splines.quadrature import gauss_legendre

EDGE_SAMPLES = 65
"""Points along an edge at which surface parameters are followed."""

MAX_ANGLE_STEP = 0.5
"""Radians by which an angle may change between neighbouring points; larger steps are bisected."""

MIN_BREAK_FRACTION = 1e-6
"""Fraction of the parameter range: closer breaks make the interpolation singular."""

MIN_INTERVAL_FRACTION = 1e-9
"""Fraction of the edge's parameter range below which an interval is not bisected."""

REFIT_SAMPLES = 257
"""Points of the OCCT curve that are projected onto both surfaces before the curve is reparametrised."""

AFFINE_TOL = 1e-11
"""Radians, or body sizes: deviation up to which a pcurve is an affine function of the curve's parameter."""

MAX_NEWTON_STEPS = 8

NEWTON_REL_TOL = 1e-15
"""Newton step, as a fraction of the largest coordinate, at which the projection has converged."""

MIN_TRANSVERSE_ANGLE = 1e-5
"""Radians; surfaces that meet at a smaller angle count as tangent and give one equation instead of two."""

ARC_LENGTH_PASSES = 2
"""Reparametrisations by arc length: the first starts from chord lengths, the second from arc lengths."""

POLE_REL_TOL = 1e-7
"""Distance from the axis, in body sizes, below which a point is a pole of a sphere or the apex of a cone; from the pole of a
free-form surface."""


WIDER_FIT = 4.0
"""Ratio of the tolerances that are tried one after another for a pcurve of an edge that is off its face."""


class UnsupportedFace(Exception):
    """The reason, in words, why a face or one of its edges cannot be represented exactly on a plane or quadric."""


def is_at_pole(carrier: BodyCarrier, points: Array, size: float) -> NDArray[np.bool_]:
    """Mask of the points (n, 3) that are a pole of a sphere or of a free-form surface, or the apex of a cone: (n,)."""
    if isinstance(carrier, FreeFormSurface):
        away = [np.linalg.norm(points - pole, axis=1) for _, pole in carrier.poles_across_v()]
        return (
            np.asarray(np.min(away, axis=0, initial=np.inf) < POLE_REL_TOL * size, bool)
            if away
            else np.zeros(len(points), bool)
        )
    if not isinstance(carrier, SphericalSurface | ConicalSurface):
        return np.zeros(len(points), bool)
    arm = points - carrier.origin
    return np.asarray(np.linalg.norm(np.cross(arm, carrier.axis), axis=1) < POLE_REL_TOL * size, bool)


def follow_parameters(
    carrier: Quadric | FreeFormSurface,
    curve: EdgeCurve,
    span: tuple[float, float],
    near: Array | None,
    t: Array | None,
    size: float,
) -> Array:
    """Continuous (u, v) of the curve on the carrier at parameters t (n,) of the span: (n, 2).

    `near` selects the period: (u, v) in the middle of the span is close to it. If t is None, the result is at EDGE_SAMPLES evenly
    spaced parameters.
    """
    grid, known = _sample_parameters(carrier, curve, span, size)
    even = known[np.searchsorted(grid, np.linspace(*span, EDGE_SAMPLES))]
    shift = np.zeros(2)
    for axis, period in enumerate(carrier.period):
        if period and near is not None:
            shift[axis] = period * round((near[axis] - even[EDGE_SAMPLES // 2, axis]) / period)
    if t is None:
        return even + shift
    uv, pole = _parameters(carrier, curve, t, size)
    for axis, period in enumerate(carrier.period):
        if period:
            about = np.interp(t, grid, known[:, axis])
            if axis == 0:
                uv[pole, 0] = about[pole]
            uv[:, axis] += period * np.round((about - uv[:, axis]) / period)
    return np.asarray(uv + shift)


@lru_cache(maxsize=1024)
def _sample_parameters(
    carrier: Quadric | FreeFormSurface, curve: EdgeCurve, span: tuple[float, float], size: float
) -> tuple[Array, Array]:
    """Evenly spaced parameters of the span, denser where angles vary fast, and continuous (u, v) there."""
    grid = np.linspace(*span, EDGE_SAMPLES)
    while True:
        uv, pole = _parameters(carrier, curve, grid, size)
        if pole.any():  # u is undefined at a pole: take that of the nearest regular sample
            known = np.flatnonzero(~pole)
            uv[pole, 0] = uv[known[np.abs(known[None, :] - np.flatnonzero(pole)[:, None]).argmin(axis=1)], 0]
        for axis, period in enumerate(carrier.period):
            if period:
                uv[:, axis] = np.unwrap(uv[:, axis], period=period)
        turns = [uv[:, axis] / (period / TWO_PI) for axis, period in enumerate(carrier.period) if period]
        if not turns:
            return grid, uv
        steps = np.abs(np.diff(np.stack(turns, axis=1), axis=0)).max(axis=1)
        wide = np.flatnonzero((steps > MAX_ANGLE_STEP) & (np.diff(grid) > MIN_INTERVAL_FRACTION * (span[1] - span[0])))
        if len(wide) == 0:
            return grid, uv
        grid = np.union1d(grid, 0.5 * (grid[wide] + grid[wide + 1]))


def _parameters(
    carrier: Quadric | FreeFormSurface, curve: EdgeCurve, t: Array, size: float
) -> tuple[Array, NDArray[np.bool_]]:
    """(u, v) of the curve at t, and a mask of poles."""
    points = curve(t)
    return carrier.parameters(points), is_at_pole(carrier, points, size)


def fit_pcurve(
    carrier: Quadric | FreeFormSurface,
    curve: EdgeCurve,
    span: tuple[float, float],
    near: Array,
    size: float,
    tol: float,
    most: float = 0.0,
) -> BSplineCurve:
    """Pcurve on the carrier, within `tol` of the curve; a line wherever (u, v) is affine in the parameter.

    Where no spline is within `tol`, one within up to `most` is taken. UnsupportedFace if there is none either.
    """
    t = np.linspace(*span, EDGE_SAMPLES)
    uv = follow_parameters(carrier, curve, span, near, None, size)
    slope = (uv[-2] - uv[1]) / (t[-2] - t[1])
    middle = uv[EDGE_SAMPLES // 2]
    straight = middle + np.multiply.outer(t - t[EDGE_SAMPLES // 2], slope)
    if (np.abs(uv - straight) < AFFINE_TOL * np.array([1.0, max(1.0, size)])).all():
        slope = np.where(np.abs(slope - np.round(slope)) < AFFINE_TOL * max(1.0, size), np.round(slope), slope)
        low, high = (middle + (s - t[EDGE_SAMPLES // 2]) * slope for s in span)
        return line_segment(low, high, span)
    inner = curve.knots if isinstance(curve, BSplineCurve) else np.zeros(0)
    inner = inner[(inner > span[0]) & (inner < span[1])]
    if isinstance(carrier, FreeFormSurface):  # knots of the curve, as close to each other as they come
        least = MIN_BREAK_FRACTION * (span[1] - span[0])
        kept = np.concatenate([[span[0]], inner])
        inner = inner[(np.diff(kept) > least) & (inner < span[1] - least)]

    kinks, bends = (_cross_knot_lines(carrier, curve, span, near, size, continuity) for continuity in (0, 1))
    breaks = _join_breaks(np.union1d(span, inner), bends)

    def error(fit: BSplineCurve, checks: Array) -> Array:
        return np.asarray(np.linalg.norm(carrier(*fit(checks).T) - curve(checks), axis=1))

    while True:
        fit = fit_adaptively(
            lambda s: follow_parameters(carrier, curve, span, near, s, size), breaks, error, tol, bends, kinks
        )
        if fit is not None or tol >= most:
            return _require_fit(fit)
        tol = min(WIDER_FIT * tol, most)


def _cross_knot_lines(
    carrier: Quadric | FreeFormSurface,
    curve: EdgeCurve,
    span: tuple[float, float],
    near: Array,
    size: float,
    continuity: int,
) -> Array:
    """Parameters of a curve at which it crosses lines of its surface where that is no smoother than C^continuity, ascending."""
    if not isinstance(carrier, FreeFormSurface):
        return np.zeros(0)
    found: list[float] = []
    for axis, knots in enumerate(carrier.spline.knot_lines(continuity)):
        if not len(knots):
            continue
        t, uv = np.linspace(*span, EDGE_SAMPLES), follow_parameters(carrier, curve, span, near, None, size)[:, axis]
        period = carrier.period[axis]
        turns = (
            np.arange(np.floor((uv.min() - knots[-1]) / period), (uv.max() - knots[0]) / period + 1) if period else [0]
        )
        for knot in (knots + turn * period for turn in turns):
            for value in knot.tolist():

                def off(s: float, axis: int = axis, value: float = value) -> float:
                    return float(follow_parameters(carrier, curve, span, near, np.array([s]), size)[0, axis] - value)

                for k in np.flatnonzero((uv[:-1] > value) != (uv[1:] > value)).tolist():
                    ends = off(t[k]), off(t[k + 1])
                    if ends[0] * ends[1] < 0:
                        found.append(float(brentq(off, t[k], t[k + 1])))
    return np.unique(found)


def _join_breaks(breaks: Array, more: Array) -> Array:
    """Breaks with others, and without those inside that are nearer to one of these than a fit can tell."""
    least = MIN_BREAK_FRACTION * (breaks[-1] - breaks[0])
    more = more[(more > breaks[0] + least) & (more < breaks[-1] - least)]
    if not len(more):
        return breaks
    apart = np.abs(breaks[:, None] - more).min(axis=1) > least
    apart[[0, -1]] = True
    more = more[np.append(True, np.diff(more) > least)]
    return np.union1d(breaks[apart], more)


def _require_fit(fit: BSplineCurve | None) -> BSplineCurve:
    """The fit; UnsupportedFace if there is none."""
    if fit is None:
        raise UnsupportedFace("has an edge that turns too sharply for a spline fit")
    return fit


def project_to_carriers(
    carriers: Sequence[BodyCarrier], points: Array, least_sine: float = MIN_TRANSVERSE_ANGLE
) -> Array:
    """Points (n, 3) projected onto all the surfaces at once by least-norm Newton steps; they must start close to them.

    Surfaces at a smaller angle than `least_sine` count as tangent: between two that miss each other points end in the middle.
    """
    for _ in range(MAX_NEWTON_STEPS):
        off = np.stack([c.distance(points) for c in carriers], axis=1)
        slope = np.stack([c.gradient(points) for c in carriers], axis=1)
        step = np.einsum("nij,nj->ni", np.linalg.pinv(slope, rcond=least_sine), off)
        points = points - step
        if np.abs(step).max() <= NEWTON_REL_TOL * np.abs(points).max():
            break
    return points


TANGENT_STEPS = 12
"""Newton steps to the points in which surfaces are tangent."""

DIFFERENCE_FRACTION = 1e-6
"""Of the largest coordinate: step of the differences of normals."""

TANGENT_RCOND = 1e-3
"""Ratio of singular values below which a direction along a tangent edge counts as free."""


def project_to_tangency(carriers: Sequence[BodyCarrier], tangent: Sequence[tuple[int, int]], points: Array) -> Array:
    """Points (n, 3) moved to where surfaces meet, and those of the pairs `tangent` with parallel normals, by Newton's method.

    The distances of tangent surfaces say nothing about the place across their common edge; n_1 x n_2 = 0 does. Steps are of least
    norm.
    """
    for _ in range(TANGENT_STEPS):
        normals = [c.gradient(points) for c in carriers]
        bends = [difference_gradients(c, points) for c in carriers]
        off = [c.distance(points)[:, None] for c in carriers]
        slope = [n[:, None] for n in normals]
        for i, j in tangent:
            n, m, h, k = normals[i], normals[j], bends[i], bends[j]
            scale = 1.0 / np.maximum(np.linalg.norm(h - k, axis=(1, 2)), 1e-300)[:, None]
            turn = np.cross(h, m[:, None], axisb=2, axisa=1, axisc=1) + np.cross(
                n[:, None], k, axisa=2, axisb=1, axisc=1
            )
            off.append(scale * np.cross(n, m))
            slope.append(scale[..., None] * turn)
        rows = np.concatenate(slope, axis=1)
        step = np.einsum("nij,nj->ni", np.linalg.pinv(rows, rcond=TANGENT_RCOND), np.concatenate(off, axis=1))
        points = points - step
        if np.abs(step).max() <= NEWTON_REL_TOL * np.abs(points).max():
            break
    return points


def difference_gradients(carrier: BodyCarrier, points: Array) -> Array:
    """Second derivatives (n, 3, 3) of the distance by differences, as good as a Newton step needs."""
    step = DIFFERENCE_FRACTION * max(float(np.abs(points).max()), 1e-300)
    ways = step * np.eye(3)
    return np.stack([carrier.gradient(points + w) - carrier.gradient(points - w) for w in ways], axis=2) / (2.0 * step)


ARC_LENGTH_DEGREE, ARC_LENGTH_GAUSS_POINTS = 5, 6
"""Degree of the spline of which lengths are measured, and points in each of its spans."""

MIN_STEP_FRACTION = 1e-9
"""Of the size of a curve: nearer points are one."""

MAX_SMOOTH_SPANS = 256
"""Most spans of a smooth curve: eight turns of a helix take 128 for 1e-8 of their radius."""


def smooth_path(path: Array, tol: float) -> Array:
    """Points (m, 3) of a smooth curve from the first to the last of the points of a path, within `tol` of all if it can be."""
    t = _measure_lengths(path)
    t /= max(t[-1], 1e-300)
    chord = path[0] + np.multiply.outer(t, path[-1] - path[0])
    best, least = path, np.inf
    spans = 1
    while spans <= min(MAX_SMOOTH_SPANS, len(path) // 3 - FIT_DEGREE):
        knots, _ = make_knots_and_sites(np.linspace(0.0, 1.0, spans + 1))
        rows = design_matrix(knots, FIT_DEGREE, t)[:, 1:-1]
        found = chord + rows @ np.linalg.lstsq(rows, path - chord, rcond=None)[0]
        off = float(np.linalg.norm(found - path, axis=1).max())
        if off < least:
            best, least = found, off
        if least <= tol:
            break
        spans *= 2
    best = best.copy()
    best[[0, -1]] = path[[0, -1]]
    return best


def fit_intersection_curve(first: BodyCarrier, second: BodyCarrier, path: Array, tol: float) -> BSplineCurve:
    """B-spline through the points (m, 3), within `tol` of both surfaces, parametrised by arc length.

    The points are close to both surfaces; they are projected onto them first.
    """
    return fit_curve_on_carriers((first, second), project_to_carriers((first, second), path), tol)


def fit_curve_on_carriers(
    carriers: Sequence[BodyCarrier], points: Array, tol: float, place_tol: float | None = None
) -> BSplineCurve:
    """B-spline through points (m, 3) on surfaces, if any, within `tol` of all of them, parametrised by arc length.

    Fewer than two surfaces do not say where the curve is: it is within `place_tol`, or `tol`, of a curve through the points.
    """
    points = points[_find_apart(points)]
    t = _measure_lengths(points)
    dense = make_interp_spline(t, points, ARC_LENGTH_DEGREE)

    def values(sites: Array, ends: bool = True) -> Array:
        through = project_to_carriers(carriers, dense(sites)) if carriers else dense(sites)
        if ends:
            through[[0, -1]] = points[[0, -1]]
        return through

    def error(fit: BSplineCurve, checks: Array) -> Array:
        at = fit(checks)
        off = [np.abs(c.distance(at)) for c in carriers]
        if len(carriers) < 2:
            off.append(np.linalg.norm(at - values(checks, ends=False), axis=1) * (tol / (place_tol or tol)))
        return np.asarray(np.max(off, axis=0))

    return _require_fit(fit_adaptively(values, np.array([0.0, t[-1]]), error, tol))


def _find_apart(points: Array) -> BoolArray:
    """Which of points (m, 3) of a path are farther than round-off from the one before; the last is."""
    far = np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > MIN_STEP_FRACTION * np.ptp(points))
    far[-1] = True
    return far


def _measure_lengths(points: Array) -> Array:
    """Arc lengths (m,) of a smooth curve through points (m, 3), from the first; chords where they are too few or coincide."""
    t = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    if len(points) <= ARC_LENGTH_DEGREE or not _find_apart(points).all():
        return t
    for _ in range(ARC_LENGTH_PASSES):
        t = _arc_lengths(make_interp_spline(t, points, ARC_LENGTH_DEGREE), t)
    return t


def _arc_lengths(dense: Callable[..., Array], t: Array) -> Array:
    """Arc length from the first parameter to each t."""
    x, w = gauss_legendre(ARC_LENGTH_GAUSS_POINTS)
    half = 0.5 * np.diff(t)
    nodes = (t[:-1] + half)[:, None] + half[:, None] * x
    speed = np.linalg.norm(dense(nodes.ravel(), 1), axis=1).reshape(nodes.shape)
    return np.concatenate([[0.0], np.cumsum(half * (speed @ w))])
