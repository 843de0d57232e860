"""A patch complex becomes kernel solids by its own connectivity: no sewing, nothing searched for, no tolerance guessed.

Vertices, edges and faces of the complex become one TopoDS each. An edge has one 3-D curve and one parameter curve per use; all
take the same parameter, so SameParameter holds by construction. Edges on planes need no parameter curve: the kernel projects.
Wires run counter-clockwise in (u, v), and a face is reversed where its outward normal is -S_u x S_v. Motions are baked into the
poles: a mirror in a TopLoc_Location makes OCC turn solids inside out.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRep import BRep_Builder
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.Geom import Geom_Surface
from OCP.gp import gp_Trsf
from OCP.TopAbs import TopAbs_FORWARD, TopAbs_IN, TopAbs_REVERSED
from OCP.TopoDS import (
    TopoDS_Compound,
    TopoDS_Edge,
    TopoDS_Face,
    TopoDS_Shape,
    TopoDS_Shell,
    TopoDS_Solid,
    TopoDS_Vertex,
    TopoDS_Wire,
)

from tpmscad.errors import KernelError
from tpmscad.kernel import convert
from tpmscad.kernel.nesting import Nesting, nesting
from tpmscad.patches import connectivity
from tpmscad.patches.carriers import Plane
from tpmscad.patches.complex import Array, Ints, PatchComplex

TOLERANCE = 1e-7
"""OCC's smallest useful tolerance (Precision::Confusion): what every vertex, edge and face gets unless measured worse."""


@dataclass(frozen=True, slots=True, eq=False)
class Built:
    """Solids of a complex. `shape` is a TopoDS_Solid, or a compound of several; `faces[i]` is face i of the complex.

    `nesting` tells which faces bound which solid.
    """

    shape: TopoDS_Shape
    solids: tuple[TopoDS_Solid, ...]
    faces: tuple[TopoDS_Face, ...]
    nesting: Nesting

    @property
    def solid(self) -> Any:
        """The build123d Solid, or Compound of Solids; its `.wrapped` is `shape`."""
        from build123d import Compound, Solid  # takes seconds to import, and files are written without it

        return Solid(self.shape) if len(self.solids) == 1 else Compound(self.shape)


def build(complex: PatchComplex) -> Built:
    """The solid or solids that a closed complex bounds, in model units, largest first.

    KernelError where the complex is open, or a shell is inside out.
    """
    unmatched = connectivity.unmatched_edges(complex)
    if len(unmatched):
        at = complex.vertices[complex.edges.start[unmatched[0]]]
        raise KernelError("build", f"{len(unmatched)} edges do not join two faces, the first at {at.round(6)}")
    faces = topods_faces(complex)
    count, label = connectivity.shells(complex)
    members = np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label, minlength=count))[:-1])
    shells = [shell_of(faces[i] for i in of) for of in members]

    def inside(shell: int, point: Array) -> bool:
        classifier = BRepClass3d_SolidClassifier(solid_of(shells[shell : shell + 1]))
        classifier.Perform(convert.point(point), TOLERANCE)
        return bool(classifier.State() == TopAbs_IN)

    nested = nesting(complex, inside)
    solids = tuple(solid_of([shells[s] for s in piece]) for piece in nested.pieces)
    return Built(solids[0] if len(solids) == 1 else compound(solids), solids, faces, nested)


def compound(shapes: Iterable[TopoDS_Shape]) -> TopoDS_Compound:
    """The shapes side by side as one."""
    builder, result = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(result)
    for shape in shapes:
        builder.Add(result, shape)
    return result


def topods_faces(complex: PatchComplex) -> tuple[TopoDS_Face, ...]:
    """Every face, outward normals, on shared edges and vertices; of open complexes too."""
    builder = BRep_Builder()
    surfaces = _surfaces(complex)
    edges = _edges(builder, complex)
    pcurves = [convert.curve_2d(c) for c in complex.pcurves]
    tolerance = np.maximum(TOLERANCE, complex.edges.deviation).tolist()
    faces, uses = complex.faces, complex.uses
    use_edge, use_sense, use_pcurve = uses.edge.tolist(), uses.sense.tolist(), uses.pcurve.tolist()
    loop_start, use_start, sense = faces.loop_start.tolist(), faces.use_start.tolist(), faces.sense.tolist()
    result = []
    for i in range(len(faces)):
        face = TopoDS_Face()
        builder.MakeFace(face, surfaces[i], TOLERANCE)
        seen: dict[int, int] = {}
        for loop in range(loop_start[i], loop_start[i + 1]):
            wire = TopoDS_Wire()
            builder.MakeWire(wire)
            for k in range(use_start[loop], use_start[loop + 1]):
                e = use_edge[k]
                if use_pcurve[k] >= 0 and e in seen:  # a seam: this face lies on both sides of the edge
                    along, against = (k, seen[e]) if use_sense[k] > 0 else (seen[e], k)
                    pair = pcurves[use_pcurve[along]], pcurves[use_pcurve[against]]
                    builder.UpdateEdge(edges[e], *pair, face, tolerance[e])
                elif use_pcurve[k] >= 0:
                    builder.UpdateEdge(edges[e], pcurves[use_pcurve[k]], face, tolerance[e])
                    seen[e] = k
                builder.Add(wire, edges[e].Oriented(TopAbs_FORWARD if use_sense[k] > 0 else TopAbs_REVERSED))
            wire.Closed(True)
            builder.Add(face, wire)
        result.append(face if sense[i] > 0 else convert.as_face(face.Reversed()))
    return tuple(result)


def straight_edges(complex: PatchComplex) -> Ints:
    """Edges that run straight, on planes only, so that nothing else takes their parameter: they become true lines."""
    segment = np.array([c.degree == 1 and len(c.poles) == 2 for c in complex.curves], bool)[complex.edges.curve]
    segment[complex.uses.edge[complex.uses.pcurve >= 0]] = False
    return np.flatnonzero(segment)


def end_points(complex: PatchComplex) -> Array:
    """Where the edges' curves begin and end: (E, 2, 3)."""
    edges = complex.edges
    keys, key = np.unique(np.column_stack([edges.curve, edges.span]), axis=0, return_inverse=True)
    local = np.stack([complex.curves[int(i)]([low, high]) for i, low, high in keys])[key.ravel()]
    return np.einsum("eij,ekj->eki", edges.rotation, local) + edges.translation[:, None]


def vertex_tolerances(complex: PatchComplex) -> Array:
    """What each vertex needs to cover the ends of its edges, and the edges' own deviations: (V,)."""
    edges = complex.edges
    tolerance = np.full(len(complex.vertices), TOLERANCE)
    ends = end_points(complex)
    for vertex, end in ((edges.start, ends[:, 0]), (edges.end, ends[:, 1])):
        miss = np.linalg.norm(complex.vertices[vertex] - end, axis=1)
        np.maximum.at(tolerance, vertex, np.maximum(miss, edges.deviation))
    return tolerance


def _motions(rotation: Array, translation: Array) -> list[gp_Trsf]:
    """The motion of each item; equal ones are made once."""
    rows = np.concatenate([rotation.reshape(-1, 9), translation], axis=1)
    distinct, index = np.unique(rows, axis=0, return_inverse=True)
    made = [convert.motion(row[:9].reshape(3, 3), row[9:]) for row in distinct]
    return [made[i] for i in index.ravel().tolist()]


def _surfaces(complex: PatchComplex) -> list[Geom_Surface]:
    """Each face's own placed surface: a surface that two faces share can't hold both parameter curves of their edge."""
    faces = complex.faces
    motions = _motions(faces.rotation, faces.translation)
    bases = [None if isinstance(c, Plane) else convert.surface(c) for c in complex.carriers]
    result = []
    for i, index in enumerate(faces.carrier.tolist()):
        carrier, base, rotation = complex.carriers[index], bases[index], faces.rotation[i]
        if isinstance(carrier, Plane):
            origin = rotation @ carrier.origin + faces.translation[i]
            result.append(convert.plane(origin, rotation @ carrier.x_axis, rotation @ carrier.y_axis))
        else:
            result.append(base.Transformed(motions[i]))
    return result


def _edges(builder: BRep_Builder, complex: PatchComplex) -> list[TopoDS_Edge]:
    """Edges with vertices, 3-D curve and range; parameter curves come with the faces."""
    vertices = []
    for position, tolerance in zip(complex.vertices, vertex_tolerances(complex).tolist(), strict=True):
        vertex = TopoDS_Vertex()
        builder.MakeVertex(vertex, convert.point(position), tolerance)
        vertices.append((vertex, vertex.Reversed()))
    edges = complex.edges
    motions = _motions(edges.rotation, edges.translation)
    curves = [convert.curve(c) for c in complex.curves]
    straight = set(straight_edges(complex).tolist())
    tolerance = np.maximum(TOLERANCE, edges.deviation).tolist()
    result = []
    spans, ends = edges.span.tolist(), np.column_stack([edges.start, edges.end]).tolist()
    for i, index in enumerate(edges.curve.tolist()):
        edge = TopoDS_Edge()
        start, end = ends[i]
        low, high = spans[i]
        if i in straight:
            a, b = complex.vertices[start], complex.vertices[end]
            builder.MakeEdge(edge, convert.straight(a, b), tolerance[i])
            low, high = 0.0, float(np.linalg.norm(b - a))
        else:
            builder.MakeEdge(edge, curves[index].Transformed(motions[i]), tolerance[i])
        builder.Add(edge, vertices[start][0])
        builder.Add(edge, vertices[end][1])
        builder.Range(edge, low, high)
        result.append(edge)
    return result


def shell_of(faces: Iterable[TopoDS_Face]) -> TopoDS_Shell:
    builder, shell = BRep_Builder(), TopoDS_Shell()
    builder.MakeShell(shell)
    for face in faces:
        builder.Add(shell, face)
    shell.Closed(True)
    return shell


def solid_of(shells: Iterable[TopoDS_Shell]) -> TopoDS_Solid:
    builder, solid = BRep_Builder(), TopoDS_Solid()
    builder.MakeSolid(solid)
    for shell in shells:
        builder.Add(solid, shell)
    return solid
