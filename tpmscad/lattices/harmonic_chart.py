"""The chart of a mirror surface's piece over the unit square: nearly conformal, and equivariant under all mirrors.

The conformal map from the hyperbolic quadrilateral of the same angles onto the piece takes reflections to reflections (Schwarz
reflection principle). It therefore continues analytically across every side and corner, and fits converge as fast as on
analytic functions. It is the map of least Dirichlet energy, over all maps onto the piece and over the one parameter of the
family of quadrilaterals; the energy then equals the area. The discrete chart minimises

    energy(X) + weight * int distance(X)^2

among the patches that meet their reflections to second order, by Gauss-Newton steps with increasing weight.
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
"""Degrees of the patches in the search for the quadrilateral, and of the chart."""

DISTANCE_WEIGHTS = (1e1, 1e1, 1e2, 1e3, 1e3, 1e4, 1e4)
"""Weights of the squared distance in successive steps, per cell squared: they take a rough start to 1e-4 cells. A chart need not
be nearer, because fits use the foot points."""

LOG_PRODUCT_HALF_RANGE = 1.0
"""Half range of the search for the quadrilateral, in ln(product - 1), about equal products of both pairs of sides."""

LOG_PRODUCT_TOL = 1e-3
"""Tolerance of ln(product - 1): the energy is flat there, and the chart need only be nearly conformal."""

LOG_PRODUCT_BRACKET = (-6.0, 4.0)
"""Bracket of ln(product - 1) in which both pairs of sides have equal products."""


@dataclass(frozen=True, slots=True, eq=False)
class HarmonicChart:
    """A nearly conformal patch near the mid surface; `distortion` is its energy over its area, at least 1."""

    symmetry: MirrorSymmetry
    quadrilateral: KleinQuadrilateral
    patch: BSplineSurface
    distortion: float

    def offset(self, u: Array, v: Array, distance: float) -> Array:
        """Points (..., 3) of the offset surface above the foot points of the patch's points."""
        _, normal, foot = self.symmetry.waves.project_to_level_set(self.patch(u, v))
        return foot + distance * normal


@lru_cache(maxsize=16)
def compute_harmonic_chart(name: str, reference: str = "nodal") -> HarmonicChart:
    """The chart of the piece of a catalogued surface."""
    symmetry = mirror_symmetry(name, reference)

    def energy(parameter: float) -> float:
        return _minimise_energy(
            symmetry, solve_klein_quadrilateral(symmetry.angles, 1 + np.exp(parameter)), SEARCH_DEGREE
        )[1]

    def excess(parameter: float) -> float:
        return solve_klein_quadrilateral(symmetry.angles, 1 + np.exp(parameter)).other - 1 - np.exp(parameter)

    equal = brentq(excess, *LOG_PRODUCT_BRACKET)
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


def _minimise_energy(
    symmetry: MirrorSymmetry, quadrilateral: KleinQuadrilateral, degree: int
) -> tuple[BSplineSurface, float]:
    """The patch of least energy on the level set over a given quadrilateral, and its energy."""
    axis = gauss_axis(bezier_knots(degree), degree)
    u, v = np.meshgrid(axis.points, axis.points, indexing="ij")
    weights = np.outer(axis.weights, axis.weights)
    conditions = mirror_conditions(axis, axis, quadrilateral.centres, symmetry.wall_normals, symmetry.wall_offsets)
    subspace = solve_conditions(conditions, pole_metric(axis, axis))
    basis = subspace.null_space_basis()
    stiffness = _stiffness_matrix(axis, quadrilateral.dirichlet_tensor(u, v) * weights[..., None, None])
    stiffness_basis = np.einsum("ab,bjd->ajd", stiffness, basis.reshape(len(stiffness), 3, -1)).reshape(basis.shape)
    reduced_stiffness = basis.T @ stiffness_basis
    design = axis.design_matrix(axis.points)
    values = np.kron(design, design)

    start, _ = symmetry.intersect_segments(u, v)
    x = subspace.project(least_squares_coordinates(start, axis, axis).ravel())
    for distance_weight in DISTANCE_WEIGHTS:
        points = values @ x.reshape(-1, 3)
        gradient = symmetry.waves.gradient(points)
        slope = np.linalg.norm(gradient, axis=-1)
        # First-order distances: a rough start may be too far away for foot points, and the steps correct them.
        distance, normal = symmetry.waves.value(points) / slope, gradient / slope[:, None]
        roots = np.sqrt(distance_weight * weights.ravel())
        jacobian = ((roots[:, None] * values)[:, :, None] * normal[:, None, :]).reshape(len(roots), -1) @ basis
        reduced_gradient = jacobian.T @ (roots * distance) + stiffness_basis.T @ x
        x = x - basis @ np.linalg.solve(jacobian.T @ jacobian + reduced_stiffness, reduced_gradient)
    coordinates = x.reshape(axis.n_coordinates, axis.n_coordinates, 3)
    energy = np.einsum("ai,ab,bi->", x.reshape(-1, 3), stiffness, x.reshape(-1, 3))
    return surface_from_coordinates(coordinates, axis, axis), float(energy)


def _stiffness_matrix(axis: SplineAxis, metric: Array) -> Array:
    """Matrix of the Dirichlet energy on coordinates, half the integral of the metric on the derivatives: (U V, U V)."""
    value, slope = axis.design_matrix(axis.points), axis.design_matrix(axis.points, 1)
    rows = np.kron(slope, value), np.kron(value, slope)
    return np.asarray(
        sum(rows[i].T @ (metric[..., i, j].reshape(-1, 1) * rows[j]) for i in range(2) for j in range(2)) / 2
    )
