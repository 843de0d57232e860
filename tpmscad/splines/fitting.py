"""Least-squares fits of surfaces to samples on a tensor grid, free or under linear conditions, solved directly.

In the orthonormal coordinates of the two axes the free solution is Phi_u^T Q Phi_v and the constrained one its orthogonal
projection on the subspace of the conditions: two small products and a projection, no normal equations.
"""

from __future__ import annotations

import numpy as np

from tpmscad.splines.axis import Axis
from tpmscad.splines.bspline import Array, Surface
from tpmscad.splines.subspace import Subspace


def fit(samples: Array, axis_u: Axis, axis_v: Axis, subspace: Subspace | None = None) -> Surface:
    """The surface in the subspace that is nearest to the samples (m, n, D) at the axes' points, in the sum of weighted squares.

    If the subspace has a metric of its own: the one that is nearest in it to the least-squares fit of the whole space.
    """
    coordinates = free_coordinates(samples, axis_u, axis_v)
    if subspace is not None:
        coordinates = subspace.project(coordinates.ravel()).reshape(coordinates.shape)
    return surface(coordinates, axis_u, axis_v)


def free_coordinates(samples: Array, axis_u: Axis, axis_v: Axis) -> Array:
    """Coordinates (U, V, D) of the unconstrained least-squares fit."""
    expected = (len(axis_u.points), len(axis_v.points))
    if samples.shape[:2] != expected or samples.ndim != 3:
        raise ValueError(f"samples {samples.shape} don't lie on the axes' grid {expected}")
    left = np.sqrt(axis_u.weights)[:, None] * axis_u.sampled()
    right = np.sqrt(axis_v.weights)[:, None] * axis_v.sampled()
    return np.einsum("mu,mnd,nv->uvd", left, samples, right, optimize=True)


def surface(coordinates: Array, axis_u: Axis, axis_v: Axis) -> Surface:
    """The surface with the given coordinates (U, V, D)."""
    poles = np.einsum("pu,uvd,qv->pqd", axis_u.to_poles, coordinates, axis_v.to_poles, optimize=True)
    return Surface(poles, axis_u.knots, axis_v.knots, axis_u.degree, axis_v.degree)


def coordinates_of(fitted: Surface, axis_u: Axis, axis_v: Axis) -> Array:
    """Coordinates (U, V, D) of a surface with the axes' knots."""
    half = np.linalg.solve(axis_u.to_poles, fitted.poles.reshape(axis_u.size, -1)).reshape(fitted.poles.shape)
    return (
        np.linalg.solve(axis_v.to_poles, half.swapaxes(0, 1).reshape(axis_v.size, -1))
        .reshape(axis_v.size, axis_u.size, -1)
        .swapaxes(0, 1)
    )
