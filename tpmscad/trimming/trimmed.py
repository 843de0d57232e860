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

from tpmscad.errors import InvalidRequest
from tpmscad.patches import connectivity
from tpmscad.patches.complex import PatchComplex
from tpmscad.trimming import tool as tools
from tpmscad.trimming.assembly import all_edges, assemble, open_edges
from tpmscad.trimming.body import Body, prepared
from tpmscad.trimming.cuts import cut_patches
from tpmscad.trimming.faces import inner_faces
from tpmscad.trimming.hits import Hits, find_hits
from tpmscad.trimming.labels import labels, sectors_at_hits
from tpmscad.trimming.pieces import Pieces, root_vertices, split
from tpmscad.trimming.reach import near_patches
from tpmscad.trimming.regions import Region, inside_body, regions
from tpmscad.trimming.sides import Sides, read_sides, spline_curves
from tpmscad.trimming.solid import in_solid
from tpmscad.trimming.states import edge_states, lattice_strands
from tpmscad.trimming.strands import FLAT, Crossings, Strands, cross
from tpmscad.trimming.tool import Array, Flags, Ints, TrimmingError
from tpmscad.trimming.touches import check_touches
from tpmscad.trimming.tracks import Tracks, all_tracks

TOLERANCE = 1e-7
"""Kernels give every edge at least this tolerance, in model units: a better curve gains nothing there."""

SNAP = 2.0
"""A vertex nearer to a surface than this many tolerances lies on it: no edge comes out shorter."""

FIT = 0.5
"""Curves are fitted to this part of the tolerance: a vertex of two of them is as far from each again."""

SHIFTS = (0.0, 1.0, -1.0, 2.0)
"""Attempts: the lattice moved along `WAY` by this many `SHIFT` tolerances where a cut can't be resolved."""

SHIFT = 10.0

WAY = np.array([0.59, 0.41, 0.70])
"""No direction of symmetry, and of about unit length."""


@dataclass(frozen=True, slots=True)
class Report:
    """How a trim went.

    Classes of (patch, surface) and of (edge, surface), distinct curves and the most poles among them, the greatest distance of a
    curve from its patch, how far the lattice had to be moved (model units; mostly 0), and why.
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
    lattice: PatchComplex,
    body: PatchComplex,
    tol: float | None = None,
    inside: Callable[[Array], Array] | None = None,
    *,
    apart: bool = False,
) -> Trimmed:
    """The common part of the lattice's solid and the body: a closed complex, the body's faces tagged "cap".

    lattice: whole patches that cover the body and may be ragged outside; outward senses. body: a closed complex of planes,
    cylinders, cones, spheres and tori, convex or not. tol: greatest distance between a cut curve and its carriers, model units,
    by default `TOLERANCE`. inside(points (n, 3)) -> (n,) bool tells solid from void where no edge of the body meets the lattice;
    without it the nearest point of the lattice does. apart: the lattice is moved where a side of a patch touches a face of the
    body, too: cuts then keep clear of sides.

    InvalidRequest if the lattice is not of whole patches, or the body not closed; TrimmingError if the lattice does not cover
    the body, or if a cut is not resolved even with the lattice moved by a few tolerances (such moves are reported).
    """
    tol = TOLERANCE if tol is None else tol
    if not (np.isfinite(tol) and tol > 0):
        raise InvalidRequest(f"tol must be positive and finite, not {tol}")
    sides, ready = read_sides(lattice), prepared(body)
    faces = regions(ready)
    reason = ""
    for attempt in SHIFTS:
        by = attempt * SHIFT * tol
        try:
            complex, report = _trim(
                moved(lattice, by * WAY) if attempt else lattice, sides, ready, faces, tol, inside, apart
            )
        except TrimmingError as error:
            reason = reason or str(error)
            continue
        return Trimmed(complex, replace(report, shifted=abs(by), reason=reason))
    raise TrimmingError(reason)


def moved(complex: PatchComplex, by: Array) -> PatchComplex:
    """The complex, moved."""
    return replace(
        complex,
        vertices=complex.vertices + by,
        edges=replace(complex.edges, translation=complex.edges.translation + by),
        faces=replace(complex.faces, translation=complex.faces.translation + by),
    )


def _trim(
    lattice: PatchComplex,
    sides: Sides,
    body: Body,
    faces: list[Region],
    tol: float,
    inside: Callable[[Array], Array] | None,
    apart: bool,
) -> tuple[PatchComplex, Report]:
    snap = SNAP * tol
    k = body.n_surfaces
    strands, own = lattice_strands(lattice), spline_curves(lattice)
    near = near_patches(lattice, body, faces)
    on = np.abs(body.levels.distances(lattice.vertices)) < snap
    crossings = cross(own, strands, body.levels, on, _edges_of(near, sides, len(strands), body), snap, FLAT * tol)
    if apart:
        check_touches(own, strands, crossings, body, faces)
    vertex, points = root_vertices(own, strands, crossings, len(lattice.vertices), snap)
    vertices = np.vstack([lattice.vertices, points])

    surfaces = body.levels.of(np.arange(k))
    cuts = cut_patches(lattice, sides, surfaces, near, on, crossings, vertex, len(vertices), FIT * tol)
    vertices = np.vstack([vertices, cuts.points])
    on = np.abs(body.levels.distances(vertices)) < snap
    curves = (*own, *(c.curve for c in cuts.cuts))
    tracks = all_tracks(lattice, cuts, crossings)
    wanted = _companions(body, tracks)
    roots = cross(curves, tracks.strands, body.levels, on, wanted, snap, FLAT * tol)
    hits = find_hits(lattice, body, cuts, tracks, curves, roots, crossings, vertex, vertices, on, tol, snap)
    vertices = np.vstack([vertices, hits.points])

    pieces = split(tracks.strands, hits.track, hits.root, hits.root_vertex)
    label, label_of = labels(body, faces, tracks, pieces, curves, hits, len(vertices))
    hit = np.zeros(len(vertices), bool)
    hit[[*hits.vertex.tolist(), *hits.corner.values()]] = True
    keys = [*label_of, *sectors_at_hits(body, hits)]
    real = np.array([v * len(body.levels) + s for v, s in keys], np.int64)
    edge_pieces = _split_edges(strands, real, body, crossings, vertex, tracks, hits)
    flat = _flat_pieces(tracks, pieces, label, edge_pieces)
    ends = _ends_of_arcs(tracks, pieces, label)

    def in_body(points: Array) -> Flags:
        return inside_body(body, faces, points)

    def in_lattice(points: Array) -> Flags:
        return in_solid(lattice, sides, points) if inside is None else np.asarray(inside(points), bool)

    states = edge_states(
        lattice, sides, body, cuts, crossings, vertex, label_of, hit, edge_pieces, flat, ends, strands, in_body
    )
    inner = inner_faces(lattice, sides, body, cuts, tracks, edge_pieces, states, pieces, label)
    edges = all_edges(lattice, cuts, crossings, tracks, edge_pieces, pieces, curves, vertices)
    open_ = open_edges(inner, lattice.faces.sense, edges, np.concatenate([flat, label]))
    complex = assemble(lattice, body, faces, cuts, hits, inner, edges, open_, curves, vertices, FIT * tol, in_lattice)
    if len(unmatched := connectivity.unmatched_edges(complex)):
        at = complex.vertices[complex.edges.start[unmatched[0]]]
        raise TrimmingError(
            f"{len(unmatched)} edges of the trimmed lattice are not used twice, the first at {at.round(6)}"
        )
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


def _edges_of(near: Flags, sides: Sides, n_edges: int, body: Body) -> Flags:
    """The edges of patches near surfaces, and no fences: (E, levels)."""
    wanted = np.zeros((n_edges, len(body.levels)), bool)
    face, surface = np.nonzero(near)
    for side in range(4):
        wanted[sides.edge[face, side], surface] = True
    return wanted


def _companions(body: Body, tracks: Tracks) -> Flags:
    """The companions that tracks may meet; lattice edges in a surface have their roots on other surfaces already."""
    of_surface = np.zeros((body.n_surfaces, len(body.levels)), bool)
    surface = body.surface[body.face_of_use[body.uses]]
    of_surface[surface, body.companion] = True
    wanted = of_surface[tracks.surface]
    wanted[tracks.edge >= 0, : body.n_surfaces] = False
    return wanted


def _split_edges(
    strands: Strands, real: Ints, body: Body, crossings: Crossings, vertex: Ints, tracks: Tracks, hits: Hits
) -> Pieces:
    """The lattice's edges split at roots that are on the body: `real` are their vertices and surfaces, as one number."""
    key = vertex * len(body.levels) + crossings.root_surface
    r = np.flatnonzero(np.isin(key, real))
    h = np.flatnonzero(tracks.edge[hits.track] >= 0)
    return split(
        strands,
        np.concatenate([crossings.root_strand[r], tracks.edge[hits.track[h]]]),
        np.concatenate([crossings.root[r], hits.root[h]]),
        np.concatenate([vertex[r], hits.root_vertex[h]]),
    )


def _flat_pieces(tracks: Tracks, pieces: Pieces, label: Ints, edge_pieces: Pieces) -> Ints:
    """The face of the body that each piece of a lattice edge lies on, or -1: (M,)."""
    result = np.full(len(edge_pieces.strand), -1)
    for i in np.flatnonzero((label >= 0) & (tracks.edge[pieces.strand] >= 0)).tolist():
        edge, (low, high) = tracks.edge[pieces.strand[i]], pieces.span[i]
        own = np.arange(edge_pieces.first[edge], edge_pieces.first[edge + 1])
        middle = edge_pieces.span[own].mean(axis=1)
        inner = own[(middle > low) & (middle < high)]
        if (result[inner] >= 0).any():
            raise TrimmingError("an edge of the lattice lies along two faces of the body")
        result[inner] = label[i]
    return result


def _ends_of_arcs(tracks: Tracks, pieces: Pieces, label: Ints) -> set[tuple[int, int]]:
    """By patch, the vertices in which arcs on the body end."""
    i = np.flatnonzero((label >= 0) & (tracks.face[pieces.strand] >= 0))
    face = tracks.face[pieces.strand[i]].tolist()
    return set(zip(face, pieces.start[i].tolist(), strict=True)) | set(zip(face, pieces.end[i].tolist(), strict=True))
