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
from tpmscad.brep.cell_bounds import bound_nets, bound_normals, chords_meet_boxes, find_longer_directions, halve_nets
from tpmscad.brep.loops import points_in_polygons
from tpmscad.index_ranges import expand_ranges
from tpmscad.parallel import split_batches
from tpmscad.splines.basis import bernstein_basis

DEGREE = 3
"""Of the cells' patches in both directions."""

REFERENCE = np.array([0.4871, 0.5317])
"""Place of a cell's reference point in its rectangle, off the middle: symmetric parts have loops through middles of cells."""

PAIRS_AT_A_TIME = 1_000_000
"""Cells and chords of a face that are compared together, which limits the memory."""

SIDE_TOL = 1e-9
"""Of the parameters of a face: within this a chord runs along a side of a cell, which it leaves whole."""

CONE_SAMPLES = np.linspace(0.0, 1.0, 5)
"""Grid lines in both directions on which a cell's normals are sampled."""


_CONE_ROWS = tuple(np.ascontiguousarray(bernstein_basis(DEGREE, CONE_SAMPLES, order)) for order in (0, 1))

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
        Cells that a loop crosses, ascending, and the chords in them.
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
        center, radius = np.empty((len(self), 3)), np.empty(len(self))
        bound_nets(self.nets, center, radius)
        return center, radius + self.pad

    def normal_cones(self) -> tuple[Array, Array]:
        """Unit axes (n, 3) and half angles (n,) of cones that contain the outward normals."""
        axis, angle = np.empty((len(self), 3)), np.empty(len(self))
        bound_normals(self.nets, self.sign, *_CONE_ROWS, axis, angle)
        return axis, angle

    def reference_points(self) -> Array:
        """Parameters (n, 2) of the reference points."""
        return self.box[:, :, 0] + REFERENCE * (self.box[:, :, 1] - self.box[:, :, 0])

    def whole(self) -> BoolArray:
        """Whether each cell lies inside the loops with all its parts: (n,)."""
        return np.asarray(np.bincount(self.chord_cell, minlength=len(self)) == 0)

    def select(self, kept: IntArray) -> SurfaceCells:
        """Some of the cells (ascending numbers)."""
        if len(kept) == len(self):
            return self
        number = np.full(len(self), -1)
        number[kept] = np.arange(len(kept))
        own = number[self.chord_cell] >= 0
        rows = {name: getattr(self, name)[kept] for name in ("nets", "pad", "box", "face", "sign", "inside")}
        return replace(self, **rows, chord_cell=number[self.chord_cell[own]], chord=self.chord[own])

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
        axis, parent = np.empty(len(self), np.int64), np.repeat(np.arange(len(self)), 1 + chosen)
        find_longer_directions(self.nets, axis)
        half = np.where(chosen[parent], np.diff(parent, prepend=-1) == 0, -1)
        nets, box = np.empty((len(parent), DEGREE + 1, DEGREE + 1, 3)), self.box[parent]
        halve_nets(self.nets, parent, half, axis, nets)
        for h in (0, 1):
            own = np.flatnonzero(half == h)
            across = axis[parent[own]]
            box[own, across, 1 - h] = self.box[parent[own], across].mean(axis=1)
        child, chord = self._chords_of_children(parent)
        inside = self.inside[parent]
        cells = replace(
            self,
            nets=nets,
            pad=self.pad[parent],
            box=box,
            face=self.face[parent],
            sign=self.sign[parent],
            inside=inside,
            chord_cell=child,
            chord=chord,
        )
        # from the parent's reference point, whose side is known, to the child's
        crossed = _segments_cross(
            self.reference_points()[parent[child]], cells.reference_points()[child], self.chords[chord]
        )
        odd = np.bincount(child[crossed], minlength=len(cells)) % 2 == 1
        meets = chords_meet_boxes(self.chords[chord], self.slack[chord], box[child])
        cells, kept = replace(cells, inside=inside ^ odd, chord_cell=child[meets], chord=chord[meets]).drop_outside()
        return cells, parent[kept]

    def drop_outside(self) -> tuple[SurfaceCells, IntArray]:
        """The cells with a part inside the loops, and their numbers."""
        kept = np.flatnonzero(self.inside | ~self.whole())
        return self.select(kept), kept

    def _chords_of_children(self, parent: IntArray) -> tuple[IntArray, IntArray]:
        """The chords of its parent for each child: numbers of children, ascending, and of chords."""
        count = np.bincount(self.chord_cell, minlength=len(self))
        end = np.cumsum(count)[parent]
        child, chord = expand_ranges(end - count[parent], end)
        return child, self.chord[chord]

    def contain(self, cell: IntArray, uv: Array) -> BoolArray:
        """Whether parameters (k, 2) in some of the cells (k,) lie inside the loops: (k,)."""
        inside = self.inside[cell].copy()
        start = self.reference_points()[cell]
        ends = np.searchsorted(self.chord_cell, np.stack([cell, cell + 1]))
        for k in np.flatnonzero(ends[1] > ends[0]).tolist():
            crossed = _segments_cross(start[k : k + 1], uv[k : k + 1], self.chords[self.chord[ends[0, k] : ends[1, k]]])
            inside[k] ^= bool(crossed.sum() % 2)
        return inside

    def middles(self) -> Array:
        """The middles (n, 3) of the patches."""
        return evaluate_cells(self.nets, np.full((len(self), 2), 0.5))[0]

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
        near = SIDE_TOL * np.ptp(lines, axis=(0, 1))
        for batch in split_batches(cells, max(1, PAIRS_AT_A_TIME // max(len(lines), 1))):
            owner, number = (a.ravel() for a in np.meshgrid(batch, np.arange(len(lines)), indexing="ij"))
            meets = chords_meet_boxes(lines[number], slack[number], box[owner])
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
        np.concatenate([np.zeros(0, np.int64), *owners]),
        np.concatenate([np.zeros(0, np.int64), *numbers]),
        np.concatenate(chords),
        np.concatenate(slacks),
        fit,
    )
    return cells.drop_outside()[0]


def evaluate_cells(nets: Array, st: Array, order: int = 1) -> list[Array]:
    """Points and derivatives (k, 3) of patches (k, 4, 4, 3) at their own parameters (k, 2) in [0, 1].

    The derivatives are those by u and v, and for order 2 those by uu, uv and vv.
    """
    rows, columns = (
        np.stack([bernstein_basis(DEGREE, st[:, axis], n) for n in range(order + 1)], axis=1) for axis in (0, 1)
    )
    along_v = (rows @ nets.reshape(len(nets), DEGREE + 1, 3 * (DEGREE + 1))).reshape(
        len(nets), order + 1, DEGREE + 1, 3
    )
    # einsum took twice the time, most of it to find the order of the contractions, for a few hundred patches at a time
    found = columns[:, None] @ along_v
    return [found[:, m, n] for m, n in [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)][: 3 * order]]


def _segments_cross(start: Array, end: Array, chords: Array) -> BoolArray:
    """Whether segments from start to end (m or 1, 2) cross chords (m, 2, 2)."""

    def side(a: Array, b: Array, p: Array) -> BoolArray:
        return np.asarray((b[:, 0] - a[:, 0]) * (p[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (p[:, 0] - a[:, 0]) > 0.0)

    one, two = chords[:, 0], chords[:, 1]
    return (side(start, end, one) != side(start, end, two)) & (side(one, two, start) != side(one, two, end))
