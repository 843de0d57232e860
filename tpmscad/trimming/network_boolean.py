"""Union, intersection and difference of two networks of patches, on the patches' own parameters, without the kernel's boolean.

The edges of each network are intersected with the faces of the other; from these points the common curves of all pairs of
faces are traced; the pieces of edges are classified by their crossings, and the faces are rebuilt from what the operation
keeps. Vertices and edges are shared by number, not matched by distance. Faces lie on spline patches, planes or quadrics, whole or
trimmed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, TypeVar

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep, translate_brep
from tpmscad.brep.restricted_surfaces import restrict_carriers
from tpmscad.errors import InvalidRequest, NothingLeft, TrimmingError
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.trimming.classify.network_edges import classify_pieces, sort_splits, split_network_edges
from tpmscad.trimming.intersect.common_curves import CommonCurves, trace_common_curves
from tpmscad.trimming.intersect.contacts import (
    NO_EDGES_IN_FACES,
    collect_contact_ends,
    find_contacts,
    find_coplanar_edges,
    find_edges_in_faces,
    find_resolved,
    sample_edges_in_planes,
)
from tpmscad.trimming.intersect.network_hits import (
    SNAP_TOLS,
    collect_curve_ends,
    find_piercings,
    prepare_networks,
    select_hits,
)
from tpmscad.trimming.rebuild.network_result import CutNetwork, KeptPart, rebuild_networks, rebuild_parts

DEFAULT_TOL = 1e-7
"""Tolerance in model units; kernels give every edge at least this tolerance, so that a smaller one has no effect there."""

SHIFT_TOLS = (0.0, 25.0, 60.0, 250.0, 1000.0)
"""Lengths of the translations of the second network that are tried, in tolerances."""

SHIFT_DIRECTION = np.array([0.23, 0.50, 0.83])
"""Their direction, of about unit length: both networks have edges in mirror planes, of which none, x = y and the like included,
is nearer to it than 11 degrees."""

FAR_SHIFTS = (0.3, 0.6, 0.9)
"""Longer translations that are tried after these, in the longest one that is allowed."""

FAR_SHIFT_DIRECTION = np.array([-0.53, 0.81, 0.25])
"""Their direction, of unit length, far from mirror planes and from the other direction."""

Operation = Literal["union", "intersection", "difference"]

KEPT_PARTS: dict[Operation, tuple[KeptPart, KeptPart]] = {
    "union": (KeptPart(1, False), KeptPart(0, False)),
    "intersection": (KeptPart(1, True), KeptPart(0, True)),
    "difference": (KeptPart(1, True, reverse=True), KeptPart(0, False)),
}
"""What an operation keeps of both networks, in the order of the result's faces: those of a lattice before those of a body."""


@dataclass(frozen=True, slots=True)
class NetworkReport:
    """Statistics of a boolean operation.

    `hits`: points in which edges pierce faces. `arcs`: edges in common curves. `max_deviation`: largest deviation of an arc from
    its two faces, model units. `shift` (3,): the translation of the second network, mostly 0, and `reason`: why it was needed.
    """

    hits: int
    arcs: int
    max_deviation: float
    shift: Array
    reason: str

    @property
    def shifted(self) -> float:
        """Length of the translation."""
        return float(np.linalg.norm(self.shift))

    @property
    def notes(self) -> tuple[str, ...]:
        """A note on the translation of the second network, a lattice, if there was one."""
        return (f"the lattice was moved by {self.shifted:.2g}: {self.reason}",) if self.shifted else ()


@dataclass(frozen=True, slots=True, eq=False)
class NetworkResult:
    """A closed boundary representation, the statistics of the operation, and what the caller built of it."""

    brep: Brep
    report: NetworkReport
    built: Any = None


def combine_networks(
    first: Brep,
    second: Brep,
    operation: Operation,
    tol: float = DEFAULT_TOL,
    *,
    build: Callable[[Brep], Any] | None = None,
    may_move: bool = True,
    max_shift: float = 0.0,
    is_cover: bool = False,
) -> NetworkResult:
    """The union, the intersection or the difference of the solids of two boundary representations.

    Parameters
    ----------
    first, second
        Closed boundary representations of spline patches, planes and quadrics, whole or trimmed.
    operation
        "union", "intersection", or "difference": first without second.
    tol
        Largest distance between a common curve and its two faces, model units.
    build
        Makes `NetworkResult.built` of the result. If it raises TrimmingError, the next placement is tried.
    may_move
        Whether the second solid may be translated by a few tolerances where edges or planes of both coincide.
    max_shift
        The length up to which it may be translated besides, model units.
    is_cover
        Whether the second one may be open, as whole patches of a lattice that cover the box of the first.

    Raises
    ------
    InvalidRequest
        If an operand is not closed, tol is not positive, or the operation is unknown.
    NothingLeft
        If no face is left.
    TrimmingError
        If the faces touch or coincide in a part, or an intersection is not resolved, at every placement that is tried.
    """
    if not (np.isfinite(tol) and tol > 0):
        raise InvalidRequest(f"tol must be positive and finite, not {tol}")
    if operation not in KEPT_PARTS:
        raise InvalidRequest(f"the operation {operation!r} is none of {', '.join(KEPT_PARTS)}")

    def finish(cut: CutNetworks) -> NetworkResult:
        brep = restrict_to_vertices(rebuild_networks(cut.operands, KEPT_PARTS[operation], cut.arcs, cut.vertices))
        return NetworkResult(brep, cut.report, build(brep) if build else None)

    return _cut_networks(_Operands(first, second, tol, is_cover), may_move, max_shift, finish)


@dataclass(frozen=True, slots=True, eq=False)
class DividedNetwork:
    """A solid divided by another one into what lies in the other and what does not.

    `shared` holds all faces, common ones once, with the sense of the first region. `within`, `beyond`: faces of `shared` that
    bound each region; those of `reversed_beyond` (a part of `beyond`) bound it with the opposite sense. `built` as in
    `NetworkResult`.
    """

    shared: Brep
    within: IntArray
    beyond: IntArray
    reversed_beyond: IntArray
    report: NetworkReport
    built: Any = None


def divide_network(
    first: Brep,
    second: Brep,
    tol: float = DEFAULT_TOL,
    *,
    build: Callable[[DividedNetwork], Any] | None = None,
    may_move: bool = True,
    max_shift: float = 0.0,
    is_cover: bool = False,
) -> DividedNetwork:
    """The first solid divided by the second: arguments and errors as in `combine_networks`, both regions at once."""
    parts = KeptPart(0, True), KeptPart(0, False), KeptPart(1, True)

    def finish(cut: CutNetworks) -> DividedNetwork:
        shared, part = rebuild_parts(cut.operands, parts, cut.arcs, cut.vertices)
        shared = restrict_to_vertices(shared)
        faces = [np.flatnonzero(part == k) for k in range(3)]
        found = DividedNetwork(
            shared,
            np.concatenate([faces[0], faces[2]]),
            np.concatenate([faces[1], faces[2]]),
            faces[2],
            cut.report,
        )
        return replace(found, built=build(found)) if build else found

    return _cut_networks(_Operands(first, second, tol, is_cover), may_move, max_shift, finish)


def restrict_to_vertices(brep: Brep) -> Brep:
    """The same faces, with carriers restricted where their poles leave the box of the vertices."""
    return restrict_carriers(brep, brep.vertices.min(axis=0), brep.vertices.max(axis=0)) if len(brep.vertices) else brep


@dataclass(frozen=True, slots=True, eq=False)
class _Operands:
    """Two networks to cut, the tolerance of their common curves, and whether the second one may be open beyond the first."""

    first: Brep
    second: Brep
    tol: float
    is_cover: bool


@dataclass(frozen=True, slots=True, eq=False)
class CutNetworks:
    """Both networks with their edges cut and classified, their common curves, and the vertices of all."""

    operands: tuple[CutNetwork, CutNetwork]
    arcs: CommonCurves
    vertices: Array
    report: NetworkReport


R = TypeVar("R", NetworkResult, DividedNetwork)


def _cut_networks(operands: _Operands, may_move: bool, max_shift: float, finish: Callable[[CutNetworks], R]) -> R:
    """What is made of two networks that are cut by each other, at the first placement of the second at which that succeeds.

    Others are tried while an intersection is not resolved, or the kernel rejects what is built.
    """
    shifts = [m * operands.tol * SHIFT_DIRECTION for m in (SHIFT_TOLS if may_move else SHIFT_TOLS[:1])]
    shifts += [f * max_shift * FAR_SHIFT_DIRECTION for f in FAR_SHIFTS if max_shift > 0]
    placements = Fallbacks(
        tuple(
            Fallback(f"the second network moved by {np.linalg.norm(s):.2g}", partial(_cut_translated, s))
            for s in shifts
        ),
        retry_on=(TrimmingError,),
        final=(NothingLeft,),
    )
    outcome = placements.run(operands, finish)
    reason = str(outcome.failures[0]) if outcome.failures else ""
    return replace(outcome.value, report=replace(outcome.value.report, reason=reason))


def _cut_translated(shift: Array, of: _Operands, finish: Callable[[CutNetworks], R]) -> R:
    """What is made of two networks, the second translated by a vector."""
    tol = of.tol
    moved = translate_brep(of.second, shift) if shift.any() else of.second
    networks = first, second = prepare_networks(of.first, moved, SNAP_TOLS * tol, is_cover=of.is_cover)
    coplanar = find_coplanar_edges(first, second, tol)
    nothing = np.zeros((0, 2), np.int64)
    piercings = find_piercings(first, second, tol, nothing), find_piercings(second, first, tol, coplanar)
    contacts = find_contacts(first, second, piercings[1], coplanar, tol)
    resolved = find_resolved(first, second, piercings, contacts, tol)
    hits = (
        select_hits(first, second, piercings[0], resolved[0], tol),
        select_hits(second, first, piercings[1], resolved[1], tol),
    )
    # The vertices are those of the first network, those of the second, the hits, the crossings of edges, and the points of closed
    # curves.
    n_first, n_second, n_hits = len(first.brep.vertices), len(second.brep.vertices), [len(h.edge) for h in hits]
    crossing = contacts.vertex < 0
    first_hits = n_first + n_second, n_first + n_second + n_hits[0]
    number = np.where(crossing, first_hits[1] + n_hits[1] + np.cumsum(crossing) - 1, n_first + contacts.vertex)
    ends = collect_curve_ends(first, second, hits, collect_contact_ends(first, second, contacts, number), tol)
    points = np.concatenate(
        [first.brep.vertices, second.brep.vertices, hits[0].point, hits[1].point, contacts.point[crossing]]
    )
    edges = sample_edges_in_planes(first, second, coplanar)
    arcs = trace_common_curves(first, second, ends, len(points), tol, edges)
    vertices = np.concatenate([points, arcs.points])

    numbers = np.arange(n_first), n_first + np.arange(n_second)
    numbers[0][contacts.first_vertex[contacts.first_vertex >= 0]] = number[contacts.first_vertex >= 0]
    on_edge = contacts.first_edge >= 0
    splits = (
        sort_splits(hits[0], first_hits[0], contacts.first_edge[on_edge], contacts.first_t[on_edge], number[on_edge]),
        sort_splits(hits[1], first_hits[1], contacts.edge[crossing], contacts.t[crossing], number[crossing]),
    )
    pieces = [split_network_edges(networks[side], splits[side], numbers[side]) for side in (0, 1)]
    in_faces = find_edges_in_faces(first, second, contacts, pieces[1].first, pieces[1].span)
    operands = []
    for side, lying in ((0, NO_EDGES_IN_FACES), (1, in_faces)):
        own, other = networks[side], networks[1 - side]
        free = np.setdiff1d(numbers[side], number)
        inside = classify_pieces(own, other, splits[side], pieces[side], free, lying.piece)
        operands.append(CutNetwork(own.brep, pieces[side], inside, lying))
    report = NetworkReport(
        sum(n_hits) + len(contacts), len(arcs.faces), float(arcs.deviation.max(initial=0.0)), shift, ""
    )
    return finish(CutNetworks((operands[0], operands[1]), arcs, vertices, report))
