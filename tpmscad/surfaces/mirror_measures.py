"""Area, curvature integrals, volume and greatest offsets of a mirror surface's nodal level set, by quadrature of its one piece.

The piece is parametrised by the segments from one edge of the tetrahedron to the other (`MirrorSymmetry.on_segments`): an
analytic map of the square, for which Gauss-Legendre quadrature converges geometrically. Of the tetrahedron, the join of its
edges, the volume up to the part r of the segments is V times the integral of 3 r^2 - 2 r^3. The integral of the Gauss curvature
is known by Gauss-Bonnet: the sides are geodesics, the angles those of the walls. Lengths in cells, integrals per cell.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.optimize import minimize

from tpmscad.surfaces.jet import Array
from tpmscad.surfaces.measures import Measures
from tpmscad.surfaces.mirrors import MirrorSymmetry, mirror_symmetry

QUADRATURE = 64
"""Gauss-Legendre points each way: with 96 nothing changes by more than 2e-14."""

GRID = 41
"""Points each way to start the search for the greatest curvatures from."""


@cache
def mirror_measures(name: str) -> Measures:
    """The measures of a catalogued surface's level set."""
    symmetry = mirror_symmetry(name)
    copies = len(symmetry.rotations)
    x, w = np.polynomial.legendre.leggauss(QUADRATURE)
    nodes, weight = (x + 1) / 2, np.outer(w, w) / 4
    points, fraction = symmetry.on_segments(nodes[:, None], nodes)
    (a, b), (c, d) = symmetry.edges
    s, t = nodes[:, None, None], nodes[None, :, None]
    segment = c + t * (d - c) - a - s * (b - a)
    gradient = symmetry.waves.gradient(points)
    # f = 0 all along: the part of the way follows a change of the segment.
    r = fraction[..., None]
    tangents = []
    for moved in ((1 - r) * (b - a), r * (d - c)):
        rate = -_dot(gradient, moved) / _dot(gradient, segment)
        tangents.append(moved + rate[..., None] * segment)
    element = weight * np.linalg.norm(np.cross(*tangents), axis=-1)
    mean = -np.trace(symmetry.waves.shape_operator(points), axis1=-2, axis2=-1) / 2
    positive = (weight * (3 * fraction**2 - 2 * fraction**3)).sum()  # f > 0 on the first edge's side
    lowest, highest = _limits(symmetry)
    return Measures(
        area=float(copies * element.sum()),
        mean=float(copies * (element * mean).sum()),
        gauss=float(copies * (2 * np.pi - (np.pi - symmetry.angles).sum())),
        below=float(1 - positive),
        lowest=lowest,
        highest=highest,
    )


def _limits(symmetry: MirrorSymmetry) -> tuple[float, float]:
    """The centres of curvature nearest to the surface on either side: an offset past them has cusps."""

    def bends(s: Array, t: Array) -> tuple[Array, Array]:
        points, _ = symmetry.on_segments(s, t)
        values = np.asarray(np.linalg.eigvalsh(symmetry.waves.shape_operator(points)), np.float64)
        return values[..., 2], -values[..., 0]

    grid = np.linspace(0.0, 1.0, GRID)
    limits = []
    for side in (0, 1):
        start = bends(grid[:, None], grid)[side]
        i, j = np.unravel_index(np.argmax(start), start.shape)
        first = np.array([grid[i], grid[j]])
        step = 0.5 / (GRID - 1)
        corners = first + step * np.array([[0, 0], [1, 0], [0, 1]]) * np.where(first > 0.5, -1, 1)
        found = minimize(
            lambda p, side=side: -float(bends(p[0], p[1])[side]),
            first,
            method="Nelder-Mead",
            bounds=[(0.0, 1.0)] * 2,
            options={"xatol": 1e-9, "fatol": 1e-13, "initial_simplex": corners},
        )
        limits.append(1 / max(-float(found.fun), float(start.max())))
    return -limits[0], limits[1]


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", a, b))
