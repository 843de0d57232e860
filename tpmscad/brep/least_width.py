"""The least distance between sides that face each other, by branch and bound over pairs of cells: a bound, not a sample.

Two places of a surface face each other through the material if the segment between them leaves both along the inward normal, and
through the void if it leaves both along the outward normal; the ball on the segment is empty. Inside faces the least distance
is stationary, so that both normals lie along the segment; where a sharp edge ends a side, the sides may taper.

Pairs of cells (`tpmscad.brep.surface_cells`) are dropped where cones of their normals and of the directions between them rule
this out, and where their hulls are farther apart than the least distance attained so far, less the resolution; the others are
bisected. What was dropped bounds the least distance from below, a pair of places attains it from above.

Sides that meet in a sharp edge nearby form a wedge, whose width goes to zero at every cut; such pairs are left out. Between
different solids any two places count.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.facing_pairs import MAX_TAPER, STRAIGHT, CellBounds, ends_at_edge, select_facing
from tpmscad.brep.local_thickness import shrink_tangent_balls
from tpmscad.brep.near_balls import find_near_balls
from tpmscad.brep.patch_pairs import approach_places, settle_places, shoot_normals, unit_vectors
from tpmscad.brep.surface_cells import SurfaceCells, evaluate_cells

RESOLUTION = 0.02
"""Of the least distance: by how much the bound may stay below the value."""

WEDGE_REACH = 20.0
"""Widths within which sides that meet in a sharp edge form a wedge."""

WEDGE_SPACINGS = 2.0
"""Distance from the edge, in spacings of its samples, within which they do at any angle: cuts graze a surface in places."""

MIN_WEDGE_ANGLE = np.radians(3.0)
"""Sides that meet at a greater angle are nearer to their edge than `WEDGE_REACH` widths all along it."""

MAX_OVERLAP = 0.2
"""Of the ball on the segment with other parts of the surface, relative to its radius."""

PAD_FRACTION = 1e-3
"""Greatest distance between cells and faces, relative to the least width so far, when cells are bisected."""

FIRST_WIDTH_SPACINGS = 16.0
"""Width up to which sides are sought at first, in spacings of edge samples: about two mean walls."""

SAMPLE_SPACINGS = 4.0
"""Radius of the cells, in spacings of edge samples, whose middles tell which balls are empty."""

LEAST_CELL = 0.02
"""Radius of cells that are not bisected any further, in spacings of edge samples or least widths, the smaller; what is left of
them bounds the distance."""

NEAREST_EDGE_SAMPLES = 16
"""Samples of sharp edges looked at around a cell; a cell with more of them is taken for one at the end of a side."""

REFINED_PAIRS = 256
"""Pairs of each round between which places are sought, those with the least bounds."""

MAX_PAIRS = 300_000
"""Pairs beyond which the search is given up: where sides just fail to face each other along an edge, they double each round."""


@dataclass(frozen=True, slots=True, eq=False)
class SharpEdges:
    """Points on sharp edges (m, 3), at most `spacing` apart, and the two smooth groups that meet there (m, 2), ascending."""

    points: Array
    groups: IntArray
    spacing: float


@dataclass(frozen=True, slots=True, eq=False)
class LeastWidth:
    """The least distance of facing sides: a lower bound, and the value attained by two places (2, 3).

    Where the search is given up, the places are the middles of the two cells of the least bound; they may just not face each
    other.

    faces: the two faces; parameters (2, 2): the places in the parameters of these faces.
    """

    bound: float
    value: float
    places: Array
    faces: tuple[int, int]
    parameters: Array


def find_least_widths(
    cells: SurfaceCells, group: IntArray, solid: IntArray, edges: SharpEdges
) -> tuple[LeastWidth | None, LeastWidth | None]:
    """The least distances of sides that face each other, through the material and through the void; None where none do.

    group, solid (F,): smooth group and solid of each face.
    """
    samples = cKDTree(np.concatenate([_sample_surface(cells, SAMPLE_SPACINGS * edges.spacing), edges.points]))
    wall, gap = (_Search(cells, through, group, solid, edges, samples).run() for through in (-1.0, 1.0))
    return wall, gap


def _sample_surface(cells: SurfaceCells, radius: float) -> Array:
    """The middles (n, 3) of parts of the cells of this radius at most, about as dense as half a mean wall."""
    while (large := cells.balls()[1] > radius).any():
        cells, _ = cells.bisect(large)
    return np.asarray(cells.middles()[cells.inside])


class _Search:
    """The cells under search, the least width so far, and the bound of the pairs dropped."""

    cells: SurfaceCells
    bounds: CellBounds
    center: Array
    radius: Array

    def __init__(
        self,
        cells: SurfaceCells,
        through: float,
        group: IntArray,
        solid: IntArray,
        edges: SharpEdges,
        samples: cKDTree,
    ) -> None:
        """through: -1 for the material, 1 for the void. samples: points of the surface, which tell whether balls are empty."""
        self.through, self.group, self.solid, self.edges = through, group, solid, edges
        self.cells: SurfaceCells
        self.center: Array
        self.radius: Array
        self.bounds: CellBounds
        self.n_groups = 1 + int(group.max())
        self.edge_key = edges.groups @ np.array([self.n_groups, 1])
        self.edge_tree = cKDTree(edges.points) if len(edges.points) else None
        self.trees_by_key = {int(k): cKDTree(edges.points[self.edge_key == k]) for k in np.unique(self.edge_key)}
        self._take(cells)
        low, high = (self.center - self.radius[:, None]).min(axis=0), (self.center + self.radius[:, None]).max(axis=0)
        self.size = float(np.linalg.norm(high - low))
        self.samples = samples
        self.found: LeastWidth | None = None

    def run(self) -> LeastWidth | None:
        """The least width and its bound: sought up to a width that doubles until there is one."""
        whole, width = self.cells, FIRST_WIDTH_SPACINGS * self.edges.spacing
        while self.found is None:
            self.value = self.bound = width
            self._search(whole)
            if width > self.size:
                break
            width *= 2.0
        if self.found is None:
            return None
        return replace(self.found, bound=min(self.bound, self.value))

    def _search(self, cells: SurfaceCells) -> None:
        """Find the least width below the value, and bound it from below."""
        self._take(cells)
        while (large := self.radius > max(2.0 * np.median(self.radius), 0.5 * self.value)).any():
            parts, parent = self.cells.bisect(large)
            self._take(parts.tighten(PAD_FRACTION * self.value), parent)
        self._attain_by_balls()
        near = find_near_balls(self.center, self.radius, self.value, "cells of faces", "check a part of the model")
        pairs = np.concatenate([np.stack(near, axis=1), np.repeat(np.arange(len(self.cells))[:, None], 2, axis=1)])
        first = np.arange(len(self.cells) + 1)
        while len(pairs):
            pairs, low = self._select_pairs(pairs, first)
            self._attain(pairs, low)
            near = low < self.value * (1.0 - RESOLUTION)
            small = self.radius[pairs].max(axis=1) < self._least_cell
            self.bound = min(self.bound, float(low[~near | small].min(initial=np.inf)))
            due = near & ~small
            if due.sum() > MAX_PAIRS:
                self._give_up(pairs[due], low[due])
                return
            pairs, first = self._bisect(pairs[due])

    def _give_up(self, pairs: IntArray, low: Array) -> None:
        """Bound the least width by the pairs that are left; the least of them attains it where nothing else has."""
        least = int(np.argmin(low))
        self.bound = min(self.bound, float(low[least]))
        if self.found is None:
            pair, middles = pairs[least], self.cells.middles()[pairs[least]]
            self.value = float(np.linalg.norm(middles[1] - middles[0]))
            first, second = self.cells.face[pair].tolist()
            parameters = self.cells.parameters(pair, np.full((2, 2), 0.5))
            self.found = LeastWidth(0.0, self.value, middles, (first, second), parameters)

    def _take(self, cells: SurfaceCells, parent: IntArray | None = None) -> None:
        """Make these the cells under search; with their parents among those so far, whose parts alone are near edges."""
        sought = np.arange(len(cells)) if parent is None else np.flatnonzero(self.bounds.edge_row[parent] >= 0)
        self.cells = cells
        self.center, self.radius = cells.balls()
        self.axis, self.angle = cells.normal_cones()
        self.whole = cells.whole()
        edge_row, edge_keys, more_edges = np.full(len(cells), -1), np.empty((0, 1), np.int64), np.empty(0, bool)
        if self.edge_tree is not None:
            k, reach = min(NEAREST_EDGE_SAMPLES, len(self.edge_key)), self.radius + self.edges.spacing
            nearest, _ = self.edge_tree.query(self.center[sought], distance_upper_bound=float(reach.max()))
            near = sought[nearest <= reach[sought]]
            away, at = self.edge_tree.query(self.center[near], k=np.arange(1, k + 1))
            meets = away <= reach[near, None]
            edge_row[near] = np.arange(len(near))
            edge_keys, more_edges = np.where(meets, self.edge_key[at], -1), meets[:, -1] & (k < len(self.edge_key))
        solid, group = self.solid[cells.face], self.group[cells.face]
        balls_and_cones = (self.center, self.radius, self.axis, self.angle)
        self.bounds = CellBounds(cells.nets, cells.pad, *balls_and_cones, solid, group, edge_row, edge_keys, more_edges)

    def _bisect(self, pairs: IntArray) -> tuple[IntArray, IntArray]:
        """Bisect the larger ones of the cells in pairs, and drop the other cells.

        Returns the pairs by numbers of parents, and the first part of each parent, with the number of all parts at the end.
        """
        if not len(pairs):
            return pairs, np.zeros(1, np.int64)
        used = np.zeros(len(self.cells), bool)
        used[pairs] = True
        kept, number = np.flatnonzero(used), np.cumsum(used) - 1
        radius = self.radius[kept]
        cells, parent = self.cells.select(kept).bisect(radius > 0.7 * radius.max())
        self._take(cells.tighten(PAD_FRACTION * self.value), kept[parent])
        return number[pairs], np.searchsorted(parent, np.arange(len(kept) + 1))

    def _select_pairs(self, parents: IntArray, first: IntArray) -> tuple[IntArray, Array]:
        """The pairs of parts with places that may face each other nearer than the value, and lower bounds of their distances."""
        count = int(np.diff(first)[parents].prod(axis=1).sum())
        pairs, low = np.empty((count, 2), np.int64), np.empty(count)
        found = select_facing(self.bounds, parents, first, self.value, self.through, self.n_groups, pairs, low)
        pairs, low = pairs[:found], low[:found]
        keep = np.ones(found, bool)
        near = low < self.value * (1.0 - RESOLUTION)  # the others are not followed
        keep[near] = ~(self._in_wedge(pairs[near], low[near]) | self._is_blocked(pairs[near], low[near]))
        return pairs[keep], low[keep]

    @property
    def _least_cell(self) -> float:
        """Radius of cells that are not bisected any further."""
        return LEAST_CELL * min(self.edges.spacing, self.value)

    def _of_one_solid(self, pairs: IntArray) -> BoolArray:
        """Whether both cells of each pair belong to the same solid: (n,)."""
        solid = self.solid[self.cells.face[pairs]]
        return np.asarray(solid[:, 0] == solid[:, 1])

    def _keys(self, pairs: IntArray) -> IntArray:
        """Numbers of the two smooth groups of each pair, those of the sharp edges where they meet: (n,)."""
        return np.asarray(np.sort(self.group[self.cells.face[pairs]], axis=1) @ np.array([self.n_groups, 1]))

    def _end_at_edges(self, pairs: IntArray) -> BoolArray:
        """Whether a sharp edge that is not one between both sides surely ends one of them in its cell: (n,)."""
        return np.array([ends_at_edge(self.bounds, i, j, self.n_groups, True) for i, j in pairs.tolist()], bool)

    def _in_wedge(self, pairs: IntArray, low: Array) -> BoolArray:
        """Whether the sides of pairs meet in a sharp edge near all places of their cells: (n,)."""
        i, j = pairs.T
        result, key = np.zeros(len(pairs), bool), self._keys(pairs)
        middle, radius = 0.5 * (self.center[i] + self.center[j]), self.radius[pairs].max(axis=1)
        open_angle = np.pi - _angle(self.axis[i], self.axis[j]) - self.angle[i] - self.angle[j]
        for k in np.intersect1d(key, list(self.trees_by_key)).tolist():
            own = np.flatnonzero((key == k) & self._of_one_solid(pairs))
            away, _ = self.trees_by_key[k].query(middle[own])
            farthest = away + radius[own]
            touching = away <= radius[own] + self.edges.spacing
            settled = (open_angle[own] > MIN_WEDGE_ANGLE) | (radius[own] < self._least_cell)
            result[own] = (
                (low[own] > farthest / WEDGE_REACH)
                | (farthest < WEDGE_SPACINGS * self.edges.spacing)
                | (touching & settled)
            )
        return result

    def _is_blocked(self, pairs: IntArray, low: Array) -> BoolArray:
        """Whether other parts of the surface lie in the balls on all segments of pairs: (n,)."""
        i, j = pairs.T
        reach = 0.5 * low * (1.0 - MAX_OVERLAP) - self.radius[pairs].max(axis=1)
        result = (reach > 0.0) & self._of_one_solid(pairs)
        if result.any():
            middles = 0.5 * (self.center[i[result]] + self.center[j[result]])
            away, _ = self.samples.query(middles, distance_upper_bound=float(reach.max()))
            result[result] = away < reach[result]
        return np.asarray(result)

    def _attain_by_balls(self) -> None:
        """Attain a first width between cells whose middles touch an empty ball on opposite sides."""
        middles = self.cells.middles()
        everyone = np.arange(len(middles))
        _, contact = shrink_tangent_balls(
            middles, -self.through * self.axis, 0.5 * self.value, everyone, cKDTree(middles)
        )
        i = np.flatnonzero(contact >= 0)
        pairs = np.stack([i, contact[i]], axis=1)
        opposite = _angle(self.axis[pairs[:, 0]], -self.axis[pairs[:, 1]]) < 2.0 * MAX_TAPER
        pairs = pairs[opposite]
        self._take_least(pairs, approach_places(self.cells.nets[pairs]))
        self._take_least(pairs, shoot_normals(self.cells.nets[pairs]))

    def _attain(self, pairs: IntArray, low: Array) -> None:
        """Attain lesser widths between places of the cells with the least bounds."""
        order = np.argsort(low, kind="stable")
        # near the edges of two solids the least bounds may all be of cells whose nearest places are trimmed away
        is_untrimmed = self.whole[pairs[order]].all(axis=1) & ~self._of_one_solid(pairs[order])
        nearest = pairs[np.concatenate([order[:REFINED_PAIRS], order[is_untrimmed][:REFINED_PAIRS]])]
        self._take_least(nearest, approach_places(self.cells.nets[nearest]))
        both = np.stack([pairs[order], pairs[order, ::-1]], axis=1).reshape(-1, 2)
        way, normal = self.center[both[:, 1]] - self.center[both[:, 0]], self.axis[both[:, 0]]
        aside = np.linalg.norm(way - (way * normal).sum(axis=1, keepdims=True) * normal, axis=1)
        # segments of an end at an edge may all be oblique, within what counts as straight
        both = both[aside < self.radius[both[:, 1]] + STRAIGHT * np.linalg.norm(way, axis=1)]
        # the least bounds may all be of pairs that do not face each other: some of all others, too
        both = np.concatenate(
            [both[: 2 * REFINED_PAIRS], both[2 * REFINED_PAIRS :: 1 + len(both) // (2 * REFINED_PAIRS)]]
        )
        ends = shoot_normals(self.cells.nets[both])
        self._take_least(both, ends)
        self._take_least(both, settle_places(self.cells.nets[both], ends))

    def _take_least(self, pairs: IntArray, st: Array) -> None:
        """Take the least distance between places (n, 2, 2) that face each other, if it is less than that so far."""
        (p, pu, pv), (q, qu, qv) = (evaluate_cells(self.cells.nets[pairs[:, k]], st[:, k]) for k in (0, 1))
        distance = np.linalg.norm(q - p, axis=1) + self.cells.pad[pairs].sum(axis=1)
        normals = [
            unit_vectors(np.cross(u, v)) * self.cells.sign[pairs[:, k], None]
            for k, (u, v) in enumerate(((pu, pv), (qu, qv)))
        ]
        unit = self.through * unit_vectors(q - p)
        tilt = np.sort([_angle(unit, normals[0]), _angle(-unit, normals[1])], axis=0)
        taper = STRAIGHT + (MAX_TAPER - STRAIGHT) * self._end_at_edges(pairs)
        one_solid = self._of_one_solid(pairs)
        counts = (distance > 0.0) & (distance < self.value)
        counts &= ((tilt[0] <= STRAIGHT) & (tilt[1] <= taper)) | ~one_solid
        if self.through < 0.0:
            counts &= one_solid
        candidates = np.flatnonzero(counts)
        for k in candidates[np.argsort(distance[candidates], kind="stable")].tolist():
            middle, width, pair = 0.5 * (p[k] + q[k]), float(distance[k]), pairs[k]
            parameters = self.cells.parameters(pair, st[k])
            if not all(self.whole[pair] | self.cells.contain(pair, parameters)):
                continue
            if one_solid[k]:
                open_angle = np.pi - float(_angle(normals[0][k : k + 1], normals[1][k : k + 1])[0])
                tree = self.trees_by_key.get(int(self._keys(pair[None])[0]))
                reach = max(WEDGE_REACH * width, WEDGE_SPACINGS * self.edges.spacing)
                if tree is not None and float(tree.query(middle)[0]) < reach + (
                    self.edges.spacing if open_angle > MIN_WEDGE_ANGLE else 0.0
                ):
                    continue
                if float(self.samples.query(middle)[0]) < 0.5 * width * (1.0 - MAX_OVERLAP):
                    continue
            first, second = self.cells.face[pair].tolist()
            self.value = width
            self.found = LeastWidth(0.0, width, np.stack([p[k], q[k]]), (first, second), parameters)
            return


def _angle(one: Array, two: Array) -> Array:
    """Angles (n,) between unit vectors (n, 3)."""
    return np.asarray(np.arccos(np.clip((one * two).sum(axis=1), -1.0, 1.0)))
