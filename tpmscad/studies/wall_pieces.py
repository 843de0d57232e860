"""The triangles of a sheet, even or graded, as pieces that repeat: both surfaces over each patch of the mid surface.

An even wall over copies of an exact patch, and a graded one, lie along the normals of the patch itself; over reflected pieces
they are the fitted offset surfaces. Neighbours have the points of their common side, and the normals there, so that
the triangles are watertight by index whatever the thickness.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.triangles.patch_triangles import PatchGrid, choose_grid, measure_deviation
from tpmscad.brep.triangles.repeated_pieces import RepeatedPieces, close_walls
from tpmscad.errors import InvalidRequest, format_point
from tpmscad.lattices.coordinate_maps import stretching
from tpmscad.lattices.copies import orientation_sign
from tpmscad.lattices.mapped_lattice import require_offsets_below_curvature_radius
from tpmscad.lattices.mapped_surface import MappedSurface, grading
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.rigid_motion import Motion
from tpmscad.sources.exact_sources import CopiedPrimitive, ReflectedPieces

WELD_REL_TOL = 1e-7
"""In cells: points of neighbours nearer than this are one; fitted pieces meet within 1e-9."""

STEPS_PER_PIECE = 2
"""Steps of the grid along a piece."""

RANGE_SAMPLES = 100_000
"""Points of the mid surface from which the least and the greatest distance are estimated."""

MEASURED_PATCHES, COMPARED_PATCHES = 80, 20_000
"""Patches of a graded wall that are measured, the worst half of them by an estimate from so many, and the others at random."""


@dataclass(frozen=True, slots=True, eq=False)
class WallPatches:
    """The patches of a wall in one cell, each with parameters in the unit square.

    at(index (n,), uv (n, 2)): points of the mid surface, arms from them to the lower and the upper surface, to be scaled, and
    tangents by both parameters, (n, 3) each. outward (P,): 1 where du x dv is along the arm upwards, else -1. alike: the first
    patch stands for all.
    """

    cell: Array
    at: Callable[[IntArray, Array], tuple[Array, Array, Array, Array, Array]]
    outward: IntArray
    alike: bool

    def choose_grid(self, scales: Array, deviation: float, least: int = 1) -> tuple[PatchGrid, list[bool], float]:
        """The coarsest grid that keeps the deviation, the diagonal for each surface, and the bound reached.

        scales (k, 2): of the arms to the lower and the upper surface, at which it is measured.
        """
        n = 1 if self.alike else len(self.outward)

        def evaluate(wall: int, face: IntArray, uv: Array) -> tuple[Array, Array, Array]:
            mid, *arms, du, dv = self.at(face % n, uv)
            return mid + scales[face // n, wall, None] * arms[wall], du, dv

        return choose_grid([(n * len(scales), partial(evaluate, wall)) for wall in (0, 1)], deviation, least)

    def pieces(self, grid: PatchGrid, turned: list[bool], reach: tuple[float, float]) -> RepeatedPieces:
        """The wall's pieces on a grid; reach: the least and the greatest scale."""
        n, uv = len(self.outward), grid.nodes
        mid, lower, upper, _, _ = (
            found.reshape(n, len(uv), 3) for found in self.at(np.repeat(np.arange(n), len(uv)), np.tile(uv, (n, 1)))
        )
        triangles = np.stack([grid.triangles(other) for other in turned])
        tol = WELD_REL_TOL * float(self.cell.max())
        block = grid.blocks(-(-grid.steps // STEPS_PER_PIECE))
        return close_walls(self.cell, mid, np.stack([lower, upper]), triangles, block, self.outward, reach, tol)


def find_wall(request: LatticeRequest) -> WallPatches | None:
    """The patches of a lattice's wall; None if it is no wall over patches: skeletal, or between level sets."""
    source, cell = request.source, np.array(request.cell)
    if request.kind != "sheet" or request.levels is not None:
        return None
    if isinstance(source, CopiedPrimitive):
        motions = source.symmetry.cell_motions
        placements = Motion(motions.rotation, motions.translation + np.array(request.phase))
        surface = _mid_surface(source, placements, cell)
        low, high = (1.0, 1.0) if request.is_graded else request.offset

        def at(index: IntArray, uv: Array) -> tuple[Array, Array, Array, Array, Array]:
            found = surface.points_at(index, *uv.T)
            return found.position, low * found.normal, high * found.normal, found.du, found.dv

        outward = np.full(len(placements), source.symmetry.handedness)
        return WallPatches(cell, at, outward, len(set(request.cell)) == 1)
    if isinstance(source, ReflectedPieces):
        fitted = source.fit(request.layer_offsets, cell[0], request.tol).surfaces
        lower, upper = (fitted.primitives[layer.primitive] for layer in fitted.layers())
        motions = Motion(
            source.symmetry.motions.rotation, source.symmetry.motions.translation + np.array(request.phase)
        )

        def reflect(index: IntArray, uv: Array) -> tuple[Array, Array, Array, Array, Array]:
            ends = []
            for surface in (lower, upper):
                (u0, u1), (v0, v1) = surface.domain
                ends.append(surface.jet(u0 + (u1 - u0) * uv[:, 0], v0 + (v1 - v0) * uv[:, 1])[:3])
            position, du, dv = (cell[0] * 0.5 * (a + b) for a, b in zip(*ends, strict=True))
            arm = cell[0] * 0.5 * (ends[1][0] - ends[0][0])
            placed = motions[index]
            mid = placed.apply(position) + (cell[0] - 1.0) * placed.translation
            arm, du, dv = (placed.apply_to_vectors(vectors) for vectors in (arm, du, dv))
            return mid, -arm, arm, du, dv

        return WallPatches(cell, reflect, orientation_sign(source.symmetry, upper) * motions.handedness, True)
    return None


def _mid_surface(source: CopiedPrimitive, placements: Motion, cell: Array) -> MappedSurface:
    """The mid surface over copies of a patch in cells of edges (3,)."""
    return MappedSurface(source.patch, source.symmetry, placements, stretching(cell / cell[0]), cell[0])


@dataclass(eq=False)
class WallDistances:
    """Distances of the surfaces of a graded wall from its mid surface, and the least and the greatest one that were met.

    box: corners (2, 3) of the body and of what reaches into it; beyond, the wall is as at the nearest point of this box.
    allowed: the least and the greatest one that pieces have room for.
    """

    request: LatticeRequest
    box: Array
    least: float = 0.0
    greatest: float = 0.0
    allowed: tuple[float, float] = (-np.inf, np.inf)

    def __call__(self, points: Array) -> Array:
        """The distances of the lower and the upper surface (n, 2) at points (n, 3) of the mid surface."""
        points = np.clip(points, *self.box)
        thickness, centre = grading(self.request.thickness, self.request.centre, points)
        if not (thickness > 0).all():
            worst = int(np.argmin(thickness))
            raise InvalidRequest(
                f"the wall has the thickness {thickness[worst]:g} near {format_point(points[worst], 4)}: it must be positive "
                "in the body and half a wall round its box"
            )
        found = centre[:, None] + thickness[:, None] * np.array(self.request.offset)
        self.least, self.greatest = min(self.least, float(found.min())), max(self.greatest, float(found.max()))
        if self.least < self.allowed[0] or self.greatest > self.allowed[1]:
            raise InvalidRequest(
                f"the wall reaches {max(-self.least, self.greatest):g} from its mid surface, farther than samples showed: "
                "let its thickness vary over cells, not between points"
            )
        return found

    def find_extremes(self, wall: WallPatches, cells: IntArray, index: IntArray) -> Array:
        """The least and the greatest distance (2, 2) of either surface at samples of patches in cells (k, 3)."""
        rng = np.random.default_rng(0)
        some = rng.integers(0, len(index), min(RANGE_SAMPLES, 50 * len(index)))
        found = self(wall.at(index[some], rng.random((len(some), 2)))[0] + cells[some] * wall.cell)
        return np.stack([found.min(axis=0), found.max(axis=0)])

    def measure(
        self, wall: WallPatches, grid: PatchGrid, turned: list[bool], cells: IntArray, index: IntArray, deviation: float
    ) -> float:
        """The greatest distance of triangles from the graded surfaces over patches in cells (k, 3), the worst ones and others."""
        rng = np.random.default_rng(1)
        some = rng.permutation(len(index))[:COMPARED_PATCHES]
        cells, index = cells[some], index[some]
        corners = np.stack(np.meshgrid([0.0, 0.5, 1.0], [0.0, 0.5, 1.0], indexing="ij"), axis=-1).reshape(-1, 2)
        mid = (
            wall.at(np.repeat(index, 9), np.tile(corners, (len(index), 1)))[0] + np.repeat(cells, 9, axis=0) * wall.cell
        )
        distances = self(mid).reshape(-1, 9, 2)
        worst = np.ptp(distances, axis=1).max(axis=1) + 0.1 * np.abs(distances).max(axis=(1, 2))
        most = np.argsort(-worst)[: MEASURED_PATCHES // 2]
        chosen = np.unique(np.append(most, np.arange(min(MEASURED_PATCHES // 2, len(index)))))
        cells, index = cells[chosen], index[chosen]

        def evaluate(which: int, face: IntArray, uv: Array) -> tuple[Array, Array, Array]:
            mid, *arms, du, dv = wall.at(index[face], uv)
            mid = mid + cells[face] * wall.cell
            return mid + self(mid)[:, which, None] * arms[which], du, dv

        groups = [(len(index), partial(evaluate, which)) for which in (0, 1)]
        return max(
            measure_deviation(group, grid, other, deviation) for group, other in zip(groups, turned, strict=True)
        )


def require_distances_below_curvature_radius(request: LatticeRequest, distances: WallDistances) -> None:
    """InvalidRequest if a graded wall reaches beyond the least radius of curvature of its mid surface."""
    source, cell = request.source, np.array(request.cell)
    assert isinstance(source, CopiedPrimitive)
    surface = _mid_surface(source, source.symmetry.cell_motions, cell)
    require_offsets_below_curvature_radius(surface, [distances.least, distances.greatest], source.name)
