"""Solids of the faces of files that state none: closed shells are filled, and loose faces are sewn first.

Sewing moves no face: it makes edges that are near each other one, whose tolerance covers the gap. Of 15 such files of other
programs five are closed, with gaps of at most 5e-6 of their size, and ten are open by 1e-3 or more; nothing lies between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeSolid, BRepBuilderAPI_Sewing
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.BRepLib import BRepLib
from OCP.ShapeFix import ShapeFix_Shell
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_IN, TopAbs_SHELL
from OCP.TopoDS import TopoDS_Edge, TopoDS_Shape, TopoDS_Shell, TopoDS_Solid

from tpmscad._typing import Array
from tpmscad.errors import format_point
from tpmscad.kernel.measure.edge_gaps import measure_edge_length
from tpmscad.kernel.measure.mass_properties import solid_moments
from tpmscad.kernel.measure.shape_sampling import sample_edge
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.bounding_boxes import box_diagonal
from tpmscad.kernel.occt.construction import make_compound, make_solid
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import (
    ShapeKey,
    count_subshape_uses,
    faces_of,
    first_vertex,
    last_vertex,
    list_subshapes,
)

SEWING_SIZES = (1e-7, 1e-6, 1e-5)
"""In body sizes: tolerances at which faces are sewn, one after the other until no edge is free; never above the last."""


@dataclass(frozen=True, slots=True, eq=False)
class ClosedShells:
    """Solids that were made, and how, in words; without solids why none could be made."""

    solids: tuple[TopoDS_Solid, ...]
    words: str


def make_solids_of_faces(shape: TopoDS_Shape, accuracy: float | None) -> ClosedShells:
    """Solids within the closed shells of a shape without solids; its faces are sewn if edges are free.

    `accuracy`: what the file states, mm: one more tolerance of sewing if it is below the largest of SEWING_SIZES.
    """
    faces = faces_of(shape)
    if not faces:
        return ClosedShells((), "it has no faces")
    shells = list_subshapes(shape, TopAbs_SHELL)
    in_shells = sum(len(faces_of(shell)) for shell in shells)
    if in_shells == len(faces) and not list_free_edges(shape):
        return _fill(shells, f"the file holds no solid, but {_count(len(shells), 'closed shell')}")
    size = box_diagonal(shape)
    tolerances = {CONFUSION_TOLERANCE, *(size * relative for relative in SEWING_SIZES)}
    if accuracy is not None:
        tolerances.add(accuracy)
    sewn: TopoDS_Shape | None = None
    for tolerance in sorted(t for t in tolerances if CONFUSION_TOLERANCE <= t <= SEWING_SIZES[-1] * size):
        sewn = _sew(shape, tolerance)
        if not list_free_edges(sewn):
            words = f"the file holds no solid: its {_count(len(faces), 'face')} were sewn within {tolerance:.2g} mm"
            return _fill(list_subshapes(sewn, TopAbs_SHELL), words)
    free = list_free_edges(sewn if sewn is not None else shape)
    length, place = _measure_longest_chain(free)
    return ClosedShells(
        (),
        f"its faces do not close even if they are sewn within {SEWING_SIZES[-1] * size:.2g} mm: {_count(len(free), 'edge')} "
        f"bound one face only, the longest chain of them, {length:.4g} mm, at {format_point(place)}",
    )


def list_free_edges(shape: TopoDS_Shape) -> list[TopoDS_Edge]:
    """The edges that bound one face only, degenerate ones left out."""
    edges = ((convert.as_edge(edge), uses) for edge, uses in count_subshape_uses(shape, TopAbs_EDGE, TopAbs_FACE))
    return [edge for edge, uses in edges if uses == 1 and not BRep_Tool.Degenerated_s(edge)]


def turn_outward(solid: TopoDS_Solid) -> TopoDS_Solid:
    """The solid, turned so that its volume is positive."""
    turned = convert.as_solid(solid.Located(solid.Location()))
    BRepLib.OrientClosedSolid_s(turned)
    return turned


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' if number != 1 else ''}"


def _sew(shape: TopoDS_Shape, tolerance: float) -> TopoDS_Shape:
    """The faces of the shape with common edges."""
    sewing = BRepBuilderAPI_Sewing(tolerance)
    for face in faces_of(shape):
        sewing.Add(face)
    sewing.Perform()
    return sewing.SewedShape()


def _fill(shells: Sequence[TopoDS_Shape], words: str) -> ClosedShells:
    """A solid within each outer shell, without what the shells inside it enclose."""
    filled = []
    for shell in shells:
        fixed = ShapeFix_Shell(convert.as_shell(shell))
        fixed.Perform()
        for part in list_subshapes(fixed.Shape(), TopAbs_SHELL):
            filled.append(turn_outward(BRepBuilderAPI_MakeSolid(convert.as_shell(part)).Solid()))
    filled.sort(key=lambda solid: -solid_moments(solid)[1])
    inside = [[j for j in range(i) if _contains(filled[j], filled[i])] for i in range(len(filled))]
    solids = [
        make_solid(
            [
                _shell_of(solid),
                *(
                    convert.as_shell(_shell_of(filled[k]).Reversed())
                    for k in range(i + 1, len(filled))
                    if len(inside[k]) % 2 == 1 and inside[k][-1] == i
                ),
            ]
        )
        for i, solid in enumerate(filled)
        if len(inside[i]) % 2 == 0
    ]
    if not solids:
        return ClosedShells((), "its faces form no shell")
    shape = make_compound(solids)
    tolerance = float(BRep_Tool.MaxTolerance_s(shape, TopAbs_EDGE))
    volume = sum(float(solid_moments(solid)[1]) for solid in solids)
    return ClosedShells(
        tuple(solids),
        f"{words}; made {_count(len(solids), 'solid')} of {volume:.6g} mm3, its edges within {tolerance:.2g} mm of its faces",
    )


def _shell_of(solid: TopoDS_Solid) -> TopoDS_Shell:
    return convert.as_shell(list_subshapes(solid, TopAbs_SHELL)[0])


def _contains(outer: TopoDS_Solid, inner: TopoDS_Solid) -> bool:
    """Whether a solid contains most of the middles of another's edges; shells do not cross."""
    classify, within = BRepClass3d_SolidClassifier(outer), []
    for edge in {ShapeKey(edge): edge for edge in list_subshapes(inner, TopAbs_EDGE)}.values():
        if not BRep_Tool.Degenerated_s(convert.as_edge(edge)):
            classify.Perform(convert.point(sample_edge(convert.as_edge(edge), 2)[1]), CONFUSION_TOLERANCE)
            within.append(classify.State() == TopAbs_IN)
    return bool(within) and 2 * sum(within) > len(within)


def _measure_longest_chain(edges: Sequence[TopoDS_Edge]) -> tuple[float, Array]:
    """Length of the longest chain of edges, and the middle of its longest edge."""
    chain_of: dict[ShapeKey, int] = {}
    chains: dict[int, list[TopoDS_Edge]] = {}
    for number, edge in enumerate(edges):
        met = {chain_of[key] for key in (ShapeKey(first_vertex(edge)), ShapeKey(last_vertex(edge))) if key in chain_of}
        chains[number] = [edge, *(other for chain in met for other in chains.pop(chain))]
        for other in chains[number]:
            chain_of[ShapeKey(first_vertex(other))] = chain_of[ShapeKey(last_vertex(other))] = number
    lengths = {number: measure_edge_length(make_compound(chain)) for number, chain in chains.items()}
    longest = max(lengths, key=lengths.__getitem__)
    edge = max(chains[longest], key=measure_edge_length)
    return lengths[longest], np.asarray(sample_edge(edge, 2)[1])
