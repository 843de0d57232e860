"""Least-squares fits of surfaces to samples on a tensor grid, free or under linear conditions, solved directly.

In the orthonormal coordinates of the two axes the free solution is Phi_u^T W Q Phi_v, with W the weights, and the constrained
one is its orthogonal projection on the subspace of the conditions: two small products and a projection, no normal equations. The
program makes its control nets by iteration (`cpia`); the direct solution is the independent reference.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.affine_subspace import AffineSubspace
from tpmscad.splines.basis import apply_bases
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.spline_axis import SplineAxis


def fit_surface(
    samples: Array, axis_u: SplineAxis, axis_v: SplineAxis, subspace: AffineSubspace | None = None
) -> BSplineSurface:
    """Least-squares fit to samples at the points of two axes, solved directly.

    Parameters
    ----------
    samples : ndarray, shape (m, n, D)
        Points at the axes' sample points.
    axis_u, axis_v : SplineAxis
        Spline spaces in coordinates orthonormal on their points.
    subspace : AffineSubspace, optional
        Conditions on the coordinates. If it has a metric, the result is the surface nearest in it to the unconstrained fit.

    Returns
    -------
    BSplineSurface
        The surface with the least weighted sum of squared differences.

    Raises
    ------
    ValueError
        If the samples don't lie on the grid of the axes.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import bezier_knots, fit_surface, gauss_axis
    >>> axis = gauss_axis(bezier_knots(2), 2)
    >>> u, v = np.meshgrid(axis.points, axis.points, indexing="ij")
    >>> surface = fit_surface(np.stack([u, v, u * v], axis=-1), axis, axis)
    >>> bool(np.allclose(surface(0.3, 0.7), [0.3, 0.7, 0.21]))
    True
    """
    coordinates = least_squares_coordinates(samples, axis_u, axis_v)
    if subspace is not None:
        coordinates = subspace.project(coordinates.ravel()).reshape(coordinates.shape)
    return surface_from_coordinates(coordinates, axis_u, axis_v)


def least_squares_coordinates(samples: Array, axis_u: SplineAxis, axis_v: SplineAxis) -> Array:
    """Coordinates (U, V, D) of the unconstrained least-squares fit to samples (m, n, D) at the axes' points."""
    expected = (len(axis_u.points), len(axis_v.points))
    if samples.shape[:2] != expected or samples.ndim != 3:
        raise ValueError(f"samples {samples.shape} don't lie on the axes' grid {expected}")
    left = np.sqrt(axis_u.weights)[:, None] * axis_u.weighted_design_matrix()
    right = np.sqrt(axis_v.weights)[:, None] * axis_v.weighted_design_matrix()
    return apply_bases(left.T, samples, right.T)


def gram_eigenvalue_bounds(basis_u: Array, basis_v: Array) -> tuple[float, float]:
    """Least and greatest eigenvalue of B^T B for the tensor product B of two design matrices."""
    values = [np.linalg.svd(b, compute_uv=False) ** 2 for b in (basis_u, basis_v)]
    return float(values[0][-1] * values[1][-1]), float(values[0][0] * values[1][0])


def surface_from_coordinates(coordinates: Array, axis_u: SplineAxis, axis_v: SplineAxis) -> BSplineSurface:
    """The surface with the given coordinates (U, V, D)."""
    poles = apply_bases(axis_u.to_poles, coordinates, axis_v.to_poles)
    return BSplineSurface(poles, axis_u.knots, axis_v.knots, axis_u.degree, axis_v.degree)


def coordinates_from_surface(surface: BSplineSurface, axis_u: SplineAxis, axis_v: SplineAxis) -> Array:
    """Coordinates (U, V, D) of a surface with the knots of the axes."""
    half = np.linalg.solve(axis_u.to_poles, surface.poles.reshape(axis_u.n_coordinates, -1)).reshape(
        surface.poles.shape
    )
    return (
        np.linalg.solve(axis_v.to_poles, half.swapaxes(0, 1).reshape(axis_v.n_coordinates, -1))
        .reshape(axis_v.n_coordinates, axis_u.n_coordinates, -1)
        .swapaxes(0, 1)
    )
