"""The triangles of a body and of the lattice that fills it, from which layers and meshes are made without a solid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tpmscad._typing import BoolArray
from tpmscad.brep.sections.polygon_regions import Operation
from tpmscad.brep.triangles.cell_polyhedron import find_periodic_cell
from tpmscad.brep.triangles.closed_mesh import SolidMesh, join_meshes
from tpmscad.brep.triangles.filled_mesh import PieceChoice, choose_pieces, combine_parts, fill_mesh
from tpmscad.brep.triangles.patch_triangles import PatchGrid, triangulate_patches
from tpmscad.brep.triangles.repeated_pieces import LATTICE, RepeatedPieces
from tpmscad.errors import InvalidRequest, TrimmingError
from tpmscad.fields.data.triangle_mesh import TriangleMesh
from tpmscad.fields.field import Field
from tpmscad.kernel.boolean.hollow_body import subtract_voids
from tpmscad.kernel.export.solid_mesh import measure_meshes
from tpmscad.memory_limit import require_memory
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.solids.matter.lattice_block import fit_patches_over_box
from tpmscad.solids.skins.offset_skin import erode_body
from tpmscad.solids.tiled_body import TILE_CORNERS, TiledBody
from tpmscad.studies.strut_triangles import triangulate_tree
from tpmscad.studies.wall_pieces import WallDistances, find_wall, require_distances_below_curvature_radius

FACET_ANGLE = 0.35
"""Radians between neighbouring facets of the body."""

REACH_MARGIN = 1.1
"""Factor on the sampled distances of a graded wall, within which its pieces are sought."""

BYTES_PER_WHOLE_TRIANGLE, BYTES_PER_CUT_TRIANGLE = 90, 450
"""Memory taken at the peak for each triangle of a whole cell, and of one that the body cuts, as measured."""


@dataclass(frozen=True, slots=True, eq=False)
class BodyTriangles:
    """The triangles of a body, and of what is then united with it or subtracted, one after the other, in the lattice's axes.

    first_kept: number of the first face of what is kept. reached: the greatest distance of the triangles from their faces.
    """

    body: SolidMesh
    others: tuple[tuple[Operation, SolidMesh], ...]
    first_kept: int
    reached: float


def triangulate_parts(tiled: TiledBody, skin: float | None, deviation: float) -> BodyTriangles:
    """The triangles of a body, its skin and its passive regions."""
    body, reached = _triangulate_body(tiled.body, deviation)
    others: list[tuple[Operation, SolidMesh]] = []
    if skin is not None:
        assert not isinstance(tiled.body, TriangleMesh)
        parts = erode_body(tiled.body, skin, tiled.openings).parts
        hollow = subtract_voids(tiled.body, [part.shape for part in parts], tiled.openings)
        walls = [measure_meshes(solid, deviation, FACET_ANGLE) for solid in hollow]
        others.append(("union", join_meshes([mesh for wall in walls for mesh in wall.meshes])))
        reached = max(reached, *(wall.deviation for wall in walls))
    first_kept = 1 + max(int(mesh.face.max()) for mesh in (body, *(mesh for _, mesh in others)))
    for operation, solid in tiled.passive.steps:
        mesh, own = _triangulate_body(solid, deviation)
        others.append((operation, replace(mesh, face=mesh.face + first_kept) if operation == "union" else mesh))
        reached = max(reached, own)

    def turn(mesh: SolidMesh) -> SolidMesh:
        return replace(mesh, points=mesh.points @ tiled.turn)

    return BodyTriangles(turn(body), tuple((operation, turn(mesh)) for operation, mesh in others), first_kept, reached)


def _triangulate_body(body: Any, deviation: float) -> tuple[SolidMesh, float]:
    """The triangles of a body, outward, and their greatest distance from it."""
    if isinstance(body, TriangleMesh):
        return SolidMesh(body.vertices, body.triangles, np.zeros(len(body.triangles), np.int64)), 0.0
    found = measure_meshes(body.shape, deviation, FACET_ANGLE)
    return join_meshes(list(found.meshes)), found.deviation


@dataclass(frozen=True, slots=True, eq=False)
class TriangulatedMatter:
    """The closed triangles of what fills a body, and their deviation."""

    mesh: SolidMesh
    reached: float

    whole_cells, cut_cells = 0, 0

    def fill(self, parts: BodyTriangles) -> SolidMesh:
        """The filled body."""
        return combine_parts(self.mesh, parts.body, parts.others)

    def require_memory(self, deviation: float) -> None:
        """OutOfMemory if all triangles would not fit."""
        _require_memory(0, len(self.mesh.triangles), deviation)


@dataclass(frozen=True, slots=True, eq=False)
class TriangulatedLattice:
    """The pieces of a lattice, those that fill a body, the scale of a graded wall, and the deviation of the triangles."""

    pieces: RepeatedPieces
    choice: PieceChoice
    scale: WallDistances | None
    reached: float

    @property
    def whole_cells(self) -> int:
        """How many cells the whole pieces make up."""
        return round(float(self.choice.whole.sum()) / len(self.pieces.low))

    @property
    def cut_cells(self) -> int:
        """How many cells the pieces make up that a boundary may touch."""
        return round(float(self.choice.cut.sum()) / len(self.pieces.low))

    def count_triangles(self, chosen: BoolArray) -> float:
        """About how many triangles of the surface chosen pieces have."""
        return float(chosen.sum()) * self.pieces.surface_count / len(self.pieces.low)

    def require_memory(self, deviation: float) -> None:
        """OutOfMemory if all triangles would not fit."""
        whole, cut = self.count_triangles(self.choice.whole), self.count_triangles(self.choice.cut)
        _require_memory(whole, cut, deviation)

    def fill(self, parts: BodyTriangles, choice: PieceChoice | None = None) -> SolidMesh:
        """The filled body; with a choice of some pieces only, then open where others are missing."""
        chosen, every = choice or self.choice, choice is None
        return fill_mesh(self.pieces, chosen, parts.body, parts.others, self.scale, is_closed=every)


def triangulate_filling(
    tiled: TiledBody, parts: BodyTriangles, deviation: float
) -> TriangulatedLattice | TriangulatedMatter:
    """The triangles of what fills a body."""
    if isinstance(tiled.filling, LatticeRequest):
        return _triangulate_lattice(tiled.filling, parts, deviation)
    if isinstance(tiled.filling, Field):
        return _triangulate_field(tiled.filling, deviation)
    found = measure_meshes(tiled.filling.shape, deviation, FACET_ANGLE)
    mesh = join_meshes(list(found.meshes))
    return TriangulatedMatter(replace(mesh, face=np.full_like(mesh.face, LATTICE)), found.deviation)


def _triangulate_field(field: Field, deviation: float) -> TriangulatedMatter:
    """The triangles of a field of struts and meshes."""
    mesh, complement, reached = triangulate_tree(field, deviation)
    if complement:
        raise InvalidRequest(
            "the complement of struts has no end: give what is left of a body, with clear=, or `body - struts`"
        )
    return TriangulatedMatter(replace(mesh, face=np.full(len(mesh.triangles), LATTICE)), reached)


def _triangulate_lattice(request: LatticeRequest, parts: BodyTriangles, deviation: float) -> TriangulatedLattice:
    """The triangles of a lattice for a body in the lattice's coordinates, and the pieces that others or the body cut."""

    def choose(pieces: RepeatedPieces) -> PieceChoice:
        others = [mesh for _, mesh in parts.others]
        return choose_pieces(pieces.cell, pieces.low, pieces.high, parts.body, others)

    wall = find_wall(request)
    if wall is None:
        pieces, reached = _find_cell(request, deviation)
        return TriangulatedLattice(pieces, choose(pieces), None, reached)
    if not request.is_graded:
        grid, turned, reached = wall.choose_grid(np.ones((1, 2)), deviation)
        pieces = wall.pieces(grid, turned, (1.0, 1.0))
        return TriangulatedLattice(pieces, choose(pieces), None, reached)
    near = choose(wall.pieces(PatchGrid(np.array([0.0, 1.0])), [False, False], (0.0, 0.0)))
    at = np.argwhere(near.whole | near.cut)
    box = np.stack([parts.body.points.min(axis=0), parts.body.points.max(axis=0)])
    distances, steps = WallDistances(request, box), 1
    distances.find_extremes(wall, at[:, :3] + near.origin, at[:, 3])
    beyond = max(-distances.least, distances.greatest)  # of the mid surface of walls that end in the body
    distances = WallDistances(request, box + np.array([[-beyond], [beyond]]))
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
