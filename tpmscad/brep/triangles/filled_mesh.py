"""A triangulated body filled with the cells of a lattice: whole cells are placed, and only what the body cuts is computed.

The cells that the boundary of the body, of its skin or of another mesh may touch are one closed block of polyhedra; its boolean
with all of these is that of the library Manifold, which leaves the coordinates of other points as they are. The sides towards
whole cells are left out of the result, and the surfaces of the whole cells join it in the same points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.sections.polygon_regions import Operation
from tpmscad.brep.triangles.cell_polyhedron import SURFACE, PeriodicCell
from tpmscad.brep.triangles.closed_mesh import (
    SolidMesh,
    combine_meshes,
    is_closed,
    join_meshes,
    label_points,
    narrow_indices,
)
from tpmscad.brep.winding_numbers import winding_numbers
from tpmscad.errors import TrimmingError

BETWEEN_CELLS, LATTICE, FIRST_OF_BODY = -1, 0, 1
"""Faces of the triangles of a filled body: the lattice, and from 1 on those of the body and its skin. Those between cut and whole
cells are left out."""

TOUCH_MARGIN_CELLS = 1e-6
"""In cells: a cell whose box is nearer to triangles counts as touched by them."""


@dataclass(frozen=True, slots=True, eq=False)
class CellChoice:
    """The cells of a lattice in a body: positions of whole and of cut ones, (k, 3), in the range `size` from `origin`."""

    origin: IntArray
    size: IntArray
    whole: IntArray
    cut: IntArray


def choose_cells(
    low: Array, cell: Array, body: SolidMesh, others: Sequence[SolidMesh] = (), margin: float = TOUCH_MARGIN_CELLS
) -> CellChoice:
    """The cells [low + i cell, low + (i + 1) cell] inside a body and no other mesh, and those that a boundary may touch.

    margin: in cells; a cell whose box is nearer to the boundary counts as touched.
    """
    reach = (body.points - low) / cell
    origin = np.floor(reach.min(axis=0) - margin).astype(np.int64)
    size = np.floor(reach.max(axis=0) + margin).astype(np.int64) - origin + 1
    touched = np.zeros(size, bool)
    for mesh in (body, *others):
        _mark_touched(touched, (mesh.points[mesh.triangles] - low) / cell - origin, margin)
    label, count = ndimage.label(~touched)
    places = np.argwhere(~touched)
    _, first = np.unique(label[tuple(places.T)], return_index=True)
    centres = low + (places[first] + origin + 0.5) * cell
    filled = winding_numbers(body.points, body.triangles, centres) > 0
    for other in others:
        filled &= winding_numbers(other.points, other.triangles, centres) == 0
    inside: BoolArray = np.append(False, filled)[label] if count else np.zeros(size, bool)
    return CellChoice(origin, size, np.argwhere(inside) + origin, np.argwhere(touched) + origin)


def _mark_touched(touched: BoolArray, corners: Array, margin: float) -> None:
    """Mark the cells that triangles (m, 3, 3), in cells, may meet: those of their boxes, after large ones are divided."""
    while len(corners):
        low, high = corners.min(axis=1), corners.max(axis=1)
        first, last = (np.floor(v).astype(np.int64) for v in (low - margin, high + margin))
        small = ((high - low) <= 1.0).all(axis=1)
        for shift in np.ndindex(3, 3, 3):
            at = np.minimum(first[small] + shift, last[small])
            at = np.clip(at, 0, np.array(touched.shape) - 1)
            touched[tuple(at.T)] = True
        a, b, c = np.moveaxis(corners[~small], 1, 0)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        corners = np.concatenate(
            [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        ).reshape(-1, 3, 3)


def fill_mesh(
    cell: PeriodicCell, choice: CellChoice, body: SolidMesh, others: Sequence[tuple[Operation, SolidMesh]] = ()
) -> SolidMesh:
    """The body filled with the lattice, then united with others, such as its skin, or without them, one after the other.

    Face 0 is the lattice; the faces of the others count from 1. TrimmingError if the result is not closed.
    """
    block = cell.place(choice.cut, choice.origin, choice.size)
    cut = replace(block.mesh, face=np.where(block.mesh.face == SURFACE, LATTICE, BETWEEN_CELLS))
    filled = combine_meshes(cut, replace(body, face=body.face + FIRST_OF_BODY), "intersection")
    for operation, other in others:
        filled = combine_meshes(filled, replace(other, face=other.face + FIRST_OF_BODY), operation)
    mesh = filled.select(filled.face != BETWEEN_CELLS)
    if len(choice.whole):
        whole = cell.surface.place(choice.whole, choice.origin, choice.size)
        common = whole.mesh.points[np.isin(whole.key, block.key)]
        del block, cut, filled
        mesh = _join_at(mesh, replace(whole.mesh, face=np.full(len(whole.mesh.triangles), LATTICE, np.int32)), common)
    if not is_closed(mesh.triangles):
        raise TrimmingError("the triangles of cut and whole cells do not close")
    return mesh


def _join_at(first: SolidMesh, second: SolidMesh, common: Array) -> SolidMesh:
    """Two meshes as one, with their points identified that both have among `common` (k, 3), bit for bit."""
    joined = join_meshes([first, second])
    label = label_points(joined.points)
    near = np.flatnonzero(np.isin(label, label_points(common)))
    _, start, index = np.unique(label[near], return_index=True, return_inverse=True)
    first_of = np.arange(len(label))
    first_of[near] = near[start][index]
    kept = first_of == np.arange(len(label))
    number = narrow_indices(np.cumsum(kept) - 1)
    return SolidMesh(joined.points[kept], number[first_of][joined.triangles], joined.face)
