"""Signed distance of points from a surface made of placed copies of a patch, by orthogonal projection on the nearest copy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.brep.orthogonal_projection import project_to_surface
from tpmscad.lattices.coordinate_maps import Map
from tpmscad.rigid_motion import Motion
from tpmscad.surfaces import PARAMETER_MARGIN, SurfacePatch

SignedDistance = Callable[[Array], Array]
"""Points (n, 3), model units, to signed distances (n,), positive along the normal of the mid surface."""

NODES_PER_PARAMETER = 17
"""Nodes of every patch along u and v among which the start of a foot point is found: half a step is within the patch's margin."""

NODE_MARGIN_CELLS = 0.3
"""In cells: how far beyond the points nodes are kept; a wall's surfaces are nearer than this to its mid surface."""

FOOT_MARGIN = 0.9 * PARAMETER_MARGIN
"""Parameters beyond the patch that a foot point may have, where the nearest node belongs to its neighbour."""

FOOT_TOL = 1e-5
"""Parameter step after which a foot point stays: the distance then changes by the square of it, 1e-10 cells."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchedSurface:
    """A mid surface made of placed copies of a patch, in cells, under `map` (model units) if there is one."""

    patch: SurfacePatch
    placements: Motion
    cell: float
    map: Map | None

    def __call__(self, points: Array) -> Array:
        """Signed distances (n,) of points (n, 3), in model units, along the normal of the mid surface."""
        return self.distance_and_foot(points)[0]

    def distance_and_foot(self, points: Array) -> tuple[Array, Array]:
        """Signed distances (n,) of points (n, 3) from the mid surface, and the foot points (n, 3)."""
        at = np.linspace(0.0, 1.0, NODES_PER_PARAMETER)
        u, v = (grid.ravel() for grid in np.meshgrid(at, at, indexing="ij"))
        nodes = self.cell * self.placements[:, None].apply(self.patch.jet(u, v).position)
        nodes = nodes if self.map is None else self.map(nodes)
        margin = NODE_MARGIN_CELLS * self.cell
        near = ((nodes > points.min(axis=0) - margin) & (nodes < points.max(axis=0) + margin)).all(axis=-1)
        copies, of_copy = np.nonzero(near)
        _, nearest = cKDTree(nodes[near]).query(points)
        placed, u, v = self.placements[copies[nearest]], u[of_copy[nearest]], v[of_copy[nearest]]

        def jet(s: Array, t: Array, rows: IntArray) -> Sequence[Array]:
            return self._evaluate(placed[rows], s, t)[:3]

        sides = -FOOT_MARGIN, 1.0 + FOOT_MARGIN
        u, v = project_to_surface(jet, points, u, v, (sides, sides), FOOT_TOL)
        foot, _, _, normal = self._evaluate(placed, u, v)
        return np.einsum("ni,ni->n", points - foot, normal), foot

    def _evaluate(self, placed: Motion, u: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        """Points of the surface, its tangents and its unit normals, (n, 3) each."""
        jet = self.patch.jet(u, v)
        position = self.cell * placed.apply(jet.position)
        along_u, along_v = (self.cell * placed.apply_to_vectors(tangent) for tangent in (jet.du, jet.dv))
        normal = placed.apply_to_vectors(jet.normal)
        if self.map is None:
            return position, along_u, along_v, normal
        jacobian = self.map.jacobian(position, self.cell)
        normal = np.linalg.solve(np.swapaxes(jacobian, -1, -2), normal[..., None])[..., 0]
        along_u, along_v = ((jacobian @ tangent[..., None])[..., 0] for tangent in (along_u, along_v))
        return self.map(position), along_u, along_v, normal / np.linalg.norm(normal, axis=-1, keepdims=True)
