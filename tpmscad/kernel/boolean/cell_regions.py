"""What is left of a body, layer by layer of cells, when its whole cells are taken out; and which layers are translates.

Everything is in the coordinates of the lattice, whose cells are axis-parallel boxes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepAlgoAPI import BRepAlgoAPI_Fuse
from OCP.BRepGProp import BRepGProp
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox
from OCP.GProp import GProp_GProps
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape, TopoDS_Solid
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray
from tpmscad.errors import KernelError
from tpmscad.kernel.boolean.boolean_operations import (
    intersect_solids,
    merge_faces,
    subtract_solid,
    translate_occt_errors,
)
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import faces_of, solids_of, vertices_of

TRANSLATE_REL_TOL = 1e-9
"""Of the size: by how much vertices and faces of translates may differ."""


def make_box(low: Array, high: Array) -> TopoDS_Solid:
    """The solid of an axis-parallel box."""
    return convert.as_solid(BRepPrimAPI_MakeBox(convert.point(low), convert.point(high)).Solid())


def clear_diagonals(whole: BoolArray) -> BoolArray:
    """The whole cells (m, n) of a layer without those that would leave two others touching along an edge only."""
    kept = whole.copy()
    while True:
        a, b, c, d = kept[:-1, :-1], kept[1:, :-1], kept[:-1, 1:], kept[1:, 1:]
        falling, rising = a & d & ~b & ~c, b & c & ~a & ~d
        if not (falling | rising).any():
            return kept
        kept[:-1, :-1][falling] = False
        kept[1:, :-1][rising] = False


def cut_region(
    shapes: Sequence[TopoDS_Shape], axes: tuple[int, int, int], whole: BoolArray, low: Array, cell: Array, height: float
) -> tuple[TopoDS_Solid, ...]:
    """The solids of a layer without its whole cells, largest first.

    axes: the two axes of `whole` (m, n) and that of the layer. low (3,): lower corner of its first cell. height: of the layer.
    """
    u, v, w = axes
    size = np.empty(3)
    size[[u, v, w]] = cell[u] * whole.shape[0], cell[v] * whole.shape[1], height
    layer = make_box(low, low + size)
    solids = [solid for shape in shapes for solid in intersect_solids(layer, shape)]
    if not whole.any():
        return tuple(solids)
    prism = _unite_boxes([_box_of_run(run, axes, low, cell, height) for run in _runs(whole)])
    return tuple(part for solid in solids for part in subtract_solid(solid, prism))


def _runs(whole: BoolArray) -> Iterator[tuple[int, int, int]]:
    """Row, first cell and end of each run of whole cells."""
    for row, cells in enumerate(whole):
        steps = np.flatnonzero(np.diff(np.concatenate([[False], cells, [False]]).astype(np.int8)))
        yield from ((row, int(first), int(end)) for first, end in steps.reshape(-1, 2))


def _box_of_run(
    run: tuple[int, int, int], axes: tuple[int, int, int], low: Array, cell: Array, height: float
) -> TopoDS_Solid:
    """The box of a run of cells."""
    (row, first, end), (u, v, w) = run, axes
    corners = np.tile(low, (2, 1))
    corners[:, u] += cell[u] * np.array([row, row + 1])
    corners[:, v] += cell[v] * np.array([first, end])
    corners[1, w] += height
    return make_box(*corners)


def _unite_boxes(boxes: Sequence[TopoDS_Solid]) -> TopoDS_Shape:
    """The union of boxes that meet in faces, with one face in each plane."""
    if len(boxes) == 1:
        return boxes[0]
    operation = BRepAlgoAPI_Fuse()
    operation.SetArguments(convert.shape_list(boxes[:1]))
    operation.SetTools(convert.shape_list(boxes[1:]))
    with translate_occt_errors("union of whole cells", boxes[0]):
        operation.Build()
        if not operation.IsDone():
            raise KernelError("union of whole cells", "the kernel's Boolean operation failed", boxes[0])
    return make_compound(solids_of(merge_faces(operation.Shape())))


def describe_region(solids: Sequence[TopoDS_Solid]) -> Array:
    """Rows (n, 5) in which solids that are translates differ by the translation only: a kind, a size, and a place.

    Vertices have kind -1 and no size; a face has the type of its surface, its area and the centre of it.
    """
    rows = [np.zeros((0, 5))]
    for solid in solids:
        points = vertices_of(solid)
        rows.append(np.column_stack([np.full(len(points), -1.0), np.zeros(len(points)), points]))
        rows.append(np.array([_describe_face(face) for face in faces_of(solid)]))
    return np.concatenate(rows)


def _describe_face(face: TopoDS_Face) -> tuple[float, ...]:
    """Type of its surface, area and centre of a face, by OCCT's default quadrature, which is the same for translates."""
    properties = GProp_GProps()
    BRepGProp.SurfaceProperties_s(face, properties)
    kind = BRepAdaptor_Surface(face, False).GetType()
    return (float(int(kind.value)), properties.Mass(), *properties.CentreOfMass().Coord())


def are_translates(first: Array, second: Array, shift: Array) -> bool:
    """Whether the second of two descriptions (n, 5) is that of the first moved by `shift` (3,)."""
    if first.shape != second.shape or not len(first):
        return False
    moved = first + np.concatenate([[0.0, 0.0], shift])
    tolerance = TRANSLATE_REL_TOL * float(np.abs(second[:, 1:]).max())
    forth, _ = cKDTree(moved).query(second)
    back, _ = cKDTree(second).query(moved)
    return bool(max(forth.max(), back.max()) <= tolerance)
