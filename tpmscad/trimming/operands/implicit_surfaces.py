"""Signed distances from planes, cylinders, cones, spheres and tori as rows of one table, evaluated in batches.

What a surface looks like from a patch is a row too: the surface brought into the patch's frame and written in one way only, so
that patches which see it from the same place have the same row. A cylinder's point is the one of its axis next to the frame's
origin, a cone's its apex, with the axis towards its open end; the sense of other axes is the one with the first coordinate > 0.

The signed distance from one surface along one patch: a function of (u, v), as a scalar B-spline is one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.carriers import Carrier, ConicalSurface, CylindricalSurface, Plane, SphericalSurface, ToroidalSurface
from tpmscad.errors import TrimmingError
from tpmscad.rigid_motion import Motion
from tpmscad.splines.basis import design_matrices
from tpmscad.splines.bspline import BSplineSurface

PLANE, CYLINDER, CONE, SPHERE, TORUS = range(5)

MIN_DIVISOR_LENGTH = 1e-150
"""Lengths below it are taken for it where they divide: on an axis directions are undefined, but finite."""


@dataclass(frozen=True, slots=True, eq=False)
class ImplicitSurfaces:
    """n surfaces: kind (n,), point and axis (n, 3), two numbers a and b (n,).

    Plane: axis . x + a. Cylinder: a is its radius. Cone: a is half its opening angle. Sphere: a is its radius, no axis.
    Torus: radii a of its circle and b of its tube.
    """

    kind: IntArray
    point: Array
    axis: Array
    a: Array
    b: Array

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def flat(self) -> BoolArray:
        return self.kind == PLANE

    def of(self, rows: IntArray) -> ImplicitSurfaces:
        return ImplicitSurfaces(self.kind[rows], self.point[rows], self.axis[rows], self.a[rows], self.b[rows])

    def in_frames(self, motion: Motion) -> ImplicitSurfaces:
        """Row i as seen from the frame whose points x lie at motion[i](x)."""
        axis = motion.apply_inverse_to_vectors(self.axis)
        point = motion.apply_inverse(self.point)
        flat, centred = self.kind == PLANE, (self.kind == SPHERE) | (self.kind == TORUS)
        a = np.where(flat, self.a + np.einsum("ni,ni->n", self.axis, motion.translation), self.a)
        along = self.kind == CYLINDER
        point = np.where(along[:, None], point - np.einsum("ni,ni->n", point, axis)[:, None] * axis, point)
        point = np.where(flat[:, None], 0.0, point)
        rounded = np.round(axis, 9)
        leading = rounded[np.arange(len(axis)), (rounded != 0).argmax(axis=1)]
        turn = (along | centred) & (leading < 0)
        return ImplicitSurfaces(self.kind, point, np.where(turn[:, None], -axis, axis), a, self.b)

    def flip_planes(self, sign: IntArray) -> ImplicitSurfaces:
        """Planes seen from the other side where sign is -1."""
        return replace(self, axis=self.axis * sign[:, None], a=np.where(self.flat, self.a * sign, self.a))

    def key(self, size: float) -> Array:
        """Rows that are equal where the surfaces are: to 1e-9 in direction and 1e-10 of `size` in place."""
        plain = np.column_stack([np.where(self.flat, self.a / size, self.a), self.point / size])
        return np.column_stack([self.kind, np.round(self.axis, 9), np.round(plain, 10), np.round(self.b, 10)]) + 0.0

    def value(self, points: Array) -> Array:
        """Signed distances (n, m) of points (n, m, 3), row by row."""
        return self.jet(points, 0)[0]

    def distances(self, points: Array) -> Array:
        """Signed distances of all points (m, 3) from all surfaces: (m, n)."""
        result = np.empty((len(points), len(self)))
        for k in range(len(self)):
            result[:, k] = self.of(np.array([k])).value(points[None])[0]
        return result

    def jet(self, points: Array, order: int) -> list[Array]:
        """Distance (n, m), its gradient (n, m, 3) and its second derivatives (n, m, 3, 3), up to `order`."""
        n, m = points.shape[:2]
        result = [np.zeros((n, m, *(3,) * k)) for k in range(order + 1)]
        for kind in np.unique(self.kind):
            rows = np.flatnonzero(self.kind == kind)
            everything = len(rows) == n
            own = self if everything else self.of(rows)
            found = own._of_kind(int(kind), points if everything else points[rows], order)
            for total, part in zip(result, found, strict=True):
                total[rows] = part
        return result

    def _of_kind(self, kind: int, points: Array, order: int) -> list[Array]:
        axis, a, b = self.axis[:, None], self.a[:, None], self.b[:, None]
        if kind == PLANE:
            found = [np.einsum("nmk,nk->nm", points, self.axis) + a]
            if order:
                found.append(np.broadcast_to(axis, points.shape))
            if order > 1:
                found.append(np.zeros((*points.shape, 3)))
            return found
        arm = points - self.point[:, None]
        z = np.einsum("nmk,nk->nm", arm, self.axis)
        across = arm - z[..., None] * axis  # a sphere has no axis, and all of its arm is across
        r = np.maximum(np.sqrt(np.einsum("nmk,nmk->nm", across, across)), MIN_DIVISOR_LENGTH)
        around = None
        if kind in (CYLINDER, SPHERE):
            value, by_r, by_z = r - a, np.ones_like(r), np.zeros_like(r)
        elif kind == CONE:
            value = r * np.cos(a) - z * np.sin(a)
            by_r, by_z = np.broadcast_to(np.cos(a), r.shape), np.broadcast_to(-np.sin(a), r.shape)
        else:
            around = np.maximum(np.hypot(r - a, z), MIN_DIVISOR_LENGTH)
            value, by_r, by_z = around - b, (r - a) / around, z / around
        found = [value]
        if order:
            e = across / r[..., None]
            found.append(by_r[..., None] * e + by_z[..., None] * axis)
        if order > 1:
            base = np.eye(3) - axis[..., :, None] * axis[..., None, :] - e[..., :, None] * e[..., None, :]
            second = (by_r / r)[..., None, None] * base
            if around is not None:
                along = by_z[..., None] * e - by_r[..., None] * axis
                second = second + along[..., :, None] * along[..., None, :] / around[..., None, None]
            found.append(second)
        return found


def build_implicit_surfaces(carriers: Sequence[Carrier]) -> ImplicitSurfaces:
    """The rows of carriers, signed as their `distance`."""
    return ImplicitSurfaces(*(np.array(column) for column in zip(*(_read_carrier(c) for c in carriers), strict=True)))


def _read_carrier(carrier: Carrier) -> tuple[int, Array, Array, float, float]:
    zero = np.zeros(3)
    if isinstance(carrier, Plane):
        return PLANE, zero, carrier.normal, -float(carrier.normal @ carrier.origin), 0.0
    if isinstance(carrier, CylindricalSurface):
        return CYLINDER, carrier.origin, carrier.axis, carrier.radius, 0.0
    if isinstance(carrier, ConicalSurface):
        up = 1.0 if carrier.angle > 0 else -1.0
        apex = carrier.origin - carrier.radius / np.tan(carrier.angle) * carrier.axis
        return CONE, apex, up * carrier.axis, abs(carrier.angle), 0.0
    if isinstance(carrier, SphericalSurface):
        return SPHERE, carrier.origin, zero, carrier.radius, 0.0
    if isinstance(carrier, ToroidalSurface):
        return TORUS, carrier.origin, carrier.axis, carrier.major, carrier.minor
    raise TrimmingError(f"a face of the body lies on a {type(carrier).__name__}, not on a plane or a quadric")


@dataclass(frozen=True, slots=True, eq=False)
class ComposedDistance:
    """g(S(u, v)) for the surface S and the one row g."""

    surface: BSplineSurface
    level: ImplicitSurfaces

    @property
    def domain(self) -> tuple[tuple[float, float], tuple[float, float]]:
        return self.surface.domain

    def grid(self, u: Array, v: Array, du: int = 0, dv: int = 0) -> Array:
        """Values or first derivatives on the grid of all u with all v: (len(u), len(v), 1)."""
        points = _evaluate_cached_grid(self.surface, u.tobytes(), v.tobytes(), 0, 0)
        found = self.level.jet(points.reshape(1, -1, 3), du + dv)
        if du + dv == 0:
            return found[0].reshape((*points.shape[:-1], 1))
        along = _evaluate_cached_grid(self.surface, u.tobytes(), v.tobytes(), du, dv)
        return np.einsum("nk,nk->n", found[1][0], along.reshape(-1, 3)).reshape((*points.shape[:-1], 1))


@lru_cache(maxsize=64)
def _evaluate_cached_grid(surface: BSplineSurface, u: bytes, v: bytes, du: int, dv: int) -> Array:
    """A patch's points or derivatives on a grid: mostly the same grid for every surface that cuts the patch."""
    return surface.grid(np.frombuffer(u), np.frombuffer(v), du, dv)


def compose_with_patch(surface: BSplineSurface, level: ImplicitSurfaces) -> BSplineSurface | ComposedDistance:
    """The distance from the one row `level` along the patch; from a plane it is a B-spline itself."""
    if not level.flat[0]:
        return ComposedDistance(surface, level)
    poles = surface.poles @ level.axis[0] + level.a[0]
    return BSplineSurface(poles[..., None], surface.knots_u, surface.knots_v, surface.degree_u, surface.degree_v)


def evaluate_second_jet(level: BSplineSurface | ComposedDistance, at: Array) -> tuple[float, Array, Array]:
    """Value, gradient (2,) and second derivatives (2, 2) by u and v at one point."""
    surface = level if isinstance(level, BSplineSurface) else level.surface
    bu = [b[0] for b in design_matrices(surface.knots_u, surface.degree_u, at[:1], (0, 1, 2))]
    bv = [b[0] for b in design_matrices(surface.knots_v, surface.degree_v, at[1:], (0, 1, 2))]
    half = np.tensordot(np.stack(bu), surface.poles, 1)  # (3, V, D)
    s = np.einsum("kv,ivd->ikd", np.stack(bv), half)  # derivative (i, k)
    if isinstance(level, BSplineSurface):
        s = s[..., 0]
        return float(s[0, 0]), np.array([s[1, 0], s[0, 1]]), np.array([[s[2, 0], s[1, 1]], [s[1, 1], s[0, 2]]])
    value, gradient, hessian = (j[0, 0] for j in level.level.jet(s[0, 0][None, None], 2))
    first = np.stack([s[1, 0], s[0, 1]])
    second = np.array([[s[2, 0], s[1, 1]], [s[1, 1], s[0, 2]]]) @ gradient + first @ hessian @ first.T
    return float(value), first @ gradient, second
