"""Distance of points from the surface that a result was made from, for pictures of the deviation.

For an exact surface it is the difference between the signed distance from the mid surface, along the common normal, and the
offset asked for. Foot points on the mid surface are orthogonal projections on the nearest copy of its primitive patch; a surface
without a patch in closed form is a level set, with the normal distance of its field. For a field it is |f| / |grad f|, as the fit
measures it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tpmscad import fields, surfaces
from tpmscad._typing import Array, IntArray
from tpmscad.brep.orthogonal_projection import project_to_surface
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field, as_field
from tpmscad.fields.kinds.normal_distance import NormalDistance
from tpmscad.lattices.coordinate_maps import Map, stretching
from tpmscad.lattices.copies import cell_origins, translate_motions
from tpmscad.lattices.mapped_surface import evaluate_thickness
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.rigid_motion import Motion
from tpmscad.surfaces import PARAMETER_MARGIN, PatchSymmetry, SurfacePatch

DistanceFunction = Callable[[Array], Array]
"""Points (n, 3), model units, to distances (n,)."""

NODES_PER_PARAMETER = 17
"""Nodes of every patch along u and v among which the start of a foot point is found: half a step is within the patch's margin."""

NODE_MARGIN_CELLS = 0.3
"""In cells: how far beyond the points nodes are kept; a wall's surfaces are nearer than this to its mid surface."""

FOOT_MARGIN = 0.9 * PARAMETER_MARGIN
"""Parameters beyond the patch that a foot point may have, where the nearest node belongs to its neighbour."""

FOOT_TOL = 1e-5
"""Parameter step after which a foot point stays: the distance then changes by the square of it, 1e-10 cells."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchedReference:
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


def lattice_distance(request: LatticeRequest, mapping: Map | None, rotation: Array | None = None) -> DistanceFunction:
    """The distance of points from the offset surfaces of a lattice.

    mapping: the map of a mapped lattice, from cubic lattice coordinates to the model; None for one that repeats its cell.
    rotation (3, 3): from lattice coordinates to those of the points.
    """
    return partial(_measure_from_lattice, request, mapping, rotation)


def _measure_from_lattice(request: LatticeRequest, mapping: Map | None, rotation: Array | None, points: Array) -> Array:
    """The distance (n,) of points (n, 3) from the offset surfaces of a lattice."""
    edges, phase = np.array(request.cell), np.array(request.phase)
    offsets = np.array([d for d in request.layer_offsets if d is not None])
    local = points if rotation is None else points @ rotation
    if mapping is None:  # every cell is like the first
        local = edges * np.mod(local / edges - phase, 1.0)
    if request.levels is not None:
        phi = fields.tpms(request.surface, request.cell)
        each = [NormalDistance(phi - level)(local) for level in request.levels]
        return np.asarray(np.abs(each).min(axis=0))
    mid_surface = _mid_surface(request, mapping)
    if request.thickness is None or not isinstance(mid_surface, PatchedReference):
        return np.asarray(np.abs(mid_surface(local)[:, None] - offsets).min(axis=1))
    # along the normal, which is exact to first order in the slope of the thickness
    distance, foot = mid_surface.distance_and_foot(local)
    unit = evaluate_thickness(request.thickness, foot)
    return np.asarray(np.abs(distance[:, None] - offsets * unit[:, None]).min(axis=1))


def field_distance(field: Any) -> DistanceFunction:
    """The distance of points from the level set {field = 0}, to first order in it."""
    return partial(_measure_from_level_set, as_field(field))


def _measure_from_level_set(reference: Field, points: Array) -> Array:
    """The distance (n,) of points (n, 3) from a level set, to first order in it."""
    return np.abs(reference(points)) / np.linalg.norm(reference.gradient(points), axis=1)


def _mid_surface(request: LatticeRequest, mapping: Map | None) -> PatchedReference | NormalDistance:
    """The mid surface of a lattice; without a map that of the first cell and its neighbours, without phase."""
    cell, phase = request.cell[0], np.array(request.phase)
    symmetry = _patch_symmetry(request.surface)
    if symmetry is None:
        return NormalDistance(fields.tpms(request.surface, request.cell))
    cells, shift = ((1, 1, 1), np.zeros(3)) if mapping is None else (request.cells, phase - np.floor(phase))
    if mapping is None and len(set(request.cell)) > 1:
        mapping = stretching(tuple(edge / cell for edge in request.cell))
    placements = translate_motions(symmetry.cell_motions, cell_origins(cells, 1) + shift)
    return PatchedReference(surfaces.primitive_patch(request.surface, request.reference), placements, cell, mapping)


def _patch_symmetry(name: str) -> PatchSymmetry | None:
    """The symmetry of a surface with a patch in closed form; None for others."""
    try:
        symmetry = surfaces.surface_symmetry(name)
    except InvalidRequest:
        return None
    return symmetry if isinstance(symmetry, PatchSymmetry) else None
