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

from tpmscad._typing import Array
from tpmscad.brep.carriers import ConicalSurface, EdgeCurve, Quadric, SphericalSurface
from tpmscad.brep.conics import TWO_PI
from tpmscad.brep.free_form_surface import BodyCarrier, FreeFormSurface
from tpmscad.splines.adaptive_curve_fit import fit_adaptively
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
"""Distance from the axis, in body sizes, below which a point is a pole of a sphere or the apex of a cone."""


class UnsupportedFace(Exception):
    """The reason, in words, why a face or one of its edges cannot be represented exactly on a plane or quadric."""


def is_at_pole(carrier: BodyCarrier, points: Array, size: float) -> NDArray[np.bool_]:
    """Mask of the points (n, 3) that are a pole of a sphere or the apex of a cone: (n,).

    Faces with a pole of a free-form surface are not represented (`exact_faces`).
    """
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
) -> BSplineCurve:
    """Pcurve on the carrier, within `tol` of the curve; a line wherever (u, v) is affine in the parameter."""
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

    def error(fit: BSplineCurve, checks: Array) -> Array:
        return np.asarray(np.linalg.norm(carrier(*fit(checks).T) - curve(checks), axis=1))

    return _require_fit(
        fit_adaptively(
            lambda s: follow_parameters(carrier, curve, span, near, s, size), np.union1d(span, inner), error, tol
        )
    )


def _require_fit(fit: BSplineCurve | None) -> BSplineCurve:
    """The fit; UnsupportedFace if there is none."""
    if fit is None:
        raise UnsupportedFace("has an edge that turns too sharply for a spline fit")
    return fit


def project_to_carriers(carriers: Sequence[BodyCarrier], points: Array) -> Array:
    """Points (n, 3) projected onto all the surfaces at once by least-norm Newton steps; they must start close to them."""
    for _ in range(MAX_NEWTON_STEPS):
        off = np.stack([c.distance(points) for c in carriers], axis=1)
        slope = np.stack([c.gradient(points) for c in carriers], axis=1)
        step = np.einsum("nij,nj->ni", np.linalg.pinv(slope, rcond=MIN_TRANSVERSE_ANGLE), off)
        points = points - step
        if np.abs(step).max() <= NEWTON_REL_TOL * np.abs(points).max():
            break
    return points


ARC_LENGTH_GAUSS_POINTS = 6


def fit_intersection_curve(first: BodyCarrier, second: BodyCarrier, path: Array, tol: float) -> BSplineCurve:
    """B-spline through the points (m, 3), within `tol` of both surfaces, parametrised by arc length.

    The points are close to both surfaces; they are projected onto them first.
    """
    points = project_to_carriers((first, second), path)
    t = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    for _ in range(ARC_LENGTH_PASSES):
        dense = make_interp_spline(t, points, 5)
        t = _arc_lengths(dense, t)
    dense = make_interp_spline(t, points, 5)

    def values(sites: Array) -> Array:
        through = project_to_carriers((first, second), dense(sites))
        through[[0, -1]] = points[[0, -1]]
        return through

    def error(fit: BSplineCurve, checks: Array) -> Array:
        at = fit(checks)
        return np.maximum(np.abs(first.distance(at)), np.abs(second.distance(at)))

    return _require_fit(fit_adaptively(values, np.array([0.0, t[-1]]), error, tol))


def _arc_lengths(dense: Callable[..., Array], t: Array) -> Array:
    """Arc length from the first parameter to each t."""
    x, w = gauss_legendre(ARC_LENGTH_GAUSS_POINTS)
    half = 0.5 * np.diff(t)
    nodes = (t[:-1] + half)[:, None] + half[:, None] * x
    speed = np.linalg.norm(dense(nodes.ravel(), 1), axis=1).reshape(nodes.shape)
    return np.concatenate([[0.0], np.cumsum(half * (speed @ w))])
