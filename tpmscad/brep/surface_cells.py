"""Faces as small cells: bicubic nets that bound pieces of surfaces, with the part of each cell that the trimming loops leave.

A cell is a rectangle of a face's parameters. Its surface is within `pad` of a bicubic Bezier patch, whose poles bound it by the
convex hull property, so that distances between cells are bounded from below. Cells are bisected like Bezier patches (de
Casteljau). Cells that a trimming loop crosses keep the chords of the loop inside them; those outside the loops are dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.loops import points_in_polygons
from tpmscad.splines.basis import bernstein_basis

DEGREE = 3
"""Of the cells' patches in both directions."""

REFERENCE = np.array([0.4871, 0.5317])
"""Place of a cell's reference point in its rectangle, off the middle: symmetric parts have loops through middles of cells."""

SIDE_TOL = 1e-9
"""Of the parameters of a face: within this a chord runs along a side of a cell, which it leaves whole."""

CONE_MARGIN = 1.3
"""Widening of the cone of a cell's sampled normals, of which a bicubic patch has more extreme ones between the samples."""

CONE_SAMPLES = np.linspace(0.0, 1.0, 5)
"""Grid lines in both directions on which a cell's normals are sampled."""


def _halving_matrices() -> Array:
    """Matrices (2, 4, 4) from the poles of a cubic to those of its halves."""
    rows, halves = np.eye(DEGREE + 1), np.zeros((2, DEGREE + 1, DEGREE + 1))
    for i in range(DEGREE + 1):
        halves[0, i], halves[1, DEGREE - i] = rows[0], rows[-1]
        rows = 0.5 * (rows[:-1] + rows[1:])
    return halves


HALVES = _halving_matrices()
_CONE_ROWS = [bernstein_basis(DEGREE, CONE_SAMPLES, order) for order in (0, 1)]


CellFit = Callable[[IntArray, Array], tuple[Array, Array]]
"""Takes faces (n,) and rectangles of their parameters (n, 2, 2) to nets (n, 4, 4, 3) and pads (n,)."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceCells:
    """Cells of faces.

    Attributes
    ----------
    nets : (n, 4, 4, 3)
        Poles of the bicubic patches.
    pad : (n,)
        Greatest distance between surface and patch.
    box : (n, 2, 2)
        Parameters: low and high of u, of v.
    face : (n,)
        Number of the face.
    sign : (n,)
        1 where the normal of the patch points outwards, -1 where it points inwards.
    inside : (n,)
        Whether the reference point lies inside the loops.
    chord_cell, chord : (m,), (m,)
        Cells that a loop crosses and the chords in them.
    chords : (c, 2, 2)
        Starts and ends of all chords of the loops, in parameters.
    slack : (c, 2)
        Greatest distance of the loop from each chord, in u and in v.
    fit : CellFit
        Fits cells anew.
    """

    nets: Array
    pad: Array
    box: Array
    face: IntArray
    sign: Array
    inside: BoolArray
    chord_cell: IntArray
    chord: IntArray
    chords: Array
    slack: Array
    fit: CellFit

    def __len__(self) -> int:
        return len(self.nets)

    def balls(self) -> tuple[Array, Array]:
        """Centres (n, 3) and radii (n,) of balls that contain the cells."""
        poles = self.nets.reshape(-1, (DEGREE + 1) ** 2, 3)
        center = 0.5 * (poles.min(axis=1) + poles.max(axis=1))
        return center, np.linalg.norm(poles - center[:, None], axis=2).max(axis=1) + self.pad

    def normal_cones(self) -> tuple[Array, Array]:
        """Unit axes (n, 3) and half angles (n,) of cones that contain the outward normals."""
        (rows, slopes), nets = _CONE_ROWS, self.nets
        along_u = np.einsum("ka,lb,nabc->nklc", slopes, rows, nets, optimize=True)
        along_v = np.einsum("ka,lb,nabc->nklc", rows, slopes, nets, optimize=True)
        normals = np.cross(along_u, along_v).reshape(len(nets), -1, 3)
        length = np.linalg.norm(normals, axis=2, keepdims=True)
        regular = length > 1e-9 * np.maximum(length.max(axis=1, keepdims=True), 1e-300)
        normals = np.divide(normals, length, out=np.zeros_like(normals), where=regular) * self.sign[:, None, None]
        axis = normals.sum(axis=1)
        size = np.linalg.norm(axis, axis=1, keepdims=True)
        axis = np.divide(axis, size, out=np.zeros_like(axis), where=size > 1e-3)
        cosine = np.where(regular[..., 0], (normals * axis[:, None]).sum(axis=2), 1.0).min(axis=1)
        angle = np.where(size[:, 0] > 1e-3, CONE_MARGIN * np.arccos(np.clip(cosine, -1.0, 1.0)), np.pi)
        return axis, np.minimum(angle, np.pi)

    def reference_points(self) -> Array:
        """Parameters (n, 2) of the reference points."""
        return self.box[:, :, 0] + REFERENCE * (self.box[:, :, 1] - self.box[:, :, 0])

    def whole(self) -> BoolArray:
        """Whether each cell lies inside the loops with all its parts: (n,)."""
        return np.asarray(np.bincount(self.chord_cell, minlength=len(self)) == 0)

    def select(self, kept: IntArray) -> SurfaceCells:
        """Some of the cells (ascending numbers)."""
        number = np.full(len(self), -1)
        number[kept] = np.arange(len(kept))
        own = number[self.chord_cell] >= 0
        return SurfaceCells(
            self.nets[kept],
            self.pad[kept],
            self.box[kept],
            self.face[kept],
            self.sign[kept],
            self.inside[kept],
            number[self.chord_cell[own]],
            self.chord[own],
            self.chords,
            self.slack,
            self.fit,
        )

    def tighten(self, tol: float) -> SurfaceCells:
        """The cells, those that are farther than `tol` from the surface fitted anew."""
        loose = np.flatnonzero(self.pad > tol)
        if not len(loose):
            return self
        nets, pad = self.nets.copy(), self.pad.copy()
        nets[loose], pad[loose] = self.fit(self.face[loose], self.box[loose])
        return replace(self, nets=nets, pad=pad)

    def bisect(self, chosen: BoolArray) -> tuple[SurfaceCells, IntArray]:
        """The cells with the chosen ones bisected across their longer direction, and the parent of each (ascending)."""
        steps = [np.linalg.norm(np.diff(self.nets, axis=axis), axis=-1).sum(axis=axis).max(axis=1) for axis in (1, 2)]
        axis = (steps[1] > steps[0]).astype(np.int64)
        parent = np.repeat(np.arange(len(self)), 1 + chosen)
        half = np.where(np.diff(parent, prepend=-1) > 0, 0, 1)
        split = chosen[parent]
        nets, box = self.nets[parent], self.box[parent].copy()
        for a in (0, 1):
            for h in (0, 1):
                own = np.flatnonzero(split & (axis[parent] == a) & (half == h))
                equation = "ij,njbc->nibc" if a == 0 else "ij,najc->naic"
                nets[own] = np.einsum(equation, HALVES[h], nets[own])
                box[own, a, 1 - h] = self.box[parent[own], a].mean(axis=1)
        cells = SurfaceCells(
            nets,
            self.pad[parent],
            box,
            self.face[parent],
            self.sign[parent],
            self.inside[parent],
            *self._chords_of_children(parent),
            self.chords,
            self.slack,
            self.fit,
        )
        return cells._drop_outside(self.reference_points()[parent], parent)

    def _chords_of_children(self, parent: IntArray) -> tuple[IntArray, IntArray]:
        """The chords of its parent for each child: numbers of children and of chords."""
        order = np.argsort(self.chord_cell, kind="stable")
        count = np.bincount(self.chord_cell, minlength=len(self))
        first = np.cumsum(count) - count
        repeats = count[parent]
        child = np.repeat(np.arange(len(parent)), repeats)
        within = np.arange(len(child)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
        return child, self.chord[order[first[parent[child]] + within]]

    def _drop_outside(self, known: Array, parent: IntArray) -> tuple[SurfaceCells, IntArray]:
        """The cells with their own chords only, without those outside the loops.

        `inside` is that of the points `known` (n, 2), from which the loops are counted to the reference points.
        """
        child, chord = self.chord_cell, self.chord
        crossed = _segments_cross(known[child], self.reference_points()[child], self.chords[chord])
        odd = np.bincount(child[crossed], minlength=len(self)) % 2 == 1
        inside = self.inside ^ odd
        touching = _chords_meet_boxes(self.chords[chord], self.slack[chord], self.box[child])
        cells = SurfaceCells(
            self.nets,
            self.pad,
            self.box,
            self.face,
            self.sign,
            inside,
            child[touching],
            chord[touching],
            self.chords,
            self.slack,
            self.fit,
        )
        kept = np.flatnonzero(inside | ~cells.whole())
        return cells.select(kept), parent[kept]

    def contain(self, cell: IntArray, uv: Array) -> BoolArray:
        """Whether parameters (k, 2) in some of the cells (k,) lie inside the loops: (k,)."""
        inside = self.inside[cell].copy()
        start = self.reference_points()[cell]
        order = np.argsort(self.chord_cell, kind="stable")
        ends = np.searchsorted(self.chord_cell[order], np.stack([cell, cell + 1]))
        for k in np.flatnonzero(ends[1] > ends[0]).tolist():
            chords = self.chords[self.chord[order[ends[0, k] : ends[1, k]]]]
            m = len(chords)
            crossed = _segments_cross(np.tile(start[k], (m, 1)), np.tile(uv[k], (m, 1)), chords)
            inside[k] ^= bool(crossed.sum() % 2)
        return inside

    def parameters(self, cell: IntArray, st: Array) -> Array:
        """Parameters (k, 2) of the faces at the patches' own parameters (k, 2) in [0, 1]."""
        low, high = np.moveaxis(self.box[cell], 2, 0)
        return np.asarray(low + st * (high - low))


def trim_cells(
    nets: Array,
    pad: Array,
    box: Array,
    face: IntArray,
    sign: Array,
    chords: Sequence[Array],
    slacks: Sequence[Array],
    fit: CellFit,
) -> SurfaceCells:
    """Cells of faces (n,), ascending, with the parts inside the loops; sign (F,), chords and slacks are those of each face."""
    first = np.cumsum([0, *map(len, chords)])
    reference = box[:, :, 0] + REFERENCE * (box[:, :, 1] - box[:, :, 0])
    inside = np.zeros(len(nets), bool)
    owners, numbers = [], []
    for i, (lines, slack) in enumerate(zip(chords, slacks, strict=True)):
        cells = np.arange(*np.searchsorted(face, [i, i + 1]))
        inside[cells] = points_in_polygons(lines[:, 0], lines[:, 1], reference[cells])
        owner, number = (a.ravel() for a in np.meshgrid(cells, np.arange(len(lines)), indexing="ij"))
        meets = _chords_meet_boxes(lines[number], slack[number], box[owner])
        near = SIDE_TOL * np.ptp(lines, axis=(0, 1))
        start, end = lines[number, 0], lines[number, 1]
        on_side = np.abs(start[:, :, None] - box[owner]).min(axis=2) <= near
        meets &= ~(on_side & (np.abs(end - start) <= near)).any(axis=1)
        owners.append(owner[meets])
        numbers.append(first[i] + number[meets])
    cells = SurfaceCells(
        nets,
        pad,
        box,
        face,
        sign[face],
        inside,
        np.concatenate(owners),
        np.concatenate(numbers),
        np.concatenate(chords),
        np.concatenate(slacks),
        fit,
    )
    return cells.select(np.flatnonzero(inside | ~cells.whole()))


def evaluate_cells(nets: Array, st: Array, order: int = 1) -> list[Array]:
    """Points and derivatives (k, 3) of patches (k, 4, 4, 3) at their own parameters (k, 2) in [0, 1].

    The derivatives are those by u and v, and for order 2 those by uu, uv and vv.
    """
    rows, columns = ([bernstein_basis(DEGREE, st[:, axis], n) for n in range(order + 1)] for axis in (0, 1))
    orders = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)][: 3 * order]
    return [np.einsum("na,nb,nabc->nc", rows[m], columns[n], nets, optimize=True) for m, n in orders]


def _segments_cross(start: Array, end: Array, chords: Array) -> BoolArray:
    """Whether segments from start to end (m, 2) cross chords (m, 2, 2)."""

    def side(a: Array, b: Array, p: Array) -> BoolArray:
        return np.asarray((b[:, 0] - a[:, 0]) * (p[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (p[:, 0] - a[:, 0]) > 0.0)

    one, two = chords[:, 0], chords[:, 1]
    return (side(start, end, one) != side(start, end, two)) & (side(one, two, start) != side(one, two, end))


def _chords_meet_boxes(chords: Array, slack: Array, box: Array) -> BoolArray:
    """Whether chords (m, 2, 2), widened by their slack (m, 2), meet rectangles (m, 2, 2)."""
    low, high = box[:, :, 0] - slack, box[:, :, 1] + slack
    start, way = chords[:, 0], chords[:, 1] - chords[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.sort(np.stack([(low - start) / way, (high - start) / way]), axis=0)
    level = way == 0.0
    between = (start >= low) & (start <= high)
    enter = np.where(level, np.where(between, -np.inf, np.inf), t[0])
    leave = np.where(level, np.where(between, np.inf, -np.inf), t[1])
    return np.asarray(np.maximum(enter.max(axis=1), 0.0) <= np.minimum(leave.min(axis=1), 1.0))
