"""A lattice around a CAD body: the patches that cover its bounding box, in the coordinates of the body.

Lattice coordinates x are those of `tpmscad.lattice`. The body's coordinates are R x, with R the rotation: the lattice is
anchored at the origin of the body's coordinates and turned about it. The patches are open and ragged outside the box;
trimming by the body needs nothing else. The kernel's boolean needs a solid, which is the lattice cut by a box a little larger
than the body's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, floor
from typing import Any

import numpy as np

from tpmscad._typing import Array, BoolArray, FractionProgress
from tpmscad.brep.boundary_representation import (
    Brep,
    move_brep,
    scale_brep,
    translate_brep,
)
from tpmscad.brep.patch_nodes import signed_distances_to_nodes
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.body_import.body_brep import FreeFormBody
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.boolean_operations import OcctSolids, intersect_solids
from tpmscad.kernel.build.solids import BrepSolids, build_solids
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.convert import transform_shape
from tpmscad.lattices import mapped_lattice
from tpmscad.lattices.coordinate_maps import Map
from tpmscad.lattices.mapped_lattice import MappedLayers
from tpmscad.lattices.mapped_surface import REGULARITY_SAMPLES_PER_CELL, MappedSurface, box_points
from tpmscad.lattices.offset_surfaces import LayersFit
from tpmscad.memory_limit import require_memory
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.results.certificate import PatchMeasures
from tpmscad.rigid_motion import Motion
from tpmscad.solids.cut import Finish, require_few_faces
from tpmscad.solids.matter.body_nearness import BodyNearness
from tpmscad.solids.matter.mapped_block import (
    MIN_WALL_THICKNESS,
    compose_map,
    exact_source,
    find_greatest_offset,
    require_walls,
)
from tpmscad.solids.matter.patch_measures import (
    measure_lattice_patches,
    move_patch_measures,
)
from tpmscad.solids.matter.reference_distance import DistanceFunction, lattice_distance
from tpmscad.stage_timer import StageTimer
from tpmscad.trimming.network_boolean import NetworkResult, Operation, combine_networks
from tpmscad.trimming.operands.polyhedra import box

BLOCK_MARGIN_CELLS = 0.1237
"""In cells: how far a block reaches beyond the body's box. The odd value keeps its faces out of symmetry planes."""

MAX_CELLS_IN_BOX = 100_000
"""Cells that the box of a body may span; each needs about a hundred patches in memory."""

BYTES_PER_CELL_IN_BODY = 1.3e6
"""Memory of each cell of an infill, until its STEP file is written, as measured between 100 and 500 cells."""

BOX_TRIM_TOL_CELLS = 5e-10
"""In cells: distance of a cut's curve from its patch, so that the gaps at caps stay below 1e-9 of the cell."""

MAX_BOX_TRIM_TOL = 2.5e-8
"""In model units: the same for cells above 50, where gaps would exceed the kernel's confusion, 1e-7 whatever the part's size."""

BOX_TRIM_ROUND_OFF_CELLS = 5e-13
"""In cells: what double precision leaves of a cut's curve, some thousand units in the last place of the cell's coordinates."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchesOverBox:
    """Whole patches that cover the box [low, high], in lattice coordinates: open, ragged outside the box.

    `mapping` is the map that they were fitted under, None for copies of primitives.
    """

    patches: Brep
    low: Array
    high: Array
    fit: LayersFit[Any]
    mapping: Map | None


def find_trim_tolerance(cell: float) -> float:
    """Distance allowed between a cut's curve and its patch, in model units."""
    return max(min(BOX_TRIM_TOL_CELLS * cell, MAX_BOX_TRIM_TOL), BOX_TRIM_ROUND_OFF_CELLS * cell)


def fit_patches_over_box(
    request: LatticeRequest,
    low: Array,
    high: Array,
    progress: FractionProgress,
    near: BodyNearness | None = None,
) -> PatchesOverBox:
    """The patches of the offset surfaces over the box [low, high] (lattice coordinates, model units) and a margin around it.

    near: tells the patches that come near a body; the others are left out where patches are fitted one by one.
    """
    edges = np.array(request.cell)
    low, high = low - BLOCK_MARGIN_CELLS * edges, high + BLOCK_MARGIN_CELLS * edges
    first, last = np.array([floor(v) for v in low / edges]), np.array([ceil(v) for v in high / edges])
    counts = last - first
    if np.prod(counts.astype(float)) > MAX_CELLS_IN_BOX:
        raise InvalidRequest(
            f"the body's box spans {' x '.join(map(str, counts))} cells of {edges.tolist()}, more than {MAX_CELLS_IN_BOX}: "
            "enlarge the cell, or cut the body"
        )
    cells = int(counts[0]), int(counts[1]), int(counts[2])
    mapping, _ = compose_map(request, None)
    if mapping is None:
        cell = request.cell[0]
        fit = request.source.fit(request.layer_offsets, cell, request.tol)
        patches = scale_brep(request.source.cover(fit.surfaces, cells, np.array(request.phase)).brep, cell)
        patches = translate_brep(patches, first * edges)
    else:
        patches, fit = _fit_over_box(request, mapping, (low, high), first, cells, progress, near)
    return PatchesOverBox(patches, low, high, fit, mapping)


def _fit_over_box(
    request: LatticeRequest,
    mapping: Map,
    bounds: tuple[Array, Array],
    first: Array,
    cells: tuple[int, int, int],
    progress: FractionProgress,
    near: BodyNearness | None,
) -> tuple[Brep, LayersFit[MappedLayers]]:
    """Patches of a lattice that repeats no cell, or whose cell has unequal edges, from the cell `first`, and their fit.

    bounds: corners of the box beyond which they are cut off, with the margin.
    """
    cell, source, edges = request.cell[0], exact_source(request), np.array(request.cell)
    margin, step = BLOCK_MARGIN_CELLS * cell, edges / REGULARITY_SAMPLES_PER_CELL

    def sample_box() -> Array:
        points = first * edges + mapping(box_points(cells, cell))
        return points[((points > bounds[0] - step) & (points < bounds[1] + step)).all(axis=1)]

    reach = find_greatest_offset(request, sample_box)
    placements = mapped_lattice.select_placements_near_box(
        source.patch, source.symmetry, mapping, bounds, first, cells, np.array(request.phase), cell, reach
    )
    within = bounds[0] * cell / edges + margin, bounds[1] * cell / edges - margin
    surface = MappedSurface(source.patch, source.symmetry, placements, mapping, cell, limits=within)
    return fit_patches_one_by_one(surface, request, near, reach, progress)


def fit_patches_one_by_one(
    surface: MappedSurface, request: LatticeRequest, near: BodyNearness | None, reach: float, progress: FractionProgress
) -> tuple[Brep, LayersFit[MappedLayers]]:
    """The patches of the walls over those of a surface whose walls, within a reach, come near a body, if any; and their fit."""
    placements = surface.placements
    if near is not None:
        images = surface.map(surface.cell * mapped_lattice.sample_placements(surface.patch, placements))
        placements = placements[np.flatnonzero(near(images, mapped_lattice.PATCH_BULGE_FRACTION, reach))]
    surface = replace(surface, placements=placements, thickness=request.thickness, centre=request.centre)
    surface.orientation()
    require_walls(surface, request)
    fit = mapped_lattice.fit_mapped_layers(surface, request.layer_offsets, request.tol, progress)
    return mapped_lattice.assemble_mapped_lattice(surface, *fit.surfaces, natural=False), fit


MAX_SHIFT_FRACTION = 0.99
"""Of what the deviation leaves of the tolerance: how far a lattice may be moved to keep its corners from a body's faces."""


@dataclass(frozen=True, eq=False)
class LatticeBlock:
    """The open patches that cover a body, in its coordinates, what was measured on them, and points' distance from their surface.

    `trim_to_box` makes the closed boundary representation of the same lattice cut flat outside the body. `closed` and `built`,
    the kernel's solid of it, are made on first use. `closes_channels`: the channels beside the wall end inside the body.
    """

    name: str
    patches: Brep
    measures: PatchMeasures
    distance: DistanceFunction
    trim_to_box: Callable[[], Brep]
    closes_channels: bool = False

    @cached_property
    def closed(self) -> Brep:
        """The lattice cut by a box around the body, closed by caps."""
        return self.trim_to_box()

    @cached_property
    def built(self) -> BrepSolids:
        """The kernel's solids of `closed`."""
        return build_solids(self.closed)

    @property
    def max_shift(self) -> float:
        """Length by which the patches may be translated and still be within the tolerance, model units.

        A hundredth is left to the trims' own translations, of some millionths, and to rounding.
        """
        return MAX_SHIFT_FRACTION * max(0.0, self.measures.tol - self.measures.deviation.max)

    def contains(self, points: Array) -> BoolArray:
        """Whether points (n, 3) in the body lie in the lattice, by the nearest nodes of its patches."""
        return signed_distances_to_nodes(self.patches, points) < 0

    def cut(self, domain: FreeFormBody, operation: Operation, finish: Finish) -> NetworkResult:
        """A body and the patches cut by each other as two networks."""
        return combine_networks(
            domain.brep, self.patches, operation, build=finish, max_shift=self.max_shift, is_cover=True
        )

    def intersect_in_kernel(self, shape: Any) -> tuple[Any, ...]:
        """What the kernel's boolean leaves of the lattice in a shape."""
        require_few_faces(len(self.patches.faces))
        return intersect_solids(self.built.shape, shape)

    def measure(self, solids: BrepSolids | OcctSolids, moved: float) -> PatchMeasures:
        """The measures of the patches after a translation by a length."""
        return move_patch_measures(self.measures, moved)


def build_lattice_block(request: LatticeRequest, rotation: Array, body: CadBody, stages: StageTimer) -> LatticeBlock:
    """The lattice of a minimal surface around a body; `rotation` (3, 3) takes lattice coordinates to the body's."""
    low, high = enclosing_box(transform_shape(body.shape, Motion(rotation.T, np.zeros(3))))
    if (high - low < np.array(request.cell)).all():
        raise InvalidRequest(
            f"{body.name} spans {' x '.join(f'{v:.4g}' for v in high - low)}, less than a cell of "
            f"{' x '.join(f'{v:.4g}' for v in request.cell)}: make the cell smaller"
        )
    cells = body.volume / float(np.prod(request.cell))
    require_memory(
        cells,
        BYTES_PER_CELL_IN_BODY,
        f"a solid of about {cells:.0f} cells in {body.name}",
        "enlarge the cell, or do without one solid: export_infill(...) writes a STEP file of cells, infill_layers(...) layers, "
        "infill_triangles(...) STL",
    )
    near = BodyNearness(body, rotation, min(request.cell)) if request.is_graded else None
    return build_block_over_box(request, rotation, low, high, stages, near)


def build_block_over_box(
    request: LatticeRequest,
    rotation: Array,
    low: Array,
    high: Array,
    stages: StageTimer,
    near: BodyNearness | None = None,
) -> LatticeBlock:
    """The lattice over a box in lattice coordinates, of corners (3,), turned by `rotation` (3, 3).

    near: tells the patches that come near the body in the box.
    """
    motion = Motion(rotation, np.zeros(3))
    check_wall_thickness(request)
    distance, request = lattice_distance(request, None, rotation), request.turned(rotation)
    with stages("fit") as done:
        cover = fit_patches_over_box(request, low, high, done, near)
    with stages("assemble"):
        patches = move_brep(cover.patches, motion)
        measures = measure_lattice_patches(request, cover.mapping, patches, cover.fit)

    def trim_to_box() -> Brep:
        tol = find_trim_tolerance(max(request.cell))
        whole = cover if near is None else fit_patches_over_box(request, low, high, lambda fraction: None)
        cut = combine_networks(box(whole.low, whole.high), whole.patches, "intersection", tol, is_cover=True)
        return move_brep(cut.brep, motion)

    return LatticeBlock(f"{request.surface} infill", patches, measures, distance, trim_to_box)


def check_wall_thickness(request: LatticeRequest) -> None:
    """InvalidRequest if the wall of a sheet is too thin for the kernel to trim."""
    if request.kind == "sheet" and not request.is_graded and np.ptp(request.offset) < MIN_WALL_THICKNESS:
        raise InvalidRequest(
            f"a wall of {np.ptp(request.offset):g} is thinner than {MIN_WALL_THICKNESS:g}, "
            "a hundred times the kernel's tolerance"
        )
