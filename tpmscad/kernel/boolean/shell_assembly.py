"""Solids from OCCT faces that share their edges: components, closedness, and nesting of shells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.TopoDS import TopoDS_Face, TopoDS_Solid

from tpmscad._typing import IntArray
from tpmscad.brep.linked_items import label_sharing
from tpmscad.errors import KernelError
from tpmscad.kernel.boolean.boolean_operations import estimate_volume
from tpmscad.kernel.build.solids import shell_contains
from tpmscad.kernel.occt.construction import make_shell, make_solid
from tpmscad.kernel.occt.exploration import ShapeKey, edges_of, first_vertex, orientation_sign

FaceEdgeUses = list[list[tuple[int, int]]]
"""Half-edges of each face: the number of the edge, and +1 or -1 for its orientation seen from outside."""

OPERATION = "assembly of trimmed faces"


def edge_uses(faces: Sequence[TopoDS_Face]) -> FaceEdgeUses:
    """Half-edges of the faces with common edge numbers; degenerate edges are omitted."""
    number: dict[ShapeKey, int] = {}
    return [
        [
            (number.setdefault(ShapeKey(edge), len(number)), orientation_sign(edge))
            for edge in edges_of(face)
            if not BRep_Tool.Degenerated_s(edge)
        ]
        for face in faces
    ]


def face_components(uses: FaceEdgeUses, barrier: set[int] | frozenset[int] = frozenset()) -> IntArray:
    """Connected component of each face, where faces join over every edge outside `barrier`: (F,)."""
    pairs = np.array([(f, e) for f, own in enumerate(uses) for e, _ in own if e not in barrier], np.int64).reshape(
        -1, 2
    )
    return label_sharing(len(uses), pairs[:, 0], pairs[:, 1])


def assemble_solids(faces: Sequence[TopoDS_Face]) -> tuple[tuple[TopoDS_Solid, ...], float]:
    """Solids bounded by faces that are oriented outwards, largest outer shell first, and their total volume by estimate.

    Raises KernelError unless every edge joins two faces with opposite orientations and every void shell lies inside a solid.
    """
    uses = edge_uses(faces)
    table = np.array([use for own in uses for use in own], np.int64).reshape(-1, 2)
    open_edges = (np.bincount(table[:, 0]) != 2) | (np.bincount(table[:, 0], table[:, 1]) != 0)
    if open_edges.any():
        raise KernelError(OPERATION, f"{np.count_nonzero(open_edges)} edges do not join two of the trimmed faces")
    label = face_components(uses)
    members = {s: [faces[f] for f in np.flatnonzero(label == s).tolist()] for s in np.unique(label).tolist()}
    shells = {s: make_shell(of) for s, of in members.items()}
    volume = {s: estimate_volume(shell) for s, shell in shells.items()}
    order = sorted(shells, key=lambda s: -volume[s])
    outer = [s for s in order if volume[s] > 0]
    pieces = {s: [s] for s in outer}
    for void in order[len(outer) :]:
        point = np.array(BRep_Tool.Pnt_s(first_vertex(edges_of(members[void][0])[0])).Coord())
        around = next((s for s in reversed(outer) if shell_contains(shells[s], point)), None)
        if around is None:
            raise KernelError(OPERATION, f"a shell of volume {volume[void]:.6g} is in no solid: inside out")
        pieces[around].append(void)
    return tuple(make_solid([shells[s] for s in piece]) for piece in pieces.values()), sum(volume.values())
