"""The lattice around a body: every patch that a box needs, in place and turned, as the body's coordinates have it.

Lattice coordinates x are those of `tpmscad.lattice`; the body's are R x, R the rotation: the lattice is anchored at the body's
origin and turned about it.

The lattice around a body as a closed block, a little larger than the body: what the kernel's boolean takes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import ceil, floor
from typing import Any

import numpy as np

from tpmscad import kernel, surfaces
from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep, move_brep, scale_brep, translate_brep
from tpmscad.brep.deviation import Deviation
from tpmscad.brep.edge_continuity import EdgeContinuity, measure_edge_continuity
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.kernel.measure.cad_body import CadBody
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.convert import transform_shape as moved_shape
from tpmscad.lattices import copies as lattices
from tpmscad.lattices import mapped_lattice as mappings
from tpmscad.lattices.maps import stretching
from tpmscad.lattices.primitive import fit_offset_surfaces
from tpmscad.rigid_motion import Motion
from tpmscad.stage_timer import StageTimer
from tpmscad.trimming import box, trim
from tpmscad.workflows.implicit_solid import solidify
from tpmscad.workflows.lattice_request import LatticeRequest
from tpmscad.workflows.lattice_solid import CUT_TOL_CELLS

BLOCK_MARGIN_CELLS = 0.1237
"""Cells by which a block reaches beyond the body's box: no plane of it then lies in a symmetry plane that the body lies in."""

MAX_CELLS_IN_BOX = 100_000
"""Cells that a body's box may span: a hundred patches each, beyond which memory ends."""


@dataclass(frozen=True, slots=True, eq=False)
class LatticeCover:
    """Whole patches that cover the box from low to high, all in lattice coordinates: open, ragged outside; the fit's figures."""

    patches: Brep
    low: Array
    high: Array
    deviation: Deviation
    bounds: Mapping[str, float]


def cover_box(request: LatticeRequest, low: Array, high: Array, progress: Callable[[float], None]) -> LatticeCover:
    """The offset surfaces over the box from low to high (lattice coordinates, model units) and a margin around it."""
    edge = np.array(request.cell)
    low, high = low - BLOCK_MARGIN_CELLS * edge, high + BLOCK_MARGIN_CELLS * edge
    first, last = np.array([floor(v) for v in low / edge]), np.array([ceil(v) for v in high / edge])
    counts = last - first
    if np.prod(counts.astype(float)) > MAX_CELLS_IN_BOX:
        raise InvalidRequest(
            f"the body's box spans {' x '.join(map(str, counts))} cells of {edge.tolist()}, more than {MAX_CELLS_IN_BOX}: "
            "enlarge the cell, or cut the body"
        )
    cells, phase = (int(counts[0]), int(counts[1]), int(counts[2])), np.array(request.phase)
    if len(set(request.cell)) == 1:
        cell = request.cell[0]
        fit = fit_offset_surfaces(request.surface, request.reference, request.layer_offsets, cell, request.tol)
        patches = scale_brep(
            lattices.cover_box(surfaces.surface_symmetry(request.surface), fit.sheet, cells, phase), cell
        )
        deviation, bounds = fit.deviation, fit.bounds
    else:
        patches, deviation = _fit_stretched_patches(request, cells, phase, progress)
        bounds = {}
    return LatticeCover(translate_brep(patches, first * edge), low, high, deviation, bounds)


def _fit_stretched_patches(
    request: LatticeRequest, cells: tuple[int, int, int], phase: Array, progress: Callable[[float], None]
) -> tuple[Brep, Deviation]:
    """Patches of a lattice whose cell has unequal edges, fitted class by class."""
    cell, name = request.cell[0], request.surface
    bend = stretching(tuple(edge / cell for edge in request.cell))
    patch, symmetry = surfaces.primitive_patch(name, request.reference), surfaces.patch_symmetry(name)
    box = np.zeros(3), np.array(cells) * np.array(request.cell)
    reach = float(np.abs(request.offset).max())
    placements = mappings.select_placements_near_box(patch, symmetry, bend, box, cells, phase, cell, reach)
    surface = mappings.MappedSurface(patch, symmetry, placements, bend, cell)
    mappings.require_offsets_below_curvature_radius(surface, request.offset, f"stretched {name}")
    lower, upper, deviation = mappings.fit_mapped_layers(surface, request.layer_offsets, request.tol, progress)
    return mappings.assemble_mapped_lattice(surface, lower, upper, natural=False), deviation


FIELD_BLOCK_MARGIN_FRACTION = 0.0137
"""Of the body's extent: how far a field's block reaches beyond the body's box."""

OFFSET_TAGS = ("offset+", "offset-")


@dataclass(frozen=True, eq=False)
class LatticeBlock:
    """The patches that cover a body, in its coordinates and open, and what its certificate will say of them.

    `closed` are those patches cut flat outside the body, `shape` the kernel's solid of them; both made when asked for.
    """

    patches: Brep
    close: Callable[[], Brep]
    tol: float
    deviation: Deviation
    reference: str
    joints: EdgeContinuity
    bounds: Mapping[str, float]
    figures: Mapping[str, float]
    shortfalls: tuple[str, ...]
    notes: tuple[str, ...]

    @cached_property
    def closed(self) -> Brep:
        return self.close()

    @cached_property
    def built(self) -> kernel.BuiltSolids:
        return kernel.build_solids(self.closed)

    @property
    def shape(self) -> Any:
        return self.built.shape


def build_lattice_block(request: LatticeRequest, turn: Array, body: CadBody, stages: StageTimer) -> LatticeBlock:
    """The lattice of a minimal surface around the body; `turn` takes lattice coordinates to the body's."""
    low, high = enclosing_box(moved_shape(body.shape, Motion(turn.T, np.zeros(3))))
    if (high - low < np.array(request.cell)).all():
        raise InvalidRequest(
            f"{body.name} spans {' x '.join(f'{v:.4g}' for v in high - low)}, less than a cell of "
            f"{' x '.join(f'{v:.4g}' for v in request.cell)}: make the cell smaller"
        )
    with stages("fit") as done:
        around = cover_box(request, low, high, done)
    with stages("assemble"):
        patches = move_brep(around.patches, Motion(turn, np.zeros(3)))
        smooth = measure_edge_continuity(patches, OFFSET_TAGS)

    def close() -> Brep:
        closed = trim(around.patches, box(around.low, around.high), CUT_TOL_CELLS * max(request.cell)).brep
        return move_brep(closed, Motion(turn, np.zeros(3)))

    reference = f"{request.reference} {request.surface} surface"
    return LatticeBlock(patches, close, request.tol, around.deviation, reference, smooth, around.bounds, {}, (), ())


def build_field_block(
    field: Field | Callable[..., Any], body: CadBody, tol: float | None, stages: StageTimer
) -> LatticeBlock:
    """The solid of a field in the body's box and a margin around it."""
    if tol is None:
        raise InvalidRequest("the solid of a field needs tol=, its greatest deviation from the field")
    low, high = enclosing_box(body.shape)
    margin = FIELD_BLOCK_MARGIN_FRACTION * float((high - low).max())
    model = solidify(field, (low - margin, high + margin), tol=tol, progress=stages.progress)
    stages.seconds.update(model.certificate.seconds)
    found = model.certificate
    return LatticeBlock(
        model.patches,
        lambda: model.patches,
        tol,
        Deviation(found.max_deviation, found.rms_deviation, found.max_deviation, found.max_deviation),
        found.reference,
        EdgeContinuity(found.gap, found.tangent_jump_deg, found.curvature_jump, 0),
        found.bounds,
        {name: value for name, value in found.figures.items() if "volume" not in name},  # that is the block's own
        found.shortfalls,
        found.notes,
    )
