"""Vertices, edges, faces and solids of OCCT shapes as Part 21 entities.

Vertices, edges, curves and surfaces that several faces or solids share are written once. Each solid has faces of its own, since
STEP has no faces with a solid on either side but in models that few readers take; faces that two solids share in OCCT lie on one
surface and are bounded by the same EDGE_CURVEs in the file. Pcurves and degenerate edges are omitted, which every reader permits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepClass3d import BRepClass3d
from OCP.BRepTools import BRepTools, BRepTools_WireExplorer
from OCP.Geom import Geom_BSplineCurve
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FORWARD, TopAbs_SHELL, TopAbs_WIRE
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Solid, TopoDS_Wire

from tpmscad._typing import Array
from tpmscad.errors import KernelError
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import (
    ShapeKey,
    faces_of,
    first_vertex,
    last_vertex,
    list_subshapes,
    orientation_sign,
)
from tpmscad.kernel.step.face_labels import NamedSolid
from tpmscad.kernel.step.geometry_entities import write_points
from tpmscad.kernel.step.occt_geometry import (
    FaceSurface,
    curve_poles,
    format_curve,
    format_surface,
    read_edge_curve,
    read_face_surface,
)
from tpmscad.kernel.step.part21 import DataSection, format_references, format_string
from tpmscad.kernel.step.topology_entities import write_solid


@dataclass(frozen=True, slots=True, eq=False)
class FaceUse:
    """A face as a solid uses it: its key, the sense of the outward normal against that of the STEP surface, its loops.

    A loop is its edges with the direction along each, or a vertex; the first loop is the outer one.
    """

    key: ShapeKey
    same_sense: bool
    loops: tuple[tuple[tuple[ShapeKey, bool], ...] | ShapeKey, ...]


@dataclass(frozen=True, slots=True)
class WrittenSolid:
    """Entity number of a solid and of its faces."""

    solid: int
    faces: tuple[int, ...]


@dataclass(slots=True, eq=False)
class _EntityTables:
    """Every distinct vertex, edge curve and surface, in order of appearance."""

    points: dict[ShapeKey, Array] = field(default_factory=dict)
    curves: dict[ShapeKey, Any] = field(default_factory=dict)
    ends: dict[ShapeKey, tuple[ShapeKey, ShapeKey]] = field(default_factory=dict)
    surfaces: dict[ShapeKey, FaceSurface] = field(default_factory=dict)

    def add_vertex(self, vertex: Any) -> ShapeKey:
        key = ShapeKey(vertex)
        if key not in self.points:
            self.points[key] = np.array(BRep_Tool.Pnt_s(vertex).Coord())
        return key

    def add_edge(self, edge: TopoDS_Edge) -> ShapeKey:
        key = ShapeKey(edge)
        if key not in self.curves:
            forward = convert.as_edge(edge.Oriented(TopAbs_FORWARD))
            self.curves[key] = read_edge_curve(forward)
            self.ends[key] = self.add_vertex(first_vertex(forward)), self.add_vertex(last_vertex(forward))
        return key

    def add_face(self, face: TopoDS_Face, void: bool) -> FaceUse:
        key = ShapeKey(face)
        forward = convert.as_face(face.Oriented(TopAbs_FORWARD))
        if key not in self.surfaces:
            self.surfaces[key] = read_face_surface(forward)
        outward = (orientation_sign(face) > 0) != void
        wires = [convert.as_wire(wire) for wire in list_subshapes(forward, TopAbs_WIRE)]
        if len(wires) > 1:
            outer = BRepTools.OuterWire_s(forward)
            wires.sort(key=lambda wire: not wire.IsSame(outer))
        loops = [self._add_loop(wire, forward, outward) for wire in wires]
        return FaceUse(key, outward != self.surfaces[key].flipped, tuple(loops))

    def _add_loop(
        self, wire: TopoDS_Wire, face: TopoDS_Face, outward: bool
    ) -> tuple[tuple[ShapeKey, bool], ...] | ShapeKey:
        edges = _walk_wire(wire, face)
        proper = [edge for edge in edges if not BRep_Tool.Degenerated_s(edge)]
        if not proper:
            return self.add_vertex(first_vertex(edges[0]))
        loop = [(self.add_edge(edge), (orientation_sign(edge) > 0) == outward) for edge in proper]
        return tuple(loop if outward else reversed(loop))


def _walk_wire(wire: TopoDS_Wire, face: TopoDS_Face) -> list[TopoDS_Edge]:
    """Edges of a wire, head to tail, counter-clockwise about S_u x S_v."""
    walk, found = BRepTools_WireExplorer(wire, face), []
    while walk.More():
        found.append(walk.Current())
        walk.Next()
    listed = [convert.as_edge(edge) for edge in list_subshapes(wire, TopAbs_EDGE)]
    if len(found) == len(listed):
        return found
    return _chain_edges(listed, face)


def _chain_edges(edges: list[TopoDS_Edge], face: TopoDS_Face) -> list[TopoDS_Edge]:
    """The edges in an order in which each starts at the end of the one before; KernelError if there is none."""
    rest, chain = edges[1:], edges[:1]
    while rest:
        end = ShapeKey(_tail_and_head(chain[-1])[1])
        following = next((edge for edge in rest if ShapeKey(_tail_and_head(edge)[0]) == end), None)
        if following is None:
            raise KernelError("write STEP", "the edges of a loop are not connected", face)
        rest.remove(following)
        chain.append(following)
    return chain


def _tail_and_head(edge: TopoDS_Edge) -> tuple[Any, Any]:
    """First and last vertex along the orientation of an edge."""
    ends = first_vertex(edge), last_vertex(edge)
    return ends if orientation_sign(edge) > 0 else (ends[1], ends[0])


def write_occt_solids(section: DataSection, solids: Sequence[NamedSolid]) -> tuple[WrittenSolid, ...]:
    """Write the solids; what they share is written once.

    Raises KernelError if a surface, curve or loop cannot be represented.
    """
    tables = _EntityTables()
    uses = [_read_solid(tables, of.solid) for of in solids]
    points, of_curve, of_surface = _write_geometry(section, tables)
    vertices = section.extend([f"VERTEX_POINT('',#{p})" for p in points])
    vertex = dict(zip(tables.points, vertices, strict=True))
    curves = dict(zip(tables.curves, of_curve, strict=True))
    rows = [(vertex[a], vertex[b], curves[key]) for key, (a, b) in tables.ends.items()]
    edges = section.extend([f"EDGE_CURVE('',#{a},#{b},#{c},.T.)" for a, b, c in rows])
    edge = dict(zip(tables.ends, edges, strict=True))
    surface = dict(zip(tables.surfaces, of_surface, strict=True))
    result = []
    for of, (faces, shells) in zip(solids, uses, strict=True):
        numbers = [
            _write_face(section, label, face, surface[face.key], edge, vertex)
            for label, face in zip(of.labels, faces, strict=True)
        ]
        outer, *voids = section.extend([f"CLOSED_SHELL('',{format_references(numbers[own])})" for own in shells])
        result.append(WrittenSolid(write_solid(section, of.name, outer, voids), tuple(numbers)))
    return tuple(result)


def _read_solid(tables: _EntityTables, solid: TopoDS_Solid) -> tuple[list[FaceUse], list[slice]]:
    """Faces of a solid in the order of `faces_of`, and those of each shell, the outer one first."""
    outer = BRepClass3d.OuterShell_s(solid)
    faces: list[FaceUse] = []
    shells = []
    for shell in list_subshapes(solid, TopAbs_SHELL):
        void, first = not shell.IsSame(outer), len(faces)
        faces += [tables.add_face(face, void) for face in faces_of(shell)]
        shells.append((void, slice(first, len(faces))))
    return faces, [own for _, own in sorted(shells, key=lambda shell: shell[0])]


def _write_geometry(section: DataSection, tables: _EntityTables) -> tuple[list[int], list[int], list[int]]:
    """Write points, curves and surfaces and return the numbers of the vertices' points, the curves and the surfaces."""
    of_curves = [
        curve_poles(c) if isinstance(c, Geom_BSplineCurve) else np.zeros((0, 3)) for c in tables.curves.values()
    ]
    groups = [np.array(list(tables.points.values())), *of_curves, *(s.poles for s in tables.surfaces.values())]
    numbers = np.split(write_points(section, np.concatenate(groups)), np.cumsum([len(g) for g in groups])[:-1])
    curve_points, surface_points = numbers[1 : 1 + len(of_curves)], numbers[1 + len(of_curves) :]
    curves, surfaces = (
        [section.add(write(section, item, own)) for item, own in zip(items.values(), points, strict=True)]
        for write, items, points in (
            (format_curve, tables.curves, curve_points),
            (format_surface, tables.surfaces, surface_points),
        )
    )
    return numbers[0].tolist(), curves, surfaces


def _write_face(
    section: DataSection,
    label: str,
    face: FaceUse,
    surface: int,
    edge: dict[ShapeKey, int],
    vertex: dict[ShapeKey, int],
) -> int:
    """Write an ADVANCED_FACE with its loops and return its number."""
    bounds = []
    for number, loop in enumerate(face.loops):
        if isinstance(loop, ShapeKey):
            written = section.add(f"VERTEX_LOOP('',#{vertex[loop]})")
        else:
            sides = section.extend(
                [f"ORIENTED_EDGE('',*,*,#{edge[key]},.{'T' if along else 'F'}.)" for key, along in loop]
            )
            written = section.add(f"EDGE_LOOP('',{format_references(sides)})")
        kind = "FACE_OUTER_BOUND" if number == 0 else "FACE_BOUND"
        bounds.append(section.add(f"{kind}('',#{written},.T.)"))
    sense = "T" if face.same_sense else "F"
    return section.add(f"ADVANCED_FACE({format_string(label)},{format_references(bounds)},#{surface},.{sense}.)")
