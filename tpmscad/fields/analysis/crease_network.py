"""The network of creases of a tree of fields in a box: arcs, corners, loops and ends at the box, from the fields alone.

Pieces of creases in cells (`crease_cells`), found with proof that none is missed, are joined where they pass from cell to cell.
What could not be proved is stated: cells of a millionth of the box, or larger ones if they are many, in which two surfaces
touch or coincide; and ends of pieces that nothing continues. Arcs shorter than a millionth of the box are left to their ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.errors import format_point
from tpmscad.fields.analysis.crease_cells import PieceSearch
from tpmscad.fields.analysis.crease_pieces import CUT, FACE, SIDE, CellPairs, Pieces
from tpmscad.fields.analysis.level_surfaces import find_level_surfaces
from tpmscad.fields.field import Field

JOIN_TOL = 1e-8
"""In longest edges of the box: distance within which ends of two pieces are one point, computed from the same equations."""

CORNER_TOL = 1e-6
"""The same of corners, each computed from three of the surfaces that meet there; no arc is shorter."""

END_TOL = 1e-4
"""In sizes of the network: distance of ends of arcs that meet, at a corner or in cells that are not resolved."""

GROUP_REACH = 8.0
"""In cells: distance of unresolved cells of one tangency; what is resolved between them is left to it."""

GRID_SHIFTS = np.array([[0.31, 0.47, 0.61], [0.23, 0.67, 0.39], [0.53, 0.19, 0.71]]) / np.sqrt(2)
"""In cells: places of the grid against the box that are tried in turn, off the planes of symmetry of a model."""

MAX_NAMED = 3
"""Creases of which a message names the place."""

CORNER, BOX, UNRESOLVED, LOOSE = "corner", "box", "unresolved", "loose"
"""Where an arc ends: at other creases, at the box, in cells that are not resolved, or nowhere, which is a failure."""


@dataclass(frozen=True, slots=True, eq=False)
class CreaseArc:
    """A crease between its ends, or a loop, which has none, and its first point again as the last one.

    leaves: the two that meet there, as numbers of `list_leaves`. points (n, 3). ends: `CORNER`, `BOX`, ... of both.
    """

    leaves: tuple[int, int]
    points: Array
    length: float
    ends: tuple[str, ...]

    @property
    def is_closed(self) -> bool:
        """Whether the arc is a loop."""
        return not self.ends


@dataclass(frozen=True, slots=True, eq=False)
class CreaseCorner:
    """A point at which creases meet, and all leaves that vanish there."""

    point: Array
    leaves: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class UnresolvedCreases:
    """Cells with corners lo, hi (n, 3) that are neither free of creases nor simple, and the pairs of leaves (n, 2) concerned."""

    lo: Array
    hi: Array
    leaves: IntArray


@dataclass(frozen=True, eq=False)
class CreaseNetwork:
    """All creases of a field in a box; none is known of a field with foreign functions, which are not enclosed."""

    arcs: tuple[CreaseArc, ...]
    corners: tuple[CreaseCorner, ...]
    unresolved: UnresolvedCreases
    cells_tested: int
    is_enclosed: bool

    @cached_property
    def length(self) -> float:
        """The length of all arcs, model units."""
        return sum(arc.length for arc in self.arcs)

    @cached_property
    def n_curves(self) -> int:
        """How many curves the arcs make from corner to corner, if a corner of two arcs counts as none."""
        ends = np.array([arc.points[k] for arc in self.arcs for k in (0, -1)]).reshape(-1, 3)
        if not len(ends):
            return 0
        size = float(np.ptp(ends, axis=0).max())
        near = cKDTree(ends).query_pairs(END_TOL * size, output_type="ndarray").reshape(-1, 2)
        return count_curves(_label_groups(near, len(ends)).reshape(-1, 2))

    @property
    def is_proved(self) -> bool:
        """Whether all creases in the box are proved to be among the arcs."""
        return not len(self.unresolved.lo) and not any(LOOSE in arc.ends for arc in self.arcs)


def describe_creases(network: CreaseNetwork) -> str:
    """Number, length and places of the creases in words, the longest first; nothing if there are none."""
    if not network.arcs:
        return ""
    arcs = sorted(network.arcs, key=lambda arc: -arc.length)[:MAX_NAMED]
    places = ", ".join(format_point(arc.points[len(arc.points) // 2], 4) for arc in arcs)
    more = " and others" if len(network.arcs) > MAX_NAMED else ""
    creases = "one crease" if len(network.arcs) == 1 else f"{len(network.arcs)} creases"
    return f"surfaces of the field cross in {creases} of length {network.length:.4g}, near {places}{more}"


def count_curves(ends: IntArray) -> int:
    """How many curves edges make, from the numbers (n, 2) of their ends: they pass where two of them meet, and end elsewhere."""
    if not len(ends):
        return 0
    degree = np.bincount(ends.ravel())
    label = _label_groups(ends, len(degree))
    passed = np.ones(label.max() + 1, bool)
    passed[label[(degree != 2) & (degree > 0)]] = False
    passed[np.setdiff1d(label, label[degree > 0])] = False
    return int(passed.sum()) + int(degree[degree != 2].sum()) // 2


def _label_groups(pairs: IntArray, count: int) -> IntArray:
    """Numbers (count,) of the groups that pairs (n, 2) of things join."""
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])


def trace_creases(field: Field, lo: Array, hi: Array) -> CreaseNetwork:
    """The creases of {field = 0} in the box [lo, hi].

    Foreign functions (`fields.from_function`) are not enclosed: creases of such leaves are unresolved, from the first cells on.
    """
    surfaces = find_level_surfaces(field)
    lo, hi = np.asarray(lo, float), np.asarray(hi, float)
    for shift in GRID_SHIFTS:
        search = PieceSearch(surfaces, lo, hi)
        search.run(shift)
        network = _join(search)
        if search.is_exhausted or not any(LOOSE in arc.ends for arc in network.arcs):
            break
    return network


def _join(search: PieceSearch) -> CreaseNetwork:
    """The network of the pieces and cells of a search."""
    leaf_of, extent = search.surfaces.leaf_of, search.extent
    pieces, left = _join_pieces(search.found), _join_cells(search.unresolved)
    n = len(pieces.pairs)
    ends = pieces.points[:, [0, -1]].reshape(-1, 3)
    kinds, owner = pieces.ends.ravel(), np.repeat(np.arange(n), 2)
    names = np.full(2 * n, LOOSE, dtype=object)
    names[kinds == SIDE], names[kinds >= CUT] = BOX, CORNER
    partner = np.full(2 * n, -1)
    count = len(search.surfaces.fields)
    code = pieces.pairs @ np.array([count, 1])
    for pair in np.unique(code):
        own = np.flatnonzero((kinds == FACE) & (code[owner] == pair))
        near = cKDTree(ends[own]).query_pairs(JOIN_TOL * extent, output_type="ndarray").reshape(-1, 2)
        # several ends in one point: a crease that runs in the sides of cells
        single = (np.bincount(near.ravel(), minlength=len(own))[near] == 1).all(axis=1)
        first, second = own[near[single]].T
        partner[first], partner[second] = second, first
    names[partner >= 0] = ""
    corners = _find_corners(search, pieces, ends, kinds, owner)
    loose = np.flatnonzero(names == LOOSE)
    if len(loose) and len(corners):
        # a corner in the side of a cell
        near = cKDTree([c.point for c in corners]).query(ends[loose])[0] <= CORNER_TOL * extent
        names[loose[near]] = CORNER
    for e in np.flatnonzero(names == LOOSE):
        own = (left.pairs == pieces.pairs[owner[e]]).all(axis=1)
        tol = JOIN_TOL * extent
        if ((ends[e] >= left.lo[own] - tol) & (ends[e] <= left.hi[own] + tol)).all(axis=1).any():
            names[e] = UNRESOLVED
    unresolved = UnresolvedCreases(left.lo, left.hi, leaf_of[left.pairs])
    arcs = _chain(pieces, partner, names, leaf_of)
    groups = _group_cells(left)
    kept = tuple(
        arc
        for arc in arcs
        if not _is_within(arc, left, groups, JOIN_TOL * extent) and (arc.is_closed or arc.length > CORNER_TOL * extent)
    )
    return CreaseNetwork(kept, tuple(corners), unresolved, search.cells_tested, search.surfaces.are_enclosed)


def _group_cells(cells: CellPairs) -> IntArray:
    """Numbers (n,) of groups of cells that lie within GROUP_REACH cells of each other."""
    n = len(cells)
    if not n:
        return np.zeros(0, np.int64)
    reach = GROUP_REACH * float((cells.hi - cells.lo).max())
    near = cKDTree(0.5 * (cells.lo + cells.hi)).query_pairs(reach, output_type="ndarray").reshape(-1, 2)
    return _label_groups(near, n)


def _is_within(arc: CreaseArc, cells: CellPairs, groups: IntArray, tol: float) -> bool:
    """Whether an arc leads from one cell that is not resolved to another of the same group, within the group's box."""
    if arc.ends != (UNRESOLVED, UNRESOLVED):
        return False
    for k in np.unique(groups):
        lo, hi = cells.lo[groups == k].min(axis=0), cells.hi[groups == k].max(axis=0)
        if ((arc.points >= lo - tol) & (arc.points <= hi + tol)).all():
            return True
    return False


def _chain(pieces: Pieces, partner: IntArray, names: Array, leaf_of: IntArray) -> list[CreaseArc]:
    """Arcs of pieces whose ends 2 k and 2 k + 1 are joined to others, or to nothing (-1)."""
    left = np.ones(len(pieces.pairs), bool)
    arcs = []
    starts = [*np.flatnonzero(partner < 0).tolist(), *range(0, len(partner), 2)]
    for first in starts:
        if not left[first // 2]:
            continue
        end, own = first, []
        while end >= 0 and left[end // 2]:
            left[end // 2] = False
            own.append(end)
            end = int(partner[end ^ 1])
        points = [pieces.points[e // 2][:: -1 if e % 2 else 1] for e in own]
        whole = np.concatenate([points[0], *(p[1:] for p in points[1:])])
        a, b = sorted(leaf_of[pieces.pairs[own[0] // 2]].tolist())
        names_of = () if partner[first] >= 0 else (str(names[first]), str(names[own[-1] ^ 1]))
        arcs.append(CreaseArc((a, b), whole, float(pieces.lengths[[e // 2 for e in own]].sum()), names_of))
    return arcs


def _find_corners(
    search: PieceSearch, pieces: Pieces, ends: Array, kinds: IntArray, owner: IntArray
) -> list[CreaseCorner]:
    """Corners: the ends of pieces at third surfaces, those that are one point together."""
    cuts = np.flatnonzero(kinds >= CUT)
    if not len(cuts):
        return []
    near = cKDTree(ends[cuts]).query_pairs(CORNER_TOL * search.extent, output_type="ndarray").reshape(-1, 2)
    label = _label_groups(near, len(cuts))
    corners = []
    for k in range(label.max() + 1):
        own = cuts[label == k]
        surfaces = np.unique(np.concatenate([pieces.pairs[owner[own]].ravel(), kinds[own] - CUT]))
        leaves = np.sort(search.surfaces.leaf_of[surfaces])
        corners.append(CreaseCorner(ends[own].mean(axis=0), tuple(leaves.tolist())))
    return corners


def _join_pieces(parts: list[Pieces]) -> Pieces:
    empty = Pieces(np.zeros((0, 2), np.int64), np.zeros((0, 5, 3)), np.zeros(0), np.zeros((0, 2), np.int64))
    every = [empty, *parts]
    return Pieces(
        np.concatenate([p.pairs for p in every]),
        np.concatenate([p.points for p in every]),
        np.concatenate([p.lengths for p in every]),
        np.concatenate([p.ends for p in every]),
    )


def _join_cells(parts: list[CellPairs]) -> CellPairs:
    empty = CellPairs(np.zeros((0, 2), np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 0), np.int64))
    every = [empty, *parts]
    return CellPairs(
        np.concatenate([p.pairs for p in every]),
        np.concatenate([p.lo for p in every]),
        np.concatenate([p.hi for p in every]),
        np.zeros((sum(map(len, every)), 0), np.int64),
    )
