"""Short edges and narrow faces of solids merged for a mesher: ends become one vertex, and both sides of a face one edge.

A mesh has a node in every vertex, so that an edge a thousand times shorter than the elements makes elements as flat as that, or
none at all. A face that has two edges left, nowhere farther apart than such an edge is long, goes with one of them. An edge
is kept whose loss would leave a face that touches itself. Surfaces and curves stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Surface
from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy
from OCP.BRepTools import BRepTools_ReShape
from OCP.gp import gp_Pnt, gp_Vec2d
from OCP.ShapeFix import ShapeFix_Edge
from OCP.TopAbs import (
    TopAbs_EDGE,
    TopAbs_FACE,
    TopAbs_FORWARD,
    TopAbs_REVERSED,
    TopAbs_SHELL,
    TopAbs_VERTEX,
    TopAbs_WIRE,
)
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Shape, TopoDS_Vertex
from scipy.spatial.distance import pdist

from tpmscad._typing import Array
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import (
    ShapeKey,
    count_subshape_uses,
    evaluate_pointwise,
    faces_of,
    first_vertex,
    last_vertex,
    list_subshapes,
    solids_of,
)

IN_SIDE = 1e-5
"""Model units: distance from a side of the box up to which a vertex lies in it."""

SAMPLES = 17
"""Points along an edge, by which its length and its distance from another are measured."""

SPREAD = 2.0
"""In lengths of the longest edge that is merged: the distance of vertices that become one."""


@dataclass(frozen=True, slots=True)
class MergedSolids:
    """Solids without short edges, for each the numbers of the faces that it has kept, and what was done.

    merged: edges that vanished. moved: greatest distance of a vertex from the one that stands for it, model units.
    """

    solids: list[TopoDS_Shape]
    faces: list[list[int]]
    merged: int = 0
    moved: float = 0.0


def merge_short_edges(solids: Sequence[TopoDS_Shape], low: Array, high: Array, longest: float) -> MergedSolids:
    """The solids, which share faces as before, without the edges up to a length and the faces that are as narrow.

    A vertex that stands for several lies in all sides of the box [low, high] that these lie in.
    """
    graph = _EdgeGraph(make_compound(solids), low, high, longest)
    if not graph.lengths.min(initial=np.inf) <= longest:
        return MergedSolids(list(solids), [[*range(len(faces_of(solid)))] for solid in solids])
    whole = BRepBuilderAPI_Copy(make_compound(solids), False, False).Shape()  # whose edges may be changed
    graph = _EdgeGraph(whole, low, high, longest)
    count = sum(graph.merge(int(e)) for e in np.argsort(graph.lengths) if graph.lengths[e] <= longest)
    gone = {ShapeKey(graph.faces[f]) for f in graph.gone_faces}
    kept = [[i for i, face in enumerate(faces_of(solid)) if ShapeKey(face) not in gone] for solid in solids_of(whole)]
    found, moved = graph.unite_vertices(graph.drop_edges(whole))
    return MergedSolids(list(solids_of(found)), kept, count, moved)


def _choose_place(points: Array, low: Array, high: Array) -> Array:
    """The point in the most sides of the box, moved into all sides that others lie in."""
    in_low, in_high = (np.abs(points - level) <= IN_SIDE for level in (low, high))
    place = points[int(np.argmax((in_low | in_high).sum(axis=1)))]
    return np.where(in_low.any(axis=0), low, np.where(in_high.any(axis=0), high, place))


class _EdgeGraph:
    """The edges of a shape between classes of vertices, and the wires of its faces as lists of edges; both change in place."""

    def __init__(self, whole: TopoDS_Shape, low: Array, high: Array, longest: float) -> None:
        self.low, self.high, self.longest = low, high, longest
        self.vertices = [convert.as_vertex(v) for v, _ in count_subshape_uses(whole, TopAbs_VERTEX, TopAbs_EDGE)]
        self.points = np.array([BRep_Tool.Pnt_s(v).Coord() for v in self.vertices]).reshape(-1, 3)
        number = {ShapeKey(v): i for i, v in enumerate(self.vertices)}
        self.edges = [convert.as_edge(e) for e, _ in count_subshape_uses(whole, TopAbs_EDGE, TopAbs_FACE)]
        self.ends = [(number[ShapeKey(first_vertex(edge))], number[ShapeKey(last_vertex(edge))]) for edge in self.edges]
        self.samples = [self._sample(edge, self.points[a]) for edge, (a, _) in zip(self.edges, self.ends, strict=True)]
        self.lengths = np.array(
            [
                np.linalg.norm(np.diff(points, axis=0), axis=1).sum() if a != b else np.inf
                for points, (a, b) in zip(self.samples, self.ends, strict=True)
            ]
        )
        self.faces = [convert.as_face(face) for face, _ in count_subshape_uses(whole, TopAbs_FACE, TopAbs_SHELL)]
        of_edge = {ShapeKey(edge): i for i, edge in enumerate(self.edges)}
        self.wires = [
            [
                [of_edge[ShapeKey(e)] for e in list_subshapes(wire, TopAbs_EDGE)]
                for wire in list_subshapes(face, TopAbs_WIRE)
            ]
            for face in self.faces
        ]
        self.edges_at: list[set[int]] = [set() for _ in self.vertices]
        self.faces_at: list[set[int]] = [set() for _ in self.vertices]
        self.faces_of: list[set[int]] = [set() for _ in self.edges]
        for f, wires in enumerate(self.wires):
            for e in (e for wire in wires for e in wire):
                self.faces_of[e].add(f)
                for v in self.ends[e]:
                    self.edges_at[v].add(e)
                    self.faces_at[v].add(f)
        self.members = {v: [v] for v in range(len(self.vertices))}
        self.gone: dict[int, tuple[int, bool] | None] = {}
        self.gone_faces: set[int] = set()

    @staticmethod
    def _sample(edge: TopoDS_Edge, start: Array) -> Array:
        """Points along an edge; a degenerate one stays at its start."""
        if BRep_Tool.Degenerated_s(edge):
            return np.repeat(start[None], SAMPLES, axis=0)
        curve = BRepAdaptor_Curve(edge)
        return evaluate_pointwise(curve, np.linspace(curve.FirstParameter(), curve.LastParameter(), SAMPLES))[0]

    def merge(self, edge: int) -> int:
        """Make the ends of an edge one class, if the faces around stay faces or vanish; the number of edges that vanish."""
        a, b = self.ends[edge]
        if edge in self.gone or a == b:
            return 0
        between = self.edges_at[a] & self.edges_at[b]
        members = self.members[a] + self.members[b]
        around = (self.faces_at[a] | self.faces_at[b]) - self.gone_faces
        if (
            self.lengths[list(between)].max() > self.longest
            or pdist(self.points[members]).max() > SPREAD * self.longest
            or not all(self._may_merge(f, {a, b}, between) for f in around)
        ):
            return 0
        twins = [(f, [e for e in self.wires[f][0] if e not in between]) for f in around if self._vanishes(f, between)]
        if len({e for _, pair in twins for e in pair}) < sum(len(pair) for _, pair in twins):
            return 0
        self.gone.update(dict.fromkeys(between))
        self.members[a] = members
        del self.members[b]
        self.edges_at[a] = (self.edges_at[a] | self.edges_at[b]) - between
        self.faces_at[a] = self.faces_at[a] | self.faces_at[b]
        for e in self.edges_at[b] - between:
            x, y = self.ends[e]
            self.ends[e] = (a if x == b else x, a if y == b else y)
        for f in around:
            self.wires[f] = [[e for e in wire if e not in between] for wire in self.wires[f]]
        for f, pair in twins:
            self.gone_faces.add(f)
            if pair:
                self._unite(f, *sorted(pair, key=self._distance_from_sides))
        return len(between) + sum(bool(pair) for _, pair in twins)

    def _may_merge(self, face: int, ends: set[int], between: set[int]) -> bool:
        """Whether a face of which two vertices become one passes them once as before, or vanishes."""
        touched = [wire for wire in self.wires[face] if any(ends & set(self.ends[e]) for e in wire)]
        if len(touched) != 1:
            return False
        (wire,) = touched
        left = [e for e in wire if e not in between]
        if len(left) < 3:
            is_wide = len(left) == 2 < len(wire) and left[0] != left[1] and self._width(*left) > self.longest
            return is_wide or self._vanishes(face, between)
        if len(set(left)) < len(left):  # a seam: its ends are passed twice
            return len(left) < len(wire)
        return sum(end in ends for e in left for end in self.ends[e]) == 2

    def _vanishes(self, face: int, between: set[int]) -> bool:
        """Whether nothing is left of a face without some edges, or two that are nowhere apart, with another face each."""
        left = [e for wire in self.wires[face] for e in wire if e not in between]
        if len(self.wires[face]) > 1 or len(left) > 2:
            return False
        if len(left) < 2:
            return not left
        one, other = left
        return (
            one != other
            and self._width(one, other) <= self.longest
            and self.faces_of[one] & self.faces_of[other] == {face}
            and not any(self._is_seam(e, f) for e in left for f in self.faces_of[e])
        )

    def _is_seam(self, edge: int, face: int) -> bool:
        """Whether a face has an edge on both sides."""
        return sum(wire.count(edge) for wire in self.wires[face]) > 1

    def _width(self, one: int, other: int) -> float:
        """Greatest distance of the samples of an edge from the chords between those of another."""
        start, step = self.samples[other][:-1], np.diff(self.samples[other], axis=0)
        off = self.samples[one][:, None] - start
        at = np.clip((off * step).sum(axis=2) / np.maximum((step * step).sum(axis=1), 1e-300), 0.0, 1.0)
        return float(np.linalg.norm(off - at[..., None] * step, axis=2).min(axis=1).max())

    def _distance_from_sides(self, edge: int) -> float:
        """Distance of an edge from the side of the box that it is nearest to."""
        points = self.samples[edge]
        return min(float(np.abs(points - level).max(axis=0).min()) for level in (self.low, self.high))

    def _unite(self, face: int, kept: int, other: int) -> None:
        """Put an edge in the place of another that bounds the same narrow face."""
        self.gone[other] = kept, self.ends[other][0] == self.ends[kept][0]
        for f in self.faces_of[other] - {face}:
            self.wires[f] = [[kept if e == other else e for e in wire] for wire in self.wires[f]]
            self.faces_of[kept].add(f)
        for v in self.ends[other]:
            self.edges_at[v].discard(other)

    def drop_edges(self, whole: TopoDS_Shape) -> TopoDS_Shape:
        """The shape without the edges and faces that have gone."""
        reshape, builder = BRepTools_ReShape(), BRep_Builder()
        for f in self.gone_faces:
            reshape.Remove(self.faces[f])
        for e in self.gone:
            found = self._substitute(e)
            if found is None:
                reshape.Remove(self.edges[e].Oriented(TopAbs_FORWARD))
                continue
            kept, same = found
            edge = convert.as_edge(self.edges[kept].Oriented(TopAbs_FORWARD))
            for f in self.faces_of[e] - self.gone_faces:
                _add_parameter_curve(edge, self.edges[e], self.faces[f])
            builder.UpdateEdge(edge, self._width(kept, e) + BRep_Tool.Tolerance_s(self.edges[e]))
            reshape.Replace(
                self.edges[e].Oriented(TopAbs_FORWARD), edge.Oriented(TopAbs_FORWARD if same else TopAbs_REVERSED)
            )
        return reshape.Apply(whole)

    def _substitute(self, edge: int) -> tuple[int, bool] | None:
        """The edge that stands for one that has gone, if any, and whether it has the same direction."""
        found, same = self.gone[edge], True
        while found is not None:
            edge, same = found[0], same == found[1]
            if edge not in self.gone:
                return edge, same
            found = self.gone[edge]
        return None

    def unite_vertices(self, whole: TopoDS_Shape) -> tuple[TopoDS_Shape, float]:
        """The shape with one vertex for each class, and the greatest distance of a member from it."""
        reshape, builder, moved = BRepTools_ReShape(), BRep_Builder(), 0.0
        for members in self.members.values():
            if len(members) == 1:
                continue
            place = _choose_place(self.points[members], self.low, self.high)
            off = np.linalg.norm(self.points[members] - place, axis=1)
            reach = [
                BRep_Tool.Tolerance_s(self.vertices[v]) + gap for v, gap in zip(members, off.tolist(), strict=True)
            ]
            vertex = TopoDS_Vertex()
            builder.MakeVertex(vertex, gp_Pnt(*place.tolist()), max(reach))
            for v in members:
                reshape.Replace(self.vertices[v].Oriented(TopAbs_FORWARD), vertex)
            moved = max(moved, float(off.max()))
        return reshape.Apply(whole), moved


def _add_parameter_curve(edge: TopoDS_Edge, former: TopoDS_Edge, face: TopoDS_Face) -> None:
    """Give an edge its curve in the parameters of a face, in the same period as that of the edge which it replaces."""
    ShapeFix_Edge().FixAddPCurve(edge, face, False, 0.0)
    surface = BRepAdaptor_Surface(face, False)
    old, new = (BRep_Tool.CurveOnSurface_s(each, face, 0.0, 0.0) for each in (former, edge))
    if old is None or new is None:
        return
    middles = [
        curve.Value(0.5 * (curve_on.FirstParameter() + curve_on.LastParameter()))
        for curve, curve_on in ((old, BRepAdaptor_Curve(former)), (new, BRepAdaptor_Curve(edge)))
    ]
    off = np.array(middles[0].Coord()) - middles[1].Coord()
    periods = [
        surface.UPeriod() if surface.IsUPeriodic() else np.inf,
        surface.VPeriod() if surface.IsVPeriodic() else np.inf,
    ]
    steps = [
        float(np.rint(x / period) * period) if np.isfinite(period) else 0.0
        for x, period in zip(off, periods, strict=True)
    ]
    if any(steps):
        new.Translate(gp_Vec2d(*steps))
