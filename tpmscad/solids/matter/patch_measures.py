"""The figures of a result's B-spline patches, and the limits they are checked against.

The patches of a minimal surface are copies of a few primitives, smooth to round-off, or are fitted one by one under a map.
Those of a field are fitted to its level set. Each kind has its own limits for the continuity across edges; a field's patches
are also checked against the Betti numbers and the volume of the field itself.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tpmscad import surfaces
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.deviation import Deviation
from tpmscad.brep.edge_continuity import EdgeContinuity, measure_edge_continuity
from tpmscad.lattices.coordinate_maps import IDENTITY, Map
from tpmscad.lattices.offset_surfaces import LayersFit
from tpmscad.minimal_series import MINIMAL_SERIES
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.results.certificate import Check, PatchMeasures, require
from tpmscad.solids.matter.field_patches import FieldPatches
from tpmscad.sources.level_set_source import LevelSetSource

OFFSET_TAGS = ("offset+", "offset-")
"""Tags of the faces that are offset surfaces of the reference."""

MAX_GAP_CELLS = 1e-9
MAX_TANGENT_JUMP_DEG = 1e-6
MAX_RELATIVE_CURVATURE_JUMP = 1e-6
"""Continuity of copied patches, which are smooth to round-off; the curvature jump is relative to the greatest curvature."""

KERNEL_POINT_TOL = 1e-7
"""Model units: the distance below which the kernel merges points; it limits the gaps of mapped patches."""

MAX_MAPPED_TANGENT_JUMP_DEG = 1e-4
MAX_MAPPED_RELATIVE_CURVATURE_JUMP = 1e-4
"""Continuity of patches under a map, whose derivatives are differences of the user's function."""

MAX_FIELD_TANGENT_JUMP_DEG = 0.01
"""Greatest tangent jump of patches that are fitted to a field, whose joints are tangent by construction."""

FIELD_VOLUME_RTOL = 1e-3
"""Relative difference allowed between the volume that the patches bound and the quadrature of the field."""


MEAN_CURVATURE = "residual mean curvature of the reference"
"""Name of the figure of a minimal surface that is a series: 0 for the exact one."""

TO_FIELD, FROM_FIELD = "deviation of the solid from the field", "deviation of the field from the solid"
"""Names of the figures of both directions."""


def measure_lattice_patches(
    request: LatticeRequest,
    mapping: Map | None,
    brep: Brep,
    fit: LayersFit[Any],
    notes: tuple[str, ...] = (),
) -> PatchMeasures:
    """The measures of a lattice's patches: copies of primitives, or fitted under `mapping`, with the limits of either."""
    continuity = measure_edge_continuity(brep, OFFSET_TAGS)
    if isinstance(request.source, LevelSetSource):
        return _measure_level_set_patches(request, continuity, fit.deviation, notes)
    limits = (
        (MAX_GAP_CELLS * request.cell[0], MAX_TANGENT_JUMP_DEG, MAX_RELATIVE_CURVATURE_JUMP)
        if mapping is None
        else (KERNEL_POINT_TOL, MAX_MAPPED_TANGENT_JUMP_DEG, MAX_MAPPED_RELATIVE_CURVATURE_JUMP)
    )
    names = ("gap", "tangent jump in degrees", "relative curvature jump")
    values = (continuity.gap, continuity.tangent_jump_deg, continuity.curvature_jump)
    reference = f"{request.reference} {request.surface} surface"
    if mapping is not None and mapping is not IDENTITY:
        reference += f" under {mapping.name}"
    if request.is_graded:
        reference += ", the wall graded"
    return PatchMeasures(
        request.tol,
        fit.deviation,
        reference,
        continuity,
        bounds=fit.bounds,
        figures={
            "CPIA iterations": fit.convergence.iterations,
            "CPIA bound": fit.convergence.bound,
            **state_mean_curvature(request),
        },
        checks=tuple(map(Check, names, values, limits)),
        notes=(*notes, *fit.notes, *request.notes),
    )


def _measure_level_set_patches(
    request: LatticeRequest, continuity: EdgeContinuity, deviation: Deviation, notes: tuple[str, ...]
) -> PatchMeasures:
    """The measures of patches fitted to a level set, whose joints are tangent within the limit of fields."""
    surface = f"{request.reference} {request.surface} {'surface' if request.levels is None else 'level sets'}"
    return PatchMeasures(
        request.tol,
        deviation,
        surface,
        continuity,
        figures=state_mean_curvature(request),
        checks=(
            Check("gap", continuity.gap, MAX_GAP_CELLS * max(request.cell)),
            Check("tangent jump in degrees", continuity.tangent_jump_deg, MAX_FIELD_TANGENT_JUMP_DEG),
        ),
        notes=(*notes, *request.notes),
    )


def state_mean_curvature(request: LatticeRequest) -> dict[str, float]:
    """The greatest mean curvature of a minimal surface that is the zero set of a series, 1 / model unit, as the figure of it."""
    if request.reference != "minimal" or surfaces.find_surface(request.surface).primitives == "exact":
        return {}
    return {MEAN_CURVATURE: MINIMAL_SERIES[request.surface].mean_curvature / min(request.cell)}


def check_field_tangent_jump(jump_deg: float) -> Check:
    """The check of the greatest tangent jump of patches that are fitted to a field."""
    return Check(
        "tangent jump",
        jump_deg,
        MAX_FIELD_TANGENT_JUMP_DEG,
        f"tangent jump {jump_deg:.3g} degrees exceeds {MAX_FIELD_TANGENT_JUMP_DEG:g}",
    )


def check_volume(own: float, of_field: float, error: float) -> Check:
    """The check of a solid's volume against the field's, which is known within an error."""
    return Check(
        "volume",
        abs(of_field - own),
        FIELD_VOLUME_RTOL * of_field + error,
        f"volume {own:.6g} differs from the field's, {of_field:.6g} within {error:.2g}: use a finer `tol`",
    )


def measure_field_patches(found: FieldPatches) -> PatchMeasures:
    """The measures of the patches of a field's solid in a box, checked against its Betti numbers and its volume too."""
    fitted, properties = found.fitted, found.properties
    volume, volume_error = found.field_volume, found.field_volume_error
    checks = [
        check_field_tangent_jump(fitted.continuity.tangent_jump_deg),
        require(
            found.field_betti in (None, properties.betti),
            f"Betti numbers {properties.betti} differ from the field's, {found.field_betti}: use a finer `tol`; "
            "of a blend, subgrid_check=True removes isolated parts that lie between its samples",
        ),
        check_volume(properties.volume, volume, volume_error),
    ]
    notes = fitted.notes
    if found.field_betti is None:
        notes = (*notes, "the field's Betti numbers did not settle on any grid tried: the solid's are its own")
    figures = {
        "tangent jump in degrees at the 95th percentile": fitted.jump_p95_deg,
        TO_FIELD: fitted.deviation.to_reference,
        FROM_FIELD: fitted.deviation.from_reference,
    }
    if np.isfinite(fitted.min_wall):
        figures["thinnest wall"] = fitted.min_wall
    return PatchMeasures(
        fitted.tol,
        fitted.deviation,
        "field",
        fitted.continuity,
        figures=figures,
        checks=tuple(checks),
        notes=notes,
    )


def move_patch_measures(measures: PatchMeasures, length: float) -> PatchMeasures:
    """The measures once the patches are translated by a length: they may be that much farther from their reference."""
    figures = {name: value + length * (name in (TO_FIELD, FROM_FIELD)) for name, value in measures.figures.items()}
    return replace(measures, deviation=measures.deviation.moved(length), figures=figures)
