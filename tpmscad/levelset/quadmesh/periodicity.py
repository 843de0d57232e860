"""Translated copies in meshes of periodic fields.

Where a whole number of leaves fits a period, the mesh repeats except near the box and near leaves split for its sake. Vertices
whose neighbourhoods are translates of each other, `MATCHED_RINGS` rings deep, are moved to the same place of
their periods. Of all curves or patches that are translates of each other by whole periods one is then fitted and measured; the
others are this one, translated. Neighbourhoods are compared by hashes of their quantised positions, refined ring by ring (colour
refinement in the manner of Weisfeiler and Leman), with the mixing function of splitmix64 (Steele, Lea and Flood 2014).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.fields.periods_and_directions import ROUND_OFF
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.patch_network import PatchNetwork

MATCHED_RINGS = 3
"""Rings of polygons round two vertices that must be translates of each other. At that distance from the box smoothing leaves
translates a hundredth of a leaf apart."""

TICKS_PER_PERIOD = 1 << 26
"""Quantised positions per period: far finer than any mesh, far coarser than round-off."""

TICK_OFFSET = 0.37
"""Offset of the quantisation, so that no fraction of a period at which leaves end lies on the limit between two ticks."""


@dataclass(frozen=True, slots=True, eq=False)
class TranslatedCopies:
    """Curve i is curve `curve[i]` translated by `curve_shift[i]`, patches likewise; an original is itself, not shifted."""

    curve: IntArray
    curve_shift: Array
    patch: IntArray
    patch_shift: Array

    @property
    def original_curves(self) -> BoolArray:
        """Mask (C,) of curves that are originals."""
        return np.asarray(self.curve == np.arange(len(self.curve)))

    @property
    def original_patches(self) -> BoolArray:
        """Mask (Q,) of patches that are originals."""
        return np.asarray(self.patch == np.arange(len(self.patch)))

    def curves_with_copies(self, chosen: BoolArray) -> BoolArray:
        """The chosen curves (C,) and all other copies of their originals."""
        return np.asarray(np.bincount(self.curve, chosen, len(self.curve))[self.curve] > 0)

    def patches_with_copies(self, chosen: BoolArray) -> BoolArray:
        """The chosen patches (Q,) and all other copies of their originals."""
        return np.asarray(np.bincount(self.patch, chosen, len(self.patch))[self.patch] > 0)


def no_copies(n_curves: int, n_patches: int) -> TranslatedCopies:
    """Copies of a network in which every curve and patch is an original."""
    curves, patches = np.arange(n_curves), np.arange(n_patches)
    return TranslatedCopies(curves, np.zeros((n_curves, 3)), patches, np.zeros((n_patches, 3)))


def snap_translated_vertices(mesh: QuadMesh, field: Field, tree: Octree) -> QuadMesh:
    """The mesh with vertices of congruent neighbourhoods moved to the same place of their periods.

    Of the vertices that are translates of each other, the one nearest the centre of the box gives the place.
    """
    period = _find_whole_periods(field, tree)
    if not period.any():
        return mesh
    ticks, cell = _quantise_positions(mesh.start_positions, tree.lo, period)
    upper = mesh.fixed & (mesh.start_positions > 0.5 * (tree.lo + tree.hi))
    size = np.rint(mesh.size / tree.cell_edges.min())
    name = _hash_rows(np.column_stack([ticks, mesh.fixed, upper, size]).astype(np.uint64))
    valid = mesh.corners >= 0
    for _ in range(MATCHED_RINGS):
        of_polygon = np.where(valid, name[mesh.corners], np.uint64(0)).sum(axis=1, dtype=np.uint64)
        total = np.zeros(len(name), np.uint64)
        for k in range(4):
            np.add.at(total, mesh.corners[valid[:, k], k], _splitmix64(of_polygon[valid[:, k]]))
        name = _splitmix64(name + _splitmix64(total))
    from_centre = np.abs(mesh.start_positions - 0.5 * (tree.lo + tree.hi)).max(axis=1)
    first = _first_occurrences(name, np.lexsort([from_centre, name]))
    is_first = first[:, None] == np.arange(len(first))[:, None]
    shift = (cell - cell[first]) * period
    vertices = np.where(is_first, mesh.vertices, mesh.vertices[first] + shift)
    return replace(mesh, vertices=_return_to_sides(vertices, mesh.side_ends, mesh.side_plane, tree))


def find_translated_copies(
    network: PatchNetwork, field: Field, tree: Octree, fitted_curves: BoolArray, fitted_patches: BoolArray
) -> tuple[PatchNetwork, TranslatedCopies]:
    """The network with congruent vertices translated exactly, and the copies among its curves and patches.

    `fitted_curves` (C,) and `fitted_patches` (Q,) mark those that are fitted already and are preferred as originals.
    """
    period = _find_whole_periods(field, tree)
    if not period.any():
        return network, no_copies(len(network.ends), len(network.curve))
    ticks, cell = _quantise_positions(network.vertices, tree.lo, period)
    vertex = _first_equal_rows(ticks)
    shift = cell - cell[vertex]
    shifted = (shift != 0).any(axis=1)[:, None]
    vertices = np.where(shifted, network.vertices[vertex] + shift * period, network.vertices)
    network = replace(network, vertices=_return_to_sides(vertices, network.ends, network.plane, tree))

    sides, spokes = slice(None, network.n_sides), slice(network.n_sides, None)
    a, b = network.ends[sides].T
    curve = np.arange(len(network.ends))
    position = np.zeros((len(network.ends), 3), np.int64)  # period of a curve's start, less that of its original vertex
    position[sides] = shift[a]
    rows = np.column_stack([vertex[a], vertex[b], shift[b] - shift[a], network.plane[sides]])
    curve[sides] = _first_equal_rows(rows, fitted_curves[sides])
    if len(network.split_curve):
        end = network.ends[spokes, 1]
        position[spokes] = position[network.split_curve]
        rows = np.column_stack([curve[network.split_curve], vertex[end], shift[end] - position[network.split_curve]])
        curve[spokes] = network.n_sides + _first_equal_rows(rows, fitted_curves[spokes])

    between = (position[network.curve[:, 1:]] - position[network.curve[:, :1]]).reshape(-1, 9)
    rows = np.column_stack([curve[network.curve], between, network.sense, network.piece])
    patch = _first_equal_rows(rows, fitted_patches)
    first = position[network.curve[:, 0]]
    curve_shift, patch_shift = (position - position[curve]) * period, (first - first[patch]) * period
    return network, TranslatedCopies(curve, curve_shift, patch, patch_shift)


def _return_to_sides(vertices: Array, ends: IntArray, plane: IntArray, tree: Octree) -> Array:
    """Vertices (V, 3), those of curves (C,) in faces of the box, 2 * axis + upper, exactly in these: periods add round-off."""
    result, corners = vertices.copy(), np.stack([tree.lo, tree.hi])
    in_face = np.flatnonzero(plane >= 0)
    axis, upper = np.divmod(plane[in_face], 2)
    result[ends[in_face].T, axis] = corners[upper, axis]
    return result


def _find_whole_periods(field: Field, tree: Octree) -> Array:
    """The field's periods (3,) that hold a whole number of leaves and are shorter than the box; 0 along other axes."""
    periods = field.periods()
    if periods is None:
        return np.zeros(3)
    p = np.array(periods, float)
    largest = tree.cell_edges * tree.size.max()
    leaves = np.maximum(1.0, np.rint(p / largest))
    slack = ROUND_OFF * float(np.abs([tree.lo, tree.hi]).max())
    return np.where((np.abs(leaves * largest - p) <= slack) & (p < tree.hi - tree.lo - slack), p, 0.0)


def _quantise_positions(points: Array, lo: Array, period: Array) -> tuple[IntArray, IntArray]:
    """Ticks within the period and the period's number, (n, 3) each; an axis without a period is one period."""
    size = np.where(period > 0, period, 1.0)
    ticks = np.floor((points - lo) / size * TICKS_PER_PERIOD + TICK_OFFSET).astype(np.int64)
    cell = np.where(period > 0, ticks // TICKS_PER_PERIOD, 0)
    return ticks - cell * TICKS_PER_PERIOD, cell


def _first_equal_rows(rows: IntArray, preferred: BoolArray | None = None) -> IntArray:
    """Number (n,) of the first row equal to each row, of the preferred rows if any of them is."""
    name = _hash_rows(rows.astype(np.uint64))
    last = np.zeros(len(rows), bool) if preferred is None else ~preferred
    first = _first_occurrences(name, np.lexsort([last, name]))
    same = (rows[first] == rows).all(axis=1)  # hashes may collide, if rarely
    return np.where(same, first, np.arange(len(rows)))


def _first_occurrences(name: NDArray[np.uint64], order: IntArray) -> IntArray:
    """For each item (n,) the first one of the same name in `order`, which sorts by name."""
    begins = np.concatenate([[True], name[order][1:] != name[order][:-1]]) if len(order) else np.zeros(0, bool)
    first = np.empty(len(order), np.int64)
    first[order] = order[begins][np.cumsum(begins) - 1]
    return first


def _hash_rows(rows: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Hash (n,) of each row (n, k)."""
    name = np.zeros(len(rows), np.uint64)
    for column in rows.T:
        name = _splitmix64(name + column)
    return name


def _splitmix64(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """The finaliser of splitmix64, which spreads the bits of x over all places."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))
