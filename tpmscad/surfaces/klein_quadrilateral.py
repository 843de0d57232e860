"""Quadrilaterals of the hyperbolic plane in Klein's model, as projective images of the unit square.

The fundamental polygon of a mirror surface has geodesic sides and angles pi / n, so that its mirror images tile the hyperbolic
plane as they tile the surface. In Klein's model reflections are projective maps (harmonic homologies), and so they are on the
unit square if it is mapped projectively onto the quadrilateral. A patch X on the square that intertwines the homologies h_i with
the reflections M_i in the mirror planes of its sides,

    X(h_i(u, v)) = M_i X(u, v),

joins all its copies smoothly, also at corners of any angle. Quadrilaterals of given angles form a one-parameter family; the
parameter is the Minkowski product of the normals of two opposite sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array

_MINKOWSKI_FORM = np.diag([-1.0, 1.0, 1.0])
_UNIT_SQUARE = np.array([[1.0, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]])  # homogeneous (1, u, v), counter-clockwise


@dataclass(frozen=True, slots=True, eq=False)
class KleinQuadrilateral:
    """A quadrilateral in Klein's model.

    - `projection` (3, 3): maps (1, u, v) to the homogeneous coordinates (time, x, y).
    - `centres` (4, 3): centres of the homologies, homogeneous in (1, u, v); the reflection in side i moves points along lines
      through the i-th.
    - `other`: product of the normals of the other pair of sides, which follows from the angles and the parameter.
    """

    projection: Array
    centres: Array
    other: float

    def dirichlet_tensor(self, u: Array, v: Array) -> Array:
        """Tensor sqrt(det g) g^-1 of the Dirichlet energy for the hyperbolic metric g at the pairs (u, v): (..., 2, 2)."""
        point = np.stack([np.ones_like(u), u, v], axis=-1) @ self.projection.T
        tangents = self.projection[:, 1:].T  # (2, 3)
        along = point @ _MINKOWSKI_FORM @ tangents.T
        size = -np.einsum("...i,ij,...j->...", point, _MINKOWSKI_FORM, point)[..., None, None]
        metric = tangents @ _MINKOWSKI_FORM @ tangents.T / size + along[..., :, None] * along[..., None, :] / size**2
        return np.asarray(np.sqrt(np.linalg.det(metric))[..., None, None] * np.linalg.inv(metric))


def solve_klein_quadrilateral(angles: ArrayLike, product: float) -> KleinQuadrilateral:
    """Quadrilateral of given angles (4,), at the corner where side i begins, with sides 0 and 2 at distance arcosh(product).

    `product` > 1. The products of the normals of adjacent sides are minus the cosines of the angles. The Gram matrix of the four
    normals has rank three, which determines the remaining product.
    """
    cosines = np.cos(angles)

    def gram(other: float) -> Array:
        matrix = np.eye(4)
        for i in range(4):
            matrix[i, i - 1] = matrix[i - 1, i] = -cosines[i]
        matrix[0, 2] = matrix[2, 0] = -product
        matrix[1, 3] = matrix[3, 1] = -other
        return matrix

    roots = np.roots(np.polyfit([0.0, 1.0, 2.0], [np.linalg.det(gram(x)) for x in (0.0, 1.0, 2.0)], 2))
    other = float(roots.real.max())
    values, vectors = np.linalg.eigh(gram(other))  # in this order one negative, one zero, two positive
    normals = vectors[:, [0, 3, 2]] * np.sqrt(np.abs(values[[0, 3, 2]]))
    duals = normals @ _MINKOWSKI_FORM
    vertices = np.array([np.cross(duals[i - 1], duals[i]) for i in range(4)])
    vertices /= vertices[:, :1]
    weights = np.linalg.solve(vertices[:3].T, vertices[3]) / np.linalg.solve(_UNIT_SQUARE[:3].T, _UNIT_SQUARE[3])
    projection = (vertices[:3] * weights[:, None]).T @ np.linalg.inv(_UNIT_SQUARE[:3].T)
    centres = normals @ np.linalg.inv(projection).T
    return KleinQuadrilateral(projection, centres / np.abs(centres).max(axis=1, keepdims=True), other)
