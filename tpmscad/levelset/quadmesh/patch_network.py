"""A net of curves and four-sided patches: the layout's polygons, triangles cut into three quadrilaterals.

The cuts of a triangle run from the middles of its sides to its centre. A side that is cut so stays one curve; the patches beside
the cut use half of it, and the neighbour across is left as it is: the middle becomes a T-vertex.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.smoothing import project_to_level_set


@dataclass(frozen=True, slots=True, eq=False)
class PatchNetwork:
    """Curves between vertices, patches between curves.

    vertices (V, 3). Curve i runs from ends[i, 0] to ends[i, 1], in the plane `plane[i]` of the box or inside (-1); curves from
    `n_sides` on begin at the middle of the curve `middle_of[i - n_sides]`, which is no vertex of `vertices`, and their
    ends[i, 0] is -1. corners (Q, 4): vertices or, -1 - c, the middle of curve c. Patch side (Q, 4): its curve, +1 or -1,
    and the piece of the curve (0 whole, 1 first half, 2 second half); sides run counter-clockwise, the outside on the left.
    `cell` (Q, 4): leaves the patch came from.
    """

    vertices: Array
    ends: IntArray
    plane: IntArray
    n_sides: int
    middle_of: IntArray
    corners: IntArray
    curve: IntArray
    sense: IntArray
    piece: IntArray
    cell: IntArray


def build_patch_network(mesh: QuadMesh, field: Field) -> PatchNetwork:
    """The net of a relaxed mesh."""
    three = mesh.corners[:, 3] < 0
    quads, triangles = np.flatnonzero(~three), np.flatnonzero(three)
    n_sides, n_vertices = len(mesh.side_ends), len(mesh.vertices)

    corners = mesh.corners[triangles][:, :3]
    centre = mesh.vertices[corners].mean(axis=1)
    size = mesh.size[corners].min(axis=1)
    centre = project_to_level_set(field, centre, np.zeros(centre.shape, bool), 0.25 * size)

    def sense_of(polygons: IntArray, n: int) -> IntArray:
        starts = mesh.side_ends[mesh.sides[polygons][:, :n], 0]
        return np.where(starts == mesh.corners[polygons][:, :n], 1, -1)

    # spoke 3 t + i runs from the middle of side i of triangle t to its centre
    sides = mesh.sides[triangles][:, :3]
    sense3 = sense_of(triangles, 3)
    spoke = n_sides + 3 * np.arange(len(triangles))[:, None] + np.arange(3)
    own = n_vertices + np.arange(len(triangles))
    before = np.roll(np.arange(3), 1)
    # patch i of a triangle: corner i, middle of side i, centre, middle of side i - 1
    small_corner = np.stack([corners, -1 - sides, np.repeat(own[:, None], 3, 1), -1 - sides[:, before]], axis=2)
    small_curve = np.stack([sides, spoke, spoke[:, before], sides[:, before]], axis=2)
    small_sense = np.stack([sense3, np.ones_like(sides), -np.ones_like(sides), sense3[:, before]], axis=2)
    first, last = np.where(sense3 > 0, 1, 2), np.where(sense3[:, before] > 0, 2, 1)
    small_piece = np.stack([first, np.zeros_like(sides), np.zeros_like(sides), last], axis=2)
    cell = mesh.cell[mesh.corners]
    small_cell = np.repeat(cell[triangles][:, None, [0, 1, 2, 2]], 3, axis=1)

    def joined(whole: IntArray, small: IntArray) -> IntArray:
        return np.concatenate([whole, small.reshape(-1, 4)]).astype(np.int64)

    return PatchNetwork(
        vertices=np.concatenate([mesh.vertices, centre]),
        ends=np.concatenate(
            [mesh.side_ends, np.stack([np.full(spoke.size, -1), np.repeat(own, 3)], axis=1).reshape(-1, 2)]
        ),
        plane=np.concatenate([mesh.side_plane, np.full(spoke.size, -1)]),
        n_sides=n_sides,
        middle_of=sides.ravel(),
        corners=joined(mesh.corners[quads], small_corner),
        curve=joined(mesh.sides[quads], small_curve),
        sense=joined(sense_of(quads, 4), small_sense),
        piece=joined(np.zeros((len(quads), 4), np.int64), small_piece),
        cell=joined(cell[quads], small_cell),
    )


@dataclass(frozen=True, slots=True, eq=False)
class NetworkMatch:
    """Which curve and patch of an earlier net each of a net's is, -1 where it is none of them: (C,), (Q,)."""

    curve: IntArray
    patch: IntArray


def match_networks(net: PatchNetwork, before: PatchNetwork) -> NetworkMatch:
    """The parts of a net that an earlier one has, too: between the same vertices to the last bit, and split alike."""
    known = {key: i for i, key in enumerate(_curve_keys(before))}
    curve = np.array([known.get(key, -1) for key in _curve_keys(net)], np.int64)
    patches = {row.tobytes(): i for i, row in enumerate(_patch_keys(before, np.arange(len(before.ends))))}
    rows = _patch_keys(net, curve)
    patch = np.array([patches.get(row.tobytes(), -1) for row in rows], np.int64)
    patch[(curve[net.curve] < 0).any(axis=1)] = -1
    return NetworkMatch(curve, patch)


def _curve_keys(net: PatchNetwork) -> list[tuple[object, ...]]:
    """What tells a net's curves apart: their ends' coordinates, and for spokes the curve they start on."""
    name = [v.tobytes() for v in net.vertices]
    keys: list[tuple[object, ...]] = [
        (name[a], name[b], int(p)) for (a, b), p in zip(net.ends[: net.n_sides], net.plane, strict=False)
    ]
    keys += [(keys[c], name[b]) for c, (_, b) in zip(net.middle_of, net.ends[net.n_sides :], strict=True)]
    return keys


def _patch_keys(net: PatchNetwork, curve: IntArray) -> IntArray:
    return np.concatenate([curve[net.curve], net.sense, net.piece], axis=1).astype(np.int64)
