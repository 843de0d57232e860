"""Closed triangle meshes of OCCT solids that keep a deviation, welded by topology.

Edges are divided first, each once for all faces that it bounds, so that its chords keep the deviation (`edge_division`). OCCT
triangulates each face by itself on these nodes (`face_triangulation`). Triangles that miss the deviation, which OCCT does not
bound, are halved (`refine_triangles`). Nodes are identified along shared edges and at shared vertices, and where OCCT itself has
made one node of two, never by distance, so that a mesh of a closed solid is closed whatever the size of its triangles. A
degenerate edge (the pole of a sphere) becomes one node, and the triangles that this collapses are left out.

Of faces that are congruent one is triangulated, and its triangles are moved to the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.linked_items import label_linked
from tpmscad.brep.triangles.closed_mesh import SolidMesh
from tpmscad.brep.triangles.measured_deviation import (
    FaceTriangles,
    pair_sides,
    refine_triangles,
)
from tpmscad.errors import KernelError
from tpmscad.index_ranges import expand_ranges
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.export.chord_crossings import find_crossing_uses
from tpmscad.kernel.export.edge_division import (
    EdgeDivision,
    FaceOutlines,
    count_least_chords,
    divide_edges,
    explore_faces,
    outline_built_solids,
)
from tpmscad.kernel.export.face_triangulation import FaceMesh, mesh_on_nodes
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import (
    ShapeKey,
    faces_of,
    first_vertex,
    last_vertex,
    solids_of,
    unwrap,
)
from tpmscad.kernel.occt.geometry_evaluators import SurfaceTable, face_evaluator, pack_surfaces
from tpmscad.memory_limit import require_memory

MAX_REFINEMENTS = 3
"""Attempts with edges and faces of half the deviation when OCCT leaves a face without triangles, or triangles do not cover it."""

MAX_CROSSING_ROUNDS = 16
"""Times that edges whose chords cross are divided further, a quarter of the sagitta each: one of two edges at a time."""

MAX_SPLIT_PASSES = 20
"""Passes over chords that are split; each splits one chord of a triangle."""

COARSE_FACTOR = 2.0
"""Deflection that OCCT is given for the inside of faces, in deviations: halving, which follows, makes fewer triangles."""

CLASS_RESOLUTION_FRACTION = 1e-3
"""In deviations: faces that differ by less are congruent; what the nodes of their edges differ by is added to the deviation."""

LEAST_CLASS_RESOLUTION = 1e-11
"""In extents of the vertices: the least difference of congruent faces."""

LEAST_DEFLECTION = 1e-5
"""In extents of the vertices: OCCT is given no less for the inside of faces, as it takes memory without asking."""

BYTES_PER_TRIANGLE = 250
"""Memory taken at the peak for each triangle, as measured."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredMeshes:
    """A closed mesh of each solid, and the greatest distance of their triangles from the faces, and of chords from edges."""

    meshes: tuple[SolidMesh, ...]
    deviation: float


def mesh_solids(shape: Any, deviation: float, angle: float) -> tuple[SolidMesh, ...]:
    """A closed mesh of each solid, within `deviation` of faces and edges, its facets turned by about `angle` (rad) at most.

    Where the edges of a body lie beside its faces by more, the triangles between them do, too. The triangulation that the shape
    may carry is neither used nor changed. Raises KernelError if OCCT cannot close a mesh.
    """
    return measure_meshes(shape, deviation, angle, tolerant=True).meshes


def measure_meshes(
    source: Any | Sequence[BrepSolids], deviation: float, angle: float, *, tolerant: bool = False
) -> MeasuredMeshes:
    """As `mesh_solids`, with the deviation that was reached; KernelError if it is missed, but where `tolerant`.

    Of solids that were built from arrays, given as such, one face of each class of congruent faces is triangulated.
    """
    if isinstance(source, list | tuple):
        size = max(float(np.ptp(of.brep.vertices, axis=0).max()) for of in source)
        resolution = max(CLASS_RESOLUTION_FRACTION * deviation, LEAST_CLASS_RESOLUTION * size)
        outlines = outline_built_solids(source, resolution)
    else:
        outlines = explore_faces([faces_of(solid) for solid in solids_of(unwrap(source))])
    for attempt in range(MAX_REFINEMENTS + 1):
        try:
            triangulation = triangulate_outlines(outlines, deviation / 2**attempt, angle, deviation)
        except KernelError:  # other nodes may do
            if attempt == MAX_REFINEMENTS:
                raise
            continue
        expanded = triangulation.expand(outlines)
        reached = triangulation.reached + expanded.gap
        if outlines.motion is not None and triangulation.reached <= deviation < reached:
            shape = make_compound(solid for of in source for solid in of.solids)
            return measure_meshes(shape, deviation, angle)  # edges of congruent faces differ by their tolerances
        if reached > deviation and not tolerant:
            continue
        meshes = tuple(_drop_collapsed(_collect(*of, expanded)) for of in outlines.solids)
        if meshes and not any(count_open_sides(mesh.triangles) for mesh in meshes):
            return MeasuredMeshes(meshes, reached)
    missed = triangulation.reached > deviation
    what = (
        f"edges lie up to {triangulation.reached:.3g} off their faces, more than deviation = {deviation:g}: raise it"
        if missed
        else f"no closed mesh within {deviation:g} of the faces: try another deviation"
    )
    raise KernelError("triangulate", what, outlines.sources[triangulation.worst] if outlines.sources else None)


@dataclass(frozen=True, slots=True, eq=False)
class FaceTriangulation:
    """Triangles of the representatives, their nodes sorted by these, with the nodes along each use of an edge and at poles.

    surfaces: of the representatives. begin: where the nodes of each begin, and their number. reached: greatest distance of
    triangles from faces and of chords from edges. worst: the representative with the greatest distance.
    """

    mesh: FaceTriangles
    surfaces: SurfaceTable
    begin: IntArray
    lines: list[list[IntArray]]
    poles: list[list[tuple[IntArray, int]]]
    division: EdgeDivision
    reached: float
    worst: int

    def expand(self, outlines: FaceOutlines) -> _ExpandedTriangles:
        """Triangles of each face on points that all faces share."""
        division, mesh, ends = self.division, self.mesh, outlines.ends
        n_edges = len(outlines.points) + int((division.chords - 1).sum())
        n_sources = len(outlines.sources)
        copies = np.argsort(outlines.of_face, kind="stable")
        limits = np.searchsorted(outlines.of_face[copies], np.arange(n_sources + 1))
        order = np.argsort(mesh.face, kind="stable")
        rows = np.searchsorted(mesh.face[order], np.arange(n_sources + 1))
        start = np.concatenate([[0], np.cumsum(np.diff(rows)[outlines.of_face])])
        count = float(start[-1])
        require_memory(count, BYTES_PER_TRIANGLE, f"{count:.3g} triangles", "raise the deviation")
        points, total, gap = [np.full((n_edges, 3), np.nan)], n_edges, 0.0
        merged = [np.zeros((0, 2), np.int64)]
        points[0][: len(outlines.points)] = outlines.points
        every = np.empty((int(count), 3), np.int64)
        for r in range(n_sources):
            own, begin = copies[limits[r] : limits[r + 1]], self.begin[r]
            nodes, assigned = np.full((len(own), self.begin[r + 1] - begin), -1), list[tuple[IntArray, IntArray]]()
            for u, line in enumerate(self.lines[r]):
                edge = outlines.uses[outlines.use_start[own] + u]
                back = outlines.turned[outlines.use_start[own] + u][:, None]
                inner = division.first[edge][:, None] + np.arange(division.chords[edge[0]] - 1)
                along = np.concatenate([ends[edge][:, :1], inner, ends[edge][:, 1:]], axis=1)
                along = np.where(back, along[:, ::-1], along)
                assigned.append((line - begin, along))
                nodes[:, line - begin] = along
            for pole, node in self.poles[r]:
                nodes[:, pole - begin] = nodes[:, node - begin, None]
            inside = np.flatnonzero(nodes[0] < 0)
            nodes[:, inside] = total + np.arange(len(own) * len(inside)).reshape(len(own), -1)
            total += len(own) * len(inside)
            placed = mesh.points[begin : self.begin[r + 1]]
            moved = placed[None] if outlines.motion is None else outlines.motion[own][:, None].apply(placed)
            points.append(moved[:, inside].reshape(-1, 3))
            for line, along in assigned:
                known = points[0][along]
                points[0][along] = np.where(np.isnan(known), moved[:, line], known)
                gap = max(gap, float(np.nan_to_num(np.abs(known - moved[:, line])).max(initial=0.0)))
                merged.append(np.stack([nodes[:, line], along], axis=-1)[nodes[:, line] != along])
            triangles = mesh.triangles[order[rows[r] : rows[r + 1]]] - begin
            every[start[own][:, None] + np.arange(len(triangles))] = nodes[:, triangles]
        places, pairs = np.concatenate(points), np.concatenate(merged)
        same = np.arange(len(places))
        if len(pairs):
            component = label_linked(len(places), pairs)
            same = np.unique(component, return_index=True)[1][component]
            gap = max(gap, float(np.linalg.norm(places - places[same], axis=1).max()))
            every = same[every]
        return _ExpandedTriangles(every, start, places, same, gap)


@dataclass(frozen=True, slots=True, eq=False)
class _ExpandedTriangles:
    """Triangles (m, 3) on common points, those of face i from start[i] on.

    same: for each point the one that stands for it, where OCCT has made one node of those that are closer than it resolves. gap:
    how far nodes of edges, of copies or merged ones, lie from the points that stand for them.
    """

    triangles: IntArray
    start: IntArray
    points: Array
    same: IntArray
    gap: float


def triangulate_outlines(
    outlines: FaceOutlines,
    deviation: float,
    angle: float,
    limit: float | None = None,
    extremum_tol: float | None = None,
) -> FaceTriangulation:
    """Triangles of the representatives, halved as far as that helps them to keep `limit`, if one is given.

    extremum_tol: see `divide_edges`. Where chords cross, or OCCT leaves a face without triangles, edges are divided further.
    """
    every = range(len(outlines.sources))
    least = count_least_chords(outlines)
    size = float(np.ptp(outlines.points, axis=0).max(initial=0.0))
    deflection = np.full(len(every), deviation if limit is None else COARSE_FACTOR * deviation)
    deflection = np.maximum(deflection, LEAST_DEFLECTION * size)
    due, found, used = list(every), dict[int, FaceMesh](), dict[int, IntArray]()
    attempts, rounds = np.zeros(len(every), np.int64), 0
    while True:
        division = divide_edges(outlines, deviation, angle, least, extremum_tol)
        due = [r for r in every if r in due or (division.chords[outlines.uses_of(r)] != used[r]).any()]
        used |= {r: division.chords[outlines.uses_of(r)] for r in due}
        lines = {r: [division.placed[e] for e in outlines.uses_of(r).tolist()] for r in due}
        crossing = {
            r: find_crossing_uses(outlines.sources[r], lines[r], outlines.ends[outlines.uses_of(r)]) for r in due
        }
        failed = {r: uses for r, uses in crossing.items() if uses.any()}
        sound = [r for r in due if r not in failed]
        for size in np.unique(deflection[sound]).tolist():
            chosen = [r for r in sound if deflection[r] == size]
            faces = [outlines.sources[r] for r in chosen]
            meshes = mesh_on_nodes(faces, [lines[r] for r in chosen], size, angle)
            found |= {r: mesh for r, mesh in zip(chosen, meshes, strict=True) if isinstance(mesh, FaceMesh)}
            left = {r: mesh for r, mesh in zip(chosen, meshes, strict=True) if not isinstance(mesh, FaceMesh)}
            attempts[list(left)] += 1
            deflection[list(left)] *= 0.5
            failed |= left
        for r, uses in failed.items():
            edges = outlines.uses_of(r)
            edges = edges[uses] if uses.any() else edges
            least[edges] = 2 * division.chords[edges]
            found.pop(r, None)
        due = [r for r in every if r not in found]
        if not due:
            break
        rounds += 1
        if rounds > MAX_CROSSING_ROUNDS or attempts.max() > MAX_REFINEMENTS:
            face = outlines.sources[due[0]]
            raise KernelError("triangulate", f"no mesh of a face within {deviation:g}: try another deviation", face)
    return _join(outlines, division, [found[r] for r in every], limit)


def _join(
    outlines: FaceOutlines,
    division: EdgeDivision,
    meshes: list[FaceMesh],
    limit: float | None,
) -> FaceTriangulation:
    """The triangles of all representatives as one, halved until they keep the limit."""
    surfaces = pack_surfaces([face_evaluator(face) for face in outlines.sources])
    sizes = [len(mesh.uv) for mesh in meshes]
    begin = np.cumsum([0, *sizes])
    owner = np.repeat(np.arange(len(meshes)), sizes)
    uv = np.concatenate([mesh.uv for mesh in meshes])
    points = surfaces(owner, uv)[0]
    lines, poles = [], []
    for r, mesh in enumerate(meshes):
        at_vertex: dict[ShapeKey, int] = {}
        lines.append([begin[r] + line for line in mesh.lines])
        for line, e in zip(lines[-1], outlines.uses_of(r).tolist(), strict=True):
            points[line] = division.placed[e][1]
            edge = outlines.edges[e]
            at_vertex |= {ShapeKey(first_vertex(edge)): int(line[0]), ShapeKey(last_vertex(edge)): int(line[-1])}
        # the pole is the vertex of the copy of the face, which the face shares with its other edges
        poles.append([(begin[r] + nodes, _find_pole(points, begin[r] + nodes, at_vertex)) for nodes, _ in mesh.poles])
        for nodes, node in poles[-1]:
            points[nodes] = points[node]
    triangles = np.concatenate([mesh.triangles + start for mesh, start in zip(meshes, begin.tolist(), strict=False)])
    face = np.repeat(np.arange(len(meshes)), [len(mesh.triangles) for mesh in meshes])
    whole = FaceTriangles(points, uv, triangles, face, pair_sides(triangles, len(points)))
    bound = np.zeros(len(meshes))
    if limit is not None:
        whole, bound = refine_triangles(whole, surfaces, len(meshes), limit)
    return _sort_nodes(whole, surfaces, begin, lines, poles, division, bound)


def _find_pole(points: Array, nodes: IntArray, at_vertex: dict[ShapeKey, int]) -> int:
    """The node at a vertex that the nodes of a degenerate edge coincide with."""
    ends = np.array(list(at_vertex.values()))
    return int(ends[np.linalg.norm(points[ends] - points[nodes[0]], axis=1).argmin()])


def _sort_nodes(
    mesh: FaceTriangles,
    surfaces: SurfaceTable,
    begin: IntArray,
    lines: list[list[IntArray]],
    poles: list[list[tuple[IntArray, int]]],
    division: EdgeDivision,
    bound: Array,
) -> FaceTriangulation:
    """The triangulation with its nodes face by face, those that halving has added behind the others of their face."""
    owner = np.zeros(len(mesh.points), np.int64)
    owner[mesh.triangles] = mesh.face[:, None]
    owner[: begin[-1]] = np.repeat(np.arange(len(begin) - 1), np.diff(begin))
    order = np.argsort(owner, kind="stable")
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    limits = np.searchsorted(owner[order], np.arange(len(begin)))
    return FaceTriangulation(
        FaceTriangles(mesh.points[order], mesh.uv[order], number[mesh.triangles], mesh.face, mesh.twin),
        surfaces,
        limits,
        [[number[line] for line in own] for own in lines],
        [[(number[nodes], int(number[node])) for nodes, node in own] for own in poles],
        division,
        max(float(bound.max(initial=0.0)), division.deviation),
        int(bound.argmax()) if len(bound) else 0,
    )


def _collect(faces: IntArray, turned: BoolArray, expanded: _ExpandedTriangles) -> SolidMesh:
    """The mesh of faces, some of them seen from behind, on the points that it uses."""
    face, row = expand_ranges(expanded.start[faces], expanded.start[faces + 1])
    triangles = expanded.triangles[row]
    back = turned[face]
    triangles[back] = triangles[back, ::-1]
    used = np.zeros(len(expanded.points), bool)
    used[triangles] = True
    return SolidMesh(expanded.points[used], (np.cumsum(used) - 1)[triangles], face)


def count_open_sides(triangles: IntArray) -> int:
    """Number of sides of triangles (m, 3) that no other triangle runs through in the opposite direction exactly once."""
    tail, head = triangles.ravel().astype(np.int64), np.roll(triangles, -1, axis=1).ravel().astype(np.int64)
    n = int(triangles.max(initial=0)) + 1
    along, against = np.sort(tail * n + head), np.sort(head * n + tail)
    repeated = int((along[1:] == along[:-1]).sum())
    if not repeated and np.array_equal(along, against):
        return 0
    return max(1, len(np.setxor1d(along, against)), repeated)


def _drop_collapsed(mesh: SolidMesh) -> SolidMesh:
    """The mesh without triangles that have a node twice, and without repeated chords."""
    proper = (mesh.triangles != np.roll(mesh.triangles, 1, axis=1)).all(axis=1)
    return _split_repeated_chords(SolidMesh(mesh.points, mesh.triangles[proper], mesh.face[proper]))


def _split_repeated_chords(mesh: SolidMesh) -> SolidMesh:
    """The mesh with every chord that more than two triangles share split at its middle, face by face but for one.

    Where two faces are close to tangent along their common edge, both may have a chord between the same two of its nodes. The
    surface of the mesh stays the same.
    """
    points, triangles, owner = mesh.points, mesh.triangles, mesh.face
    for _ in range(MAX_SPLIT_PASSES):
        ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
        _, chord, uses = np.unique(ends[:, 0] * len(points) + ends[:, 1], return_inverse=True, return_counts=True)
        repeated = np.flatnonzero(uses[chord] > 2)
        if len(repeated) == 0:
            break
        of_face: dict[tuple[int, int], list[int]] = {}
        for side in repeated.tolist():
            of_face.setdefault((int(chord[side]), int(owner[side // 3])), []).append(side)
        touched = set[int]()
        kept = {number for (number, _), sides in of_face.items() if len(sides) != 2}  # an edge between faces stays
        made: list[tuple[int, int, int]] = []
        makers: list[int] = []
        middles: list[Array] = []
        for (number, _), sides in of_face.items():
            members = {side // 3 for side in sides}
            if len(sides) != 2 or members & touched:
                kept.add(number)
                continue
            if number not in kept:
                kept.add(number)  # the first face keeps its chord
                continue
            touched |= members
            middle = len(points) + len(middles)
            middles.append(points[ends[sides[0]]].mean(axis=0))
            for side in sides:
                t, k = divmod(side, 3)
                a, b, c = (int(triangles[t, (k + i) % 3]) for i in range(3))
                made += [(a, middle, c), (middle, b, c)]
                makers += [int(owner[t])] * 2
        if not made:
            break
        rest = np.setdiff1d(np.arange(len(triangles)), list(touched))
        points = np.concatenate([points, middles])
        triangles = np.concatenate([triangles[rest], made])
        owner = np.concatenate([owner[rest], makers])
    return SolidMesh(points, triangles, owner)
