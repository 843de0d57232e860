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

from tpmscad.patches.mirror.joints import mirror_conditions
from tpmscad.splines.axis import Axis, bezier_knots, gauss_axis
from tpmscad.splines.bspline import Array, Surface
from tpmscad.splines.fitting import free_coordinates, surface
from tpmscad.splines.subspace import pole_metric, solve_conditions
from tpmscad.surfaces import MirrorSymmetry, mirror_symmetry
from tpmscad.surfaces.hyperbolic import Quadrilateral, quadrilateral

SEARCH_DEGREE, DEGREE = 8, 14
"""Of the patches that the parameter is looked for with, and of the chart."""

WEIGHTS = (1e1, 1e1, 1e2, 1e3, 1e3, 1e4, 1e4)
"""Of the distance, per cell squared: from a rough start to 1e-4 of the cell. A chart need not be nearer: fits take the feet."""

SPREAD = 1.0
"""How far from equal products of both pairs of sides the parameter is looked for, in ln(product - 1)."""

PARAMETER = 1e-3
"""How well ln(product - 1) is found: the energy is flat there, and the chart need only be nearly conformal."""


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """A nearly conformal patch near the mid surface, the quadrilateral it is a chart over, its energy over its area."""

    symmetry: MirrorSymmetry
    quadrilateral: Quadrilateral
    patch: Surface
    distortion: float

    def offset(self, u: Array, v: Array, distance: float) -> Array:
        """Points (..., 3) of the offset surface, over the feet of the patch's points."""
        _, normal, foot = self.symmetry.waves.foot(self.patch(u, v))
        return foot + distance * normal


@lru_cache(maxsize=16)
def chart(name: str) -> Chart:
    """The chart of a catalogued surface's piece, on the nodal surface."""
    symmetry = mirror_symmetry(name)

    def energy(parameter: float) -> float:
        return _harmonic(symmetry, quadrilateral(symmetry.angles, 1 + np.exp(parameter)), SEARCH_DEGREE)[1]

    def excess(parameter: float) -> float:
        return quadrilateral(symmetry.angles, 1 + np.exp(parameter)).other - 1 - np.exp(parameter)

    equal = brentq(excess, -6.0, 4.0)
    found = minimize_scalar(
        energy, bounds=(equal - SPREAD, equal + SPREAD), method="bounded", options={"xatol": PARAMETER}
    )
    best = quadrilateral(symmetry.angles, 1 + np.exp(found.x))
    patch, least = _harmonic(symmetry, best, DEGREE)
    nodes, weights = np.polynomial.legendre.leggauss(2 * DEGREE)
    t = (nodes + 1) / 2
    area = weights @ np.linalg.norm(patch.normal(t[:, None], t), axis=-1) @ weights / 4
    return Chart(symmetry, best, patch, least / float(area))


def _harmonic(symmetry: MirrorSymmetry, shape: Quadrilateral, degree: int) -> tuple[Surface, float]:
    """The patch of least energy on the level set over a given quadrilateral, and its energy."""
    axis = gauss_axis(bezier_knots(degree), degree)
    u, v = np.meshgrid(axis.points, axis.points, indexing="ij")
    weight = np.outer(axis.weights, axis.weights)
    conditions = mirror_conditions(axis, axis, shape.centres, symmetry.wall_normals, symmetry.wall_offsets)
    subspace = solve_conditions(conditions, pole_metric(axis, axis))
    basis = subspace.basis()
    stiffness = _stiffness(axis, shape.conformal(u, v) * weight[..., None, None])
    pulled = np.einsum("ab,bjd->ajd", stiffness, basis.reshape(len(stiffness), 3, -1)).reshape(basis.shape)
    free_stiffness = basis.T @ pulled
    values = np.kron(axis.design(axis.points), axis.design(axis.points))

    start, _ = symmetry.on_segments(u, v)
    x = subspace.project(free_coordinates(start, axis, axis).ravel())
    for emphasis in WEIGHTS:
        points = values @ x.reshape(-1, 3)
        gradient = symmetry.waves.gradient(points)
        steepness = np.linalg.norm(gradient, axis=-1)
        # To first order: a rough start can be too far off for feet, and the steps bring the rest.
        distance, normal = symmetry.waves.value(points) / steepness, gradient / steepness[:, None]
        root = np.sqrt(emphasis * weight.ravel())
        rows = ((root[:, None] * values)[:, :, None] * normal[:, None, :]).reshape(len(root), -1) @ basis
        residual = rows.T @ (root * distance) + pulled.T @ x
        x = x - basis @ np.linalg.solve(rows.T @ rows + free_stiffness, residual)
    cube = x.reshape(axis.size, axis.size, 3)
    return surface(cube, axis, axis), float(np.einsum("ai,ab,bi->", x.reshape(-1, 3), stiffness, x.reshape(-1, 3)))


def _stiffness(axis: Axis, metric: Array) -> Array:
    """The matrix of Dirichlet's energy, half the integral of the metric on the derivatives, on coordinates (U V, U V)."""
    value, slope = axis.design(axis.points), axis.design(axis.points, 1)
    rows = np.kron(slope, value), np.kron(value, slope)
    return np.asarray(
        sum(rows[i].T @ (metric[..., i, j].reshape(-1, 1) * rows[j]) for i in range(2) for j in range(2)) / 2
    )
