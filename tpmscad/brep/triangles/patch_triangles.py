"""Triangles of whole B-spline patches, each on the same grid of its parameters, so that neighbours share their points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep, spline_faces
from tpmscad.brep.triangles.closed_mesh import weld_points
from tpmscad.brep.triangles.measured_deviation import Surfaces, bound_triangles
from tpmscad.errors import InvalidRequest
from tpmscad.splines.bspline import BSplineSurface

WELD_REL_TOL = 1e-8
"""In extents of the patches: points of neighbours nearer than this are one."""

MAX_STEPS = 256
"""Grid steps along a side of a patch; more are taken for a deviation without sense."""

SPACINGS = (0.0, -0.2, 0.2)
"""How the grid is spaced: parameters t + s sin(2 pi t) / (2 pi), symmetric, so that it does not matter from which end a side is
read. At -0.2 the offset gyroid misses its patches by a twelfth less than on an even grid, which saves a step of four."""


PatchGroup = tuple[int, Surfaces]
"""A number of patches, triangulated alike, and what evaluates them at parameters in the unit square."""


@dataclass(frozen=True, slots=True)
class PatchGrid:
    """Grid lines of each patch, as parts (n + 1,) of its sides."""

    parts: Array

    @property
    def steps(self) -> int:
        """Steps along a side."""
        return len(self.parts) - 1

    def parameters(self, surface: BSplineSurface) -> tuple[Array, Array]:
        """Parameters (n + 1,), (n + 1,) of the grid lines of a surface."""
        (u0, u1), (v0, v1) = surface.domain
        return u0 + (u1 - u0) * self.parts, v0 + (v1 - v0) * self.parts

    @property
    def nodes(self) -> Array:
        """Parameters (k, 2) of the points of the grid in the unit square."""
        return np.stack(np.meshgrid(self.parts, self.parts, indexing="ij"), axis=-1).reshape(-1, 2)

    def triangles(self, turned: bool) -> IntArray:
        """Two triangles in each rectangle of the points of the grid: (2 n^2, 3); `turned` ones have the other diagonal."""
        n = self.steps
        i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
        a = (i * (n + 1) + j).ravel()
        b, c, d = a + n + 1, a + n + 2, a + 1
        halves = ((a, b, d), (b, c, d)) if turned else ((a, b, c), (a, c, d))
        return np.concatenate([np.stack(half, axis=1) for half in halves])

    def blocks(self, count: int) -> IntArray:
        """The block of each triangle (2 n^2,), if the grid is divided into `count` blocks along each side."""
        part = np.arange(self.steps) * count // self.steps
        return np.tile((part[:, None] * count + part).ravel(), 2)


def triangulate_patches(brep: Brep, deviation: float) -> tuple[Array, IntArray, float]:
    """Points (n, 3) and triangles (m, 3) within `deviation` of the patches, with the sense of their faces, and the bound reached.

    Every face is a whole patch. All patches have the same grid, the coarsest that serves the worst of them.
    """
    surfaces = list(spline_faces(brep))
    grid, turned, reached = choose_grid([_as_patch(surface) for _, surface in surfaces], deviation)
    points, triangles, count = [], [], 0
    for (faces, surface), other in zip(surfaces, turned, strict=True):
        nodes, local = surface.grid(*grid.parameters(surface)).reshape(-1, 3), grid.triangles(other)
        for face in faces.tolist():
            motion = brep.faces.motion
            points.append(nodes @ motion.rotation[face].T + motion.translation[face])
            triangles.append((local if brep.faces.sense[face] > 0 else local[:, ::-1]) + count)
            count += len(nodes)
    stacked = np.concatenate(points)
    welded, index = weld_points(stacked, WELD_REL_TOL * float(np.ptp(stacked, axis=0).max()))
    found = index[np.concatenate(triangles)]
    return welded, found[(found != np.roll(found, 1, axis=1)).all(axis=1)], reached


def _as_patch(surface: BSplineSurface) -> PatchGroup:
    (u0, u1), (v0, v1) = surface.domain
    return 1, lambda _, uv: surface.jet(u0 + (u1 - u0) * uv[:, 0], v0 + (v1 - v0) * uv[:, 1])[:3]


def choose_grid(groups: Sequence[PatchGroup], deviation: float, least: int = 1) -> tuple[PatchGrid, list[bool], float]:
    """The coarsest grid whose triangles keep the deviation, which groups have the other diagonal, and the bound reached.

    least: steps that the grid has at least.
    """
    steps = least
    while steps <= MAX_STEPS:
        nearest = np.inf
        for spacing in SPACINGS:
            t = np.linspace(0, 1, steps + 1)
            grid = PatchGrid(t + spacing * np.sin(2 * np.pi * t) / (2 * np.pi))
            found = np.array(
                [[measure_deviation(group, grid, turned, deviation) for turned in (False, True)] for group in groups]
            )
            worst = float(found.min(axis=1).max())
            if worst <= deviation:
                return grid, [bool(k) for k in found.argmin(axis=1)], worst
            nearest = min(nearest, worst)
        steps = max(steps + 1, int(0.9 * steps * np.sqrt(nearest / deviation)))
    raise InvalidRequest(f"deviation = {deviation:g} needs more than {MAX_STEPS**2} rectangles on a patch: raise it")


def measure_deviation(group: PatchGroup, grid: PatchGrid, turned: bool, deviation: float) -> float:
    """A bound on the distance of the triangles on a grid from patches; `deviation`: to which it is of interest."""
    count, surfaces = group
    uv, triangles = grid.nodes, grid.triangles(turned)
    points = surfaces(np.repeat(np.arange(count), len(uv)), np.tile(uv, (count, 1)))[0].reshape(count, len(uv), 3)
    bound, _ = bound_triangles(
        surfaces,
        np.repeat(np.arange(count), len(triangles)),
        points[:, triangles].reshape(-1, 3, 3),
        np.tile(uv[triangles], (count, 1, 1)),
        np.tile(np.array([[0.0, 0.0], [1.0, 1.0]]), (count, 1, 1)),
        deviation,
    )
    return float(bound.max())
