"""Intersections of patches with surfaces as exact curves: projection, arc length, and an even parametrisation. In batches.

The even parameter distributes arc length and turning angle evenly, so that a curve gets its knots where it bends. Near a saddle
(a *focus*) it follows the logarithm of the distance from the saddle. Splines converge only if the parameter is smooth; it is
therefore derived from exact points, tangents and curvatures along the intersection, not from a coarse path or an earlier fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.errors import UntracedCurve, format_point
from tpmscad.splines.basis import design_matrices
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.operands.quadric_table import CONE, MIN_DIVISOR_LENGTH, QuadricTable

TURN_PER_LENGTH_RAD = 4.0
"""Turning angle, in radians, that has the weight of the curve's whole length."""

FOCUS_GRADING = 0.5
"""Near a focus, the parameter per logarithm of the distance from it."""

PARAMETER_GRADING = 0.1
"""Where (u, v) along a curve varies fast: the parameter per relative change of d(u, v)/dx. Beside a point at which the patch is
singular, d(u, v)/dx goes like the inverse root of the distance, so that the parameter is graded as near a focus. Curves that
reach no tolerance without it need 64 spans with 0.1, 91 with 0.3 and 128 with 0.03; with 1.0 they fail again."""

NEWTON_STEP_TOL = 1e-9
"""Newton step in (u, v) at which a projection has converged: its error is of the order of the square."""

NEWTON_STEPS = 12
"""Largest number of Newton steps of a projection."""

MIN_SQUARED_SLOPE = 1e-300
"""Lower bound of squared gradients used as divisors."""

SADDLE_SINE = 1e-7
"""Sine of the angle between patch and surface below which the end of a curve is a saddle."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchSurfacePairs:
    """n pairs of a patch and a surface; the patches share one spline space and have the poles (n, U, V, 3).

    Points are given as (u, v): (n, m, 2). `foci` (n, q, 4): points and radii in model units, with infinite radii for padding.
    The apex of a cone always is a focus. `follows_turning`: the even parameter distributes turning as well as arc length.
    `follows_pcurves`: it also follows the variation of (u, v).
    """

    poles: Array
    space: tuple[Array, Array, int, int]
    surfaces: QuadricTable
    foci: Array
    follows_turning: bool = True
    follows_pcurves: bool = False

    def take(self, rows: IntArray) -> PatchSurfacePairs:
        """The pairs of the given rows."""
        return replace(self, poles=self.poles[rows], surfaces=self.surfaces.take(rows), foci=self.foci[rows])

    def without_foci(self) -> PatchSurfacePairs:
        """The pairs without foci: their parameters follow arc length and turning only."""
        return replace(self, foci=np.full_like(self.foci, np.inf))

    def following_pcurves(self) -> PatchSurfacePairs:
        """The pairs without foci, for patches that are nearly singular: their parameters follow the variation of (u, v), too."""
        return replace(self.without_foci(), follows_pcurves=True)

    def following_arc_length(self) -> PatchSurfacePairs:
        """The pairs without foci and turning, for curves whose curvature varies faster than the curves themselves."""
        return replace(self.without_foci(), follows_turning=False)

    def jet(self, uv: Array, order: int) -> list[Array]:
        """Derivatives (0, 0); (1, 0), (0, 1); (2, 0), (1, 1), (0, 2) of the patches up to `order`: (n, m, 3) each."""
        knots_u, knots_v, degree_u, degree_v = self.space
        n, m = uv.shape[:2]
        bu = [b.reshape(n, m, -1) for b in design_matrices(knots_u, degree_u, uv[..., 0].ravel(), range(order + 1))]
        bv = [b.reshape(n, m, -1) for b in design_matrices(knots_v, degree_v, uv[..., 1].ravel(), range(order + 1))]
        rows = self.poles.reshape(n, self.poles.shape[1], -1)
        half = [(b @ rows).reshape(n, m, -1, 3) for b in bu]
        pairs = [(total - k, k) for total in range(order + 1) for k in range(total + 1)]
        return [np.einsum("nmv,nmvd->nmd", bv[j], half[i]) for i, j in pairs]

    def points(self, uv: Array) -> Array:
        """Points on the patches: (n, m, 3)."""
        return self.jet(uv, 0)[0]

    def project_inner_sites(self, uv: Array) -> Array:
        """The sites (n, m, 2) with the inner ones projected onto the intersection.

        If an end is off the surface, the sites near it are projected onto the level that decays from the end's distance to zero.
        """
        m = uv.shape[1]
        value = self.surfaces.value(self.points(uv[:, [0, -1]]))
        x = np.linspace(0.0, 1.0, m)
        target = value[:, :1] * (1 - x) ** 4 + value[:, 1:] * x**4
        uv, problem, rows = uv.copy(), self, np.arange(len(uv))
        for _ in range(NEWTON_STEPS):
            s, su, sv = problem.jet(uv[rows, 1:-1], 1)
            g, gradient = problem.surfaces.jet(s, 1)
            g = g - target[rows, 1:-1]
            slope = np.stack([np.einsum("nmk,nmk->nm", d, gradient) for d in (su, sv)], axis=2)
            step = slope * (g / np.maximum((slope**2).sum(axis=2), MIN_SQUARED_SLOPE))[..., None]
            uv[rows, 1:-1] -= step
            left = np.abs(step).max(axis=(1, 2), initial=0.0) > NEWTON_STEP_TOL
            if not left.any():
                break
            if not left.all():
                rows = rows[left]
                problem = self.take(rows)
        return uv

    def measure_arc_length(self, uv: Array) -> tuple[Array, Array, Array, Array]:
        """Arc length x, d(u, v)/dx, the even parameter s in [0, 1] and ds/dx at points uv (n, m, 2) on the curves.

        Let k and l be the normal curvatures of the patch and the surface along the curve, and a the angle between their normals.
        The curvature of the curve is sqrt(k^2 + l^2 - 2 k l cos a) / sin a. It is evaluated at the points themselves, so that
        the result does not depend on how evenly they are placed.
        """
        points, su, sv, suu, suv, svv = self.jet(uv, 2)
        planar = bool(self.surfaces.is_plane.all())
        across = self.surfaces.jet(points, 1 if planar else 2)[1:]
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
        for end, inner, step in ((0, 1, 0), (-1, -2, -1)):  # both normals are parallel there and give no tangent
            rows = at_saddle[:, end]
            curvature[rows, end] = curvature[rows, inner]
            slope[rows, end] = np.diff(uv, axis=1)[rows, step] / chord[rows, step][:, None]
        middle = 0.5 * (curvature[:, 1:] + curvature[:, :-1])
        chord = chord * (1.0 + (middle * chord) ** 2 / 24.0)
        curvature[np.isfinite(self.foci[:, 0, 3]) & self.surfaces.is_plane] = 0.0
        turning = curvature / TURN_PER_LENGTH_RAD if self.follows_turning else np.zeros_like(curvature)
        density = np.hypot(1.0 / chord.sum(axis=1, keepdims=True), turning)
        apices = np.flatnonzero(self.surfaces.kind == CONE)
        if len(apices):
            apart = ((points[apices] - self.surfaces.point[apices, None]) ** 2).sum(axis=2)
            density[apices] = np.sqrt(density[apices] ** 2 + FOCUS_GRADING**2 / np.maximum(apart, MIN_DIVISOR_LENGTH))
        for f in range(self.foci.shape[1]):
            if not np.isfinite(self.foci[:, f, 3]).any():
                continue
            apart = ((points - self.foci[:, f, None, :3]) ** 2).sum(axis=2)
            density = np.sqrt(density**2 + FOCUS_GRADING**2 / (apart + self.foci[:, f, None, 3] ** 2))
        if self.follows_pcurves:
            variation = _measure_pcurve_variation((su, sv, suu, suv, svv), across, speed, slope)
            density = np.hypot(density, PARAMETER_GRADING * variation)
        x = np.concatenate([np.zeros((len(uv), 1)), np.cumsum(chord, axis=1)], axis=1)
        apart = np.maximum(x[:, 2:] - x[:, :-2], MIN_DIVISOR_LENGTH)  # coincident points are kept apart
        rise = np.empty_like(density)  # derivative of the density, for the corrected trapezoidal rule
        rise[:, 1:-1] = (density[:, 2:] - density[:, :-2]) / apart
        rise[:, [0, -1]] = rise[:, [1, -2]]
        steps = chord * 0.5 * (density[:, 1:] + density[:, :-1])
        steps = np.maximum(steps - chord**2 / 12.0 * np.diff(rise, axis=1), 0.5 * steps)
        total = np.concatenate([np.zeros((len(uv), 1)), np.cumsum(steps, axis=1)], axis=1)
        length = total[:, -1:]
        return x, slope, total / length, density / length

    def parametrise(self, uv: Array) -> EvenParametrisation:
        """The even parametrisation of the curves through points uv (n, m, 2) on them."""
        x, slope, s, density = self.measure_arc_length(uv)
        lost = ~(np.diff(s, axis=1) > 0).all(axis=1)  # NaN as well
        if lost.any():  # too few points for turning: arc length alone until there are more
            s[lost] = np.linspace(0.0, 1.0, s.shape[1])
            density[lost] = 1.0 / np.maximum(x[lost, -1:], MIN_DIVISOR_LENGTH)
            stuck = ~(np.diff(x, axis=1) > 0).all(axis=1)
            if stuck.any():
                place = self.points(uv)[np.argmax(stuck), 0]
                raise UntracedCurve(
                    f"an intersection curve is lost near {format_point(place)}, where patch and face are nearly tangent"
                )
        secant = np.diff(s, axis=1) / np.diff(x, axis=1)
        # Fritsch and Carlson's slope limit keeps x(s) monotone where the points are sparse
        rate = 1.0 / np.maximum(density, np.maximum(_pad_intervals(secant, 0), _pad_intervals(secant, 1)) / 3.0)
        return EvenParametrisation(uv, x, slope, s, rate)

    def evaluate_at(self, even: EvenParametrisation, at: Array) -> Array:
        """Points (n, len(at), 2) on the curves at even parameters."""
        return self.project_inner_sites(even.initial_sites(at))

    def distances(self, uv: Array) -> Array:
        """Unsigned distances (n, m) of points (n, m, 2) from their surfaces."""
        return np.abs(self.surfaces.value(self.points(uv)))

    def project_to_surfaces(self, points: Array) -> Array:
        """Points (n, m, 3) moved to the nearest points of their surfaces."""
        g, gradient = self.surfaces.jet(points, 1)
        return points - g[..., None] * gradient


@dataclass(frozen=True, slots=True, eq=False)
class EvenParametrisation:
    """Points uv (n, m, 2) along n curves: their arc lengths x, d(u, v)/dx, even parameters s in [0, 1], and dx/ds."""

    uv: Array
    arc_length: Array
    slope: Array
    parameter: Array
    speed: Array

    def take(self, rows: IntArray) -> EvenParametrisation:
        """The curves of the given rows."""
        return EvenParametrisation(
            self.uv[rows], self.arc_length[rows], self.slope[rows], self.parameter[rows], self.speed[rows]
        )

    def initial_sites(self, at: Array) -> Array:
        """(u, v) near the curves at even parameters, by Hermite interpolation: (n, len(at), 2)."""
        x, speed = self.arc_length, self.speed
        i, f = _locate_intervals(self.parameter, at)
        row = np.arange(len(self.uv))[:, None]
        target = _interpolate_hermite(self.parameter, x[..., None], speed[..., None], row, i, f)[..., 0]
        fraction = np.clip((target - x[row, i]) / (x[row, i + 1] - x[row, i]), 0.0, 1.0)
        sites = _interpolate_hermite(x, self.uv, self.slope, row, i, fraction)
        sites[:, [0, -1]] = self.uv[:, [0, -1]]
        return sites


def map_foci_to_space(surfaces: Sequence[BSplineSurface], foci: Sequence[Array]) -> Array:
    """Foci as points and radii in model units (n, q, 4), padded by infinite radii, from (u, v) and radii on n patches."""
    result = np.full((len(foci), max(1, max(len(f) for f in foci)), 4), [0.0, 0.0, 0.0, np.inf])
    for i, (surface, own) in enumerate(zip(surfaces, foci, strict=True)):
        if len(own):
            u, v, radius = own.T
            result[i, : len(own), :3] = surface(u, v)
            result[i, : len(own), 3] = radius * np.sqrt(np.linalg.norm(surface.normal(u, v), axis=1))
    return result


def _measure_pcurve_variation(jet: Sequence[Array], across: Sequence[Array], speed: Array, slope: Array) -> Array:
    """Relative change (n, m) of T = d(u, v)/dx per length, |T'| / |T|; 0 where T is not defined.

    `jet`: derivatives of the patches; `across`: gradient and perhaps Hessian of the surfaces' distance g; `slope`: T, which is
    (-g_v, g_u) / `speed`.
    """
    su, sv, suu, suv, svv = jet
    guu, guv, gvv = ((second * across[0]).sum(axis=2) for second in (suu, suv, svv))
    if len(across) > 1:
        pairs = ((su, su), (su, sv), (sv, sv))
        bent = [np.einsum("nmi,nmij,nmj->nm", first, across[1], other) for first, other in pairs]
        guu, guv, gvv = guu + bent[0], guv + bent[1], gvv + bent[2]
    u, v = slope[..., :1], slope[..., 1:]
    tangent, bend = u * su + v * sv, u * u * suu + 2 * u * v * suv + v * v * svv
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = (
            np.stack([-(guv * u[..., 0] + gvv * v[..., 0]), guu * u[..., 0] + guv * v[..., 0]], axis=2)
            / speed[..., None]
        )
        along = (tangent * (turn[..., :1] * su + turn[..., 1:] * sv + bend)).sum(axis=2)
        variation = np.linalg.norm(turn - slope * along[..., None], axis=2) / np.linalg.norm(slope, axis=2)
    return np.where(np.isfinite(variation), variation, 0.0)


def _pad_intervals(interval: Array, side: int) -> Array:
    """Values of intervals (n, m - 1) assigned to the points on their left (0) or right (1): (n, m)."""
    return np.concatenate([interval, interval[:, -1:]] if side == 0 else [interval[:, :1], interval], axis=1)


def _locate_intervals(s: Array, at: Array) -> tuple[IntArray, Array]:
    """Interval, and fraction of it, of each parameter `at` (k,) in each row of s (n, m), ascending from 0 to 1: (n, k) each."""
    n, m = s.shape
    row = np.arange(n)[:, None]
    i = np.searchsorted((s + 2 * row).ravel(), (at + 2 * row).ravel(), side="right").reshape(n, -1) - 1 - m * row
    i = np.clip(i, 0, m - 2)
    return i, (at - s[row, i]) / (s[row, i + 1] - s[row, i])


def _interpolate_hermite(x: Array, values: Array, slopes: Array, row: IntArray, i: IntArray, f: Array) -> Array:
    """Cubic Hermite interpolation at fraction f of interval i; x (n, m), values and slopes (n, m, d) -> (n, k, d)."""
    h, f = (x[row, i + 1] - x[row, i])[..., None], f[..., None]
    p, q = values[row, i], values[row, i + 1]
    dp, dq = h * slopes[row, i], h * slopes[row, i + 1]
    return p + f * (dp + f * (3 * (q - p) - 2 * dp - dq + f * (2 * (p - q) + dp + dq)))
