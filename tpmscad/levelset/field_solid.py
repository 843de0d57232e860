"""The solid {field < 0} in a box as a measured boundary representation: the entry to this package.

The field is decomposed into the level sets that bound the solid. Each is fitted by itself on the coarsest mesh that passes, and
the results and the planar caps in the faces of the box are assembled. Nothing is accepted that was not measured: a level set that
cannot be fitted within the request ends in a LevelSetError that names the place and the cause.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, FractionProgress
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.deviation import Deviation
from tpmscad.brep.edge_continuity import EdgeContinuity
from tpmscad.errors import InvalidRequest, LevelSetError
from tpmscad.fields.analysis.outermost_extremes import expose_extremes, list_leaves, replace_leaves
from tpmscad.fields.data.field_notes import find_least_spacing
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.linear_extension import LinearExtension, extend_linearly
from tpmscad.levelset.adaptive_search import fit_level_set_adaptively, split_hidden_crossings
from tpmscad.levelset.boundary_level_sets import (
    NarrowPlaces,
    box_corners,
    check_separation,
    find_narrow_places,
    sample_level_set,
    sample_narrow_places,
    shift_level_off_corners,
)
from tpmscad.levelset.brep_assembly import assemble_field_brep
from tpmscad.levelset.fit.fit_quality import measure_curvature_jump
from tpmscad.levelset.fit_simplification import simplify_fit
from tpmscad.levelset.level_set_fit import FitRequest, LevelSetFit
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR
from tpmscad.parallel import TaskRunner, run_serial

MIN_SAMPLE_LINES = 40
"""Least number of sampling grid lines along the longest edge of the box."""

MAX_DATA_LINES = 256
"""Most lines along the longest edge of the box that samples of data ask for: 17 million points in a cube."""

SAMPLES_PER_PERIOD = 8
"""Least number of sampling grid lines per period of a periodic field."""


@dataclass(frozen=True, slots=True, eq=False)
class FieldSolid:
    """A field's solid as a Brep, with its measured quality; lengths in model units, angles in degrees.

    `field` is the field that was fitted: the requested one, except for levels shifted off the corners of the box, which `notes`
    report.
    """

    brep: Brep
    field: Field
    tol: float
    deviation: Deviation
    """From the patches to the level sets, and from samples of these to the patches."""
    continuity: EdgeContinuity
    """Across the joints of the patches; curvatures are compared in the Frobenius norm."""
    jump_p95_deg: float
    """95th percentile over all joints of the largest angle between the normals of two patches."""
    min_wall: float
    """Least distance between two level sets, infinite for a single one."""
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FieldFit:
    """The fits of the level sets that bound a field's solid in the box [lo, hi], and the Brep they make with its caps.

    `field` as in `FieldSolid`; `fits` are those of the level sets that meet the box, `min_wall` the least distance between two.
    """

    fits: tuple[LevelSetFit, ...]
    lo: Array
    hi: Array
    field: Field
    tol: float
    min_wall: float
    notes: tuple[str, ...]
    brep: Brep


@dataclass(frozen=True, slots=True, eq=False)
class _LevelSetPart:
    """One of the level sets that bound the solid, extended linearly beyond the box, and samples (n, 3) of it."""

    field: LinearExtension
    samples: Array

    def with_narrow_places(self, lo: Array, hi: Array) -> _LevelSetPart:
        """With samples of narrow places as well, which may be all of a small part."""
        found = sample_narrow_places(self.field, lo, hi, self.samples, find_narrow_places(self.field, lo, hi))
        return replace(self, samples=np.concatenate([self.samples, found]))


def fit_field_solid(
    field: Field, lo: Array, hi: Array, tol: float, *, run_tasks: TaskRunner = run_serial
) -> FieldSolid:
    """The solid {field < 0} in the box [lo, hi], within tol of the field's level set in both directions, with few patches.

    Arguments and errors as in `fit_field`. Betti numbers and volume are compared by the caller (`tpmscad.solidify`).
    """
    return measure_field_fit(simplify_field_fit(fit_field(field, lo, hi, tol, run_tasks=run_tasks)))


def fit_field(
    field: Field,
    lo: Array,
    hi: Array,
    tol: float,
    *,
    detect_hidden_crossings: bool = False,
    run_tasks: TaskRunner = run_serial,
    progress: FractionProgress | None = None,
) -> FieldFit:
    """The level sets of a field's solid in the box [lo, hi], fitted within tol.

    `detect_hidden_crossings`: split leaves, too, whose corners hide a crossing of the level set or that miss a narrow place, at
    the price of more patches; for solids whose Betti numbers would differ from the field's. `run_tasks` runs the fits, in this
    process or elsewhere (`tpmscad.parallel`), with the same result. `progress` is called with the fraction done.

    Raises LevelSetError where the level set cannot be fitted, and InvalidRequest for a bad box or tolerance.
    """
    lo, hi = validate_box(lo, hi, tol)
    field = expose_extremes(field)
    parts, notes = _prepare_parts(field, lo, hi, tol)
    if detect_hidden_crossings:
        parts = [part.with_narrow_places(lo, hi) for part in parts]
    level_sets = tuple(part.field for part in parts)
    fitted_field = replace_leaves(field, level_sets)
    min_wall = check_separation(fitted_field, level_sets, [part.samples for part in parts], tol)
    fits = []
    for i, part in enumerate(parts):
        if len(part.samples):
            request = FitRequest(part.field, tol, part.samples, run_tasks)
            fits.append(fit_level_set_adaptively(request, lo, hi, detect_hidden_crossings))
        if progress:
            progress((i + 1) / len(parts))
    brep = _assemble(fits, fitted_field, lo, hi)
    return FieldFit(tuple(fits), lo, hi, fitted_field, tol, min_wall, notes, brep)


def find_places_of_fit(fit: FieldFit) -> tuple[NarrowPlaces, ...]:
    """The narrow places of each level set of a fit."""
    return tuple(find_narrow_places(each.request.field, fit.lo, fit.hi) for each in fit.fits)


def refine_field_fit(fit: FieldFit, narrow: Sequence[NarrowPlaces], everywhere: bool) -> FieldFit:
    """The fit continued where octree leaves hide a crossing of its level sets; LevelSetError if that fails.

    Leaves are split near the `narrow` places of each level set, or `everywhere` if these do not suffice. Faster than `fit_field`
    with `detect_hidden_crossings`, because patches elsewhere are reused.
    """
    refined = []
    for each, places in zip(fit.fits, narrow, strict=True):
        field, samples = each.request.field, each.request.surface_samples
        missed = sample_narrow_places(field, fit.lo, fit.hi, samples, places)
        refined.append(split_hidden_crossings(each, missed, None if everywhere else places.points))
    return replace(fit, fits=tuple(refined), brep=_assemble(refined, fit.field, fit.lo, fit.hi))


def simplify_field_fit(fit: FieldFit, progress: FractionProgress | None = None) -> FieldFit:
    """The fit with patches merged where the tolerance allows it, which takes longer than the fit itself."""
    simplified = []
    for i, each in enumerate(fit.fits):
        simplified.append(simplify_fit(each))
        if progress:
            progress((i + 1) / len(fit.fits))
    if all(new is old for new, old in zip(simplified, fit.fits, strict=True)):
        return fit
    return replace(fit, fits=tuple(simplified), brep=_assemble(simplified, fit.field, fit.lo, fit.hi))


def check_field_in_box(field: Field, lo: Array, hi: Array, tol: float) -> None:
    """Raise what `fit_field_solid` would raise before it fits: bad box or tolerance, no surface, crossings, thin walls."""
    lo, hi = validate_box(lo, hi, tol)
    field = expose_extremes(field)
    parts, _ = _prepare_parts(field, lo, hi, tol)
    level_sets = tuple(part.field for part in parts)
    check_separation(replace_leaves(field, level_sets), level_sets, [part.samples for part in parts], tol)


def validate_box(lo: Array, hi: Array, tol: float) -> tuple[Array, Array]:
    """The corners as arrays; InvalidRequest unless they span a box, and tol is positive and below its shortest edge."""
    low, high = np.asarray(lo, float), np.asarray(hi, float)
    if low.shape != (3,) or high.shape != (3,) or not (low < high).all() or not np.isfinite([low, high]).all():
        raise InvalidRequest(f"domain ({lo!r}, {hi!r}) must be two points (x, y, z), the first below the second")
    if not 0 < tol < (high - low).min():
        raise InvalidRequest(
            f"tol {tol!r} must be above zero and below the box's shortest edge, {(high - low).min():g}"
        )
    return low, high


def find_sample_spacing(field: Field, lo: Array, hi: Array) -> float:
    """The spacing at which the level sets that bound a field's solid are sampled in a box, model units."""
    periods = [leaf.periods() for leaf in list_leaves(expose_extremes(field))]
    lengths = [length / SAMPLES_PER_PERIOD for period in periods for length in period or () if length > 0]
    longest, data = float((hi - lo).max()), find_least_spacing(field)
    if data is not None:  # a cavity or a speck of one sample is found where lines pass samples
        lengths.append(max(data, longest / MAX_DATA_LINES))
    return min([longest / MIN_SAMPLE_LINES, *lengths])


def _prepare_parts(field: Field, lo: Array, hi: Array, tol: float) -> tuple[list[_LevelSetPart], tuple[str, ...]]:
    """The level sets that bound the solid, sampled and shifted off the corners of the box, and a note on each shift."""
    parts = []
    spacing = find_sample_spacing(field, lo, hi)
    for level_set in list_leaves(field):
        extended = extend_linearly(level_set, lo, hi)
        parts.append(_LevelSetPart(extended, sample_level_set(extended, lo, hi, spacing)))
    if not any(len(part.samples) for part in parts):  # a speck, perhaps, between the lines of the grid
        parts = [part.with_narrow_places(lo, hi) for part in parts]
    if not any(len(part.samples) for part in parts):
        raise LevelSetError("the field has no surface inside the box: check the level and the domain")
    notes = []
    for i, part in enumerate(parts):
        shifted, note = shift_level_off_corners(field, part.field, part.samples, lo, hi, tol, spacing)
        if note is not None:
            parts[i] = _LevelSetPart(shifted, sample_level_set(shifted, lo, hi, spacing))
            notes.append(note)
    return parts, tuple(notes)


def _assemble(fits: Sequence[LevelSetFit], field: Field, lo: Array, hi: Array) -> Brep:
    """The patches of the level sets with the caps of the box, whose corners are solid where the field is not positive."""
    corner_solid = field(box_corners(lo, hi)) <= 0
    return assemble_field_brep([(f.network, f.fit) for f in fits], [f.fixed for f in fits], lo, hi, corner_solid)


def measure_field_fit(fit: FieldFit) -> FieldSolid:
    """The solid of a fit with the worst measurements of its level sets."""
    qualities = [each.quality for each in fit.fits]
    jump = np.concatenate([q.tangent_jump_deg for q in qualities])
    curvature_jump, max_curvature = np.max([measure_curvature_jump(f.network, f.fit) for f in fit.fits], axis=0)
    to_field = max(float(q.distance.max()) for q in qualities)
    from_field = max(float(each.sample_distances.max(initial=0.0)) for each in fit.fits)
    rms = float(np.sqrt(np.mean(np.concatenate([q.mean_square_distance for q in qualities]))))
    gap, jump_deg = float(fit.brep.edges.deviation.max(initial=0.0)), float(jump.max(initial=0.0))
    return FieldSolid(
        brep=fit.brep,
        field=fit.field,
        tol=fit.tol,
        deviation=Deviation(max(to_field, from_field), rms, to_field, from_field),
        continuity=EdgeContinuity(gap, jump_deg, float(curvature_jump / max(max_curvature, MIN_DIVISOR)), 0),
        jump_p95_deg=float(np.percentile(jump, 95)) if len(jump) else 0.0,
        min_wall=fit.min_wall,
        notes=fit.notes,
    )
