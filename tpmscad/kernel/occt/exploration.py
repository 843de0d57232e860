"""Exploration of OCCT shapes: sub-shapes, their orientation, and shapes as dictionary keys.

OCCT compares shapes in three ways. `IsSame` ignores the orientation, and with it `ShapeKey` identifies an edge in both faces
that share it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.gp import gp_Pnt, gp_Vec
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_FORWARD, TopAbs_REVERSED, TopAbs_SOLID, TopAbs_VERTEX
from OCP.TopExp import TopExp, TopExp_Explorer
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Shape, TopoDS_Solid, TopoDS_Vertex

from tpmscad._typing import Array
from tpmscad.api.argument_kinds import show_value
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.occt import convert


class ShapeKey:
    """A shape as a dictionary key; shapes that differ in orientation only are equal."""

    __slots__ = ("shape",)

    def __init__(self, shape: TopoDS_Shape) -> None:
        self.shape = shape

    def __hash__(self) -> int:
        return hash(self.shape)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ShapeKey) and bool(self.shape.IsSame(other.shape))


def unwrap(shape: Any) -> Any:
    """The TopoDS shape behind a build123d or CadQuery object, None behind an empty one; anything else is returned as it is."""
    try:
        return getattr(shape, "wrapped", shape)
    except AssertionError:  # build123d raises this for an empty shape
        return None


def require_shape(shape: Any) -> TopoDS_Shape:
    """The TopoDS shape behind a build123d or CadQuery object, or a TopoDS shape itself; InvalidRequest for anything else."""
    found = unwrap(shape)
    if not isinstance(found, TopoDS_Shape) or found.IsNull():
        raise InvalidRequest(
            f"{show_value(shape)} is no shape: give a model, a build123d or CadQuery object, or a TopoDS shape that is not empty"
        )
    return found


def list_subshapes(shape: TopoDS_Shape, kind: Any) -> list[Any]:
    """Sub-shapes of a kind (TopAbs_FACE, ...), oriented as the shape uses them, one entry per use."""
    explorer, found = TopExp_Explorer(shape, kind), []
    while explorer.More():
        found.append(explorer.Current())
        explorer.Next()
    return found


def count_subshape_uses(shape: TopoDS_Shape, kind: Any, owner: Any) -> list[tuple[Any, int]]:
    """Distinct sub-shapes of a kind, each with the number of its uses in sub-shapes of the kind `owner`."""
    ancestors = convert.shape_map()
    TopExp.MapShapesAndAncestors_s(shape, kind, owner, ancestors)
    return [(ancestors.FindKey(i), ancestors.FindFromIndex(i).Size()) for i in range(1, ancestors.Extent() + 1)]


def bounds_face(edge: TopoDS_Shape) -> bool:
    """Whether an edge of a face, as the face uses it, bounds it: booleans leave edges within faces where solids only touch."""
    return edge.Orientation() in (TopAbs_FORWARD, TopAbs_REVERSED)


def list_bounding_edges(shape: TopoDS_Shape) -> list[TopoDS_Edge]:
    """Edges that bound a face or a wire, one entry per use."""
    return [convert.as_edge(edge) for edge in list_subshapes(shape, TopAbs_EDGE) if bounds_face(edge)]


def solids_of(shape: Any) -> list[TopoDS_Solid]:
    """Solids of a shape, placed copies included."""
    return [convert.as_solid(solid) for solid in list_subshapes(require_shape(shape), TopAbs_SOLID)]


def faces_of(shape: Any) -> list[TopoDS_Face]:
    """Faces of a shape in the explorer's order, oriented as its solids use them."""
    return [convert.as_face(face) for face in list_subshapes(require_shape(shape), TopAbs_FACE)]


def vertices_of(shape: Any) -> Array:
    """Points (n, 3) of the vertices of a shape."""
    vertices = count_subshape_uses(unwrap(shape), TopAbs_VERTEX, TopAbs_EDGE)
    return np.array([BRep_Tool.Pnt_s(convert.as_vertex(vertex)).Coord() for vertex, _ in vertices]).reshape(-1, 3)


def edges_of(face: TopoDS_Face) -> list[TopoDS_Edge]:
    """Edges of a face, oriented as its loops use them."""
    return [convert.as_edge(edge) for edge in list_subshapes(face, TopAbs_EDGE)]


def evaluate_pointwise(geometry: Any, parameters: Array) -> tuple[Array, ...]:
    """Points and first derivatives, (n, 3) each, of an OCCT curve at parameters (n,) or of a surface at (n, 2)."""
    at = parameters[:, None] if parameters.ndim == 1 else parameters
    point, slopes, rows = gp_Pnt(), [gp_Vec() for _ in range(at.shape[1])], []
    for row in at.tolist():
        geometry.D1(*row, point, *slopes)
        rows.append([point.Coord(), *(slope.Coord() for slope in slopes)])
    return tuple(np.array(rows).reshape(-1, 1 + len(slopes), 3).swapaxes(0, 1).copy())


def first_vertex(edge: TopoDS_Edge) -> TopoDS_Vertex:
    """Vertex at the start of the edge's curve, whatever the orientation of the edge."""
    return TopExp.FirstVertex_s(edge)


def last_vertex(edge: TopoDS_Edge) -> TopoDS_Vertex:
    """Vertex at the end of the edge's curve, whatever the orientation of the edge."""
    return TopExp.LastVertex_s(edge)


def orientation_sign(shape: TopoDS_Shape) -> int:
    """-1 for a reversed shape, else 1."""
    return -1 if shape.Orientation() == TopAbs_REVERSED else 1
