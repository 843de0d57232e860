"""Tensor-product B-splines as frozen values: poles, knots with repetition and degree. Nothing else is stored.

The basis is evaluated one parameter at a time (`basis.design_matrix`). The four sides of a surface are numbered
counter-clockwise in (u, v). Each side runs counter-clockwise too, with the patch on its left:

    side 0: v = v0, u rising      side 1: u = u1, v rising      side 2: v = v1, u falling      side 3: u = u0, v falling
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.rigid_motion import Motion
from tpmscad.splines.basis import (
    apply_bases,
    check_knot_counts,
    design_matrices,
    design_matrix,
    knot_domain,
    scipy_spline,
)


@dataclass(frozen=True, slots=True, eq=False)
class BSplineCurve:
    """B-spline curve in D dimensions.

    Parameters
    ----------
    poles : ndarray, shape (N, D)
        Control points.
    knots : ndarray, shape (N + degree + 1,)
        Knot vector with repetition.
    degree : int
        Polynomial degree.

    Raises
    ------
    ValueError
        If the number of knots does not fit the poles and the degree.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import BSplineCurve, bezier_knots
    >>> parabola = BSplineCurve(np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 1.0]]), bezier_knots(2), 2)
    >>> parabola(0.5)
    array([0.5 , 0.25])
    """

    poles: Array
    knots: Array
    degree: int

    def __post_init__(self) -> None:
        check_knot_counts(self.poles, (self.knots,), (self.degree,))

    @property
    def domain(self) -> tuple[float, float]:
        """Ends of the parameter interval."""
        return knot_domain(self.knots, self.degree)

    def __call__(self, t: ArrayLike, order: int = 0) -> Array:
        """Points, or derivatives of the given order, at t: (..., D)."""
        return np.asarray(scipy_spline(self.knots, self.poles, self.degree)(np.asarray(t, float), order))

    def reversed(self) -> BSplineCurve:
        """Curve of the same points on the same domain, run in the opposite direction."""
        low, high = self.domain
        return BSplineCurve(self.poles[::-1].copy(), (low + high) - self.knots[::-1], self.degree)

    def moved(self, motion: Motion) -> BSplineCurve:
        """Image under a rigid motion."""
        return BSplineCurve(motion.apply(self.poles), self.knots, self.degree)

    def scaled(self, factor: float) -> BSplineCurve:
        """Curve x -> factor x."""
        return BSplineCurve(factor * self.poles, self.knots, self.degree)


def is_segment(curve: object) -> bool:
    """Whether a curve is a single straight segment of degree one."""
    return isinstance(curve, BSplineCurve) and curve.degree == 1 and len(curve.poles) == 2


def line_segment(start: ArrayLike, end: ArrayLike, domain: tuple[float, float] = (0.0, 1.0)) -> BSplineCurve:
    """Straight segment as a curve of degree one.

    Parameters
    ----------
    start, end : array_like, shape (D,)
        End points.
    domain : tuple of float, optional
        Parameters of the end points.

    Returns
    -------
    BSplineCurve
        The segment, parametrised linearly.

    Examples
    --------
    >>> from tpmscad.splines import line_segment
    >>> line_segment([0, 0], [2, 4])(0.25)
    array([0.5, 1. ])
    """
    return BSplineCurve(np.array([start, end], float), np.repeat(np.array(domain, float), 2), 1)


@dataclass(frozen=True, slots=True, eq=False)
class BSplineSurface:
    """Tensor-product B-spline surface in D dimensions.

    Parameters
    ----------
    poles : ndarray, shape (U, V, D)
        Control net.
    knots_u, knots_v : ndarray, shape (U + degree_u + 1,), (V + degree_v + 1,)
        Knot vectors with repetition.
    degree_u, degree_v : int
        Polynomial degrees.

    Raises
    ------
    ValueError
        If the number of knots does not fit the poles and the degree.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import BSplineSurface, bezier_knots
    >>> knots = bezier_knots(1)
    >>> saddle = BSplineSurface(np.array([[[0.0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 1]]]), knots, knots, 1, 1)
    >>> saddle(0.5, 0.5)
    array([0.5 , 0.5 , 0.25])
    """

    poles: Array
    knots_u: Array
    knots_v: Array
    degree_u: int
    degree_v: int

    def __post_init__(self) -> None:
        check_knot_counts(self.poles, (self.knots_u, self.knots_v), (self.degree_u, self.degree_v))

    @property
    def domain(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Parameter rectangle ((u0, u1), (v0, v1))."""
        return knot_domain(self.knots_u, self.degree_u), knot_domain(self.knots_v, self.degree_v)

    @property
    def space(self) -> tuple[int, int, bytes, bytes]:
        """Degrees and knots, equal for surfaces of one spline space."""
        return self.degree_u, self.degree_v, self.knots_u.tobytes(), self.knots_v.tobytes()

    @property
    def corners(self) -> Array:
        """Parameters (4, 2) of the corners; corner i is the start of side i."""
        (u0, u1), (v0, v1) = self.domain
        return np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]])

    def __call__(self, u: ArrayLike, v: ArrayLike, du: int = 0, dv: int = 0) -> Array:
        """Points, or the mixed derivative of orders (du, dv), at the broadcast pairs (u, v): (..., D)."""
        u, v = np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float))
        rows = design_matrix(self.knots_u, self.degree_u, u.ravel(), du)
        columns = design_matrix(self.knots_v, self.degree_v, v.ravel(), dv)
        half = (rows @ self.poles.reshape(len(self.poles), -1)).reshape(len(rows), *self.poles.shape[1:])
        return (columns[:, None] @ half).reshape(*u.shape, self.poles.shape[2])

    def jet(self, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """Points and first derivatives by u and by v at parameters (n,), (n,): (n, D) each, in half the time of three calls."""
        rows = design_matrices(self.knots_u, self.degree_u, u, (0, 1))
        columns = design_matrices(self.knots_v, self.degree_v, v, (0, 1))
        half = (np.concatenate(rows) @ self.poles.reshape(len(self.poles), -1)).reshape(
            2, len(u), -1, self.poles.shape[2]
        )
        value, by_u = (columns[0][:, None] @ half)[:, :, 0]
        return value, by_u, (columns[1][:, None] @ half[0])[:, 0]

    def knot_lines(self, continuity: int) -> tuple[Array, Array]:
        """The inner knots along u and along v across which the surface is no smoother than C^continuity, by multiplicity."""
        found = []
        for knots, degree in ((self.knots_u, self.degree_u), (self.knots_v, self.degree_v)):
            values, counts = np.unique(knots[degree + 1 : -degree - 1], return_counts=True)
            found.append(values[degree - counts <= continuity])
        return found[0], found[1]

    def grid(self, u: ArrayLike, v: ArrayLike, du: int = 0, dv: int = 0) -> Array:
        """Points, or the mixed derivative of orders (du, dv), on the grid of all u with all v: (len(u), len(v), D)."""
        rows = design_matrix(self.knots_u, self.degree_u, np.asarray(u, float), du)
        columns = design_matrix(self.knots_v, self.degree_v, np.asarray(v, float), dv)
        return apply_bases(rows, self.poles, columns)

    def normal(self, u: ArrayLike, v: ArrayLike) -> Array:
        """Normal vectors S_u x S_v at the pairs (u, v), not of unit length: (..., 3)."""
        return np.cross(self(u, v, 1, 0), self(u, v, 0, 1))

    def side(self, index: int) -> BSplineCurve:
        """Boundary curve of side 0..3, run counter-clockwise."""
        along_u = index in (0, 2)
        poles = {0: self.poles[:, 0], 1: self.poles[-1], 2: self.poles[:, -1], 3: self.poles[0]}[index]
        curve = BSplineCurve(
            poles.copy(), self.knots_u if along_u else self.knots_v, self.degree_u if along_u else self.degree_v
        )
        return curve if index in (0, 1) else curve.reversed()

    def side_pcurve(self, index: int) -> BSplineCurve:
        """Parameter curve of side 0..3, with the domain and direction of `side(index)`."""
        corners = self.corners
        return line_segment(corners[index], corners[(index + 1) % 4], self.side(index).domain)

    def turned(self, turns: int) -> BSplineSurface:
        """Surface of the same points whose side 0 is side `turns` of this one, on the same domain turned with it."""
        surface = self
        for _ in range(turns % 4):
            low, high = surface.domain[0]
            poles = surface.poles[::-1].swapaxes(0, 1).copy()
            knots_v = (low + high) - surface.knots_u[::-1]
            surface = BSplineSurface(poles, surface.knots_v, knots_v, surface.degree_v, surface.degree_u)
        return surface

    def moved(self, motion: Motion) -> BSplineSurface:
        """Image under a rigid motion."""
        return BSplineSurface(motion.apply(self.poles), self.knots_u, self.knots_v, self.degree_u, self.degree_v)

    def scaled(self, factor: float) -> BSplineSurface:
        """Surface x -> factor x."""
        return BSplineSurface(factor * self.poles, self.knots_u, self.knots_v, self.degree_u, self.degree_v)


def isoparametric_curve(surface: BSplineSurface, axis: int, at: float) -> BSplineCurve:
    """Curve of the points of a surface at which parameter `axis` (0 or 1) is `at`, with the other parameter."""
    if axis == 0:
        rows = design_matrix(surface.knots_u, surface.degree_u, np.array([at]))
        return BSplineCurve(np.tensordot(rows[0], surface.poles, 1), surface.knots_v, surface.degree_v)
    rows = design_matrix(surface.knots_v, surface.degree_v, np.array([at]))
    return BSplineCurve(np.tensordot(rows[0], surface.poles, (0, 1)), surface.knots_u, surface.degree_u)
