"""Signed distances from planes, cylinders, cones, spheres and tori as rows of one table, evaluated in batches.

What a surface looks like from a patch is a row too: the surface brought into the patch's frame and written in one way only, so
that patches which see it from the same place have the same row. A cylinder's point is the one of its axis next to the frame's
origin, a cone's its apex, with the axis towards its open end; the sense of other axes is the one with the first coordinate > 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad.patches.carriers import Carrier, Cone, Cylinder, Plane, Sphere, Torus
from tpmscad.trimming.tool import Array, Flags, Ints, TrimmingError

PLANE, CYLINDER, CONE, SPHERE, TORUS = range(5)

LEAST = 1e-150
"""Lengths below it are taken for it where they divide: on an axis directions are undefined, but finite."""


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """n surfaces: kind (n,), point and axis (n, 3), two numbers a and b (n,).

    Plane: axis . x + a. Cylinder: a is its radius. Cone: a is half its opening angle. Sphere: a is its radius, no axis.
    Torus: radii a of its circle and b of its tube.
    """

    kind: Ints
    point: Array
    axis: Array
    a: Array
    b: Array

    def __len__(self) -> int:
        return len(self.kind)

    @property
    def flat(self) -> Flags:
        return self.kind == PLANE

    def of(self, rows: Ints) -> Levels:
        return Levels(self.kind[rows], self.point[rows], self.axis[rows], self.a[rows], self.b[rows])

    def framed(self, rotation: Array, translation: Array) -> Levels:
        """Row i as seen from the frame whose points x lie at rotation[i] x + translation[i]."""
        axis = np.einsum("ni,nij->nj", self.axis, rotation)
        point = np.einsum("ni,nij->nj", self.point - translation, rotation)
        flat, centred = self.kind == PLANE, (self.kind == SPHERE) | (self.kind == TORUS)
        a = np.where(flat, self.a + np.einsum("ni,ni->n", self.axis, translation), self.a)
        along = self.kind == CYLINDER
        point = np.where(along[:, None], point - np.einsum("ni,ni->n", point, axis)[:, None] * axis, point)
        point = np.where(flat[:, None], 0.0, point)
        rounded = np.round(axis, 9)
        leading = rounded[np.arange(len(axis)), (rounded != 0).argmax(axis=1)]
        turn = (along | centred) & (leading < 0)
        return Levels(self.kind, point, np.where(turn[:, None], -axis, axis), a, self.b)

    def turned(self, sign: Ints) -> Levels:
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
        r = np.maximum(np.sqrt(np.einsum("nmk,nmk->nm", across, across)), LEAST)
        around = None
        if kind in (CYLINDER, SPHERE):
            value, by_r, by_z = r - a, np.ones_like(r), np.zeros_like(r)
        elif kind == CONE:
            value = r * np.cos(a) - z * np.sin(a)
            by_r, by_z = np.broadcast_to(np.cos(a), r.shape), np.broadcast_to(-np.sin(a), r.shape)
        else:
            around = np.maximum(np.hypot(r - a, z), LEAST)
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


def levels_of(carriers: Sequence[Carrier]) -> Levels:
    """The rows of carriers, signed as their `distance`."""
    return Levels(*(np.array(column) for column in zip(*(_row(c) for c in carriers), strict=True)))


def _row(carrier: Carrier) -> tuple[int, Array, Array, float, float]:
    zero = np.zeros(3)
    if isinstance(carrier, Plane):
        return PLANE, zero, carrier.normal, -float(carrier.normal @ carrier.origin), 0.0
    if isinstance(carrier, Cylinder):
        return CYLINDER, carrier.origin, carrier.axis, carrier.radius, 0.0
    if isinstance(carrier, Cone):
        up = 1.0 if carrier.angle > 0 else -1.0
        apex = carrier.origin - carrier.radius / np.tan(carrier.angle) * carrier.axis
        return CONE, apex, up * carrier.axis, abs(carrier.angle), 0.0
    if isinstance(carrier, Sphere):
        return SPHERE, carrier.origin, zero, carrier.radius, 0.0
    if isinstance(carrier, Torus):
        return TORUS, carrier.origin, carrier.axis, carrier.major, carrier.minor
    raise TrimmingError(f"a face of the body lies on a {type(carrier).__name__}, not on a plane or a quadric")
