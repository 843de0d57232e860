"""Trivariate tensor-product B-splines: bodies with parameters u, v, w, as isogeometric analysis takes them.

Like curves and surfaces they hold poles, knots with repetition and degrees, and nothing else. A body is right-handed if
(V_u x V_v) . V_w is positive.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.rigid_motion import Motion
from tpmscad.splines.basis import check_knot_counts, design_matrix, knot_domain, nonzero_basis
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.knots import bezier_knots, bezier_rows
from tpmscad.splines.quadrature import composite_gauss_legendre

POINTS_AT_ONCE = 20_000
"""Points evaluated at once: tens of megabytes of basis functions, and many points in each span."""


@dataclass(frozen=True, slots=True, eq=False)
class BSplineVolume:
    """Trivariate tensor-product B-spline in three dimensions.

    Parameters
    ----------
    poles : ndarray, shape (U, V, W, 3)
        Control net.
    knots : tuple of three ndarrays
        Knot vectors with repetition: U + degree + 1 knots along u, and so on.
    degrees : tuple of three ints
        Polynomial degrees.

    Raises
    ------
    ValueError
        If the number of knots does not fit the poles and the degrees.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import BSplineVolume, bezier_knots
    >>> corners = np.stack(np.meshgrid([0.0, 2.0], [0.0, 1.0], [0.0, 1.0], indexing="ij"), axis=-1)
    >>> block = BSplineVolume(corners, (bezier_knots(1),) * 3, (1, 1, 1))
    >>> block.integrate_volume()
    2.0
    """

    poles: Array
    knots: tuple[Array, Array, Array]
    degrees: tuple[int, int, int]

    def __post_init__(self) -> None:
        check_knot_counts(self.poles, self.knots, self.degrees)

    @property
    def domain(self) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
        """Parameter box ((u0, u1), (v0, v1), (w0, w1))."""
        u, v, w = (knot_domain(knots, degree) for knots, degree in zip(self.knots, self.degrees, strict=True))
        return u, v, w

    def grid(self, u: ArrayLike, v: ArrayLike, w: ArrayLike, orders: tuple[int, int, int] = (0, 0, 0)) -> Array:
        """Points, or the mixed derivative of the given orders, on the grid of all u, v and w: (len(u), len(v), len(w), 3)."""
        result = self.poles
        for axis, (t, order) in enumerate(zip((u, v, w), orders, strict=True)):
            rows = design_matrix(self.knots[axis], self.degrees[axis], np.asarray(t, float), order)
            result = np.moveaxis(np.tensordot(rows, result, axes=(1, axis)), 0, axis)
        return result

    def jacobian(self, u: ArrayLike, v: ArrayLike, w: ArrayLike) -> Array:
        """(V_u x V_v) . V_w on the grid of all u, v and w: (len(u), len(v), len(w))."""
        du, dv, dw = (self.grid(u, v, w, orders) for orders in ((1, 0, 0), (0, 1, 0), (0, 0, 1)))
        return np.einsum("...i,...i->...", np.cross(du, dv), dw)

    def images(self, points: Array) -> tuple[Array, Array]:
        """Images (n, 3) of parameters (n, 3), and Jacobian matrices (n, 3, 3), entry (i, j) the derivative of i by parameter j.

        Beyond the domain the polynomials of the last spans go on.
        """
        image, jacobian = np.empty((len(points), 3)), np.empty((len(points), 3, 3))
        for start in range(0, len(points), POINTS_AT_ONCE):
            rows = slice(start, start + POINTS_AT_ONCE)
            image[rows], jacobian[rows] = self._images_of_few(points[rows])
        return image, jacobian

    def _images_of_few(self, points: Array) -> tuple[Array, Array]:
        """As `images`. The points of one span share its poles, so that each span is three products of matrices."""
        first, value, slope = zip(
            *(nonzero_basis(k, p, t) for k, p, t in zip(self.knots, self.degrees, points.T, strict=True)), strict=True
        )
        image, jacobian = np.empty((len(points), 3)), np.empty((len(points), 3, 3))
        span = np.ravel_multi_index(first, self.poles.shape[:3])
        order = np.argsort(span, kind="stable")
        for rows in np.split(order, 1 + np.flatnonzero(np.diff(span[order]))) if len(points) else ():
            i, j, k = (slice(at[rows[0]], at[rows[0]] + p + 1) for at, p in zip(first, self.degrees, strict=True))
            (u, v, w), (du, dv, dw) = ([values[rows] for values in each] for each in (value, slope))
            net = self.poles[i, j, k].reshape(self.degrees[0] + 1, -1)
            shape = len(rows), self.degrees[1] + 1, -1
            at_u, by_u = (u @ net).reshape(shape), (du @ net).reshape(shape)

            def along_v(basis: Array, poles: Array) -> Array:
                """Poles (n, degree_w + 1, 3) of the lines along w at the points."""
                return np.einsum("nqk,nq->nk", poles, basis).reshape(len(basis), -1, 3)

            lines = along_v(v, at_u)
            image[rows] = np.einsum("nkd,nk->nd", lines, w)
            jacobian[rows, :, 0] = np.einsum("nkd,nk->nd", along_v(v, by_u), w)
            jacobian[rows, :, 1] = np.einsum("nkd,nk->nd", along_v(dv, at_u), w)
            jacobian[rows, :, 2] = np.einsum("nkd,nk->nd", lines, dw)
        return image, jacobian

    def integrate_volume(self) -> float:
        """The integral of the Jacobian determinant, by a Gauss rule that is exact for it; negative if left-handed."""
        rules = [
            composite_gauss_legendre(np.unique(knots[p : len(knots) - p]), (3 * p + 1) // 2)
            for knots, p in zip(self.knots, self.degrees, strict=True)
        ]
        (u, weights_u), (v, weights_v), (w, weights_w) = rules
        return float(np.einsum("ijk,i,j,k->", self.jacobian(u, v, w), weights_u, weights_v, weights_w))

    def end(self, axis: int, last: bool) -> BSplineSurface:
        """The boundary surface at the first or last parameter of an axis; the other two parameters stay in order."""
        i, j = (k for k in range(3) if k != axis)
        poles = np.take(self.poles, -1 if last else 0, axis=axis)
        return BSplineSurface(poles, self.knots[i], self.knots[j], self.degrees[i], self.degrees[j])

    def reversed_w(self) -> BSplineVolume:
        """The same body with w reversed: of the other handedness."""
        low, high = self.domain[2]
        u, v, w = self.knots
        return BSplineVolume(self.poles[:, :, ::-1].copy(), (u, v, (low + high) - w[::-1]), self.degrees)

    def moved(self, motion: Motion) -> BSplineVolume:
        """Image under a rigid motion."""
        return BSplineVolume(motion.apply(self.poles), self.knots, self.degrees)

    def scaled(self, factor: float) -> BSplineVolume:
        """Body x -> factor x."""
        return BSplineVolume(factor * self.poles, self.knots, self.degrees)

    def bezier_nets(self) -> Array:
        """Control nets of the polynomial spans: (spans, degree_u + 1, degree_v + 1, degree_w + 1, 3), u slowest."""
        rows = [bezier_rows(knots, degree)[1] for knots, degree in zip(self.knots, self.degrees, strict=True)]
        nets = np.einsum("aip,bjq,ckr,pqrd->abcijkd", *rows, self.poles, optimize=True)
        return np.asarray(nets.reshape(-1, *nets.shape[3:]))


def ruled_volume(lower: BSplineSurface, upper: BSplineSurface) -> BSplineVolume:
    """The body of the segments between points of equal parameters of two surfaces.

    Parameters
    ----------
    lower, upper : BSplineSurface
        Surfaces of one spline space. Between two offsets of one surface the segments are normals of that surface.

    Returns
    -------
    BSplineVolume
        Linear along w, from `lower` at 0 to `upper` at 1.

    Raises
    ------
    ValueError
        If the surfaces have different spline spaces.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import BSplineSurface, bezier_knots, ruled_volume
    >>> knots = bezier_knots(1)
    >>> square = np.array([[[0.0, 0, 0], [0, 2, 0]], [[2, 0, 0], [2, 2, 0]]])
    >>> lower, upper = (BSplineSurface(square + [0, 0, z], knots, knots, 1, 1) for z in (0, 3))
    >>> ruled_volume(lower, upper).integrate_volume()
    12.0
    """
    same = lower.poles.shape == upper.poles.shape and all(
        np.array_equal(a, b) for a, b in ((lower.knots_u, upper.knots_u), (lower.knots_v, upper.knots_v))
    )
    if not same:
        raise ValueError("a ruled volume needs two surfaces of one spline space")
    return BSplineVolume(
        np.stack([lower.poles, upper.poles], axis=2),
        (lower.knots_u, lower.knots_v, bezier_knots(1)),
        (lower.degree_u, lower.degree_v, 1),
    )
