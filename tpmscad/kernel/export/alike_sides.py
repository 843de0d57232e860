"""Opposite sides of a box made alike for a mesher: edges in them are divided at the images of the vertices of the other side.

The solid of a periodic field repeats, but the curves that bound its caps do not end at the same places on both sides. A vertex
whose image is no vertex divides the edge of the other side there, along all axes until nothing is left to divide: an edge of the
box has four images. Curves, faces and their order stay as they are. Vertices of far sides go to the images of those of near ones:
the curves of both sides agree within the tolerance of a fit only, and theirs grow to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve
from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy
from OCP.BRepTools import BRepTools_ReShape
from OCP.gp import gp_Pnt
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_FORWARD, TopAbs_REVERSED, TopAbs_VERTEX
from OCP.TopoDS import TopoDS_Edge, TopoDS_Shape, TopoDS_Vertex, TopoDS_Wire
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.brep.linked_items import label_linked
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import (
    count_subshape_uses,
    evaluate_pointwise,
    first_vertex,
    last_vertex,
    solids_of,
)

IN_SIDE = 1e-5
"""Model units: distance from a side of the box up to which an edge lies in it."""

SHORTEST = 1e-6
"""Model units: length of a part of an edge below which it is not divided there."""

SAMPLES = 33
"""Points along an edge, from the nearest of which the foot of a point is found."""

DIGITS = 6
"""Of the coordinates by which vertices are told apart."""

NEAR_SAMPLES = 6
"""Samples whose edges are tried for the foot of a point: those on both sides of a vertex, where edges end."""

NEWTON_STEPS = 12

MAX_ROUNDS = 12
"""Rounds over the axes: a vertex on an edge of the box has images on three others, two rounds away at most."""


@dataclass(slots=True, eq=False)
class _SideEdge:
    """An edge in a side of the box, its samples, and the parameters at which it is divided."""

    edge: TopoDS_Edge
    curve: BRepAdaptor_Curve
    parameters: Array
    points: Array
    splits: list[float] = field(default_factory=list)
    vertices: list[Array] = field(default_factory=list)

    def foot(self, point: Array) -> tuple[float, Array]:
        """Parameter and point of the foot of a point, the nearest sample being the start."""
        t = float(self.parameters[int(np.argmin(np.linalg.norm(self.points - point, axis=1)))])
        low, high = float(self.parameters[0]), float(self.parameters[-1])
        for _ in range(NEWTON_STEPS):
            (at,), (slope,) = evaluate_pointwise(self.curve, np.array([t]))
            t = float(np.clip(t + (point - at) @ slope / max(float(slope @ slope), 1e-300), low, high))
        return t, evaluate_pointwise(self.curve, np.array([t]))[0][0]


def make_sides_alike(
    solids: Sequence[TopoDS_Shape], low: Array, high: Array, same: float, reach: float
) -> tuple[list[TopoDS_Shape], float]:
    """The solids, which share faces as before, with the edges and vertices in opposite sides of the box [low, high] alike.

    With the greatest distance by which a vertex is moved.

    Same: distance along an edge up to which a vertex and the image of another are taken for one. Reach: distance of the curves of
    both sides, beyond which the sides are left as they are; model units.
    """
    whole = BRepBuilderAPI_Copy(make_compound(solids), False, False).Shape()  # whose vertices may be moved
    edges = _find_side_edges(whole, low, high)
    for _ in range(MAX_ROUNDS):
        count = sum(_divide_along(edges, axis, low, high, same, reach) for axis in range(3))
        if not count and not _divide_twins([e for e in edges if (np.abs(e.points - low).max(axis=0) <= IN_SIDE).any()]):
            break
    reshape = BRepTools_ReShape()
    for each in edges:
        if each.splits:
            reshape.Replace(each.edge.Oriented(TopAbs_FORWARD), _divide(each))
    whole = reshape.Apply(whole)
    moved = _move_vertices(whole, low, high, same, reach)
    return list(solids_of(whole)), moved


def _move_vertices(whole: TopoDS_Shape, low: Array, high: Array, same: float, reach: float) -> float:
    """Move vertices in far sides to the images of those in near ones, within their tolerances, which grow; the greatest move."""
    edges = _find_side_edges(whole, low, high)
    ends = [
        convert.as_vertex(v)
        for v, _ in count_subshape_uses(make_compound(e.edge for e in edges), TopAbs_VERTEX, TopAbs_EDGE)
    ]
    points = np.array([BRep_Tool.Pnt_s(vertex).Coord() for vertex in ends]).reshape(-1, 3)
    pairs = [np.zeros((0, 2), np.int64)]
    for axis in range(3):
        near, far = _edges_in_sides(edges, axis, low, high)
        if near and far:
            found = _find_feet(near, far, (high - low)[axis] * np.eye(3)[axis], same)
            rows = [
                cKDTree(points).query(which)[1] for which in (found.vertices, found.known[np.maximum(found.pair, 0)])
            ]
            pairs.append(np.column_stack(rows)[(found.pair >= 0) & (found.distance <= reach)])
    label = label_linked(len(points), np.concatenate(pairs))
    builder, moved = BRep_Builder(), 0.0
    at_far = np.abs(points - high) <= IN_SIDE
    in_sides = at_far | (np.abs(points - low) <= IN_SIDE)
    first = np.lexsort([at_far.sum(axis=1), -in_sides.sum(axis=1), label])
    root = first[np.searchsorted(label[first], label)]
    for number, (vertex, own) in enumerate(zip(ends, root.tolist(), strict=True)):
        place = points[own] + np.rint((points[number] - points[own]) / (high - low)) * (high - low)
        gap = float(np.linalg.norm(place - points[number]))
        if gap:
            builder.UpdateVertex(vertex, gp_Pnt(*place.tolist()), gap + BRep_Tool.Tolerance_s(vertex))
            moved = max(moved, gap)
    return moved


def _find_side_edges(whole: TopoDS_Shape, low: Array, high: Array) -> list[_SideEdge]:
    """The edges that lie in sides of the box."""
    found = []
    for shape, _ in count_subshape_uses(whole, TopAbs_EDGE, TopAbs_FACE):
        edge = convert.as_edge(shape)
        if BRep_Tool.Degenerated_s(edge):
            continue
        curve = BRepAdaptor_Curve(edge)
        parameters = np.linspace(curve.FirstParameter(), curve.LastParameter(), SAMPLES)
        points = evaluate_pointwise(curve, parameters)[0]
        if min(np.abs(points - low).max(axis=0).min(), np.abs(points - high).max(axis=0).min()) <= IN_SIDE:
            ends = [np.array(BRep_Tool.Pnt_s(end(edge)).Coord()) for end in (first_vertex, last_vertex)]
            found.append(_SideEdge(edge, curve, parameters, points, vertices=ends))
    return found


def _divide_twins(edges: Sequence[_SideEdge]) -> int:
    """Divide edges between the same two vertices as another, which gmsh would take for it; the number of divisions.

    Those of near sides: of far ones, the images are divided next.
    """
    known: set[frozenset[tuple[float, ...]]] = set()
    count = 0
    for each in edges:
        order = np.argsort(each.splits)
        stops = [float(each.parameters[0]), *np.array(each.splits)[order].tolist(), float(each.parameters[-1])]
        points = [each.vertices[0], *(each.vertices[2 + i] for i in order.tolist()), each.vertices[1]]
        for k in range(len(points) - 1):
            key = frozenset(tuple(point.round(DIGITS).tolist()) for point in points[k : k + 2])
            if key in known:
                t = 0.5 * (stops[k] + stops[k + 1])
                each.splits.append(t)
                each.vertices.append(evaluate_pointwise(each.curve, np.array([t]))[0][0])
                count += 1
            known.add(key)
    return count


def _edges_in_sides(edges: Sequence[_SideEdge], axis: int, low: Array, high: Array) -> list[list[_SideEdge]]:
    """The edges in the near and in the far side along an axis."""
    return [
        [each for each in edges if np.abs(each.points[:, axis] - level[axis]).max() <= IN_SIDE] for level in (low, high)
    ]


@dataclass(frozen=True, slots=True, eq=False)
class _Feet:
    """Vertices (n, 3) of one side, the feet of their images on edges of the other, and the vertices that these are paired with.

    distance (n,) from image to foot; edge (n,) and parameter (n,) of the foot; pair (n,): row of `known` (m, 3), or -1.
    """

    vertices: Array
    feet: Array
    distance: Array
    edge: list[_SideEdge]
    parameter: Array
    known: Array
    pair: IntArray


def _find_feet(own: Sequence[_SideEdge], other: Sequence[_SideEdge], move: Array, same: float) -> _Feet:
    """The feet of the images of one side's vertices on the edges of the other."""
    vertices = np.unique(np.concatenate([each.vertices for each in own]), axis=0)
    known = np.unique(np.concatenate([each.vertices for each in other]), axis=0)
    samples = cKDTree(np.concatenate([each.points for each in other]))
    edge, parameter, feet = [], [], []
    for image, rows in zip(vertices + move, samples.query(vertices + move, NEAR_SAMPLES)[1].tolist(), strict=True):
        tried = [(other[k], *other[k].foot(image)) for k in {row // SAMPLES for row in rows}]
        of, t, foot = min(tried, key=lambda each: float(np.linalg.norm(each[2] - image)))
        edge.append(of)
        parameter.append(t)
        feet.append(foot)
    distance = np.linalg.norm(np.array(feet) - vertices - move, axis=1)
    return _Feet(
        vertices, np.array(feet), distance, edge, np.array(parameter), known, _pair_off(np.array(feet), known, same)
    )


def _divide_along(edges: Sequence[_SideEdge], axis: int, low: Array, high: Array, same: float, reach: float) -> int:
    """Divide the edges in both sides along an axis where images of vertices are no vertices; the number of divisions."""
    near, far = _edges_in_sides(edges, axis, low, high)
    if not near or not far:
        return 0
    shift, count = (high - low)[axis] * np.eye(3)[axis], 0
    for own, other, move in ((near, far, shift), (far, near, -shift)):
        found = _find_feet(own, other, move, same)
        for i in np.flatnonzero((found.pair < 0) & (found.distance <= reach)).tolist():
            edge, foot = found.edge[i], found.feet[i]
            if np.linalg.norm(np.array(edge.vertices) - foot, axis=1).min() > SHORTEST:
                edge.splits.append(float(found.parameter[i]))
                edge.vertices.append(foot)
                count += 1
    return count


def _pair_off(points: Array, known: Array, same: float) -> IntArray:
    """The known point that each of points (n,) is paired with, each with one, nearest pairs first, up to a distance; else -1."""
    pairs = cKDTree(points).sparse_distance_matrix(cKDTree(known), same, output_type="coo_matrix")
    pair, is_taken = np.full(len(points), -1), np.zeros(len(known), bool)
    for k in np.argsort(pairs.data, kind="stable").tolist():
        i, j = pairs.row[k], pairs.col[k]
        if pair[i] < 0 and not is_taken[j]:
            pair[i], is_taken[j] = j, True
    return pair


def _divide(each: _SideEdge) -> TopoDS_Wire:
    """The parts of a divided edge, from the start of its curve to the end."""
    builder, wire = BRep_Builder(), TopoDS_Wire()
    builder.MakeWire(wire)
    tolerance = BRep_Tool.Tolerance_s(each.edge)
    inner = []
    order = np.argsort(each.splits)
    for i in order.tolist():
        vertex = TopoDS_Vertex()
        builder.MakeVertex(vertex, gp_Pnt(*each.vertices[2 + i].tolist()), tolerance)
        inner.append(vertex)
    forward = convert.as_edge(each.edge.Oriented(TopAbs_FORWARD))
    ends = [first_vertex(forward), *inner, last_vertex(forward)]
    stops = [float(each.parameters[0]), *np.sort(each.splits).tolist(), float(each.parameters[-1])]
    for (a, b), (start, stop) in zip(pairwise(ends), pairwise(stops), strict=True):
        part = convert.as_edge(forward.EmptyCopied())
        builder.Add(part, a.Oriented(TopAbs_FORWARD))
        builder.Add(part, b.Oriented(TopAbs_REVERSED))
        builder.Range(part, start, stop)
        builder.Add(wire, part)
    return wire
