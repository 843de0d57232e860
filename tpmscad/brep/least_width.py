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
from tpmscad.brep.local_thickness import shrink_tangent_balls
from tpmscad.brep.patch_pairs import approach_places, settle_places, shoot_normals, unit_vectors
from tpmscad.brep.surface_cells import SurfaceCells, evaluate_cells

RESOLUTION = 0.02
"""Of the least distance: by how much the bound may stay below the value."""

STRAIGHT = np.radians(0.25)
"""Angle within which a segment is along a normal: kinks of smooth joints, and the Newton steps that end there, are smaller."""

MAX_TAPER = np.radians(20.0)
"""Greatest angle between the segment and one of its normals where a sharp edge ends a side."""

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

PAIRS_AT_ONCE = 100_000
"""Pairs of cells compared at a time, about 200 MB."""

REFINED_PAIRS = 256
"""Pairs of each round between which places are sought, those with the least bounds."""


@dataclass(frozen=True, slots=True, eq=False)
class SharpEdges:
    """Points on sharp edges (m, 3), at most `spacing` apart, and the two smooth groups that meet there (m, 2), ascending."""

    points: Array
    groups: IntArray
    spacing: float


@dataclass(frozen=True, slots=True, eq=False)
class LeastWidth:
    """The least distance of facing sides: a lower bound, and the value attained by two places (2, 3).

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
            self._take(self.cells.bisect(large)[0].tighten(PAD_FRACTION * self.value))
        self._attain_by_balls()
        pairs = cKDTree(self.center).query_pairs(2.0 * self.radius.max() + self.value, output_type="ndarray")
        pairs = np.concatenate([pairs.astype(np.int64), np.repeat(np.arange(len(self.cells))[:, None], 2, axis=1)])
        while len(pairs):
            pairs, low = self._select_pairs(pairs)
            self._attain(pairs, low)
            near = low < self.value * (1.0 - RESOLUTION)
            small = self.radius[pairs].max(axis=1) < self._least_cell
            self.bound = min(self.bound, float(low[~near | small].min(initial=np.inf)))
            pairs = self._bisect(pairs[near & ~small])

    def _take(self, cells: SurfaceCells) -> None:
        """Make these the cells under search."""
        self.cells = cells
        self.center, self.radius = cells.balls()
        self.axis, self.angle = cells.normal_cones()
        self.whole = cells.whole()
        self.edge_keys_near = np.full((len(cells), 1), -1)
        self.more_edges_near = np.zeros(len(cells), bool)
        if self.edge_tree is not None:
            k = min(NEAREST_EDGE_SAMPLES, len(self.edge_key))
            away, at = self.edge_tree.query(
                self.center, k=np.arange(1, k + 1), distance_upper_bound=float(self.radius.max()) + self.edges.spacing
            )
            meets = away <= (self.radius + self.edges.spacing)[:, None]
            self.edge_keys_near = np.where(meets, self.edge_key[np.minimum(at, len(self.edge_key) - 1)], -1)
            self.more_edges_near = meets[:, -1] & (k < len(self.edge_key))

    def _bisect(self, pairs: IntArray) -> IntArray:
        """Bisect the larger ones of the cells in pairs, drop the other cells, and return the pairs of their parts."""
        if not len(pairs):
            return pairs
        used, numbers = np.unique(pairs, return_inverse=True)
        i, j = numbers.reshape(-1, 2).T
        radius = self.radius[used]
        cells, parent = self.cells.select(used).bisect(radius > 0.7 * radius.max())
        self._take(cells.tighten(PAD_FRACTION * self.value))
        first = np.searchsorted(parent, np.arange(len(used) + 1))
        count = np.diff(first)
        parts = count[i] * count[j]
        pair = np.repeat(np.arange(len(i)), parts)
        within = np.arange(len(pair)) - np.repeat(np.cumsum(parts) - parts, parts)
        a, b = first[i[pair]] + within // count[j[pair]], first[j[pair]] + within % count[j[pair]]
        return np.stack([a, b], axis=1)[(i[pair] != j[pair]) | (a <= b)]

    def _select_pairs(self, pairs: IntArray) -> tuple[IntArray, Array]:
        """The pairs with places that may face each other nearer than the value, and lower bounds of their distances."""
        parts = [self._select_some(pairs[at : at + PAIRS_AT_ONCE]) for at in range(0, len(pairs), PAIRS_AT_ONCE)]
        kept, low = (np.concatenate(part) for part in zip(*parts, strict=True))
        return kept, low

    def _select_some(self, pairs: IntArray) -> tuple[IntArray, Array]:
        i, j = pairs.T
        way = self.center[j] - self.center[i]
        apart, reach = np.linalg.norm(way, axis=1), self.radius[i] + self.radius[j]
        one_solid = self._of_one_solid(pairs)
        keep = apart - reach < self.value
        if self.through < 0.0:
            keep &= one_solid
        pairs, way, apart, reach, one_solid = (a[keep] for a in (pairs, way, apart, reach, one_solid))
        i, j = pairs.T
        unit = way / np.maximum(apart, 1e-300)[:, None]
        taper = STRAIGHT + (MAX_TAPER - STRAIGHT) * self._end_at_edges(pairs)
        turn = _angle(self.axis[i], self.axis[j])
        facing = turn + self.angle[i] + self.angle[j] >= np.pi - taper
        spread = np.where(apart > reach, np.arcsin(np.clip(reach / np.maximum(apart, 1e-300), 0.0, 1.0)), np.pi)
        tilt = np.sort(
            [
                _angle(self.through * unit, self.axis[i]) - spread - self.angle[i],
                _angle(-self.through * unit, self.axis[j]) - spread - self.angle[j],
            ],
            axis=0,
        )
        facing &= (tilt[0] <= STRAIGHT) & (tilt[1] <= taper)
        keep = facing | ~one_solid
        pairs, unit = pairs[keep], unit[keep]
        low = self._bound_distance(pairs, unit)
        keep = low < self.value
        pairs, low = pairs[keep], low[keep]
        keep = ~self._in_wedge(pairs, low) & ~self._is_blocked(pairs, low)
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

    def _end_at_edges(self, pairs: IntArray, surely: bool = False) -> BoolArray:
        """Whether a sharp edge that is not one between both sides may end (surely: ends) one of them in its cell: (n,)."""
        key, result = self._keys(pairs)[:, None], np.zeros(len(pairs), bool)
        for cell in pairs.T:
            near = self.edge_keys_near[cell]
            result |= ((near >= 0) & (near != key)).any(axis=1)
            if not surely:
                result |= self.more_edges_near[cell]
        return result

    def _bound_distance(self, pairs: IntArray, unit: Array) -> Array:
        """Lower bounds (n,) of the distances of cells, by their hulls along four directions; inf if they face the other way."""
        i, j = pairs.T
        nets_i, nets_j = (self.cells.nets[k].reshape(-1, 16, 3) for k in (i, j))
        pad = self.cells.pad[i] + self.cells.pad[j]
        out_i, out_j = self.through * self.axis[i], -self.through * self.axis[j]
        mean = out_i + out_j
        mean /= np.maximum(np.linalg.norm(mean, axis=1), 1e-300)[:, None]
        low, away = np.zeros(len(pairs)), np.zeros(len(pairs), bool)
        for direction, cone in ((unit, None), (mean, None), (out_i, self.angle[i]), (out_j, self.angle[j])):
            height_i, height_j = (np.einsum("nkc,nc->nk", nets, direction) for nets in (nets_i, nets_j))
            low = np.maximum(low, height_j.min(axis=1) - height_i.max(axis=1) - pad)
            if cone is not None:
                ahead = height_j.max(axis=1) - height_i.min(axis=1) + pad
                away |= (ahead < 0.0) & (cone < 0.5 * np.pi - MAX_TAPER)
        return np.where(away & self._of_one_solid(pairs), np.inf, low)

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
        away, _ = self.samples.query(0.5 * (self.center[i] + self.center[j]))
        farthest = away + self.radius[pairs].max(axis=1)
        return np.asarray((farthest < 0.5 * low * (1.0 - MAX_OVERLAP)) & self._of_one_solid(pairs))

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
        both = np.concatenate([pairs[order], pairs[order, ::-1]])
        pairs = pairs[order[:REFINED_PAIRS]]
        self._take_least(pairs, approach_places(self.cells.nets[pairs]))
        way, normal = self.center[both[:, 1]] - self.center[both[:, 0]], self.axis[both[:, 0]]
        aside = np.linalg.norm(way - (way * normal).sum(axis=1, keepdims=True) * normal, axis=1)
        both = both[aside < self.radius[both[:, 1]]][: 4 * REFINED_PAIRS]
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
        taper = STRAIGHT + (MAX_TAPER - STRAIGHT) * self._end_at_edges(pairs, surely=True)
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
