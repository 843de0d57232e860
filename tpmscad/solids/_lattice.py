"""A lattice of a minimal surface in a box, as a certified solid.

Cubic cells without a map: the offset surfaces of one primitive patch are fitted and copied by the symmetry operations of the
surface (or reflected, for surfaces between mirror planes), so that all joints are smooth to round-off. Unequal cell edges or
a map: every patch is fitted to its own image. A lattice of natural boundary ends in whole patches, bridged by gap faces; one
in a box is trimmed by the planes of the box and closed by caps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations
from typing import Any

import numpy as np

from tpmscad import surfaces
from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_options
from tpmscad.brep.boundary_representation import Brep, scale_brep
from tpmscad.errors import InvalidRequest, TrimmingError, format_point
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.kernel.build.solids import build_solids
from tpmscad.kernel.measure.envelope import Envelope
from tpmscad.lattices import copies, mapped_lattice, mapped_surface
from tpmscad.lattices.coordinate_maps import Map
from tpmscad.lattices.offset_surfaces import LayersFit
from tpmscad.lattices.spline_maps import SplineMap
from tpmscad.lattices.spline_volumes import SplineVolumes, mapped_walls
from tpmscad.memory_limit import require_memory
from tpmscad.requests.lattice_options import LatticeOptions
from tpmscad.requests.lattice_request import MIN_TOL_CELLS, LatticeRequest, resolve_lattice_request
from tpmscad.results.certificate import certify_built_solids
from tpmscad.results.loose_pieces import drop_loose_pieces
from tpmscad.results.model import Model, UnitCell
from tpmscad.solids.matter.lattice_block import find_trim_tolerance
from tpmscad.solids.matter.mapped_block import compose_map, cover_mapped_lattice, exact_source, require_walls
from tpmscad.solids.matter.patch_measures import measure_lattice_patches
from tpmscad.solids.matter.reference_distance import lattice_distance
from tpmscad.stage_timer import StageTimer
from tpmscad.trimming.network_boolean import combine_networks
from tpmscad.trimming.operands.polyhedra import box

FIT_TOL_FRACTIONS = (1.0, 0.1, 0.01)
"""Fractions of the tolerance to which primitives are fitted, in order, while the cuts of coarser patches cannot be traced."""

LEAST_GAIN = 0.2
"""Least logarithm of the ratio of a cell's longest and shortest edge that is worth advice."""

LEAST_OVERHANG_CELLS = 0.01
"""Cells by which patches of a natural boundary reach beyond a map before it is told."""

BYTES_PER_CELL = 3.5e6
"""Of a lattice: a thousand cells of the gyroid, with their checks, took 3.7 GiB."""


@validate_options(LatticeOptions, 'lattice("gyroid", cell=10, cells=(2, 2, 2), thickness=1)')
def lattice(options: LatticeOptions) -> Model:
    """Make a lattice of a minimal surface that fills the box from the origin to `cells` x `cell`.

    Returns
    -------
    Model
        The solid and its certificate; `certificate.met` is False if the result misses the request.

    Raises
    ------
    InvalidRequest
        If the request cannot be carried out; the message names the value, the limit and the remedy.
    TrimmingError
        If the cuts with the faces of the box cannot be traced.
    KernelError
        If the kernel cannot build the solid.

    Examples
    --------
    >>> model = tpmscad.lattice("gyroid", cell=10.0, cells=(2, 2, 2), thickness=1.0, tol=0.01)  # doctest: +SKIP
    >>> model.certificate.met  # doctest: +SKIP
    True
    >>> model.export_step("gyroid.step")  # doctest: +SKIP
    """
    request = resolve_lattice_request(options)
    require_memory(
        math.prod(request.cells),
        BYTES_PER_CELL,
        f"a solid of {' x '.join(f'{n}' for n in request.cells)} cells",
        "use fewer cells, or write it in slabs (tpmscad.export_slabs) or as copies of one cell (tpmscad.export_instances)",
    )
    return make_lattice(request, options.loose, StageTimer(options.progress), options.map)


def make_lattice(
    request: LatticeRequest,
    loose: str,
    stages: StageTimer,
    map: Map | Callable[[Array], Array] | None = None,
) -> Model:
    """The lattice of a valid request, with or without its loose pieces; errors as for `lattice`."""
    mapping, map_notes = compose_map(request, map)
    made = (
        _fit_and_copy(request, stages)
        if mapping is None
        else _fit_mapped_patches(request, mapping, stages, spline_map=isinstance(map, SplineMap))
    )
    with stages("build"):
        brep, built, dropped = drop_loose_pieces(made.brep, build_solids(made.brep), loose)
    with stages("check"):
        notes = (
            *map_notes,
            *made.notes,
            *dropped.notes,
            *(_note_phase(request, len(dropped.volumes) + built.n_solids) if map is None else ()),
        )
        measures = measure_lattice_patches(request, mapping, brep, made.fit, notes)
        certificate = certify_built_solids(built, measures, dropped=dropped.volumes)
    name = f"{request.surface} {request.kind}"
    unit_cell = made.unit_cell
    if unit_cell is not None and dropped.volumes:
        unit_cell = replace(unit_cell, make=partial(_refuse_unit_cell, name, len(dropped.volumes)))
    return Model(
        name,
        brep,
        certificate.with_seconds(stages.seconds),
        built,
        unit_cell,
        distance_to_reference=lattice_distance(request, mapping),
        make_spline_volumes=None if dropped.volumes else made.make_spline_volumes,
        envelope=None
        if map is not None
        else Envelope.of_box("the box of the cells", np.zeros(3), np.multiply(request.cell, request.cells)),
    )


def _note_phase(request: LatticeRequest, n_pieces: int) -> tuple[str, ...]:
    """What the phase has to do with a lattice in a box that is cut into several pieces."""
    if n_pieces < 2 or request.boundary != "box":
        return ()
    known = surfaces.find_surface(request.surface).one_piece
    best = known.phase_of(request.kind, request.side)
    if request.phase != best:
        return (f"phase {format_point(best, 6)} gives fewer pieces: it is the default in a box",)
    if request.kind == "skeletal" and known.skeletal_chips:
        return (f"no phase makes one piece of every skeletal {request.surface}: this one leaves chips only",)
    return (
        "in all of space the solid is one piece: the faces of the box cut it, beyond the offsets that one phase joins",
    )


def _refuse_unit_cell(name: str, n_dropped: int) -> Brep:
    """InvalidRequest: the copies of one cell would bring the loose pieces back that the solid was made without."""
    raise InvalidRequest(
        f"{n_dropped} loose piece{'s were' if n_dropped > 1 else ' was'} left out of the {name}, which copies of one cell would "
        'contain: make it with loose="keep" (--keep-loose), or leave instanced (--instanced) out'
    )


@dataclass(frozen=True, slots=True, eq=False)
class LatticePatches:
    """The closed boundary representation of a lattice in model units, the fit of its patches, and notes on its making."""

    brep: Brep
    fit: LayersFit[Any]
    notes: tuple[str, ...]
    unit_cell: UnitCell | None = None
    make_spline_volumes: Callable[[], SplineVolumes | None] | None = None


def _fit_until_traced(request: LatticeRequest, fit_and_trim: Callable[[float], LatticePatches]) -> LatticePatches:
    """The patches of `fit_and_trim(tol)`, fitted more closely than requested while their cuts cannot be traced."""
    least = MIN_TOL_CELLS * request.cell[0]
    tolerances = dict.fromkeys(max(request.tol * fraction, least) for fraction in FIT_TOL_FRACTIONS)
    fits = tuple(Fallback(f"fitted to {tol:.3g}", partial(fit_and_trim, tol)) for tol in tolerances)
    outcome = Fallbacks(fits, retry_on=(TrimmingError,)).run()
    if not outcome.failures:
        return outcome.value
    note = f"{outcome.name}: the cuts of coarser patches could not be traced"
    return replace(outcome.value, notes=(*outcome.value.notes, note))


def _fit_and_copy(request: LatticeRequest, stages: StageTimer) -> LatticePatches:
    """The copies of fitted primitives."""
    cell = request.cell[0]

    def fit_and_copy(tol: float) -> LatticePatches:
        with stages("fit"):
            fit = request.source.fit(request.layer_offsets, cell, tol)
        brep, notes = _copy_primitives(request, fit.surfaces, request.cells, stages)
        unit_cell = UnitCell(partial(_copy_one_cell, request, fit.surfaces), request.cell, request.cells)
        is_filled = request.kind == "sheet" and request.source.has_facing_patches and not notes
        fill = partial(_fill_cells, request, fit.surfaces) if is_filled else None
        return LatticePatches(brep, fit, notes, unit_cell, fill)

    return _fit_until_traced(request, fit_and_copy)


def _fill_cells(request: LatticeRequest, fitted: Any) -> SplineVolumes | None:
    """The trivariate splines of a lattice, in model units; None if its boundary cuts walls."""
    natural = request.boundary == "natural"
    volumes = request.source.fill(fitted, request.cells, np.array(request.phase), natural=natural)
    return None if volumes is None else volumes.scaled(request.cell[0])


def _copy_one_cell(request: LatticeRequest, fitted: Any) -> Brep:
    """The boundary representation of one cell."""
    return _copy_primitives(request, fitted, (1, 1, 1), StageTimer(None))[0]


def _copy_primitives(
    request: LatticeRequest, fitted: Any, cells: tuple[int, int, int], stages: StageTimer
) -> tuple[Brep, tuple[str, ...]]:
    """The boundary representation of the copies of the fitted primitives, in model units, and notes on it."""
    cell, phase = request.cell[0], np.array(request.phase)
    with stages("assemble"):
        assemble = request.source.natural if request.boundary == "natural" else request.source.cover
        assembly = assemble(fitted, cells, phase)
        brep = scale_brep(assembly.brep, cell)
    if assembly.trim_corner is None:
        return brep, ()
    low = cell * assembly.trim_corner
    with stages("trim"):
        return _trim_by_body(brep, box(low, low + np.array(request.cell) * np.array(cells, float)), cell)


def _note_overhang(surface: mapped_surface.MappedSurface, request: LatticeRequest) -> tuple[str, ...]:
    """How far whole patches reach beyond the ends of a spline map, if they do."""
    points = mapped_lattice.sample_placements(surface.patch, surface.placements).reshape(-1, 3)
    ends = np.array(request.cells, float)
    beyond = np.where(surface.periods, 0.0, np.maximum(-points.min(axis=0), points.max(axis=0) - ends))
    if beyond.max() < LEAST_OVERHANG_CELLS:
        return ()
    axis = int(beyond.argmax())
    length = float(beyond[axis]) * float(
        np.linalg.norm(surface.map.jacobian(surface.cell * ends / 2, surface.cell)[:, axis]) * surface.cell
    )
    return (
        f"whole cells reach up to {length:.3g} mm beyond the ends of the map along {'uvw'[axis]}: "
        "infill(body, ..., map=) and solidify(field, map) end in the faces",
    )


def _fit_mapped_patches(
    request: LatticeRequest, mapping: Map, stages: StageTimer, *, spline_map: bool = False
) -> LatticePatches:
    """Patches fitted one by one to the mapped surface."""
    cell, name = request.cell[0], request.surface
    source = exact_source(request)
    with stages("fit"):
        surface = mapped_surface.MappedSurface(
            source.patch,
            source.symmetry,
            copies.translate_motions(
                source.symmetry.cell_motions,
                np.asarray(copies.cell_origins(request.cells, 0) + np.array(request.phase), float),
            ),
            mapping,
            cell,
            thickness=request.thickness,
            centre=request.centre,
        )
        if request.boundary == "natural":  # whole cells: nothing of them is cut off
            try:
                mapped_surface.require_regular(mapping, mapped_surface.box_points(request.cells, cell), cell)
                mapped_lattice.require_patches_that_bend(
                    surface, request.layer_offsets, request.offset, f"mapped {name}", request.tol
                )
            except InvalidRequest as error:
                raise InvalidRequest(f"{error}{_advise_cells(surface, request.cells)}") from None
        surface, body = cover_mapped_lattice(request, surface)
        surface.orientation()
        require_walls(surface, request)

    def fit_and_trim(tol: float) -> LatticePatches:
        with stages("fit") as done:
            fit = mapped_lattice.fit_mapped_layers(surface, request.layer_offsets, tol, done)
            lower, upper = fit.surfaces
        with stages("assemble"):
            brep = mapped_lattice.assemble_mapped_lattice(surface, lower, upper, natural=body is None)
        notes = _note_overhang(surface, request) if spline_map and body is None else ()
        if body is not None:
            with stages("trim"):
                brep, notes = _trim_by_body(brep, body, cell)
        fill = None
        if body is None and lower is not None and upper is not None:
            periods = 0.0, 0.0, 0.0
            if not request.is_graded:
                periods = mapped_surface.find_translation_periods(mapping, request.cells, cell)
            fill = partial(mapped_walls, lower, upper, periods)
        return LatticePatches(brep, fit, notes, make_spline_volumes=fill)

    return _fit_until_traced(request, fit_and_trim)


def _advise_cells(surface: mapped_surface.MappedSurface, cells: tuple[int, int, int]) -> str:
    """Advice to exchange the numbers of cells, if that makes the cells under a map much more nearly cubic; else nothing."""
    points = mapped_surface.box_points((1, 1, 1), 1.0) * surface.cell * np.array(cells)
    edges = np.linalg.norm(surface.map.jacobian(points, surface.cell), axis=1).mean(axis=0) * surface.cell
    lengths = edges * cells
    if not lengths.all():  # refused with its place, where the patches are fitted
        return ""
    best = min(permutations(cells), key=lambda n: float(np.ptp(np.log(lengths / n))))
    if np.ptp(np.log(edges)) < 2 * np.ptp(np.log(lengths / best)) + LEAST_GAIN:
        return ""
    return (
        f"; along its axes the lattice measures {' x '.join(f'{x:.3g}' for x in lengths)}: cells={tuple(best)} would be more "
        "nearly cubic"
    )


def _trim_by_body(brep: Brep, body: Brep, cell: float) -> tuple[Brep, tuple[str, ...]]:
    """The part inside a body, closed by caps, and a note if the lattice had to be moved off a face that it touches."""
    cut = combine_networks(body, brep, "intersection", tol=find_trim_tolerance(cell), is_cover=True)
    return cut.brep, cut.report.notes
