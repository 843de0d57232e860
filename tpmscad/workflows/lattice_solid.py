"""The public functions. Each reads like the abstract of its method; what it does is done on the floors below."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad import kernel, surfaces
from tpmscad._typing import Array, Progress
from tpmscad.brep.boundary_representation import Brep, scale_brep
from tpmscad.brep.deviation import Deviation
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import KernelError, TrimmingError
from tpmscad.lattices import copies as lattices
from tpmscad.lattices import mapped_lattice as mappings
from tpmscad.lattices.copies import cover_box_by_reflection
from tpmscad.lattices.maps import Map, as_map, composition, stretching
from tpmscad.lattices.offset_surfaces import OffsetSurfaces
from tpmscad.lattices.primitive import OffsetSurfacesFit, fit_offset_surfaces
from tpmscad.stage_timer import StageTimer
from tpmscad.trimming import box, trim
from tpmscad.workflows.certificate import certify_lattice
from tpmscad.workflows.lattice_request import MIN_TOL_CELLS, LatticeRequest, resolve_lattice_request
from tpmscad.workflows.model import Model, UnitCell

Notes = tuple[str, ...]

CUT_TOL_CELLS = 5e-10
"""Of the cell: how far a cut's curve may be from its patch, so that gaps at the caps too stay below 1e-9 of the cell."""

FIT_TOL_FRACTIONS = (1.0, 0.1, 0.01)
"""Of the tolerance: what patches are fitted to. On walls within 15 % of the greatest offset, in a box that stands anywhere, one
cut in ten could not be traced on the coarsest patches that met 1e-3 to 1e-4 of the cell (F-RD)."""

REREAD_VOLUME_RTOL = 1e-9
"""Relative: how far the volume of a file that was read back may be from what was written."""


def lattice(
    surface: str,
    *,
    cell: float | Sequence[float],
    cells: int | Sequence[int] = (1, 1, 1),
    thickness: float | None = None,
    offset: float | Sequence[float] | None = None,
    volume_fraction: float | None = None,
    kind: str = "sheet",
    side: str = "-",
    reference: str | None = None,
    boundary: str = "box",
    phase: Sequence[float] = (0.0, 0.0, 0.0),
    map: Map | Callable[[Array], Array] | None = None,
    tol: float | None = None,
    progress: Progress | None = None,
) -> Model:
    """A lattice of a minimal surface, from the origin to `cells` x `cell`, as a certified solid.

    cell: edge length, or three of them, in model units (mm). cells: how many, per axis. Exactly one of
    thickness (of the wall, along the normal), offset (signed normal distances of the wall's two sides; one distance for
    kind="skeletal") and volume_fraction. side: which side of the surface is solid, for kind="skeletal" ("-" is where the
    nodal value is negative). reference: the exact "minimal" surface, where there is one, or the trigonometric ("nodal") one of
    its name. boundary: flat caps in the planes of the box, or whole patches bridged by gap faces. phase shifts the lattice, in
    cells. map: a smooth function (..., 3) -> (..., 3) of lattice coordinates in model units; walls keep their thickness. tol:
    greatest deviation in model units, by default a thousandth of the cell.

    InvalidRequest names what can't be had and what would do; a result that misses the request has certificate.met False.
    """
    request = resolve_lattice_request(
        surface,
        cell=cell,
        cells=cells,
        thickness=thickness,
        offset=offset,
        volume_fraction=volume_fraction,
        kind=kind,
        side=side,
        reference=reference,
        boundary=boundary,
        phase=phase,
        tol=tol,
        mapped=map is not None,
    )
    stages = StageTimer(progress)
    bend = _compose_map(request, map)
    cell = None
    if bend is None:
        fit, brep, notes = _fit_and_copy(request, stages)
        deviation, bounds = fit.deviation, fit.bounds
        cell = UnitCell(
            lambda: _copy_primitives(request, fit.sheet, (1, 1, 1), StageTimer(None))[0],
            request.cell[0] * _cell_origins(request.cells),
        )
    else:
        brep, notes, deviation = _fit_mapped_patches(request, bend, stages)
        bounds = {}
    with stages("build"):
        built = kernel.build_solids(brep)
    with stages("check"):
        valid = kernel.is_valid(built.shape)
        certificate = certify_lattice(request, bend, brep, deviation, bounds, built.nesting.moments, valid, notes)
    return Model(
        f"{request.surface} {request.kind}", brep, replace(certificate, seconds=dict(stages.seconds)), built, cell
    )


def lattice_size(cell: float | Sequence[float], cells: int | Sequence[int]) -> tuple[float, float, float]:
    """Edge lengths of the box of `cells` x `cell` that a lattice fills."""
    x, y, z = (np.broadcast_to(np.asarray(cell, float), 3) * np.broadcast_to(np.asarray(cells, float), 3)).tolist()
    return x, y, z


def export_step(model: Any, path: str | Path, *, schema: str = "ap242", name: str | None = None) -> None:
    """Write a Model, or any build123d or CadQuery shape, as STEP, in one step: the file is there whole or not at all."""
    if isinstance(model, Model):
        model.export_step(path, schema=schema)
    else:
        kernel.write_shape(model, path, schema=schema, name=name)


def write_checked_model(
    model: Model, path: str | Path, *, instanced: bool, schema: str, stored_volume: float = REREAD_VOLUME_RTOL
) -> None:
    """Write a model from its patches, then read the file back: KernelError if it is not the valid solid that was written.

    stored_volume: relative, how far the volume read back may be off.

    The reader mends nothing on this occasion: the file is valid as it stands.
    """
    brep, nesting, instances, copies = model.patches, model.built.nesting, None, 1
    if instanced and model.cells is not None:
        brep = model.cells.make()
        nesting = kernel.build_solids(brep).nesting
        instances, copies = kernel.Instances.translated(model.cells.translations), len(model.cells.translations)
    expected = copies * float(integral_properties.volume(nesting.moments)[0])

    verify = make_volume_check(expected, stored_volume)
    kernel.write_step(brep, nesting, path, schema=schema, name=model.name, instances=instances, verify=verify)


def make_volume_check(volume: float, within: float = REREAD_VOLUME_RTOL) -> Callable[[Path], None]:
    """What a written file must pass, or KernelError: read back with nothing mended it holds valid solids of this volume,
    `within` a relative tolerance."""

    def verify(written: Path) -> None:
        found = kernel.check_step(written, healed=False)
        if not found.ok or abs(found.shape.volume - volume) > within * volume:
            raise KernelError("export_step", f"written with volume {volume:.12g}, the file reads back as: {found}")

    return verify


def check_step(path: str | Path) -> Any:
    """Read a STEP file back with the kernel and report what is in it."""
    return kernel.check_step(path)


def render_step(path: str | Path, picture: str | Path) -> None:
    """Draw a STEP file as a PNG; needs no display."""
    kernel.render_png(kernel.read_step(path), picture)


def _compose_map(request: LatticeRequest, map: Map | Callable[[Array], Array] | None) -> Map | None:
    """The map from cubic lattice coordinates (cell = the first edge) to the model, or None where it is the identity."""
    stretch = None
    if len(set(request.cell)) > 1:
        stretch = stretching(tuple(edge / request.cell[0] for edge in request.cell))
    if map is None:
        return stretch
    return as_map(map) if stretch is None else composition(as_map(map), stretch, request.cell[0])


def _fit_and_copy(request: LatticeRequest, stages: StageTimer) -> tuple[OffsetSurfacesFit, Brep, Notes]:
    """The primitives and the complex of their copies; finer ones are fitted where the cuts of coarse ones can't be traced."""
    finest = max(request.tol * FIT_TOL_FRACTIONS[-1], MIN_TOL_CELLS * request.cell[0])
    for share in FIT_TOL_FRACTIONS:
        tol = max(request.tol * share, finest)
        with stages("fit"):
            fit = fit_offset_surfaces(request.surface, request.reference, request.layer_offsets, request.cell[0], tol)
        try:
            brep, notes = _copy_primitives(request, fit.sheet, request.cells, stages)
        except TrimmingError:
            if tol == finest:
                raise
            continue
        if share < 1:
            notes = (*notes, f"fitted to {tol:.3g}: the cuts of coarser patches could not be traced")
        return fit, brep, notes
    raise AssertionError("the last of the tolerances returns or raises")


def _copy_primitives(
    request: LatticeRequest, sheet: OffsetSurfaces, cells: tuple[int, int, int], stages: StageTimer
) -> tuple[Brep, Notes]:
    """The complex of copied primitives, in model units, and what is to be said of its making."""
    cell, phase = request.cell[0], np.array(request.phase)
    if surfaces.has_mirrors(request.surface):
        return _copy_mirrored_pieces(request, sheet, cells, stages)
    symmetry = surfaces.patch_symmetry(request.surface)
    if request.boundary == "natural":
        with stages("assemble"):
            whole = lattices.place_whole_cells(request.surface, cells, phase)
            return scale_brep(lattices.build_natural_lattice(symmetry, sheet, whole), cell), ()
    with stages("assemble"):
        cover = scale_brep(lattices.cover_box(symmetry, sheet, cells, phase), cell)
    with stages("trim"):
        return _trim_by_box(cover, np.zeros(3), cell * np.array(cells, float), cell)


def _copy_mirrored_pieces(
    request: LatticeRequest, sheet: OffsetSurfaces, cells: tuple[int, int, int], stages: StageTimer
) -> tuple[Brep, Notes]:
    """The complex of reflected pieces. Its natural boundary is flat too: the mirrors about the block of cells, moved with it."""
    cell, phase = request.cell[0], np.array(request.phase)
    natural = request.boundary == "natural"
    with stages("assemble"):
        symmetry = surfaces.mirror_symmetry(request.surface)
        cover = scale_brep(cover_box_by_reflection(symmetry, sheet, cells, phase, natural=natural), cell)
    low = cell * phase if natural else np.zeros(3)
    with stages("trim"):
        return _trim_by_box(cover, low, low + cell * np.array(cells, float), cell)


def _fit_mapped_patches(request: LatticeRequest, bend: Map, stages: StageTimer) -> tuple[Brep, Notes, Deviation]:
    """The complex of patches fitted one by one to the mapped surface, what is to be said of its making, their deviation."""
    cell, phase, name = request.cell[0], np.array(request.phase), request.surface
    patch, symmetry = surfaces.primitive_patch(name, request.reference), surfaces.patch_symmetry(name)
    bounds = None
    with stages("fit") as done:
        if request.boundary == "natural":
            placements = lattices.place_whole_cells(name, request.cells, phase)
        else:
            bounds = mappings.map_box(bend, cell * np.array(request.cells, float))
            reach = float(np.abs(request.offset).max())
            placements = mappings.select_placements_near_box(
                patch, symmetry, bend, bounds, request.cells, phase, cell, reach
            )
        surface = mappings.MappedSurface(patch, symmetry, placements, bend, cell)
        mappings.require_offsets_below_curvature_radius(surface, request.offset, f"mapped {name}")
        lower, upper, deviation = mappings.fit_mapped_layers(surface, request.layer_offsets, request.tol, done)
    with stages("assemble"):
        brep = mappings.assemble_mapped_lattice(surface, lower, upper, natural=bounds is None)
    if bounds is None:
        return brep, (), deviation
    with stages("trim"):
        return *_trim_by_box(brep, *bounds, cell), deviation


def _trim_by_box(brep: Brep, low: Array, high: Array, cell: float) -> tuple[Brep, Notes]:
    """The complex cut by a box; a lattice that had to be moved a little, past something that a plane touches, is told."""
    cut = trim(brep, box(low, high), tol=CUT_TOL_CELLS * cell)
    if cut.report.shifted == 0.0:
        return cut.brep, ()
    return cut.brep, (f"the lattice was moved by {cut.report.shifted:.2g}: {cut.report.reason}",)


def _cell_origins(cells: tuple[int, int, int]) -> Array:
    """The corners of the cells: (n, 3)."""
    axes = [np.arange(n, dtype=float) for n in cells]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
