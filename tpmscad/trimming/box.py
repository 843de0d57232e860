"""A lattice trimmed by a box, or by any convex polyhedron, without the kernel: a closed complex comes out of an open one.

The lattice's edges are split at the planes, each patch's cut is traced once for all patches that see the plane from the same
place, the cut curves are split by the other planes, and what is inside is chained by vertices: trimmed faces first, then the
caps from the edges these leave open. Nothing is searched for by distance except the points in which two cuts meet.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tpmscad.errors import InvalidRequest
from tpmscad.patches import connectivity
from tpmscad.patches.complex import PatchComplex
from tpmscad.trimming import tool as tools
from tpmscad.trimming.assembly import all_edges, assemble, open_planes, plane_of_edges
from tpmscad.trimming.cuts import cut_patches
from tpmscad.trimming.faces import inner_faces
from tpmscad.trimming.meeting import meeting_points
from tpmscad.trimming.pieces import root_vertices, split
from tpmscad.trimming.sides import read_sides
from tpmscad.trimming.strands import FLAT, Strands, cross
from tpmscad.trimming.tool import Array, Tool, TrimmingError

TOLERANCE = 1e-7
"""Kernels give every edge at least this tolerance, in model units: a better curve gains nothing there."""

SNAP = 2.0
"""A vertex nearer to a plane than this many tolerances lies on it: no edge comes out shorter."""

FIT = 0.5
"""Curves are fitted to this part of the tolerance: a vertex of two of them is as far from each again."""

SHIFTS = (0.0, 1.0, -1.0, 2.0)
"""Attempts: planes moved outwards by this many `SHIFT` tolerances where a cut can't be resolved."""

SHIFT = 10.0


@dataclass(frozen=True, slots=True)
class Report:
    """How a trim went.

    Classes of (patch, plane) and of (edge, plane), distinct curves and the most poles among them, the greatest distance of a
    curve from its patch, how far the planes had to be moved outwards (model units; mostly 0), and why.
    """

    patch_classes: int
    edge_classes: int
    curves: int
    most_poles: int
    max_deviation: float
    shifted: float
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Trimmed:
    """The closed complex and how it was made."""

    complex: PatchComplex
    report: Report


def trim_box(
    lattice: PatchComplex,
    lo: ArrayLike,
    hi: ArrayLike,
    tol: float | None = None,
    inside: Callable[[Array], Array] | None = None,
) -> PatchComplex:
    """The part of the lattice's solid in the box from lo to hi: the complex of `trim`."""
    return trim(lattice, tools.box(lo, hi), tol, inside).complex


def trim(
    lattice: PatchComplex, tool: Tool, tol: float | None = None, inside: Callable[[Array], Array] | None = None
) -> Trimmed:
    """The solid that the lattice bounds, cut by the tool's planes: a closed complex, cap faces tagged "cap".

    lattice: whole patches that cover the tool and may be ragged outside; outward senses. tol: greatest distance between a
    cut curve and its patch, model units, by default `TOLERANCE`. inside(points (n, 3)) -> (n,) bool tells solid from void;
    it is asked only if no edge of the lattice meets the tool.

    InvalidRequest if the lattice is not of whole patches; TrimmingError if it does not cover the tool, or if a cut is not
    resolved even with the planes moved by a few tolerances (such moves are reported).
    """
    tol = TOLERANCE if tol is None else tol
    if not (np.isfinite(tol) and tol > 0):
        raise InvalidRequest(f"tol must be positive and finite, not {tol}")
    reason = ""
    for attempt in SHIFTS:
        moved = tools.shifted(tool, np.full(len(tool.planes), attempt * SHIFT * tol)) if attempt else tool
        try:
            complex, report = _trim(lattice, moved, tol, inside)
        except TrimmingError as error:
            reason = reason or str(error)
            continue
        return Trimmed(complex, replace(report, shifted=attempt * SHIFT * tol, reason=reason))
    raise TrimmingError(reason)


def _trim(
    lattice: PatchComplex, tool: Tool, tol: float, inside: Callable[[Array], Array] | None
) -> tuple[PatchComplex, Report]:
    snap = SNAP * tol
    k = len(tool.planes)
    sides = read_sides(lattice)
    e = lattice.edges
    edges = Strands(e.curve, e.rotation, e.translation, e.span, e.start, e.end)
    on = np.abs(tool.distances(lattice.vertices)) < snap
    crossings = cross(lattice.curves, edges, tool, on, np.zeros((len(edges), k), bool), snap, FLAT * tol)
    vertex, points = root_vertices(lattice.curves, edges, crossings, len(lattice.vertices), snap)
    edge_pieces = split(edges, crossings, vertex)
    vertices = np.vstack([lattice.vertices, points])

    cuts = cut_patches(lattice, sides, tool, on, crossings, vertex, len(vertices), FIT * tol)
    vertices = np.vstack([vertices, cuts.points])
    on = np.abs(tool.distances(vertices)) < snap
    curves = [c.curve for c in cuts.cuts]
    faces = lattice.faces
    arcs = Strands(
        cuts.cut,
        faces.rotation[cuts.face],
        faces.translation[cuts.face],
        np.tile([0.0, 1.0], (len(cuts.face), 1)),
        cuts.start,
        cuts.end,
    )
    own = cuts.plane[:, None] == np.arange(k)
    hits = cross(curves, arcs, tool, on, own, snap, FLAT * tol)
    hit_vertex, points, root = meeting_points(lattice, cuts, arcs, hits, tool, len(vertices), tol)
    hits = replace(hits, root=root)
    arc_pieces = split(arcs, hits, hit_vertex)
    vertices = np.vstack([vertices, points])
    on = np.abs(tool.distances(vertices)) < snap

    faces = inner_faces(lattice, sides, cuts, edge_pieces, arc_pieces)
    pieces = all_edges(lattice, cuts, crossings, edge_pieces, arc_pieces, vertices)
    open_edges = open_planes(faces, lattice.faces.sense, pieces, plane_of_edges(cuts, edge_pieces, arc_pieces))
    complex = assemble(lattice, tool, cuts, faces, pieces, open_edges, vertices, on, inside)
    if len(open_ := connectivity.unmatched_edges(complex)):
        at = complex.vertices[complex.edges.start[open_[0]]]
        raise TrimmingError(f"{len(open_)} edges of the trimmed lattice are not used twice, the first at {at.round(6)}")
    report = Report(
        patch_classes=cuts.n_classes,
        edge_classes=crossings.n_classes,
        curves=len(cuts.cuts),
        most_poles=max((len(c.curve.poles) for c in cuts.cuts), default=0),
        max_deviation=float(complex.edges.deviation.max(initial=0.0)),
        shifted=0.0,
        reason="",
    )
    return complex, report
