"""Opposite sides of a box made alike for a mesher: edges in them are divided at the images of the vertices of the other side.

The solid of a periodic field repeats, but the curves that bound its caps do not end at the same places on both sides. A vertex
whose image is no vertex divides the edge of the other side there, along all axes until nothing is left to divide: an edge of the
box has four images. Nothing is moved: curves, faces and their order stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve
from OCP.BRepTools import BRepTools_ReShape
from OCP.gp import gp_Pnt
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_FORWARD, TopAbs_REVERSED
from OCP.TopoDS import TopoDS_Edge, TopoDS_Shape, TopoDS_Vertex, TopoDS_Wire
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray
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

NEWTON_STEPS = 12

MAX_ROUNDS = 8
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


def make_sides_alike(solids: Sequence[TopoDS_Shape], low: Array, high: Array, same: float) -> list[TopoDS_Shape]:
    """The solids, which share faces as before, with the edges in opposite sides of the box [low, high] divided alike.

    Same: distance up to which a vertex and the image of another are taken for one, model units; images farther than it from
    every edge of the other side are left out, as the sides differ there.
    """
    whole = make_compound(solids)
    edges = _find_side_edges(whole, low, high)
    for _ in range(MAX_ROUNDS):
        if not sum(_divide_along(edges, axis, low, high, same) for axis in range(3)):
            break
    reshape = BRepTools_ReShape()
    divided = [each for each in edges if each.splits]
    if not divided:
        return list(solids)
    for each in divided:
        reshape.Replace(each.edge.Oriented(TopAbs_FORWARD), _divide(each))
    return list(solids_of(reshape.Apply(whole)))


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


def _divide_along(edges: Sequence[_SideEdge], axis: int, low: Array, high: Array, same: float) -> int:
    """Divide the edges in both sides along an axis where images of vertices are no vertices; the number of divisions."""
    sides = [
        [each for each in edges if np.abs(each.points[:, axis] - level[axis]).max() <= IN_SIDE] for level in (low, high)
    ]
    if not all(sides):
        return 0
    shift, count = (high - low)[axis] * np.eye(3)[axis], 0
    for own, other, move in ((sides[0], sides[1], shift), (sides[1], sides[0], -shift)):
        images = np.unique(np.concatenate([each.vertices for each in own]), axis=0) + move
        known = np.unique(np.concatenate([each.vertices for each in other]), axis=0)
        samples = cKDTree(np.concatenate([each.points for each in other]))
        for image in images[~_pair_off(images, known, same)]:
            nearest = other[int(samples.query(image)[1]) // SAMPLES]
            t, foot = nearest.foot(image)
            ends = np.linalg.norm(np.array(nearest.vertices) - foot, axis=1)
            if np.linalg.norm(foot - image) <= same and ends.min() > SHORTEST:
                nearest.splits.append(t)
                nearest.vertices.append(foot)
                count += 1
    return count


def _pair_off(images: Array, known: Array, same: float) -> BoolArray:
    """Which images (n,) are paired with known points, each with one, nearest pairs first, up to a distance."""
    pairs = cKDTree(images).sparse_distance_matrix(cKDTree(known), same, output_type="coo_matrix")
    is_paired, is_taken = np.zeros(len(images), bool), np.zeros(len(known), bool)
    for k in np.argsort(pairs.data, kind="stable").tolist():
        i, j = pairs.row[k], pairs.col[k]
        if not is_paired[i] and not is_taken[j]:
            is_paired[i] = is_taken[j] = True
    return is_paired


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
