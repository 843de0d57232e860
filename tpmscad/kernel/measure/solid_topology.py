"""Topology of OCCT solids from the sub-shapes that their faces share: Betti numbers, and where solids only touch.

As in `brep.connectivity`, each fan of faces round a vertex counts as a vertex of its own, shell by shell: what meets in points or
along edges only counts as apart.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_SHELL, TopAbs_VERTEX, TopAbs_WIRE
from OCP.TopoDS import TopoDS_Shape, TopoDS_Solid

from tpmscad._typing import triple
from tpmscad.brep.linked_items import label_sharing
from tpmscad.brep.solid_properties import TouchingPlace
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import (
    ShapeKey,
    bounds_face,
    count_subshape_uses,
    faces_of,
    list_bounding_edges,
    list_subshapes,
)


@dataclass(frozen=True, slots=True)
class SolidTopology:
    """(pieces, tunnels, voids), the Euler characteristic of each shell, and where solids or shells touch."""

    betti: tuple[int, int, int]
    euler: tuple[int, ...]
    contacts: tuple[TouchingPlace, ...]


def measure_topology(solids: Sequence[TopoDS_Solid]) -> SolidTopology:
    """The topology of solids: b1 = b0 + b2 - chi / 2, with b0 pieces, b2 voids and the Euler characteristic chi of all shells."""
    shells = [list_subshapes(solid, TopAbs_SHELL) for solid in solids]
    counted = [_count_shell(shell) for of in shells for shell in of]
    euler = tuple(number for number, _ in counted)
    pieces, voids = len(solids), sum(len(of) - 1 for of in shells)
    fans = Counter(vertex for _, vertices in counted for vertex in vertices)
    return SolidTopology((pieces, pieces + voids - sum(euler) // 2, voids), euler, _find_contacts(solids, fans))


def _count_shell(shell: TopoDS_Shape) -> tuple[int, list[ShapeKey]]:
    """The Euler characteristic of a shell, a face with h holes counted as 1 - h, and the vertex of each of its fans."""
    faces = list_subshapes(shell, TopAbs_FACE)
    parts: dict[tuple[ShapeKey, int], int] = {}  # of faces at a vertex
    ends: dict[tuple[ShapeKey, ShapeKey], int] = {}  # of edges at a vertex
    edges: dict[ShapeKey, bool] = {}
    pairs = []
    for face, shape in enumerate(faces):
        for edge in map(ShapeKey, list_bounding_edges(shape)):
            edges.setdefault(edge, BRep_Tool.Degenerated_s(edge.shape))
            for vertex in map(ShapeKey, list_subshapes(edge.shape, TopAbs_VERTEX)):
                part = parts.setdefault((vertex, face), len(parts))
                pairs.append((part, ends.setdefault((edge, vertex), len(ends))))
    part, end = np.array(pairs, np.int64).reshape(-1, 2).T
    _, first = np.unique(label_sharing(len(parts), part, end), return_index=True)
    vertices = [vertex for vertex, _ in parts]
    proper = sum(not is_degenerate for is_degenerate in edges.values())
    wires = sum(bool(list_bounding_edges(wire)) for wire in list_subshapes(shell, TopAbs_WIRE))
    euler = len(first) - proper + 2 * len(faces) - wires
    return euler, [vertices[k] for k in first.tolist()]


def _find_contacts(solids: Sequence[TopoDS_Solid], fans: Counter[ShapeKey]) -> tuple[TouchingPlace, ...]:
    """Edges of more than two faces, and vertices elsewhere with several fans, or in the middle of several faces."""
    whole = make_compound(solids)
    contacts, on_edges, sides = [], set(), Counter[ShapeKey]()
    for face in faces_of(whole):
        for edge in list_subshapes(face, TopAbs_EDGE):  # one within a face has it on both sides
            sides[ShapeKey(edge)] += 1 if bounds_face(edge) else 2
    for shared in (edge.shape for edge, number in sides.items() if number > 2):
        on_edges |= {ShapeKey(vertex) for vertex in list_subshapes(shared, TopAbs_VERTEX)}
        contacts.append(TouchingPlace("edge", _middle(shared)))
    in_faces = {ShapeKey(vertex): uses for vertex, uses in count_subshape_uses(whole, TopAbs_VERTEX, TopAbs_FACE)}
    for vertex, uses in in_faces.items():
        if vertex not in on_edges and (fans[vertex] > 1 if vertex in fans else uses > 1):
            contacts.append(TouchingPlace("point", _point_of(vertex.shape)))
    return tuple(contacts)


def _point_of(vertex: Any) -> tuple[float, float, float]:
    return triple(BRep_Tool.Pnt_s(convert.as_vertex(vertex)).Coord())


def _middle(edge: Any) -> tuple[float, float, float]:
    """The mean of the vertices of an edge."""
    return triple(np.mean([_point_of(vertex) for vertex in list_subshapes(edge, TopAbs_VERTEX)], axis=0).tolist())
