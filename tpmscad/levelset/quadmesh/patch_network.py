"""Network of curves and four-sided patches made from a quad mesh, with each triangle cut into three quadrilaterals.

The cuts of a triangle, its spokes, run from the midpoints of its sides to its centre. A side cut so remains one curve: the
patches of the triangle use one half of it each, the neighbour across uses the whole curve, and the midpoint is a T-vertex.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.smoothing import project_to_level_set

WHOLE, FIRST_HALF, SECOND_HALF = 0, 1, 2
"""Pieces of a curve that a patch side lies on."""

CENTRE_STEP_FRACTION = 0.25
"""Largest Newton step of a triangle's centre towards the level set, in sizes of its vertices."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchNetwork:
    """Curves between vertices, and patches between curves.

    Curves from number `n_sides` on are spokes. A spoke begins at a T-vertex, which is not among `vertices`.
    """

    vertices: Array
    """Positions (V, 3)."""
    ends: IntArray
    """First and last vertex (C, 2) of curves; the first one of a spoke is -1."""
    plane: IntArray
    """Face of the box in which a curve (C,) lies, 2 * axis + upper, or -1 inside."""
    n_sides: int
    split_curve: IntArray
    """Curve (C - n_sides,) at whose midpoint each spoke begins."""
    corners: IntArray
    """Corners (Q, 4) of patches, counter-clockwise as seen from the void: a vertex, or -1 - c for the midpoint of curve c."""
    curve: IntArray
    """Curve (Q, 4) of each patch side; side i runs from corner i to the next."""
    sense: IntArray
    """+1 (Q, 4) where a side runs along its curve, -1 where it runs against it."""
    piece: IntArray
    """Piece (Q, 4) of the curve that a side lies on: WHOLE, FIRST_HALF or SECOND_HALF."""
    leaf: IntArray
    """Octree leaves (Q, 4) that the patch comes from."""


@dataclass(frozen=True, slots=True, eq=False)
class NetworkMatch:
    """Curve (C,) and patch (Q,) of a previous network that each of a network's equals, -1 for none."""

    previous_curve: IntArray
    previous_patch: IntArray


def build_patch_network(mesh: QuadMesh, field: Field) -> PatchNetwork:
    """The patch network of a smoothed mesh."""
    triangular = mesh.corners[:, 3] < 0
    quads, triangles = np.flatnonzero(~triangular), np.flatnonzero(triangular)
    n_sides, n_vertices = len(mesh.side_ends), len(mesh.vertices)

    corners = mesh.corners[triangles][:, :3]
    centre = mesh.vertices[corners].mean(axis=1)
    size = mesh.size[corners].min(axis=1)
    centre = project_to_level_set(field, centre, np.zeros(centre.shape, bool), CENTRE_STEP_FRACTION * size)

    # spoke 3 t + i runs from the midpoint of side i of triangle t to its centre
    sides = mesh.sides[triangles][:, :3]
    sense = _side_senses(mesh, triangles, 3)
    spoke = n_sides + 3 * np.arange(len(triangles))[:, None] + np.arange(3)
    centre_vertex = n_vertices + np.arange(len(triangles))
    previous = np.roll(np.arange(3), 1)
    # patch i of a triangle: corner i, midpoint of side i, centre, midpoint of side i - 1
    part_corner = np.stack(
        [corners, -1 - sides, np.repeat(centre_vertex[:, None], 3, 1), -1 - sides[:, previous]], axis=2
    )
    part_curve = np.stack([sides, spoke, spoke[:, previous], sides[:, previous]], axis=2)
    part_sense = np.stack([sense, np.ones_like(sides), -np.ones_like(sides), sense[:, previous]], axis=2)
    first = np.where(sense > 0, FIRST_HALF, SECOND_HALF)
    last = np.where(sense[:, previous] > 0, SECOND_HALF, FIRST_HALF)
    part_piece = np.stack([first, np.zeros_like(sides), np.zeros_like(sides), last], axis=2)
    leaf = mesh.leaf[mesh.corners]
    part_leaf = np.repeat(leaf[triangles][:, None, [0, 1, 2, 2]], 3, axis=1)

    spoke_ends = np.stack([np.full(spoke.size, -1), np.repeat(centre_vertex, 3)], axis=1).reshape(-1, 2)
    return PatchNetwork(
        vertices=np.concatenate([mesh.vertices, centre]),
        ends=np.concatenate([mesh.side_ends, spoke_ends]),
        plane=np.concatenate([mesh.side_plane, np.full(spoke.size, -1)]),
        n_sides=n_sides,
        split_curve=sides.ravel(),
        corners=_append_parts(mesh.corners[quads], part_corner),
        curve=_append_parts(mesh.sides[quads], part_curve),
        sense=_append_parts(_side_senses(mesh, quads, 4), part_sense),
        piece=_append_parts(np.full((len(quads), 4), WHOLE), part_piece),
        leaf=_append_parts(leaf[quads], part_leaf),
    )


def match_networks(network: PatchNetwork, previous: PatchNetwork) -> NetworkMatch:
    """Curves and patches that a previous network has, too: between the same vertices to the last bit, and split alike."""
    known = {key: i for i, key in enumerate(_curve_keys(previous))}
    curve = np.array([known.get(key, -1) for key in _curve_keys(network)], np.int64)
    patches = {row.tobytes(): i for i, row in enumerate(_patch_keys(previous, np.arange(len(previous.ends))))}
    patch = np.array([patches.get(row.tobytes(), -1) for row in _patch_keys(network, curve)], np.int64)
    patch[(curve[network.curve] < 0).any(axis=1)] = -1
    return NetworkMatch(curve, patch)


def _side_senses(mesh: QuadMesh, polygons: IntArray, n: int) -> IntArray:
    """+1 where side i of a polygon with n corners starts at its corner i, -1 where it ends there: (len(polygons), n)."""
    starts = mesh.side_ends[mesh.sides[polygons][:, :n], 0]
    return np.where(starts == mesh.corners[polygons][:, :n], 1, -1)


def _append_parts(quads: IntArray, parts: IntArray) -> IntArray:
    """Rows (Q, 4) of quadrilaterals, followed by those of the parts (T, 3, 4) of triangles."""
    return np.concatenate([quads, parts.reshape(-1, 4)]).astype(np.int64)


def _curve_keys(network: PatchNetwork) -> list[tuple[object, ...]]:
    """Key of each curve: the coordinates of its ends and its plane, or for a spoke the key of the curve that it splits."""
    name = [v.tobytes() for v in network.vertices]
    keys: list[tuple[object, ...]] = [
        (name[a], name[b], int(p)) for (a, b), p in zip(network.ends[: network.n_sides], network.plane, strict=False)
    ]
    keys += [(keys[c], name[b]) for c, (_, b) in zip(network.split_curve, network.ends[network.n_sides :], strict=True)]
    return keys


def _patch_keys(network: PatchNetwork, curve: IntArray) -> IntArray:
    """Key (Q, 12) of each patch by names `curve` (C,) of its curves."""
    return np.concatenate([curve[network.curve], network.sense, network.piece], axis=1).astype(np.int64)
