"""Cut curves as B-splines: one parameter for the parameter curve on the patch and the curve in space, fitted in batches.

Sites lie exactly on the cut (Newton steps along the gradient). Interpolation is linear, so a space curve through sites in a plane
lies in the plane to round-off; what is left to measure is |S(pc(t)) - C(t)|. The parameter spreads length and turning evenly,
so that a bent curve gets its knots where it bends; past a saddle (a focus) it runs like the logarithm of the distance from it.
It must be smooth for the splines to converge, so it comes from the exact points, tangents and curvatures along the cut, not
from the coarse path nor from an earlier fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tpmscad.splines.bspline import Curve, Surface, design
from tpmscad.trimming.tool import Array, TrimmingError

DEGREE = 7
SPANS = (4, 8, 16, 32, 64, 128)
ROUNDS = 2
"""Rounds of moving the points along a curve to even parameters, at each number of spans."""

NODES = 8
"""Points along a curve for each span, which carry its length and turning."""

SADDLE = 1e-7
"""Sine of the angle between patch and plane below which a curve's end is a saddle."""

TURN = 3.0
"""Turning by this angle (radians) counts as much as running the curve's whole length."""

GRADE = 0.5
"""Near a focus the parameter runs by this much times the logarithm of the distance from it."""

CHECKS = 5
"""Points between knots where the deviation is measured."""


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """A cut curve on one patch: parameter curve and space curve (in the patch's own frame) on [0, 1], measured deviation."""

    pcurve: Curve
    curve: Curve
    deviation: float


def fit(
    surface: Surface, normals: Array, constants: Array, paths: Sequence[Array], foci: Sequence[Array], tol: float
) -> tuple[Cut, ...]:
    """The zero curves of normals (n, 3) . S + constants (n,) along coarse paths with exact ends, within tol.

    foci: for each path points (k, 3) of (u, v) and radius there, about which it may turn sharply.
    Ends may be off their plane (by less than a snap): the parameter curve starts there, the space curve in the plane.
    """
    result: list[Cut | None] = [None] * len(paths)
    if not paths:
        return ()
    waiting = np.arange(len(paths))
    in_space = _foci_in_space(surface, foci)
    uv = _Problem(surface, normals, constants, in_space).onto(_refined(paths, NODES * SPANS[0] + 1))
    for spans in SPANS:
        problem = _Problem(surface, normals[waiting], constants[waiting], in_space[waiting])
        knots, sites, inverse = _space(spans)
        for _ in range(ROUNDS):
            uv = problem.resampled(uv, np.linspace(0.0, 1.0, NODES * spans + 1))
        on_curve = problem.resampled(uv, sites)
        pcurve, curve = inverse @ on_curve, inverse @ problem.in_plane(problem.points(on_curve))
        error = _deviation(problem, pcurve, curve, spans)
        limit = np.maximum(
            tol, 1.01 * problem.off_plane(uv[:, [0, -1]]).max(axis=1)
        )  # snapped ends are off by their snap
        done = error <= limit
        for k in np.flatnonzero(done):
            cut = Curve(pcurve[k].copy(), knots, DEGREE), Curve(curve[k].copy(), knots, DEGREE)
            result[waiting[k]] = Cut(*cut, float(error[k]))
        waiting, uv = waiting[~done], uv[~done]
        if len(waiting) == 0:
            return tuple(c for c in result if c is not None)
    raise TrimmingError(f"a cut curve is still {error.max():.3g} from its patch with {SPANS[-1]} spans, over {tol:.3g}")


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    surface: Surface
    normals: Array
    constants: Array
    foci: Array

    def points(self, uv: Array) -> Array:
        n, m = uv.shape[:2]
        return _jet(self.surface, uv.reshape(-1, 2), 0)[0].reshape(n, m, 3)

    def onto(self, uv: Array) -> Array:
        """Inner sites (n, m, 2) moved onto the zero curve; near the ends onto what makes the ends exact."""
        n, m = uv.shape[:2]
        value = np.einsum("nmk,nk->nm", self.points(uv[:, [0, -1]]), self.normals) + self.constants[:, None]
        x = np.linspace(0.0, 1.0, m)
        target = value[:, :1] * (1 - x) ** 4 + value[:, 1:] * x**4
        uv = uv.copy()
        for _ in range(12):
            s, su, sv = _jet(self.surface, uv[:, 1:-1].reshape(-1, 2), 1)
            normal = np.repeat(self.normals, m - 2, axis=0)
            g = np.einsum("pk,pk->p", s, normal) + np.repeat(self.constants, m - 2) - target[:, 1:-1].ravel()
            slope = np.column_stack([np.einsum("pk,pk->p", su, normal), np.einsum("pk,pk->p", sv, normal)])
            step = slope * (g / np.maximum((slope**2).sum(axis=1), 1e-300))[:, None]
            uv[:, 1:-1] -= step.reshape(n, m - 2, 2)
            if np.abs(step).max(initial=0.0) < 1e-13:
                break
        return uv

    def along(self, uv: Array) -> tuple[Array, Array, Array, Array]:
        """Arc length x, d(u, v)/dx, and a parameter s in [0, 1] that spreads length and turning evenly, with ds/dx.

        A plane section turns at the rate |II(T, T)| / sin(angle of the planes), T its unit tangent. All comes from the points
        themselves, so that the unevenness of a first path leaves no trace. For points uv (n, m, 2) on the curves.
        """
        n, m = uv.shape[:2]
        s, su, sv, suu, suv, svv = _jet(self.surface, uv.reshape(-1, 2), 2)
        plane = np.repeat(self.normals, m, axis=0)
        a, b = -np.einsum("pk,pk->p", sv, plane), np.einsum("pk,pk->p", su, plane)  # (u, v) along the curve
        tangent = a[:, None] * su + b[:, None] * sv
        normal = np.cross(su, sv)
        second = (a * a)[:, None] * suu + (2 * a * b)[:, None] * suv + (b * b)[:, None] * svv
        bend = np.abs(np.einsum("pk,pk->p", second, normal))
        sine = np.linalg.norm(np.cross(normal, plane), axis=1)
        speed = np.linalg.norm(tangent, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            curvature = (bend / (speed**2 * sine)).reshape(n, m)
            slope = (np.column_stack([a, b]) / speed[:, None]).reshape(n, m, 2)
        points = s.reshape(n, m, 3)
        chord = np.linalg.norm(np.diff(points, axis=1), axis=2)
        for end, inner, step in (
            (0, 1, 0),
            (-1, -2, -1),
        ):  # an end may be a saddle, where nothing points along the curve
            saddle = (
                np.linalg.norm(np.cross(normal, plane), axis=1).reshape(n, m)[:, end]
                < SADDLE * np.linalg.norm(normal, axis=1).reshape(n, m)[:, end]
            )
            curvature[saddle, end] = curvature[saddle, inner]
            slope[saddle, end] = ((uv[:, 1] - uv[:, 0]) if end == 0 else (uv[:, -1] - uv[:, -2]))[saddle] / chord[
                saddle, step
            ][:, None]
        middle = 0.5 * (curvature[:, 1:] + curvature[:, :-1])
        chord = chord * (1.0 + (middle * chord) ** 2 / 24.0)
        curvature[np.isfinite(self.foci[:, 0, 3])] = 0.0
        density = np.hypot(1.0 / chord.sum(axis=1, keepdims=True), curvature / TURN)
        for f in range(self.foci.shape[1]):
            apart = ((points - self.foci[:, f, None, :3]) ** 2).sum(axis=2)
            density = np.sqrt(density**2 + GRADE**2 / (apart + self.foci[:, f, None, 3] ** 2))
        x = np.concatenate([np.zeros((n, 1)), np.cumsum(chord, axis=1)], axis=1)
        rise = np.empty_like(density)  # of the density, for the corrected trapezium rule
        rise[:, 1:-1] = (density[:, 2:] - density[:, :-2]) / (x[:, 2:] - x[:, :-2])
        rise[:, [0, -1]] = rise[:, [1, -2]]
        steps = chord * 0.5 * (density[:, 1:] + density[:, :-1])
        steps = np.maximum(steps - chord**2 / 12.0 * np.diff(rise, axis=1), 0.5 * steps)
        total = np.concatenate([np.zeros((n, 1)), np.cumsum(steps, axis=1)], axis=1)
        length = total[:, -1:]
        return x, slope, total / length, density / length

    def resampled(self, uv: Array, at: Array) -> Array:
        """Points (n, len(at), 2) on the curves at even parameters, from points along them."""
        x, slope, s, density = self.along(uv)
        i, f = _locate(s, at)
        row = np.arange(len(uv))[:, None]
        secant = np.diff(s, axis=1) / np.diff(x, axis=1)
        # x(s) is kept monotone (Fritsch and Carlson's slope limit) where the points are too sparse for a good s
        rate = 1.0 / np.maximum(density, np.maximum(_padded(secant, 0), _padded(secant, 1)) / 3.0)
        target = _cubic(s, x[..., None], rate[..., None], row, i, f)[..., 0]
        h = x[row, i + 1] - x[row, i]
        guess = _cubic(x, uv, slope, row, i, np.clip((target - x[row, i]) / h, 0.0, 1.0))
        guess[:, [0, -1]] = uv[:, [0, -1]]
        return self.onto(guess)

    def off_plane(self, uv: Array) -> Array:
        """Distances of points (n, m, 2) from their planes: (n, m)."""
        return np.abs(np.einsum("nmk,nk->nm", self.points(uv), self.normals) + self.constants[:, None])

    def in_plane(self, points: Array) -> Array:
        """Points (n, m, 3) dropped onto their planes."""
        g = np.einsum("nmk,nk->nm", points, self.normals) + self.constants[:, None]
        return points - g[..., None] * self.normals[:, None]


def _foci_in_space(surface: Surface, foci: Sequence[Array]) -> Array:
    """Points and radii in model units (n, q, 4), filled up with infinite radii."""
    result = np.full((len(foci), max(1, max(len(f) for f in foci)), 4), [0.0, 0.0, 0.0, np.inf])
    for i, own in enumerate(foci):
        if len(own):
            s, su, sv = _jet(surface, own[:, :2], 1)
            result[i, : len(own), :3] = s
            result[i, : len(own), 3] = own[:, 2] * np.sqrt(np.linalg.norm(np.cross(su, sv), axis=1))
    return result


def _padded(interval: Array, side: int) -> Array:
    """Values of intervals (n, m - 1) given to the points on their left (0) or right (1), the last one twice: (n, m)."""
    return np.concatenate([interval, interval[:, -1:]] if side == 0 else [interval[:, :1], interval], axis=1)


def _locate(s: Array, at: Array) -> tuple[NDArray[np.int64], Array]:
    """Interval and fraction in it of each parameter `at` (k,), row by row of s (n, m) rising from 0 to 1: (n, k)."""
    n, m = s.shape
    row = np.arange(n)[:, None]
    i = np.searchsorted((s + 2 * row).ravel(), (at + 2 * row).ravel(), side="right").reshape(n, -1) - 1 - m * row
    i = np.clip(i, 0, m - 2)
    return i, (at - s[row, i]) / (s[row, i + 1] - s[row, i])


def _cubic(x: Array, values: Array, slopes: Array, row: Array, i: Array, f: Array) -> Array:
    """Cubic Hermite interpolation at fraction f of interval i: x (n, m), values and slopes (n, m, d) -> (n, k, d)."""
    h, f = (x[row, i + 1] - x[row, i])[..., None], f[..., None]
    p, q = values[row, i], values[row, i + 1]
    dp, dq = h * slopes[row, i], h * slopes[row, i + 1]
    return p + f * (dp + f * (3 * (q - p) - 2 * dp - dq + f * (2 * (p - q) + dp + dq)))


def _refined(paths: Sequence[Array], least: int) -> Array:
    """Polylines brought to one number of points, at least `least`, by halving longest segments: (n, m, 2)."""
    count = max(least, max(len(path) for path in paths))
    result = []
    for path in paths:
        while len(path) < count:
            length = np.linalg.norm(np.diff(path, axis=0), axis=1)
            at = np.sort(np.argsort(-length, kind="stable")[: count - len(path)])
            path = np.insert(path, at + 1, 0.5 * (path[at] + path[at + 1]), axis=0)
        result.append(path)
    return np.stack(result)


def _deviation(problem: _Problem, pcurve: Array, curve: Array, spans: int) -> Array:
    t = np.linspace(0.0, 1.0, spans * CHECKS + 1)
    rows = design(_space(spans)[0], DEGREE, t)
    on_surface = problem.points(rows @ pcurve)
    return np.linalg.norm(on_surface - rows @ curve, axis=2).max(axis=1)


@lru_cache(maxsize=16)
def _space(spans: int) -> tuple[Array, Array, Array]:
    """Knots, Greville sites, and the inverse of interpolation there."""
    knots = np.concatenate([np.zeros(DEGREE), np.arange(spans + 1) / spans, np.ones(DEGREE)])
    sites = np.array([knots[i + 1 : i + DEGREE + 1].mean() for i in range(spans + DEGREE)])
    return knots, sites, np.linalg.inv(design(knots, DEGREE, sites))


def _jet(surface: Surface, uv: Array, order: int) -> tuple[Array, ...]:
    """Derivatives (0, 0); (1, 0), (0, 1); (2, 0), (1, 1), (0, 2) up to `order` at uv (n, 2): each (n, 3)."""
    bu = [design(surface.knots_u, surface.degree_u, uv[:, 0], k) for k in range(order + 1)]
    bv = [design(surface.knots_v, surface.degree_v, uv[:, 1], k) for k in range(order + 1)]
    shape = surface.poles.shape
    flat = surface.poles.reshape(shape[0], -1)
    half = [(b @ flat).reshape(-1, *shape[1:]) for b in bu]
    pairs = [(total - k, k) for total in range(order + 1) for k in range(total + 1)]
    return tuple(np.einsum("nv,nvd->nd", bv[j], half[i]) for i, j in pairs)
