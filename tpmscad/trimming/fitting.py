"""Cut curves as B-splines: one parameter for the parameter curve on the patch and the curve in space, fitted in batches.

Sites lie exactly on the cut (Newton steps along the gradient). Interpolation is linear, so a space curve through sites in a plane
lies in the plane to round-off; what is left to measure is |S(pc(t)) - C(t)|. The parameter spreads length and turning evenly,
so that a curve which squeezes past a saddle gets its knots where it turns. Sites of that parameter come from the spline of the
round before; the first round starts from the coarse path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tpmscad.splines.bspline import Curve, Surface, design
from tpmscad.trimming.tool import Array, TrimmingError

DEGREE = 7
SPANS = (4, 8, 16, 32, 64, 128)
ROUNDS = 3
"""Rounds of moving the sites at each number of spans: the parameter has settled to what the next round would change."""

TURN = 3.0
"""Turning by this angle (radians) counts as much as running the curve's whole length."""

CHECKS = 5
"""Points between knots where the deviation is measured."""


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """A cut curve on one patch: parameter curve and space curve (in the patch's own frame) on [0, 1], measured deviation."""

    pcurve: Curve
    curve: Curve
    deviation: float


def fit(surface: Surface, normals: Array, constants: Array, paths: Sequence[Array], tol: float) -> tuple[Cut, ...]:
    """The zero curves of normals (n, 3) . S + constants (n,) along coarse paths with exact ends, within tol.

    Ends may be off their plane (by less than a snap): the parameter curve starts there, the space curve in the plane.
    """
    result: list[Cut | None] = [None] * len(paths)
    if not paths:
        return ()
    waiting = np.arange(len(paths))
    start = _refined(paths, 8 * SPANS[0] + 1)
    knots = None
    for spans in SPANS:
        problem = _Problem(surface, normals[waiting], constants[waiting])
        pcurve, curve = _settled(problem, start, spans, knots)
        knots = _space(spans)[0]
        error = _deviation(problem, pcurve, curve, spans)
        for k in np.flatnonzero(error <= tol):
            cut = Curve(pcurve[k].copy(), knots, DEGREE), Curve(curve[k].copy(), knots, DEGREE)
            result[waiting[k]] = Cut(*cut, float(error[k]))
        waiting, start = waiting[error > tol], pcurve[error > tol]
        if len(waiting) == 0:
            return tuple(c for c in result if c is not None)
    raise TrimmingError(f"a cut curve is still {error.max():.3g} from its patch with {SPANS[-1]} spans, over {tol:.3g}")


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    surface: Surface
    normals: Array
    constants: Array

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

    def even_parameter(self, uv: Array) -> Array:
        """The parameter in [0, 1], spread evenly over length and turning, of points on the curves (n, m, 2): (n, m).

        A plane section turns at the rate |II(T, T)| / sin(angle of the planes), T its unit tangent: from the points alone, so
        that the unevenness of a first fit leaves no trace.
        """
        n, m = uv.shape[:2]
        s, su, sv, suu, suv, svv = _jet(self.surface, uv.reshape(-1, 2), 2)
        plane = np.repeat(self.normals, m, axis=0)
        a, b = np.einsum("pk,pk->p", sv, plane), -np.einsum("pk,pk->p", su, plane)
        tangent = a[:, None] * su + b[:, None] * sv
        normal = np.cross(su, sv)
        second = (a * a)[:, None] * suu + (2 * a * b)[:, None] * suv + (b * b)[:, None] * svv
        bend = np.abs(np.einsum("pk,pk->p", second, normal))
        sine = np.linalg.norm(np.cross(normal, plane), axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            curvature = (bend / ((tangent**2).sum(axis=1) * sine)).reshape(n, m)
        curvature[:, 0], curvature[:, -1] = curvature[:, 1], curvature[:, -2]  # an end may be a saddle
        points = s.reshape(n, m, 3)
        chord = np.linalg.norm(np.diff(points, axis=1), axis=2)
        middle = 0.5 * (curvature[:, 1:] + curvature[:, :-1])
        chord = chord * (1.0 + (middle * chord) ** 2 / 24.0)
        density = np.hypot(1.0 / chord.sum(axis=1, keepdims=True), curvature / TURN)
        steps = chord * 0.5 * (density[:, 1:] + density[:, :-1])
        total = np.concatenate([np.zeros((n, 1)), np.cumsum(steps, axis=1)], axis=1)
        return np.asarray(total / total[:, -1:])

    def in_plane(self, points: Array) -> Array:
        """Points (n, m, 3) dropped onto their planes."""
        g = np.einsum("nmk,nk->nm", points, self.normals) + self.constants[:, None]
        return points - g[..., None] * self.normals[:, None]


def _settled(problem: _Problem, start: Array, spans: int, knots: Array | None) -> tuple[Array, Array]:
    """Poles of the parameter curves (n, N, 2) and space curves (n, N, 3).

    `start`: points along a path (n, m, 2) where `knots` is None, else poles on these knots from a coarser fit.
    """
    own, sites, inverse, nodes = _space(spans)
    ends = start[:, [0, -1]]
    for _ in range(ROUNDS):
        if knots is None:
            uv = start
        else:
            uv = design(knots, DEGREE, nodes) @ start
            uv[:, [0, -1]] = ends
        uv = problem.onto(uv)
        parameter = problem.even_parameter(uv)
        if knots is None:
            guess = np.stack([_interpolate(sites, x, p) for x, p in zip(parameter, uv, strict=True)])
        else:
            t = np.stack([np.interp(sites, x, nodes) for x in parameter])
            rows = design(knots, DEGREE, t.ravel()).reshape(*t.shape, -1)
            guess = np.einsum("nsk,nkd->nsd", rows, start)
        guess[:, [0, -1]] = ends
        uv = problem.onto(guess)
        start, knots = inverse @ uv, own
        start[:, [0, -1]] = ends
    return start, inverse @ problem.in_plane(problem.points(uv))


def _interpolate(sites: Array, x: Array, p: Array) -> Array:
    return np.column_stack([np.interp(sites, x, p[:, 0]), np.interp(sites, x, p[:, 1])])


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
    t = (np.arange(spans * CHECKS) + 0.5) / (spans * CHECKS)
    rows = design(_space(spans)[0], DEGREE, t)
    on_surface = problem.points(rows @ pcurve)
    return np.linalg.norm(on_surface - rows @ curve, axis=2).max(axis=1)


@lru_cache(maxsize=16)
def _space(spans: int) -> tuple[Array, Array, Array, Array]:
    """Knots, Greville sites, the inverse of interpolation there, and eight parameters per span with both ends."""
    knots = np.concatenate([np.zeros(DEGREE), np.arange(spans + 1) / spans, np.ones(DEGREE)])
    sites = np.array([knots[i + 1 : i + DEGREE + 1].mean() for i in range(spans + DEGREE)])
    return knots, sites, np.linalg.inv(design(knots, DEGREE, sites)), np.linspace(0.0, 1.0, 8 * spans + 1)


def _jet(surface: Surface, uv: Array, order: int) -> tuple[Array, ...]:
    """Derivatives (0, 0); (1, 0), (0, 1); (2, 0), (1, 1), (0, 2) up to `order` at uv (n, 2): each (n, 3)."""
    bu = [design(surface.knots_u, surface.degree_u, uv[:, 0], k) for k in range(order + 1)]
    bv = [design(surface.knots_v, surface.degree_v, uv[:, 1], k) for k in range(order + 1)]
    shape = surface.poles.shape
    flat = surface.poles.reshape(shape[0], -1)
    half = [(b @ flat).reshape(-1, *shape[1:]) for b in bu]
    pairs = [(total - k, k) for total in range(order + 1) for k in range(total + 1)]
    return tuple(np.einsum("nv,nvd->nd", bv[j], half[i]) for i, j in pairs)
