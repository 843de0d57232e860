"""Triangles of a filled body without its solid: one cell is triangulated and repeated, and what the body cuts is computed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tpmscad._typing import BoolArray
from tpmscad.api.public_calls import validate_options
from tpmscad.brep.sections.polygon_regions import Operation
from tpmscad.brep.triangles.cell_polyhedron import find_periodic_cell
from tpmscad.brep.triangles.closed_mesh import SolidMesh, join_meshes, load_manifold
from tpmscad.brep.triangles.filled_mesh import FIRST_OF_BODY, PieceChoice, choose_pieces, fill_mesh
from tpmscad.brep.triangles.patch_triangles import PatchGrid, triangulate_patches
from tpmscad.brep.triangles.repeated_pieces import RepeatedPieces
from tpmscad.errors import InvalidRequest, TrimmingError
from tpmscad.fields.data.triangle_mesh import TriangleMesh
from tpmscad.kernel.boolean.hollow_body import subtract_voids
from tpmscad.kernel.export.solid_mesh import measure_meshes
from tpmscad.memory_limit import require_memory
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.requests.study_options import InfillTrianglesOptions
from tpmscad.results.loose_pieces import select_pieces
from tpmscad.results.triangulated_infill import TriangulatedInfill
from tpmscad.solids.matter.lattice_block import fit_patches_over_box
from tpmscad.solids.skins.offset_skin import erode_body
from tpmscad.solids.tiled_body import TILE_CORNERS, read_tiled_body
from tpmscad.stage_timer import StageTimer
from tpmscad.studies.wall_pieces import WallDistances, find_wall, require_distances_below_curvature_radius

DEFAULT_DEVIATION_CELLS = 0.01
"""In cells: default deviation of the triangles."""

FACET_ANGLE = 0.35
"""Radians between neighbouring facets of the body."""

REACH_MARGIN = 1.1
"""Factor on the sampled distances of a graded wall, within which its pieces are sought."""

BYTES_PER_WHOLE_TRIANGLE, BYTES_PER_CUT_TRIANGLE = 90, 450
"""Memory taken at the peak for each triangle of a whole cell, and of one that the body cuts, as measured."""


@validate_options(
    InfillTrianglesOptions, 'infill_triangles(body, "gyroid", cell=1, thickness=0.12, deviation=0.01).write("part.stl")'
)
def infill_triangles(options: InfillTrianglesOptions) -> TriangulatedInfill:
    """Triangulate a body filled with a lattice, without making its solid.

    The triangles are closed and follow the exact patches, and the body's faces, within `deviation`. Cells that lie wholly in the
    body are copies of one; those that the body's boundary may touch are cut by it. 18,000 cells take minutes.

    Returns
    -------
    TriangulatedInfill
        Points and triangles with volume, area, centre of mass and pieces; `write` stores them as STL, 3MF or GLB, `render` draws
        them.

    Raises
    ------
    InvalidRequest
        If an argument is not understood, the lattice has no equal cells (a field or a map), what is kept is a loose piece that
        would be left out, or manifold3d is missing.
    OutOfMemory
        If the triangles would not fit into the memory of the machine.
    KernelError
        If the kernel cannot triangulate the body.

    Examples
    --------
    >>> part = tpmscad.infill_triangles("stem.step", "gyroid", cell=1, thickness=0.12, deviation=0.01)  # doctest: +SKIP
    >>> part.write("stem.stl")  # doctest: +SKIP
    >>> part.render("stem.png", section="y")  # doctest: +SKIP
    """
    load_manifold()
    stages = StageTimer(options.progress)
    tiled = read_tiled_body(options, "export the solid, infill(...).export(path)", stages, as_triangles=True)
    request, deviation = tiled.request, options.deviation or DEFAULT_DEVIATION_CELLS * min(tiled.request.cell)
    with stages("triangulate"):
        body, reached = _triangulate_body(tiled.body, deviation)
        others: list[tuple[Operation, SolidMesh]] = []
        if options.skin is not None:
            assert not isinstance(tiled.body, TriangleMesh)
            parts = erode_body(tiled.body, options.skin, tiled.openings).parts
            hollow = subtract_voids(tiled.body, [part.shape for part in parts], tiled.openings)
            walls = [measure_meshes(solid, deviation, FACET_ANGLE) for solid in hollow]
            others.append(("union", join_meshes([mesh for wall in walls for mesh in wall.meshes])))
            reached = max(reached, *(wall.deviation for wall in walls))
        first_kept = 1 + max(int(mesh.face.max()) for mesh in (body, *(mesh for _, mesh in others)))
        for operation, solid in tiled.passive.steps:
            mesh, own = _triangulate_body(solid, deviation)
            others.append((operation, replace(mesh, face=mesh.face + first_kept) if operation == "union" else mesh))
            reached = max(reached, own)
    body = replace(body, points=body.points @ tiled.turn)
    others = [(operation, replace(mesh, points=mesh.points @ tiled.turn)) for operation, mesh in others]
    with stages("fit"):
        lattice = triangulate_lattice(request, body, [mesh for _, mesh in others], deviation)
    with stages("cut"):
        filled = fill_mesh(lattice.pieces, lattice.choice, body, others, lattice.scale)
        filled, notes = _drop_loose_pieces(filled, options.loose, first_kept + FIRST_OF_BODY)
    return TriangulatedInfill(
        f"{request.surface} infill",
        filled.points @ tiled.turn.T,
        filled.triangles,
        filled.face,
        max(reached, lattice.reached),
        lattice.count_cells(lattice.choice.whole),
        lattice.count_cells(lattice.choice.cut),
        notes,
    )


def _drop_loose_pieces(mesh: SolidMesh, loose: str, first_kept: int) -> tuple[SolidMesh, tuple[str, ...]]:
    """A mesh without its loose pieces, and the note on them. Components of negative volume are voids of the others.

    InvalidRequest if one of them has faces of what is kept, which are numbered from `first_kept`.
    """
    volumes = mesh.component_volumes
    solid = np.flatnonzero(volumes > 0)
    kept, dropped = select_pieces(volumes[solid].tolist(), loose)
    if not dropped.volumes:
        return mesh, ()
    component, shown = mesh.component, volumes <= 0
    shown[solid[kept]] = True
    if (mesh.face[~shown[component]] >= first_kept).any():
        raise InvalidRequest(
            f"what is kept lies in loose pieces of {dropped.volumes[0]:.4g} mm3 at most, which are left out: check its place, "
            'or keep loose pieces (loose="keep")'
        )
    return mesh.select(shown[component]), dropped.notes


def _triangulate_body(body: Any, deviation: float) -> tuple[SolidMesh, float]:
    """The triangles of a body, outward, and their greatest distance from it."""
    if isinstance(body, TriangleMesh):
        return SolidMesh(body.vertices, body.triangles, np.zeros(len(body.triangles), np.int64)), 0.0
    found = measure_meshes(body.shape, deviation, FACET_ANGLE)
    return join_meshes(list(found.meshes)), found.deviation


@dataclass(frozen=True, slots=True, eq=False)
class TriangulatedLattice:
    """The pieces of a lattice, those that fill a body, the scale of a graded wall, and the deviation of the triangles."""

    pieces: RepeatedPieces
    choice: PieceChoice
    scale: WallDistances | None
    reached: float

    def count_cells(self, chosen: BoolArray) -> int:
        """How many cells chosen pieces make up."""
        return round(float(chosen.sum()) / len(self.pieces.low))


def triangulate_lattice(
    request: LatticeRequest, body: SolidMesh, others: list[SolidMesh], deviation: float
) -> TriangulatedLattice:
    """The triangles of a lattice for a body in the lattice's coordinates, and the pieces that others or the body cut."""

    def choose(pieces: RepeatedPieces) -> PieceChoice:
        per_cell = pieces.surface_count
        _require_memory(int(body.volume / np.prod(pieces.cell)) * per_cell, 0, deviation)
        choice = choose_pieces(pieces.cell, pieces.low, pieces.high, body, others)
        whole, cut = (int(chosen.sum()) * per_cell / len(pieces.low) for chosen in (choice.whole, choice.cut))
        _require_memory(whole, cut, deviation)
        return choice

    wall = find_wall(request)
    if wall is None:
        pieces, reached = _find_cell(request, deviation)
        return TriangulatedLattice(pieces, choose(pieces), None, reached)
    if not request.is_graded:
        grid, turned, reached = wall.choose_grid(np.ones((1, 2)), deviation)
        pieces = wall.pieces(grid, turned, (1.0, 1.0))
        return TriangulatedLattice(pieces, choose(pieces), None, reached)
    distances, steps = WallDistances(request), 1
    near = choose(wall.pieces(PatchGrid(np.array([0.0, 1.0])), [False, False], (0.0, 0.0)))
    at = np.argwhere(near.whole | near.cut)
    extremes = distances.find_extremes(wall, at[:, :3] + near.origin, at[:, 3])
    while True:
        grid, turned, reached = wall.choose_grid(extremes, deviation, steps)
        reach = REACH_MARGIN * distances.least, REACH_MARGIN * distances.greatest
        pieces = wall.pieces(grid, turned, reach)
        choice = choose(pieces)
        at = np.argwhere(choice.whole | choice.cut)
        patch = at[:, 3] * len(wall.outward) // len(pieces.low)
        measured = distances.measure(wall, grid, turned, at[:, :3] + choice.origin, patch, deviation)
        require_distances_below_curvature_radius(request, distances)
        if measured <= deviation and reach[0] <= distances.least and distances.greatest <= reach[1]:
            distances.allowed = reach
            return TriangulatedLattice(pieces, choice, distances, max(measured, reached))
        steps = grid.steps + (measured > deviation)


def _find_cell(request: LatticeRequest, deviation: float) -> tuple[RepeatedPieces, float]:
    """The triangulated cell of a lattice, and the greatest distance of its triangles from the patches."""
    cell, failure = np.array(request.cell), TrimmingError("")
    for corner in TILE_CORNERS:
        low = corner * cell
        points, triangles, reached = triangulate_patches(
            fit_patches_over_box(request, low, low + cell, lambda fraction: None).patches, deviation
        )
        try:
            return find_periodic_cell(points, triangles, low, cell), reached
        except TrimmingError as error:
            failure = error
    raise failure


def _require_memory(whole: float, cut: float, deviation: float) -> None:
    """OutOfMemory if this many triangles of whole and of cut pieces would not fit."""
    require_memory(
        whole * BYTES_PER_WHOLE_TRIANGLE + cut * BYTES_PER_CUT_TRIANGLE,
        1.0,
        f"{whole + cut:.3g} triangles",
        f"raise deviation = {deviation:g}, cut the body into parts, or write its layers, infill_layers(...)",
    )
