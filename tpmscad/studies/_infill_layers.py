"""Layers of a filled body without its solid: the section of one cell is repeated in the plane and clipped by the body's section.

A lattice of equal cells has the same section in every cell, and the same one again a cell higher. One cell is cut by the kernel's
faces at every height that occurs; in the plane of a layer its curves are joined from cell to cell by their links, and only the
section of the body is a polygon operation. Time and memory go with the area of the layers, not with the number of cells in the
solid.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_options
from tpmscad.brep.sections.periodic_section import PeriodicSection, find_periodic_section
from tpmscad.brep.sections.polygon_regions import (
    MANIFOLD_FOR_LAYERS,
    Operation,
    Region,
    combine_regions,
    region_length,
    signed_areas,
)
from tpmscad.errors import InvalidRequest, TrimmingError
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.shape_extents import shape_bounds
from tpmscad.kernel.slicing.contours import SlicedFaces, triangulate_for_slices
from tpmscad.parallel import task_runner
from tpmscad.requests.lattice_request import (
    LatticeRequest,
    lattice_in_body,
    resolve_lattice_request,
    rotation_matrix,
)
from tpmscad.requests.named_matter import resolve_named_matter
from tpmscad.requests.study_options import InfillLayersOptions
from tpmscad.solids.matter.lattice_block import find_trim_tolerance, fit_patches_over_box
from tpmscad.solids.skins.offset_skin import erode_body
from tpmscad.solids.tiled_body import TILE_CORNERS, TiledBody, read_tiled_body
from tpmscad.stage_timer import StageTimer
from tpmscad.studies.lattice_triangles import triangulate_filling, triangulate_parts
from tpmscad.studies.layer_slices import Slices, choose_chord_error, collect_layers, divide_at_jumps, divide_into_layers
from tpmscad.studies.triangle_layers import cut_into_layers
from tpmscad.trimming.network_boolean import combine_networks
from tpmscad.trimming.operands.polyhedra import box

SLICING_SHARE = 0.5
"""Share of the chord error for cutting faces; the rest is for leaving out points."""

HEIGHT_REL_TOL = 1e-6
"""In cells: sections nearer to the lower and upper side of the cell, which are flat, are cut so far beside it."""

HEIGHT_ROUND_OFF_CELLS = 1e-9
"""In cells: difference of two heights that round-off explains."""

SECTIONS_OF_CELL = 256
"""Sections from which the mean of a cell's area over a layer is taken: over whole cells it is within 1e-5 of the volume. In 30
layers to a cell the areas in their middles alone are 5e-4 off, since the area has peaks where the wall is level."""

LAYERS_PER_TASK = 16
"""Layers that are joined and clipped by one task."""


@validate_options(InfillLayersOptions, 'infill_layers(body, "gyroid", cell=1, thickness=0.12, height=0.03)')
def infill_layers(options: InfillLayersOptions) -> Slices:
    """Cut a body filled with a lattice into layers, without making its solid.

    The layers are those of `infill(...).slices(height)`, except that detached pieces are kept, and that layers begin at
    the lowest point of the body and of what is kept, even if it is cleared. Their number of cells is limited by the area of a
    layer only: 18,000 cells take about a minute. Graded walls and fields are cut as triangles within half the chord error of the
    exact faces, a distance in space: where a face is nearly level, the exact contour may be farther away in the plane.

    Returns
    -------
    Slices
        The layers, each with its closed contours, area, perimeter and volume; `write` stores them as SVG, CLI or 3MF.

    Raises
    ------
    InvalidRequest
        If an argument is not understood, an even lattice has no equal cells in the planes of the layers (a rotation about x or
        y), a map or a graded skeletal solid is given, or there would be more than 100,000 layers.
    KernelError
        If the kernel cannot triangulate the body or a cell.

    Examples
    --------
    >>> layers = tpmscad.infill_layers("stem.step", "gyroid", cell=1, thickness=0.12, height=0.03)  # doctest: +SKIP
    >>> layers.write("stem.cli")  # doctest: +SKIP
    """
    import_extra("manifold3d", *MANIFOLD_FOR_LAYERS)  # before minutes of work
    options, stages = resolve_named_matter(options), StageTimer(options.progress)
    skin, instead = options.skin, "slice the solid, infill(...).slices(height)"
    turn = rotation_matrix(options.rotation)
    by_triangles = not isinstance(options.surface, str) or resolve_lattice_request(lattice_in_body(options)).is_graded
    if turn[2, 2] != 1.0 and not by_triangles:
        raise InvalidRequest(
            f"rotation {options.rotation} tilts the cells, so that no two layers are alike: rotate about z only, or {instead}"
        )
    tiled = read_tiled_body(options, instead, stages)
    body, openings, passive = tiled.body, tiled.openings, tiled.passive
    assert isinstance(body, CadBody)
    with stages("read"):
        bounds = np.array([shape_bounds(each.shape) for each in (body, *passive.kept)])
        edges = divide_into_layers(options.height, (float(bounds[:, 0, 2].min()), float(bounds[:, 1, 2].max())))
        error = choose_chord_error(options.height, options.chord_error)
    if by_triangles:
        return _cut_triangles(tiled, options, edges, error, stages)
    request = tiled.request
    with stages("read"):
        outer, *others = (
            triangulate_for_slices([each.shape], SLICING_SHARE * error) for each in (body, *passive.bodies)
        )
    inner: SlicedFaces | None = None
    if skin is not None:
        with stages("offset"):
            parts = erode_body(body, skin, openings).parts
            inner = triangulate_for_slices([part.shape for part in parts], SLICING_SHARE * error)
    with stages("cut"):
        lattice = CellSections(request, _find_gap(0.5 * (edges[:-1] + edges[1:]), request.cell[2]), error)
        regions = tuple((operation, own) for (operation, _), own in zip(passive.steps, others, strict=True))
        filled = LayeredInfill(lattice, turn[:2, :2], outer, inner, bool(openings), regions, error, options.executor)
        jumps = [faces.jumps for faces in (outer, *others, *([] if inner is None else [inner]))]
        cuts = divide_at_jumps(edges, np.concatenate(jumps))
        middles, own = (0.5 * (heights[:-1] + heights[1:]) for heights in (cuts, edges))
        levels = np.union1d(middles, own)
        sections = filled.fill(levels)
        parts = [sections[i] for i in np.searchsorted(levels, middles).tolist()]
        excess = lattice.mean_shares(cuts) - [each.share for each in parts]
        volumes = np.diff(cuts) * ([each.area for each in parts] + excess * [each.room for each in parts])
        volumes = np.add.reduceat(volumes, np.searchsorted(cuts, edges[:-1]))
        layers = [sections[i] for i in np.searchsorted(levels, own).tolist()]
        found = ((each.contours, each.area, each.length) for each in layers)
        return collect_layers(f"{request.surface} infill", edges, error, found, volumes)


def _cut_triangles(
    tiled: TiledBody, options: InfillLayersOptions, edges: Array, error: float, stages: StageTimer
) -> Slices:
    """The layers between ascending heights of a body with a graded wall or a field, whose cells are no copies."""
    with stages("triangulate"):
        parts = triangulate_parts(tiled, options.skin, SLICING_SHARE * error)
        filling = triangulate_filling(tiled, parts, SLICING_SHARE * error)
    with stages("cut"):
        found = cut_into_layers(filling, parts, tiled.turn, edges, (1 - SLICING_SHARE) * error, options.executor)
    return collect_layers(tiled.name, edges, error, *found)


def _find_gap(heights: Array, period: float) -> float:
    """The height that is, but for multiples of the period, in the middle of the widest gap between heights (n,)."""
    rest = np.sort(np.mod(heights, period))
    gaps = np.diff(np.append(rest, rest[0] + period))
    widest = int(np.argmax(gaps))
    return float(np.mod(rest[widest] + 0.5 * gaps[widest], period))


@dataclass(frozen=True, eq=False)
class CellSections:
    """Sections of an endless lattice at any height, from one cell cut along the axes, with its lower side at `bottom`."""

    request: LatticeRequest
    bottom: float
    error: float

    @cached_property
    def cell(self) -> Array:
        """Edges of the cell (3,)."""
        return np.array(self.request.cell)

    @cached_property
    def _tiles(self) -> dict[int, tuple[Array, SlicedFaces]]:
        return {}

    def _triangulate_cell(self, corner: int) -> tuple[Array, SlicedFaces]:
        """The lowest corner (2,) of a cell, and its faces; cells begin at several places."""
        if corner not in self._tiles:
            low = np.append(TILE_CORNERS[corner, :2] * self.cell[:2], self.bottom)
            cover = fit_patches_over_box(self.request, low, low + self.cell, lambda fraction: None)
            tol = find_trim_tolerance(max(self.request.cell))
            cell = box(low, low + self.cell)
            solids = build_solids(combine_networks(cell, cover.patches, "intersection", tol, is_cover=True).brep)
            self._tiles[corner] = low[:2], triangulate_for_slices(solids, SLICING_SHARE * self.error)
        return self._tiles[corner]

    def at(self, heights: Array) -> list[CellSection]:
        """The sections at heights (n,), cut once for all that are whole cells apart."""
        rest = np.mod(heights - self.bottom, self.cell[2])
        rest = np.clip(rest, HEIGHT_REL_TOL * self.cell[2], (1 - HEIGHT_REL_TOL) * self.cell[2])
        rounding = HEIGHT_ROUND_OFF_CELLS * self.cell[2]
        _, first, index = np.unique(np.rint(rest / rounding), return_index=True, return_inverse=True)
        found: dict[int, CellSection] = {}
        failure = TrimmingError("")
        for corner in range(len(TILE_CORNERS)):
            due = np.array([k for k in range(len(first)) if k not in found])
            if len(due):
                for k, section in zip(due.tolist(), self._cut_cell(corner, rest[first[due]]), strict=True):
                    if isinstance(section, TrimmingError):
                        failure = section
                    else:
                        found[k] = section
        if len(found) < len(first):
            raise failure
        return [found[k] for k in index.ravel().tolist()]

    def mean_shares(self, edges: Array) -> Array:
        """The mean part of a cell that is solid between consecutive heights (n + 1,): (n,)."""
        period = self.cell[2]
        levels = self.bottom + period * (np.arange(SECTIONS_OF_CELL) + 0.5) / SECTIONS_OF_CELL
        shares = self._triangulate_cell(0)[1].measure_areas(levels) / np.prod(self.cell[:2])
        cumulated = np.append(0.0, np.cumsum(shares)) / SECTIONS_OF_CELL
        whole, rest = np.divmod((edges - self.bottom) / period, 1.0)
        below = whole * cumulated[-1] + np.interp(rest, np.linspace(0.0, 1.0, SECTIONS_OF_CELL + 1), cumulated)
        return np.asarray(np.diff(below) * period / np.diff(edges))

    def _cut_cell(self, corner: int, rest: Array) -> list[CellSection | TrimmingError]:
        """The sections at ascending heights (n,) above the lower side of a cell; the failure where one is unclear."""
        low, faces = self._triangulate_cell(corner)
        sections: list[CellSection | TrimmingError] = []
        for contours, area, _ in faces.cut(self.bottom + rest):
            try:
                exact = find_periodic_section(contours, area, low, self.cell[:2])
            except TrimmingError as error:
                sections.append(error)
                continue
            thinned = exact.thin((1 - SLICING_SHARE) * self.error)
            sections.append(
                CellSection(thinned, area, area - thinned.area, exact.length / thinned.length if exact.length else 1.0)
            )
        return sections


@dataclass(frozen=True, slots=True, eq=False)
class CellSection:
    """The section of one cell: its curves, its exact area, and what this exceeds that of the polygons by (mm2).

    lengthening: the length of the curves over that of the polygons.
    """

    curves: PeriodicSection
    area: float
    excess: float
    lengthening: float


@dataclass(frozen=True, slots=True, eq=False)
class LayeredInfill:
    """The layers of a body filled with a lattice, which is turned in its plane by `turn` (2, 2).

    passive: solids that are then united with what is filled, or subtracted from it, one after the other.
    """

    lattice: CellSections
    turn: Array
    body: SlicedFaces
    cavity: SlicedFaces | None
    has_openings: bool
    passive: tuple[tuple[Operation, SlicedFaces], ...]
    error: float
    executor: Executor | None

    def fill(self, heights: Array) -> list[FilledSection]:
        """The filled sections at ascending heights (n,), in tasks of LAYERS_PER_TASK."""
        sections = self.lattice.at(heights)
        body, cavity = (
            [None] * len(heights) if solids is None else self._cut_body(solids, heights)
            for solids in (self.body, self.cavity)
        )
        passive: list[Passive] = [[] for _ in heights]
        for operation, solids in self.passive:
            for own, section in zip(passive, self._cut_body(solids, heights), strict=True):
                if section.outline:
                    own.append((operation, section))
        regions = list(zip(sections, body, cavity, passive, strict=True))
        tasks = [
            (self.turn, self.has_openings, regions[first : first + LAYERS_PER_TASK])
            for first in range(0, len(regions), LAYERS_PER_TASK)
        ]
        with task_runner(self.executor, tasks[0] if tasks else None) as run_tasks:
            return [layer for batch in run_tasks(_fill_sections, tasks) for layer in batch]

    def _cut_body(self, solids: SlicedFaces, heights: Array) -> list[BodySection]:
        """The sections of solids at ascending heights (n,)."""
        found = solids.cut(heights, self.executor)
        return [BodySection(outline, area) for outline, area, _ in found]


@dataclass(frozen=True, slots=True, eq=False)
class BodySection:
    """The section of a body in a plane: polygons, and the exact area within them (mm2)."""

    outline: Region
    area: float

    def combine(self, other: BodySection, operation: Operation) -> BodySection:
        """The union with another section, or the difference.

        What chords miss of the exact area goes with the length of the outlines: each counts as far as it bounds the result.
        """
        united, left = (combine_regions(self.outline, other.outline, kind) for kind in ("union", "difference"))
        own, others, of_united, of_left = map(region_length, (self.outline, other.outline, united, left))
        outside = 0.5 * (of_united + of_left - others)  # of the outline, as far as it is not in the other section
        result, kept = (united, of_united - outside) if operation == "union" else (left, outside - of_left)
        area = signed_areas(result)
        for section, bounding, length in ((self, outside, own), (other, kept, others)):
            area += (section.area - signed_areas(section.outline)) * (bounding / length if length else 0.0)
        return BodySection(result, area)


Passive = list[tuple[Operation, BodySection]]
"""Sections that are united with one that is filled, or subtracted from it, in this order."""


@dataclass(frozen=True, slots=True, eq=False)
class FilledSection:
    """The contours of a layer, with area and length of the exact ones.

    room: the area in which the lattice lies, the body's or the cavity's. share: the part of a cell that is solid.
    """

    contours: Region
    area: float
    length: float
    room: float
    share: float


def _fill_sections(
    turn: Array, has_openings: bool, regions: Sequence[tuple[CellSection, BodySection, BodySection | None, Passive]]
) -> list[FilledSection]:
    return [_fill_section(turn, has_openings, *region) for region in regions]


def _fill_section(
    turn: Array,
    has_openings: bool,
    lattice: CellSection,
    body: BodySection,
    cavity: BodySection | None,
    passive: Passive,
) -> FilledSection:
    """The lattice in a section of the body or, with a skin, the section without what the lattice leaves of the cavity.

    The cavity touches the outline of the body at openings only; elsewhere its polygons are holes as they are.

    Polygons miss a part of the area between chords and curves. The lattice's share is that of its cell for the area that is
    filled; the body's share counts where the lattice lies along its outline. Of the area that passive sections take nothing is
    left to the lattice; what is solid without it is combined with them.
    """
    room = body if cavity is None else cavity
    kept: Operation = "intersection" if cavity is None else "difference"
    inside = lattice.curves.combine([polygon @ turn for polygon in room.outline], kept)
    inside = [polygon @ turn.T for polygon in inside]
    if cavity is None:
        contours, beside = inside, BodySection([], 0.0)
    else:
        contours, beside = [*body.outline, *(p[::-1] for p in inside)], body
        if has_openings:
            contours = combine_regions(body.outline, inside, "difference")
    for operation, section in passive:
        contours = combine_regions(contours, section.outline, operation)
        inside = combine_regions(inside, section.outline, "difference")
        room, beside = room.combine(section, "difference"), beside.combine(section, operation)
    cell_area, polygon_area = float(np.prod(lattice.curves.cell)), signed_areas(room.outline)
    share = lattice.area / cell_area
    sense, filled = (1, share) if cavity is None else (-1, 1 - share)
    area = (
        signed_areas(inside) + sense * lattice.excess * polygon_area / cell_area + filled * (room.area - polygon_area)
    )
    return FilledSection(
        contours, beside.area + sense * area, lattice.lengthening * region_length(contours), room.area, share
    )
