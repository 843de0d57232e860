"""A lattice trimmed by a body of planes and quadrics, without the kernel: a closed complex comes out of an open one.

Each patch's cuts are traced once for all patches that see a surface of the body from the same place. Where a cut passes an edge
of the body its direction tells which face it goes on; so every piece of a cut, and with it every crossing of a lattice edge, is
known to be on the body or not. What is inside is chained by vertices: trimmed faces first, then the body's own faces from the
edges these leave open. Nothing is searched for by distance except the points in which two cuts meet.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, translate_brep
from tpmscad.brep.loops import LoopError
from tpmscad.errors import InvalidRequest, TrimmingError
from tpmscad.trimming.classify.intersection_curves import classify_intersection_curves, collect_face_sectors
from tpmscad.trimming.classify.lattice_edges import classify_lattice_edges, read_edge_segments
from tpmscad.trimming.classify.point_membership import points_in_lattice
from tpmscad.trimming.intersect.body_edges import BodyEdgeIntersections, intersect_body_edges
from tpmscad.trimming.intersect.broad_phase import find_candidate_pairs
from tpmscad.trimming.intersect.curve_surface import (
    ZERO_FRACTION_OF_TOL,
    CurveSegments,
    CurveSurfaceIntersections,
    SubSegments,
    assign_root_vertices,
    check_tangencies,
    intersect_segments,
    split_segments,
)
from tpmscad.trimming.intersect.patch_surface import IntersectionCurves, collect_intersection_curves, intersect_patches
from tpmscad.trimming.operands import polyhedra as tools
from tpmscad.trimming.operands.face_regions import FaceRegion, build_face_regions, points_in_body
from tpmscad.trimming.operands.patch_sides import PatchSides, read_patch_sides, read_spline_curves
from tpmscad.trimming.operands.trimming_body import TrimmingBody, prepare_trimming_body
from tpmscad.trimming.rebuild.lattice_faces import build_lattice_faces
from tpmscad.trimming.rebuild.trimmed_brep import assemble_trimmed_brep, build_edge_table, find_cap_boundary

DEFAULT_TOL = 1e-7
"""Kernels give every edge at least this tolerance, in model units: a better curve gains nothing there."""

SNAP_TOLS = 2.0
"""A vertex nearer to a surface than this many tolerances lies on it: no edge comes out shorter."""

FIT_FRACTION_OF_TOL = 0.5
"""Curves are fitted to this part of the tolerance: a vertex of two of them is as far from each again."""

SHIFT_ATTEMPTS = (0.0, 1.0, -1.0, 2.0)
"""Attempts: the lattice moved along `WAY` by this many `SHIFT` tolerances where a cut can't be resolved."""

SHIFT_STEP_TOLS = 10.0

SHIFT_DIRECTION = np.array([0.59, 0.41, 0.70])
"""No direction of symmetry, and of about unit length."""


@dataclass(frozen=True, slots=True)
class TrimReport:
    """How a trim went.

    Classes of (patch, surface) and of (edge, surface), distinct curves and the most poles among them, the greatest distance of a
    curve from its patch, how far the lattice had to be moved (model units; mostly 0), and why.
    """

    n_patch_classes: int
    n_edge_classes: int
    curves: int
    max_poles: int
    max_deviation: float
    shifted: float
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class TrimResult:
    """The closed complex and how it was made."""

    brep: Brep
    report: TrimReport


def trim_box(
    lattice: Brep,
    lo: ArrayLike,
    hi: ArrayLike,
    tol: float | None = None,
    inside: Callable[[Array], Array] | None = None,
) -> Brep:
    """The part of the lattice's solid in the box from lo to hi: the complex of `trim`."""
    return trim(lattice, tools.box(lo, hi), tol, inside).brep


def trim(
    lattice: Brep,
    body: Brep,
    tol: float | None = None,
    inside: Callable[[Array], Array] | None = None,
    *,
    apart: bool = False,
) -> TrimResult:
    """The common part of the lattice's solid and the body: a closed complex, the body's faces tagged "cap".

    lattice: whole patches that cover the body and may be ragged outside; outward senses. body: a closed complex of planes,
    cylinders, cones, spheres and tori, convex or not. tol: greatest distance between a cut curve and its carriers, model units,
    by default `TOLERANCE`. inside(points (n, 3)) -> (n,) bool tells solid from void where no edge of the body meets the lattice;
    without it the nearest point of the lattice does. apart: the lattice is moved where a side of a patch touches a face of the
    body, too: cuts then keep clear of sides.

    InvalidRequest if the lattice is not of whole patches, or the body not closed; TrimmingError if the lattice does not cover
    the body, or if a cut is not resolved even with the lattice moved by a few tolerances (such moves are reported).
    """
    tol = DEFAULT_TOL if tol is None else tol
    if not (np.isfinite(tol) and tol > 0):
        raise InvalidRequest(f"tol must be positive and finite, not {tol}")
    sides, ready = read_patch_sides(lattice), prepare_trimming_body(body)
    faces = build_face_regions(ready)
    reason = ""
    for attempt in SHIFT_ATTEMPTS:
        by = attempt * SHIFT_STEP_TOLS * tol
        try:
            brep, report = _trim_once(
                translate_brep(lattice, by * SHIFT_DIRECTION) if attempt else lattice,
                sides,
                ready,
                faces,
                tol,
                inside,
                apart,
            )
        except (TrimmingError, LoopError) as error:
            reason = reason or str(error)
            continue
        return TrimResult(brep, replace(report, shifted=abs(by), reason=reason))
    raise TrimmingError(reason)


def _trim_once(
    lattice: Brep,
    sides: PatchSides,
    body: TrimmingBody,
    faces: list[FaceRegion],
    tol: float,
    inside: Callable[[Array], Array] | None,
    apart: bool,
) -> tuple[Brep, TrimReport]:
    snap = SNAP_TOLS * tol
    k = body.n_surfaces
    strands, own = read_edge_segments(lattice), read_spline_curves(lattice)
    near = find_candidate_pairs(lattice, body, faces)
    on = np.abs(body.levels.distances(lattice.vertices)) < snap
    crossings = intersect_segments(
        own,
        strands,
        body.levels,
        on,
        _select_candidate_edges(near, sides, len(strands), body),
        snap,
        ZERO_FRACTION_OF_TOL * tol,
    )
    if apart:
        check_tangencies(own, strands, crossings, body, faces)
    vertex, points = assign_root_vertices(own, strands, crossings, len(lattice.vertices), snap)
    vertices = np.vstack([lattice.vertices, points])

    surfaces = body.levels.of(np.arange(k))
    cuts = intersect_patches(
        lattice, sides, surfaces, near, on, crossings, vertex, len(vertices), FIT_FRACTION_OF_TOL * tol
    )
    vertices = np.vstack([vertices, cuts.points])
    on = np.abs(body.levels.distances(vertices)) < snap
    curves = (*own, *(c.curve for c in cuts.fitted_arcs))
    tracks = collect_intersection_curves(lattice, cuts, crossings)
    wanted = _select_separating_surfaces(body, tracks)
    roots = intersect_segments(curves, tracks.curve_segments, body.levels, on, wanted, snap, ZERO_FRACTION_OF_TOL * tol)
    hits = intersect_body_edges(lattice, body, cuts, tracks, curves, roots, crossings, vertex, vertices, on, tol, snap)
    vertices = np.vstack([vertices, hits.points])

    pieces = split_segments(tracks.curve_segments, hits.curve_index, hits.root, hits.root_vertex)
    label, label_of = classify_intersection_curves(body, faces, tracks, pieces, curves, hits, len(vertices))
    hit = np.zeros(len(vertices), bool)
    hit[[*hits.vertex.tolist(), *hits.corner.values()]] = True
    keys = [*label_of, *collect_face_sectors(body, hits)]
    real = np.array([v * len(body.levels) + s for v, s in keys], np.int64)
    edge_pieces = _split_lattice_edges(strands, real, body, crossings, vertex, tracks, hits)
    flat = _label_coincident_edges(tracks, pieces, label, edge_pieces)
    ends = _collect_arc_end_vertices(tracks, pieces, label)

    def in_body(points: Array) -> BoolArray:
        return points_in_body(body, faces, points)

    def in_lattice(points: Array) -> BoolArray:
        return points_in_lattice(lattice, sides, points) if inside is None else np.asarray(inside(points), bool)

    states = classify_lattice_edges(
        lattice, sides, body, cuts, crossings, vertex, label_of, hit, edge_pieces, flat, ends, strands, in_body
    )
    inner = build_lattice_faces(lattice, sides, body, cuts, tracks, edge_pieces, states, pieces, label)
    edges = build_edge_table(lattice, cuts, crossings, tracks, edge_pieces, pieces, curves, vertices)
    open_ = find_cap_boundary(inner, lattice.faces.sense, edges, np.concatenate([flat, label]))
    brep = assemble_trimmed_brep(
        lattice, body, faces, cuts, hits, inner, edges, open_, curves, vertices, FIT_FRACTION_OF_TOL * tol, in_lattice
    )
    if len(unmatched := connectivity.find_unmatched_edges(brep)):
        at = brep.vertices[brep.edges.start[unmatched[0]]]
        raise TrimmingError(
            f"{len(unmatched)} edges of the trimmed lattice are not used twice, the first at {at.round(6)}"
        )
    report = TrimReport(
        n_patch_classes=cuts.n_classes,
        n_edge_classes=crossings.n_classes,
        curves=len(cuts.fitted_arcs),
        max_poles=max((len(c.curve.poles) for c in cuts.fitted_arcs), default=0),
        max_deviation=float(brep.edges.deviation.max(initial=0.0)),
        shifted=0.0,
        reason="",
    )
    return brep, report


def _select_candidate_edges(near: BoolArray, sides: PatchSides, n_edges: int, body: TrimmingBody) -> BoolArray:
    """The edges of patches near surfaces, and no fences: (E, levels)."""
    wanted = np.zeros((n_edges, len(body.levels)), bool)
    face, surface = np.nonzero(near)
    for side in range(4):
        wanted[sides.edge[face, side], surface] = True
    return wanted


def _select_separating_surfaces(body: TrimmingBody, tracks: IntersectionCurves) -> BoolArray:
    """The companions that tracks may meet; lattice edges in a surface have their roots on other surfaces already."""
    of_surface = np.zeros((body.n_surfaces, len(body.levels)), bool)
    surface = body.surface[body.face_of_use[body.uses]]
    of_surface[surface, body.separating_surface] = True
    wanted = of_surface[tracks.surface]
    wanted[tracks.edge >= 0, : body.n_surfaces] = False
    return wanted


def _split_lattice_edges(
    strands: CurveSegments,
    real: IntArray,
    body: TrimmingBody,
    crossings: CurveSurfaceIntersections,
    vertex: IntArray,
    tracks: IntersectionCurves,
    hits: BodyEdgeIntersections,
) -> SubSegments:
    """The lattice's edges split at roots that are on the body: `real` are their vertices and surfaces, as one number."""
    key = vertex * len(body.levels) + crossings.root_surface
    r = np.flatnonzero(np.isin(key, real))
    h = np.flatnonzero(tracks.edge[hits.curve_index] >= 0)
    return split_segments(
        strands,
        np.concatenate([crossings.root_segment[r], tracks.edge[hits.curve_index[h]]]),
        np.concatenate([crossings.root[r], hits.root[h]]),
        np.concatenate([vertex[r], hits.root_vertex[h]]),
    )


def _label_coincident_edges(
    tracks: IntersectionCurves, pieces: SubSegments, label: IntArray, edge_pieces: SubSegments
) -> IntArray:
    """The face of the body that each piece of a lattice edge lies on, or -1: (M,)."""
    result = np.full(len(edge_pieces.segment), -1)
    for i in np.flatnonzero((label >= 0) & (tracks.edge[pieces.segment] >= 0)).tolist():
        edge, (low, high) = tracks.edge[pieces.segment[i]], pieces.span[i]
        own = np.arange(edge_pieces.first[edge], edge_pieces.first[edge + 1])
        middle = edge_pieces.span[own].mean(axis=1)
        inner = own[(middle > low) & (middle < high)]
        if (result[inner] >= 0).any():
            raise TrimmingError("an edge of the lattice lies along two faces of the body")
        result[inner] = label[i]
    return result


def _collect_arc_end_vertices(tracks: IntersectionCurves, pieces: SubSegments, label: IntArray) -> set[tuple[int, int]]:
    """By patch, the vertices in which arcs on the body end."""
    i = np.flatnonzero((label >= 0) & (tracks.face[pieces.segment] >= 0))
    face = tracks.face[pieces.segment[i]].tolist()
    return set(zip(face, pieces.start[i].tolist(), strict=True)) | set(zip(face, pieces.end[i].tolist(), strict=True))
