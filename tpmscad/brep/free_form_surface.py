"""Free-form carriers of faces: polynomial B-spline surfaces with the signed distance, its gradient and foot parameters.

They are called and asked like planes and quadrics: the distance of a point is that from its nearest foot, positive on the side of
S_u x S_v. Where the surface ends before the normal through the point reaches it, the foot is forced to the border, and the values
are those of the tangent plane there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.brep.carriers import Plane, Quadric
from tpmscad.brep.foot_surface import find_point_sides
from tpmscad.brep.surface_feet import SurfaceFeet, SurfaceGrid, find_feet, make_surface_grid
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface

CLOSED_RTOL = 1e-9
"""In sizes of the surface: distance of the sides at a seam."""

SEAM_ANGLE = 1e-6
"""Radians between the normals on both sides of a seam, up to which the surface is smooth there."""

SEAM_SAMPLES = 33
"""Points along a seam at which that is measured."""


@dataclass(frozen=True, slots=True, eq=False)
class FreeFormSurface:
    """A polynomial B-spline surface as an implicit surface.

    Attributes
    ----------
    spline : BSplineSurface
        The surface, of degrees 1 to 9, without creases.
    closed : tuple of bool
        Whether it is closed and smooth along u, and along v; its parameters have a period then.
    continuation : float
        Length in model units by which the polynomials of its end spans go on beyond its borders, at most: by half a span at
        most, and neither beyond a pole nor beyond a seam.
    """

    spline: BSplineSurface
    closed: tuple[bool, bool] = (False, False)
    continuation: float = 0.0

    @property
    def domain(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Parameter rectangle ((u0, u1), (v0, v1)) of the spline."""
        return self.spline.domain

    @property
    def period(self) -> tuple[float, float]:
        """Periods of u and v; 0 means none."""
        (u0, u1), (v0, v1) = self.spline.domain
        return (u1 - u0 if self.closed[0] else 0.0), (v1 - v0 if self.closed[1] else 0.0)

    def __call__(self, u: ArrayLike, v: ArrayLike, du: int = 0, dv: int = 0) -> Array:
        """Points, or the mixed derivative of orders (du, dv), at the pairs (u, v), broadcast: (..., 3)."""
        s, t = (
            low + np.mod(np.asarray(x, float) - low, period) if period else np.asarray(x, float)
            for x, (low, _), period in zip((u, v), self.domain, self.period, strict=True)
        )
        return self.spline(s, t, du, dv)

    def normal(self, u: ArrayLike, v: ArrayLike) -> Array:
        """S_u x S_v at the pairs (u, v), not normalised: (..., 3)."""
        return np.cross(self(u, v, 1, 0), self(u, v, 0, 1))

    def feet(self, points: ArrayLike) -> SurfaceFeet:
        """The nearest feet of points (..., 3), in one row."""
        return find_feet(_make_grid(self), np.asarray(points, float).reshape(-1, 3))

    def parameters(self, points: ArrayLike) -> Array:
        """(u, v) of the nearest feet of points (..., 3): (..., 2)."""
        return self.feet(points).parameters.reshape(*np.shape(points)[:-1], 2)

    def distance(self, points: ArrayLike) -> Array:
        """Signed distance of points (..., 3), positive on the side of S_u x S_v: (...)."""
        return self.feet(points).distance.reshape(np.shape(points)[:-1])

    def gradient(self, points: ArrayLike) -> Array:
        """Gradient of the distance, unit vectors: (..., 3)."""
        return self.feet(points).gradient.reshape(np.shape(points))

    def poles_across_v(self) -> tuple[tuple[int, Array], ...]:
        """The sides of constant v that are points: -1 for that of low v, 1 for that of high v, and the point (3,)."""
        is_point, poles = find_point_sides(self.spline), self.spline.poles
        return tuple((end, poles[0, at]) for end, side, at in ((-1, 0, 0), (1, 2, -1)) if is_point[side])

    def scaled(self, factor: float) -> FreeFormSurface:
        """The surface scaled about the origin of space."""
        return FreeFormSurface(self.spline.scaled(factor), self.closed, factor * self.continuation)

    def moved(self, motion: Motion) -> FreeFormSurface:
        """The surface after a rigid motion, with its sides; a mirror reverses the parameter u."""
        spline = self.spline.moved(motion)
        if motion.handedness < 0:
            low, high = spline.domain[0]
            spline = BSplineSurface(
                spline.poles[::-1].copy(),
                (low + high) - spline.knots_u[::-1],
                spline.knots_v,
                spline.degree_u,
                spline.degree_v,
            )
        return FreeFormSurface(spline, self.closed, self.continuation)


BodyCarrier = Plane | Quadric | FreeFormSurface
"""What carries a face of a body to trim by: a surface with a signed distance and with parameters of points."""


@lru_cache(maxsize=256)
def _make_grid(surface: FreeFormSurface) -> SurfaceGrid:
    """The nodes from which feet are sought, made at the first question."""
    return make_surface_grid(surface.spline, surface.closed, surface.continuation)


def find_smooth_seams(spline: BSplineSurface) -> tuple[bool, bool]:
    """Whether a surface is closed along u, and along v, with one tangent plane on both sides of the seam.

    Sides that are points are no seams.
    """
    size = float(np.linalg.norm(np.ptp(spline.poles.reshape(-1, 3), axis=0)))
    found = []
    for axis in (0, 1):
        t = np.linspace(*spline.domain[1 - axis], SEAM_SAMPLES)
        ends = [(end, t) if axis == 0 else (t, end) for end in spline.domain[axis]]
        points, normals = ([f(*end) for end in ends] for f in (spline, spline.normal))
        together = np.abs(points[1] - points[0]).max() <= CLOSED_RTOL * size
        extent = np.linalg.norm(np.ptp(points[0], axis=0)) > CLOSED_RTOL * size
        lengths = [np.linalg.norm(n, axis=1) for n in normals]
        regular = np.minimum(*lengths) > SEAM_ANGLE * max(lengths[0].max(), lengths[1].max())
        turned = np.linalg.norm(np.cross(normals[0], normals[1]), axis=1) > SEAM_ANGLE * lengths[0] * lengths[1]
        against = np.einsum("nk,nk->n", normals[0], normals[1]) < 0
        found.append(bool(together and extent and not ((turned | against) & regular).any()))
    return found[0], found[1]
