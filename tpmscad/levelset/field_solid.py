"""Any implicit field in a box as a patch complex: laid out, fitted, measured, refined where it falls short, or refused.

The coarsest layouts are tried first: uniform ones, with higher degrees where a patch misses, then octrees refined by the turning
of the normals and by what their fits miss. Nothing is accepted that was not measured; what can't pass ends in a LayoutError that
names the place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, FractionProgress
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import InvalidRequest, LevelSetError
from tpmscad.fields.field import Field
from tpmscad.fields.linear_extension import LinearExtension, extend_linearly
from tpmscad.levelset.adaptive_search import fit_level_set_adaptively
from tpmscad.levelset.boundary_level_sets import (
    check_separation,
    decompose_level_sets,
    replace_level_sets,
    sample_level_set,
)
from tpmscad.levelset.brep_assembly import assemble_field_brep
from tpmscad.parallel import TaskRunner, run_serial

MIN_SAMPLE_LINES = 40
"""Grid lines along the box's longest edge on which curvature is sampled, at least."""


MAX_VOLUME_CHANGE_FRACTION = 3e-4
"""Part of the solid's volume by which a level may change it when it is moved off a corner of the box."""

CROSSINGS_PER_AREA = 1.5
"""Crossings of a surface with a grid's lines, per step squared of its area: the mean of |nx| + |ny| + |nz|."""


@dataclass(frozen=True, slots=True, eq=False)
class FieldSolid:
    """A field's solid as a complex, with what was measured on it; lengths in model units, angles in degrees.

    `field` is what was laid out: the one asked for, but for levels moved off the box's corners, which `notes` tell.
    `to_field` and `from_field`: greatest distances from the patches to the level sets and back; `jump_p95_deg` over all joints.
    """

    brep: Brep
    field: Field
    tol: float
    to_field: float
    from_field: float
    rms: float
    cosine: float
    jump_deg: float
    jump_p95_deg: float
    curvature_jump: float
    wall: float
    leaves: int
    notes: tuple[str, ...]


def fit_field_solid(
    field: Field,
    lo: Array,
    hi: Array,
    tol: float,
    *,
    probed: bool = False,
    work: TaskRunner = run_serial,
    progress: FractionProgress | None = None,
) -> FieldSolid:
    """The solid {field < 0} inside the box [lo, hi], within tol of the field's level set in both directions.

    `probed`: leaves are split where they hide crossings, too, at the price of more faces: for solids whose Betti numbers else
    differ from the field's. `work` does the fits, here or elsewhere, with the same result (`levelset.work.workers`).

    LayoutError names where the field can't be laid out, and why; InvalidRequest what is wrong with the request. Betti numbers
    and volume are the caller's to compare (`tpmscad.workflows.implicit_solid`).
    """
    lo, hi = validate_box(lo, hi, tol)
    done = progress or (lambda share: None)
    parts = tuple(extend_linearly(part, lo, hi) for part in decompose_level_sets(field))
    spacing = float((hi - lo).max()) / MIN_SAMPLE_LINES
    samples = []
    for part in parts:
        if (period := part.periods()) is not None:
            spacing = min(spacing, min(period) / 8)
        samples.append(sample_level_set(part, lo, hi, spacing))
    if not any(len(s) for s in samples):
        raise LevelSetError("the field has no surface inside the box: check the level and the domain")
    notes: list[str] = []
    parts, samples = _shift_levels_off_corners(field, parts, samples, lo, hi, tol, spacing, notes)
    shown = replace_level_sets(field, parts)
    wall = check_separation(shown, parts, samples, tol)

    fitted = []
    for i, part in enumerate(parts):
        if len(samples[i]):
            fitted.append(fit_level_set_adaptively(part, lo, hi, tol, samples[i], probed, work))
        done((i + 1) / len(parts))
    corners = np.stack(np.meshgrid(*np.stack([lo, hi], axis=1), indexing="ij"), axis=-1)
    corner_solid = shown(corners) <= 0
    brep = assemble_field_brep([(f.net, f.fit) for f in fitted], [f.fixed for f in fitted], lo, hi, corner_solid)
    jump = np.concatenate([f.measured.tangent_jump_deg for f in fitted])
    steepest = max(float(f.measured.curvature.max(initial=0.0)) for f in fitted)
    return FieldSolid(
        brep=brep,
        field=shown,
        tol=tol,
        to_field=max(float(f.measured.of.distance.max()) for f in fitted),
        from_field=max(float(f.missed.max(initial=0.0)) for f in fitted),
        rms=float(np.sqrt(np.mean(np.concatenate([f.measured.of.square for f in fitted])))),
        cosine=min(float(f.measured.of.cosine.min()) for f in fitted),
        jump_deg=float(jump.max(initial=0.0)),
        jump_p95_deg=float(np.percentile(jump, 95)) if len(jump) else 0.0,
        curvature_jump=max(float(f.measured.bend.max(initial=0.0)) for f in fitted) / max(steepest, 1e-300),
        wall=wall,
        leaves=sum(len(f.tree.size) for f in fitted),
        notes=tuple(notes),
    )


def _shift_levels_off_corners(
    field: Field,
    parts: tuple[LinearExtension, ...],
    samples: list[Array],
    lo: Array,
    hi: Array,
    tol: float,
    spacing: float,
    notes: list[str],
) -> tuple[tuple[LinearExtension, ...], list[Array]]:
    """Levels moved by at most a tenth of tol where the surface passes through a corner of the box, and the volume by SHARE."""
    corners = np.stack(np.meshgrid(*np.stack([lo, hi], axis=1), indexing="ij"), axis=-1).reshape(-1, 3)
    result, moved = [], []
    for part, points in zip(parts, samples, strict=True):
        value, slope = part.value_and_gradient(corners)
        near = np.abs(value) < 1e-2 * tol * np.linalg.norm(slope, axis=1)
        if near.any() and len(points):
            move = min(
                0.1 * tol, MAX_VOLUME_CHANGE_FRACTION * _estimate_volume_per_area(field, points, lo, hi, spacing)
            )
            shift = move * float(np.linalg.norm(part.gradient(points), axis=1).min())
            where = ", ".join(f"{x:g}" for x in corners[near][0])
            notes.append(f"the surface passes through the box's corner ({where}): its level was moved by {shift:.3g}")
            part = replace(part, field=part.field + shift)
            points = sample_level_set(part, lo, hi, spacing)
        result.append(part)
        moved.append(points)
    return tuple(result), moved


def _estimate_volume_per_area(field: Field, points: Array, lo: Array, hi: Array, spacing: float) -> float:
    """The solid's volume by the area of a level set, both roughly: from where that crosses a grid's lines, as samples_of does."""
    axes = [np.linspace(a, b, max(2, int(np.ceil((b - a) / spacing))) + 1) for a, b in zip(lo, hi, strict=True)]
    volume = float(np.mean(field.on_grid(*axes) < 0) * np.prod(hi - lo))
    step = float(np.prod([axis[1] - axis[0] for axis in axes]) ** (2 / 3))
    return volume / (len(points) * step / CROSSINGS_PER_AREA)


def validate_box(lo: Array, hi: Array, tol: float) -> tuple[Array, Array]:
    """The corners as arrays; InvalidRequest unless they span a box, and tol is above zero and below its edges."""
    try:
        low, high = np.asarray(lo, float), np.asarray(hi, float)
    except (TypeError, ValueError) as error:
        raise InvalidRequest(f"domain ({lo!r}, {hi!r}) must be two points of three numbers") from error
    if low.shape != (3,) or high.shape != (3,) or not (low < high).all() or not np.isfinite([low, high]).all():
        raise InvalidRequest(f"domain ({lo!r}, {hi!r}) must be two points (x, y, z), the first below the second")
    if not 0 < tol < (high - low).min():
        raise InvalidRequest(f"tol {tol!r} must be above zero and below the box's least edge, {(high - low).min():g}")
    return low, high
