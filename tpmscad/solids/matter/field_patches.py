"""The patches of a field's solid in a box, fitted and measured without the kernel.

The level set {field = 0} inside the box is fitted to the tolerance (`tpmscad.levelset`) after its convex edges have been
rounded within part of it. The volume, the Betti numbers and the pieces of the solid that the patches bound are computed from
their arrays. Two independent witnesses come from the field alone: its Betti numbers on a sequence of grids, and its volume by
quadrature along grid lines. If the Betti numbers differ, the fit is continued with octree leaves split where they hide
crossings, or repeated from the start if that does not help; they are compared before patches are merged, which takes longer than
everything before.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.deviation import Deviation
from tpmscad.brep.moments import integral_properties
from tpmscad.brep.moments.integral_properties import FaceMoments
from tpmscad.brep.solid_properties import SolidProperties, measure_solid
from tpmscad.errors import CrossingSurfaces, LevelSetError, ThinWall, format_point
from tpmscad.fields.analysis import volume_quadrature
from tpmscad.fields.analysis.betti_numbers import FINER_LINES, Betti, compute_betti_numbers, count_tunnels_near_surface
from tpmscad.fields.data.field_notes import collect_notes
from tpmscad.fields.field import Field, as_field
from tpmscad.fields.kinds.linear_extension import LinearExtension, extend_linearly
from tpmscad.levelset import field_solid
from tpmscad.levelset.crossing_operands import split_crossing_operands
from tpmscad.levelset.edge_rounding import round_edges
from tpmscad.levelset.field_solid import (
    FieldFit,
    FieldSolid,
    find_places_of_fit,
    find_sample_spacing,
    fit_field,
    measure_field_fit,
    refine_field_fit,
    simplify_field_fit,
    validate_box,
)
from tpmscad.parallel import limit_blas_threads, run_serial, task_runner
from tpmscad.stage_timer import StageTimer

ROUNDING_TOL_FRACTION = 0.8
"""Fraction of the tolerance by which rounding may move the surface at edges; the fit seldom needs a tenth of it."""

TOL_PER_WALL = 1 / 3
"""Of the thinnest wall that samples show: the tolerance chosen where a default is too large. A wall must be thicker than twice
the tolerance wherever samples of the fit, which may be denser, find it."""

MIN_ROUNDING_RADIUS_PERIODS = 1.5e-3
"""In periods: the least rounding radius that the finest octree leaves can resolve."""

N_QUADRATURE_LINES = 64
"""Grid lines along the longest edge of the box with which the quadrature of the volume starts."""


@dataclass(frozen=True, slots=True, eq=False)
class FieldPatches:
    """The patches of a field's solid in a box, with what was measured on them; lengths in model units.

    `fitted` holds the patches and their deviation from the field given, the displacement by rounding included.
    `moments` are the integrals over its faces, `properties` those of the solid it bounds. `field_betti` are the Betti numbers of
    the field in the box (None if they differ on all grids), `field_volume` its volume and `field_volume_error` the uncertainty of
    that.
    """

    fitted: FieldSolid
    moments: FaceMoments
    properties: SolidProperties
    field_betti: Betti | None
    field_volume: float
    field_volume_error: float


def fit_field_patches(
    field: Field | Callable[..., Any],
    lo: Any,
    hi: Any,
    tol: float,
    stages: StageTimer,
    *,
    executor: Executor | None = None,
) -> FieldPatches:
    """The solid {field < 0} in the box [lo, hi] as patches within `tol` of the level set, measured without the kernel.

    LevelSetError names the place at which the field cannot be fitted, and the reason.
    """
    field = as_field(field)
    lo, hi = validate_box(lo, hi, tol)
    rounded, moved, notes = _round_field_edges(field, lo, hi, tol)
    # fits are many small tasks: a process pool of this machine's cores took longer than one process
    runner = nullcontext(run_serial) if executor is None else task_runner(executor, rounded)
    with stages("fit") as done, runner as run_tasks, limit_blas_threads():
        first = fit_field(rounded, lo, hi, tol - moved, run_tasks=run_tasks, progress=lambda part: done(0.5 * part))
        betti, is_possible = _compute_betti_numbers_of(first)
        if is_possible:  # else patches that miss a neck would be merged and measured in vain
            fit = simplify_field_fit(first, lambda part: done(0.5 + 0.5 * part))
            moments, properties = _measure_brep(fit.brep)
        if not is_possible or (betti is not None and properties.betti != betti):
            refined = _refine_until_possible(first, betti)
            if refined is None:
                refined = fit_field(rounded, lo, hi, tol - moved, detect_hidden_crossings=True, run_tasks=run_tasks)
            fit = simplify_field_fit(refined)
            moments, properties = _measure_brep(fit.brep)
        fitted = measure_field_fit(fit)
    with stages("check"):
        if moved and betti is not None:
            unrounded = compute_betti_numbers(field, lo, hi)
            if unrounded not in (None, betti):
                notes = (
                    *notes,
                    f"rounding changes the field's Betti numbers from {unrounded} to {betti}: use a finer `tol`",
                )
                betti = unrounded
        spacing = float((hi - lo).max()) / N_QUADRATURE_LINES
        volume, volume_error = volume_quadrature.integrate_volume(field, lo, hi, spacing)
    d = fitted.deviation
    deviation = Deviation(d.max + moved, d.rms, d.to_reference + moved, d.from_reference + moved)
    notes = (*collect_notes(field), *notes, *fitted.notes)
    fitted = replace(fitted, tol=tol, deviation=deviation, notes=notes)
    return FieldPatches(fitted, moments, properties, betti, volume, volume_error)


def _measure_brep(brep: Brep) -> tuple[FaceMoments, SolidProperties]:
    """The moments of the faces, and the properties of the solid that they bound."""
    moments = integral_properties.integrate_faces(brep)
    return moments, measure_solid(brep, moments)


def _compute_betti_numbers_of(fit: FieldFit) -> tuple[Betti | None, bool]:
    """The Betti numbers of a fit's field, None if unknown, and whether its patches can have them: shells and sum agree.

    Uncertain numbers are not returned if the patches cannot have them, but the second value is then False as well.
    """
    contradicted = False

    def confirm(betti: Betti) -> bool:
        nonlocal contradicted
        possible = _could_have(fit.brep, betti)
        contradicted |= not possible
        return possible

    betti = compute_betti_numbers(fit.field, fit.lo, fit.hi, confirm=confirm)
    if betti is None or confirm(betti):
        return betti, not contradicted
    # two grids can miss the same neck; a finer one is believed where the patches, counted otherwise, confirm it
    finer = compute_betti_numbers(fit.field, fit.lo, fit.hi, FINER_LINES, 1, confirm)
    if finer is None or not confirm(finer):
        known = finer or betti
        if connectivity.label_shells(fit.brep)[0] != known[0] + known[2]:  # whatever the tunnels
            return betti, False
        finer = count_tunnels_near_surface(fit.field, fit.lo, fit.hi, known, confirm)
    return (betti, False) if finer is None else (finer, True)


def _refine_until_possible(fit: FieldFit, betti: Betti | None) -> FieldFit | None:
    """The fit continued where leaves hide crossings, None if that fails or its patches cannot have the Betti numbers.

    Near narrow places first: everywhere it takes half as many patches again.
    """
    refined, narrow = fit, find_places_of_fit(fit)
    for everywhere in (False, True):
        try:
            refined = refine_field_fit(refined, narrow, everywhere)
        except LevelSetError:
            return None
        if betti is not None and _could_have(refined.brep, betti):
            return refined
    return None


def _could_have(brep: Brep, betti: Betti) -> bool:
    """Whether the number of shells and the Euler characteristic are those of a solid with these Betti numbers."""
    count, shell = connectivity.label_shells(brep)
    euler = int(connectivity.euler_characteristic(brep, shell).sum())
    return count == betti[0] + betti[2] and euler == 2 * (betti[0] - betti[1] + betti[2])


def check_field_in_box(field: Field | Callable[..., Any], lo: Any, hi: Any, tol: float) -> None:
    """Raise what `fit_field_patches` would raise before it fits."""
    field = as_field(field)
    low, high = validate_box(lo, hi, tol)
    rounded, moved, _ = _round_field_edges(field, low, high, tol)
    try:
        field_solid.check_field_in_box(rounded, low, high, tol - moved)
    except CrossingSurfaces:  # they are made one by one (`combined_solids`)
        split_crossing_operands(rounded, low, high, tol - moved, find_sample_spacing(rounded, low, high))


def limit_tol_to_walls(field: Field, lo: Array, hi: Array, tol: float) -> float:
    """The tolerance, or a fraction of the thinnest wall in the box where that is less."""
    try:
        check_field_in_box(field, lo, hi, tol)
    except ThinWall as error:
        return TOL_PER_WALL * error.thickness
    return tol


def _round_field_edges(field: Field, lo: Array, hi: Array, tol: float) -> tuple[Field, float, tuple[str, ...]]:
    """The field with the edges of its walls rounded, the greatest displacement of its level set, and notes on it."""
    extended = field if isinstance(field, LinearExtension) else extend_linearly(field, lo, hi)
    rounding = round_edges(
        extended.field, np.maximum(lo, extended.lo), np.minimum(hi, extended.hi), ROUNDING_TOL_FRACTION * tol
    )
    if rounding is None:
        return field, 0.0, ()
    edge = f"{rounding.opening_deg:.0f} degrees at {format_point(rounding.sharpest_point, 5)}"
    periods = [p for structure in rounding.field.structures for p in structure.periods() or () if p > 0]
    if rounding.radius < MIN_ROUNDING_RADIUS_PERIODS * min(periods, default=0.0):
        raise LevelSetError(
            f"a blended wall ends in an edge of {edge}: within tol {tol:g} it can be rounded with a radius of "
            f"{rounding.radius:.2g} only, too little for smooth patches; "
            "blend over a longer distance, or use a thicker wall or a larger tol"
        )
    rounded = replace(field, field=rounding.field) if isinstance(field, LinearExtension) else rounding.field
    note = f"edges of walls were rounded: the surface moves by up to {rounding.max_displacement:.3g}; the sharpest has {edge}"
    return rounded, rounding.max_displacement, (note,)
