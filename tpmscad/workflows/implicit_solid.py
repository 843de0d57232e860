"""Any implicit field as a certified NURBS solid: lay out, fit, close, build, measure.

model = solidify(fields.rod(fields.tpms("gyroid", 10.0), -0.3), ((0, 0, 0), (10, 10, 10)), tol=0.01)
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any

import numpy as np

from tpmscad import kernel
from tpmscad._typing import Progress
from tpmscad.blending.edge_rounding import round_edges
from tpmscad.brep.moments import integral_properties
from tpmscad.brep.solid_properties import SolidProperties, measure_solid
from tpmscad.errors import InvalidRequest, LevelSetError
from tpmscad.fields import volume_quadrature
from tpmscad.fields.betti_numbers import compute_betti_numbers
from tpmscad.fields.field import Field, as_field
from tpmscad.fields.linear_extension import LinearExtension, extend_level_sets_linearly, extend_linearly
from tpmscad.kernel.measure.cad_body import read_body
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.levelset.field_solid import FieldSolid, fit_field_solid, validate_box
from tpmscad.parallel import task_runner
from tpmscad.stage_timer import StageTimer
from tpmscad.workflows.certificate import Certificate, build_certificate
from tpmscad.workflows.model import Model

FIELD_TANGENT_JUMP_LIMITS_DEG = (0.5, 2.0)
"""Joints: at the 95th percentile, and at most."""

ROUNDING_TOL_FRACTION = 0.8
"""Part of tol by which the surface may move where edges are rounded; fits seldom need a tenth of it."""

MIN_ROUNDING_RADIUS_PERIODS = 1.5e-3
"""Part of the period below which the least radius of an edge is too small for the finest leaves: layouts were found down to
3.6e-3, at 1.2e-3 none."""

FIELD_VOLUME_RTOL = 1e-3
"""Relative: the volume the patches bound against the quadrature of the field."""

KERNEL_VOLUME_RTOL = 1e-6
"""Relative: the kernel's quadrature of its own faces against ours of the patches."""

N_QUADRATURE_LINES = 96
"""Grid lines along the box's longest edge for the volume, at first."""

BoxCorners = Sequence[Sequence[float]]


def solidify(
    field: Field | Callable[..., Any],
    domain: BoxCorners | Any,
    *,
    tol: float,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Model:
    """The solid {field < 0} inside `domain`, its surface within tol of the level set.

    domain: a box ((x0, y0, z0), (x1, y1, z1)), or a body (a build123d or CadQuery shape, a STEP file) in the field's coordinates:
    then the solid is laid out in a box a little larger and trimmed by the body, whose own faces stay exact; what the field is
    beyond the body's box does not matter.
    The field may be any of tpmscad.fields or a function of points. executor: any concurrent.futures.Executor whose workers can
    import this package does the fits in a box; None: a pool of this machine's cores, where that pays. The result is the same,
    bit for bit. LayoutError names where a field can't be made a solid and why; a result that misses what was asked for has
    certificate.met False.
    """
    if not _is_numeric_box(domain):
        if executor is not None:
            raise InvalidRequest("an executor is for boxes; a body is filled by one process: leave executor out")
        from tpmscad.workflows import infill  # which fills the body with what solidify makes of its box

        bounds = enclosing_box(read_body(domain).shape)
        return infill(domain, extend_level_sets_linearly(as_field(field), *bounds), tol=tol, progress=progress)
    field = as_field(field)
    lo, hi = validate_box(*_parse_corners(domain), tol)
    stages = StageTimer(progress)
    smooth, moved, notes = _round_edges(field, lo, hi, tol)
    with stages("fit") as done, task_runner(executor, smooth) as work:
        made = fit_field_solid(smooth, lo, hi, tol - moved, work=work, progress=done)
        moments = integral_properties.integrate_faces(made.brep)
        shape, expected = measure_solid(made.brep, moments), compute_betti_numbers(made.field, lo, hi)
        if expected is not None and shape.betti != expected:
            made = fit_field_solid(smooth, lo, hi, tol - moved, probed=True, work=work, progress=done)
            moments = integral_properties.integrate_faces(made.brep)
            shape = measure_solid(made.brep, moments)
    with stages("build"):
        built = kernel.build_solids(made.brep, moments)
    with stages("check"):
        found = kernel.check_shape(built.shape)
        if moved and expected is not None and (asked := compute_betti_numbers(field, lo, hi)) not in (None, expected):
            notes = (*notes, f"rounding changes the field's Betti numbers from {asked} to {expected}: use a finer tol")
            expected = asked
        volume, spread = volume_quadrature.integrate_volume(field, lo, hi, float((hi - lo).max()) / N_QUADRATURE_LINES)
        made = replace(
            made, tol=tol, to_field=made.to_field + moved, from_field=made.from_field + moved, notes=notes + made.notes
        )
        certificate = certify_field_solid(made, shape, expected, volume, spread, found)
    return Model("field solid", made.brep, replace(certificate, seconds=dict(stages.seconds)), built)


def _round_edges(field: Field, lo: np.ndarray, hi: np.ndarray, tol: float) -> tuple[Field, float, tuple[str, ...]]:
    """The field to lay out, how far its level set is from the one asked for, and what is to be said of it."""
    seen = field if isinstance(field, LinearExtension) else extend_linearly(field, lo, hi)
    eased = round_edges(seen.field, np.maximum(lo, seen.lo), np.minimum(hi, seen.hi), ROUNDING_TOL_FRACTION * tol)
    if eased is None:
        return field, 0.0, ()
    edge = f"{eased.opening:.0f} degrees at ({', '.join(f'{x:.5g}' for x in eased.near)})"
    periods = [p for structure in eased.field.structures for p in structure.periods() or () if p > 0]
    if eased.radius < MIN_ROUNDING_RADIUS_PERIODS * min(periods, default=0.0):
        raise LevelSetError(
            f"a blended wall ends in an edge of {edge}: within tol {tol:g} it can be rounded with a radius of "
            f"{eased.radius:.2g} only, too little for smooth patches; "
            "blend over a longer way, or use a thicker wall or a larger tol"
        )
    smooth = replace(field, field=eased.field) if isinstance(field, LinearExtension) else eased.field
    note = f"edges of walls were rounded: the surface moves by up to {eased.moved:.3g}; the sharpest has {edge}"
    return smooth, eased.moved, (note,)


def certify_field_solid(
    made: FieldSolid,
    shape: SolidProperties,
    betti: tuple[int, int, int] | None,
    volume: float,
    spread: float,
    found: Any,
) -> Certificate:
    """Hold what was measured against the request; `found` is what the kernel says of the built solid."""
    notes = list(made.notes)
    shortfalls = []
    deviation = max(made.to_field, made.from_field)
    typical, most = FIELD_TANGENT_JUMP_LIMITS_DEG
    for wrong, text in (
        (deviation > made.tol, f"deviation {deviation:.3g} exceeds tol {made.tol:g}"),
        (made.jump_deg > most, f"tangent jump {made.jump_deg:.3g} degrees exceeds {most:g}"),
        (
            made.jump_p95_deg > typical,
            f"tangent jump {made.jump_p95_deg:.3g} degrees at the 95th percentile exceeds {typical:g}",
        ),
        (not shape.closed, "the faces do not close"),
        (not found.valid, "the kernel's check rejects the solid"),
        (
            shape.closed and abs(found.volume - shape.volume) > KERNEL_VOLUME_RTOL * shape.volume,
            f"the kernel's solid has volume {found.volume:.9g}, the patches bound {shape.volume:.9g}",
        ),
        (
            betti is not None and shape.betti != betti,
            f"Betti numbers {shape.betti} differ from the field's, {betti}: use a finer tol; "
            "of a blend, specks=True takes away parts that lie between its samples",
        ),
        (
            abs(volume - shape.volume) > FIELD_VOLUME_RTOL * volume + spread,
            f"volume {shape.volume:.6g} differs from the field's, {volume:.6g} within {spread:.2g}",
        ),
    ):
        if wrong:
            shortfalls.append(text)
    if betti is None:
        notes.append("the field's Betti numbers did not settle on any grid tried: the solid's are its own")
    return build_certificate(
        made.brep,
        shape,
        shortfalls,
        tuple(notes),
        tol=made.tol,
        max_deviation=deviation,
        rms_deviation=made.rms,
        reference="field",
        gap=float(made.brep.edges.deviation.max(initial=0.0)),
        tangent_jump_deg=made.jump_deg,
        curvature_jump=made.curvature_jump,
        valid=found.valid,
        figures={
            "tangent jump in degrees at the 95th percentile": made.jump_p95_deg,
            "deviation of the solid from the field": made.to_field,
            "deviation of the field from the solid": made.from_field,
            "volume of the field": volume,
            "uncertainty of that volume": spread,
        }
        | ({"thinnest wall": made.wall} if np.isfinite(made.wall) else {}),
    )


def _is_numeric_box(domain: Any) -> bool:
    """Whether the domain is told in numbers, as a box is."""
    if isinstance(domain, str | os.PathLike):
        return False
    try:
        np.asarray(domain, float)
    except (TypeError, ValueError):
        return isinstance(domain, Sequence)
    return True


def _parse_corners(domain: BoxCorners) -> tuple[np.ndarray, np.ndarray]:
    try:
        lo, hi = (np.asarray(point, float) for point in domain)
    except (TypeError, ValueError) as error:
        raise InvalidRequest(f"domain {domain!r} must be two points ((x0, y0, z0), (x1, y1, z1))") from error
    return lo, hi
