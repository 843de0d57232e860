"""The chart of a mirror surface's piece over the unit square: as nearly conformal as can be, equivariant under all mirrors.

The conformal map from the hyperbolic quadrilateral of the same angles onto the piece takes reflections to reflections (Schwarz),
so it goes on analytically across every side and corner, which is what makes fits converge as fast as on smooth functions.
It is the map of least Dirichlet energy, over all maps onto the piece and over the family's one parameter; the energy is then the
area. The discrete chart minimises

    energy(X) + weight * int distance(X)^2

among the patches that meet their reflections to second order, by Gauss-Newton steps with growing weight.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from tpmscad._typing import Array
from tpmscad.lattices.mirror_continuity import mirror_conditions
from tpmscad.splines.affine_subspace import pole_metric, solve_conditions
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.knots import bezier_knots
from tpmscad.splines.quadrature import gauss_legendre_unit
from tpmscad.splines.spline_axis import SplineAxis, gauss_axis
from tpmscad.splines.surface_fit import least_squares_coordinates, surface_from_coordinates
from tpmscad.surfaces import MirrorSymmetry, mirror_symmetry
from tpmscad.surfaces.klein_quadrilateral import KleinQuadrilateral, solve_klein_quadrilateral

SEARCH_DEGREE, CHART_DEGREE = 8, 14
"""Of the patches that the parameter is looked for with, and of the chart."""

DISTANCE_WEIGHTS = (1e1, 1e1, 1e2, 1e3, 1e3, 1e4, 1e4)
"""Of the distance, per cell squared: from a rough start to 1e-4 of the cell. A chart need not be nearer: fits take the feet."""

LOG_PRODUCT_HALF_RANGE = 1.0
"""How far from equal products of both pairs of sides the parameter is looked for, in ln(product - 1)."""

LOG_PRODUCT_TOL = 1e-3
"""How well ln(product - 1) is found: the energy is flat there, and the chart need only be nearly conformal."""


@dataclass(frozen=True, slots=True, eq=False)
class HarmonicChart:
    """A nearly conformal patch near the mid surface, the quadrilateral it is a chart over, its energy over its area."""

    symmetry: MirrorSymmetry
    quadrilateral: KleinQuadrilateral
    patch: BSplineSurface
    distortion: float

    def offset(self, u: Array, v: Array, distance: float) -> Array:
        """Points (..., 3) of the offset surface, over the feet of the patch's points."""
        _, normal, foot = self.symmetry.waves.project_to_level_set(self.patch(u, v))
        return foot + distance * normal


@lru_cache(maxsize=16)
def compute_harmonic_chart(name: str) -> HarmonicChart:
    """The chart of a catalogued surface's piece, on the nodal surface."""
    symmetry = mirror_symmetry(name)

    def energy(parameter: float) -> float:
        return _minimise_energy(
            symmetry, solve_klein_quadrilateral(symmetry.angles, 1 + np.exp(parameter)), SEARCH_DEGREE
        )[1]

    def excess(parameter: float) -> float:
        return solve_klein_quadrilateral(symmetry.angles, 1 + np.exp(parameter)).other - 1 - np.exp(parameter)

    equal = brentq(excess, -6.0, 4.0)
    found = minimize_scalar(
        energy,
        bounds=(equal - LOG_PRODUCT_HALF_RANGE, equal + LOG_PRODUCT_HALF_RANGE),
        method="bounded",
        options={"xatol": LOG_PRODUCT_TOL},
    )
    best = solve_klein_quadrilateral(symmetry.angles, 1 + np.exp(found.x))
    patch, least = _minimise_energy(symmetry, best, CHART_DEGREE)
    t, weights = gauss_legendre_unit(2 * CHART_DEGREE)
    area = weights @ np.linalg.norm(patch.normal(t[:, None], t), axis=-1) @ weights
    return HarmonicChart(symmetry, best, patch, least / float(area))


def _minimise_energy(symmetry: MirrorSymmetry, shape: KleinQuadrilateral, degree: int) -> tuple[BSplineSurface, float]:
    """The patch of least energy on the level set over a given quadrilateral, and its energy."""
    axis = gauss_axis(bezier_knots(degree), degree)
    u, v = np.meshgrid(axis.points, axis.points, indexing="ij")
    weight = np.outer(axis.weights, axis.weights)
    conditions = mirror_conditions(axis, axis, shape.centres, symmetry.wall_normals, symmetry.wall_offsets)
    subspace = solve_conditions(conditions, pole_metric(axis, axis))
    basis = subspace.null_space_basis()
    stiffness = _stiffness_matrix(axis, shape.dirichlet_tensor(u, v) * weight[..., None, None])
    pulled = np.einsum("ab,bjd->ajd", stiffness, basis.reshape(len(stiffness), 3, -1)).reshape(basis.shape)
    free_stiffness = basis.T @ pulled
    values = np.kron(axis.design_matrix(axis.points), axis.design_matrix(axis.points))

    start, _ = symmetry.intersect_segments(u, v)
    x = subspace.project(least_squares_coordinates(start, axis, axis).ravel())
    for emphasis in DISTANCE_WEIGHTS:
        points = values @ x.reshape(-1, 3)
        gradient = symmetry.waves.gradient(points)
        steepness = np.linalg.norm(gradient, axis=-1)
        # To first order: a rough start can be too far off for feet, and the steps bring the rest.
        distance, normal = symmetry.waves.value(points) / steepness, gradient / steepness[:, None]
        root = np.sqrt(emphasis * weight.ravel())
        rows = ((root[:, None] * values)[:, :, None] * normal[:, None, :]).reshape(len(root), -1) @ basis
        residual = rows.T @ (root * distance) + pulled.T @ x
        x = x - basis @ np.linalg.solve(rows.T @ rows + free_stiffness, residual)
    cube = x.reshape(axis.n_coordinates, axis.n_coordinates, 3)
    return surface_from_coordinates(cube, axis, axis), float(
        np.einsum("ai,ab,bi->", x.reshape(-1, 3), stiffness, x.reshape(-1, 3))
    )


def _stiffness_matrix(axis: SplineAxis, metric: Array) -> Array:
    """The matrix of Dirichlet's energy, half the integral of the metric on the derivatives, on coordinates (U V, U V)."""
    value, slope = axis.design_matrix(axis.points), axis.design_matrix(axis.points, 1)
    rows = np.kron(slope, value), np.kron(value, slope)
    return np.asarray(
        sum(rows[i].T @ (metric[..., i, j].reshape(-1, 1) * rows[j]) for i in range(2) for j in range(2)) / 2
    )
