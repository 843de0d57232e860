"""Sections of patches by surfaces as exact curves: moved onto the cut, measured along it, sampled at even parameters. In batches.

The even parameter spreads length and turning evenly, so that a bent curve gets its knots where it bends; past a saddle (a
focus) it runs like the logarithm of the distance from it. It must be smooth for splines to converge, so it comes from the
exact points, tangents and curvatures along the cut, not from a coarse path nor from an earlier fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.errors import TrimmingError
from tpmscad.splines.basis import design_matrices
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.operands.implicit_surfaces import CONE, MIN_DIVISOR_LENGTH, ImplicitSurfaces

TURN_PER_LENGTH_RAD = 4.0
"""Turning by this angle (radians) counts as much as running the curve's whole length."""

FOCUS_GRADING = 0.5
"""Near a focus the parameter runs by this much times the logarithm of the distance from it."""

NEWTON_STEP_TOL = 1e-9
"""A Newton step onto the cut that is shorter in (u, v) is the last: its square is what is left."""

SADDLE_SINE = 1e-7
"""Sine of the angle between patch and surface below which a curve's end is a saddle."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchSurfacePairs:
    """Sections of n patches of one spline space, with their own poles (n, U, V, 3), by the n rows of `levels`.

    Points on them are given as (u, v), (n, m, 2). `foci` (n, q, 4): points and radii in model units,
    infinite if none. A cone's apex is one anyway.
    """

    poles: Array
    space: tuple[Array, Array, int, int]
    levels: ImplicitSurfaces
    foci: Array

    def of(self, rows: IntArray) -> PatchSurfacePairs:
        """Some of them."""
        return replace(
            self,
            poles=self.poles[rows],
            levels=self.levels.of(rows),
            foci=self.foci[rows],
        )

    def without_foci(self) -> PatchSurfacePairs:
        """The same, spread by length and turning only."""
        return replace(self, foci=np.full_like(self.foci, np.inf))

    def jet(self, uv: Array, order: int) -> list[Array]:
        """Derivatives (0, 0); (1, 0), (0, 1); (2, 0), (1, 1), (0, 2) up to `order`: each (n, m, 3)."""
        knots_u, knots_v, degree_u, degree_v = self.space
        n, m = uv.shape[:2]
        bu = [b.reshape(n, m, -1) for b in design_matrices(knots_u, degree_u, uv[..., 0].ravel(), range(order + 1))]
        bv = [b.reshape(n, m, -1) for b in design_matrices(knots_v, degree_v, uv[..., 1].ravel(), range(order + 1))]
        rows = self.poles.reshape(n, self.poles.shape[1], -1)
        half = [(b @ rows).reshape(n, m, -1, 3) for b in bu]
        pairs = [(total - k, k) for total in range(order + 1) for k in range(total + 1)]
        return [np.einsum("nmv,nmvd->nmd", bv[j], half[i]) for i, j in pairs]

    def points(self, uv: Array) -> Array:
        return self.jet(uv, 0)[0]

    def project_inner_sites(self, uv: Array) -> Array:
        """Inner sites (n, m, 2) moved onto the zero curve; near the ends onto what makes the ends exact."""
        m = uv.shape[1]
        value = self.levels.value(self.points(uv[:, [0, -1]]))
        x = np.linspace(0.0, 1.0, m)
        target = value[:, :1] * (1 - x) ** 4 + value[:, 1:] * x**4
        uv, problem, rows = uv.copy(), self, np.arange(len(uv))
        for _ in range(12):
            s, su, sv = problem.jet(uv[rows, 1:-1], 1)
            g, gradient = problem.levels.jet(s, 1)
            g = g - target[rows, 1:-1]
            slope = np.stack([np.einsum("nmk,nmk->nm", d, gradient) for d in (su, sv)], axis=2)
            step = slope * (g / np.maximum((slope**2).sum(axis=2), 1e-300))[..., None]
            uv[rows, 1:-1] -= step
            left = np.abs(step).max(axis=(1, 2), initial=0.0) > NEWTON_STEP_TOL
            if not left.any():
                break
            if not left.all():
                rows = rows[left]
                problem = self.of(rows)
        return uv

    def along(self, uv: Array) -> tuple[Array, Array, Array, Array]:
        """Arc length x, d(u, v)/dx, and a parameter s in [0, 1] that spreads length and turning evenly, with ds/dx.

        The curvatures k, l of the patch and the surface along the section, at the angle a to each other, turn it at the rate
        sqrt(k^2 + l^2 - 2 k l cos a) / sin a. All comes from the points themselves, so that the unevenness of a first path
        leaves no trace. For points uv (n, m, 2) on the curves.
        """
        points, su, sv, suu, suv, svv = self.jet(uv, 2)
        planar = bool(self.levels.flat.all())
        across = self.levels.jet(points, 1 if planar else 2)[1:]
        a, b = -(sv * across[0]).sum(axis=2), (su * across[0]).sum(axis=2)  # (u, v) along the curve
        normal = np.cross(su, sv)
        second = (a * a)[..., None] * suu + (2 * a * b)[..., None] * suv + (b * b)[..., None] * svv
        speed = np.linalg.norm(a[..., None] * su + b[..., None] * sv, axis=2)
        sine = np.linalg.norm(np.cross(normal, across[0]), axis=2)
        with np.errstate(divide="ignore", invalid="ignore"):
            curvature = np.abs((second * normal).sum(axis=2)) / (speed**2 * sine)
            if not planar:
                tangent = (a[..., None] * su + b[..., None] * sv) / speed[..., None]
                own = (second * normal).sum(axis=2) / speed**2
                other = -np.einsum("nmi,nmij,nmj->nm", tangent, across[1], tangent)
                other = other * np.linalg.norm(normal, axis=2)
                cosine = (normal * across[0]).sum(axis=2) / np.linalg.norm(normal, axis=2)
                curvature = np.sqrt(np.maximum(own**2 + other**2 - 2 * own * other * cosine, 0.0)) / sine
            slope = np.stack([a, b], axis=2) / speed[..., None]
        chord = np.linalg.norm(np.diff(points, axis=1), axis=2)
        at_saddle = sine < SADDLE_SINE * np.linalg.norm(normal, axis=2)
        for end, inner, step in ((0, 1, 0), (-1, -2, -1)):  # nothing there points along the curve
            rows = at_saddle[:, end]
            curvature[rows, end] = curvature[rows, inner]
            slope[rows, end] = np.diff(uv, axis=1)[rows, step] / chord[rows, step][:, None]
        middle = 0.5 * (curvature[:, 1:] + curvature[:, :-1])
        chord = chord * (1.0 + (middle * chord) ** 2 / 24.0)
        curvature[np.isfinite(self.foci[:, 0, 3]) & self.levels.flat] = 0.0
        density = np.hypot(1.0 / chord.sum(axis=1, keepdims=True), curvature / TURN_PER_LENGTH_RAD)
        apices = np.flatnonzero(self.levels.kind == CONE)
        if len(apices):
            apart = ((points[apices] - self.levels.point[apices, None]) ** 2).sum(axis=2)
            density[apices] = np.sqrt(density[apices] ** 2 + FOCUS_GRADING**2 / np.maximum(apart, MIN_DIVISOR_LENGTH))
        for f in range(self.foci.shape[1]):
            if not np.isfinite(self.foci[:, f, 3]).any():
                continue
            apart = ((points - self.foci[:, f, None, :3]) ** 2).sum(axis=2)
            density = np.sqrt(density**2 + FOCUS_GRADING**2 / (apart + self.foci[:, f, None, 3] ** 2))
        x = np.concatenate([np.zeros((len(uv), 1)), np.cumsum(chord, axis=1)], axis=1)
        apart = np.maximum(x[:, 2:] - x[:, :-2], MIN_DIVISOR_LENGTH)  # points on one another are told from their order
        rise = np.empty_like(density)  # of the density, for the corrected trapezium rule
        rise[:, 1:-1] = (density[:, 2:] - density[:, :-2]) / apart
        rise[:, [0, -1]] = rise[:, [1, -2]]
        steps = chord * 0.5 * (density[:, 1:] + density[:, :-1])
        steps = np.maximum(steps - chord**2 / 12.0 * np.diff(rise, axis=1), 0.5 * steps)
        total = np.concatenate([np.zeros((len(uv), 1)), np.cumsum(steps, axis=1)], axis=1)
        length = total[:, -1:]
        return x, slope, total / length, density / length

    def parametrise(self, uv: Array) -> EvenParametrisation:
        """The curves through points uv (n, m, 2) on them, with the even parameter."""
        x, slope, s, density = self.along(uv)
        lost = ~(np.diff(s, axis=1) > 0).all(axis=1)  # NaN as well
        if lost.any():  # hopeless so far: by length, and more points may do
            s[lost] = np.linspace(0.0, 1.0, s.shape[1])
            density[lost] = 1.0 / np.maximum(x[lost, -1:], MIN_DIVISOR_LENGTH)
            if not (np.diff(x, axis=1) > 0).all():
                raise TrimmingError("the points of a cut curve do not follow each other")
        secant = np.diff(s, axis=1) / np.diff(x, axis=1)
        # x(s) is kept monotone (Fritsch and Carlson's slope limit) where the points are too sparse for a good s
        rate = 1.0 / np.maximum(density, np.maximum(_pad_intervals(secant, 0), _pad_intervals(secant, 1)) / 3.0)
        return EvenParametrisation(uv, x, slope, s, rate)

    def sampled(self, spread: EvenParametrisation, at: Array) -> Array:
        """Points (n, len(at), 2) on the curves at even parameters."""
        return self.project_inner_sites(spread.initial_sites(at))

    def resampled(self, uv: Array, at: Array) -> Array:
        """Points (n, len(at), 2) on the curves at even parameters, from points along them."""
        return self.sampled(self.parametrise(uv), at)

    def off(self, uv: Array) -> Array:
        """Distances of points (n, m, 2) from their surfaces: (n, m)."""
        return np.abs(self.levels.value(self.points(uv)))

    def dropped(self, points: Array) -> Array:
        """Points (n, m, 3) dropped onto their surfaces."""
        g, gradient = self.levels.jet(points, 1)
        return points - g[..., None] * gradient


@dataclass(frozen=True, slots=True, eq=False)
class EvenParametrisation:
    """Points uv (n, m, 2) along n curves, their arc lengths x, d(u, v)/dx, even parameters s from 0 to 1, and dx/ds."""

    uv: Array
    x: Array
    slope: Array
    s: Array
    rate: Array

    def of(self, rows: IntArray) -> EvenParametrisation:
        """Some of the curves."""
        return EvenParametrisation(self.uv[rows], self.x[rows], self.slope[rows], self.s[rows], self.rate[rows])

    def initial_sites(self, at: Array) -> Array:
        """(u, v) at even parameters, near the curves: (n, len(at), 2)."""
        i, f = _locate_intervals(self.s, at)
        row = np.arange(len(self.uv))[:, None]
        target = _interpolate_hermite(self.s, self.x[..., None], self.rate[..., None], row, i, f)[..., 0]
        h = self.x[row, i + 1] - self.x[row, i]
        guess = _interpolate_hermite(
            self.x, self.uv, self.slope, row, i, np.clip((target - self.x[row, i]) / h, 0.0, 1.0)
        )
        guess[:, [0, -1]] = self.uv[:, [0, -1]]
        return guess


def map_foci_to_space(surfaces: Sequence[BSplineSurface], foci: Sequence[Array]) -> Array:
    """Points and radii in model units (n, q, 4) from (u, v) and radii there, a patch each; filled up with infinite radii."""
    result = np.full((len(foci), max(1, max(len(f) for f in foci)), 4), [0.0, 0.0, 0.0, np.inf])
    for i, (surface, own) in enumerate(zip(surfaces, foci, strict=True)):
        if len(own):
            u, v, radius = own.T
            result[i, : len(own), :3] = surface(u, v)
            result[i, : len(own), 3] = radius * np.sqrt(np.linalg.norm(surface.normal(u, v), axis=1))
    return result


def _pad_intervals(interval: Array, side: int) -> Array:
    """Values of intervals (n, m - 1) given to the points on their left (0) or right (1), the last one twice: (n, m)."""
    return np.concatenate([interval, interval[:, -1:]] if side == 0 else [interval[:, :1], interval], axis=1)


def _locate_intervals(s: Array, at: Array) -> tuple[IntArray, Array]:
    """Interval and fraction in it of each parameter `at` (k,), row by row of s (n, m) rising from 0 to 1: (n, k)."""
    n, m = s.shape
    row = np.arange(n)[:, None]
    i = np.searchsorted((s + 2 * row).ravel(), (at + 2 * row).ravel(), side="right").reshape(n, -1) - 1 - m * row
    i = np.clip(i, 0, m - 2)
    return i, (at - s[row, i]) / (s[row, i + 1] - s[row, i])


def _interpolate_hermite(x: Array, values: Array, slopes: Array, row: IntArray, i: IntArray, f: Array) -> Array:
    """Cubic Hermite interpolation at fraction f of interval i: x (n, m), values and slopes (n, m, d) -> (n, k, d)."""
    h, f = (x[row, i + 1] - x[row, i])[..., None], f[..., None]
    p, q = values[row, i], values[row, i + 1]
    dp, dq = h * slopes[row, i], h * slopes[row, i + 1]
    return p + f * (dp + f * (3 * (q - p) - 2 * dp - dq + f * (2 * (p - q) + dp + dq)))
