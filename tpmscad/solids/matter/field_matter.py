"""The solid of a field as matter for a body: patches that are fitted in the box of the body, or operands that cross."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import select_spline_faces
from tpmscad.errors import CrossingSurfaces, InvalidRequest, OutsideSpan
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.volume_fraction_thresholds import continue_thresholds
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.measure.shape_sampling import sample_faces
from tpmscad.kernel.occt.bounding_boxes import box_diagonal
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.levelset.crossing_operands import has_meeting_quadrics
from tpmscad.results.certificate import require
from tpmscad.solids.cut import Matter
from tpmscad.solids.matter.crossing_fields import fit_crossing_fields
from tpmscad.solids.matter.field_patches import fit_field_patches
from tpmscad.solids.matter.lattice_block import LatticeBlock
from tpmscad.solids.matter.patch_measures import measure_field_patches
from tpmscad.solids.matter.reference_distance import field_distance
from tpmscad.solids.volume_samples import sample_body
from tpmscad.stage_timer import StageTimer

FIELD_BLOCK_MARGIN_FRACTION = 0.0137
"""Fraction of the body's extent by which a field's block reaches beyond the body's box."""


SPAN_POINTS_PER_DIAGONAL = 48
"""Points of a body's faces along its diagonal at which volume fractions are asked."""


def build_field_matter(field: Field, body: CadBody, tol: float, stages: StageTimer) -> Matter:
    """The solid of a field in the body's box and a margin around it; its operands where its level sets cross.

    Volume fractions must stay within their spans in the body only: what they are in the corners of its box is never seen.
    """
    low, high = expand_body_box(*body.box)
    continued = continue_thresholds(field)
    if continued is not field:
        _require_spans(field, body)
    if tol > 0 and has_meeting_quadrics(continued, low, high, tol):
        return fit_crossing_fields(continued, low, high, tol, stages)
    try:
        found = fit_field_patches(continued, low, high, tol, stages)
    except CrossingSurfaces:
        return fit_crossing_fields(continued, low, high, tol, stages)
    measures = measure_field_patches(found)
    closed = require(found.properties.closed, "the field's patches do not close in the body's box")
    measures = replace(measures, checks=(*measures.checks, closed))
    patches = select_spline_faces(found.fitted.brep)  # the caps lie outside the body
    return LatticeBlock("field infill", patches, measures, field_distance(continued), lambda: found.fitted.brep)


def _require_spans(field: Field, body: CadBody) -> None:
    """InvalidRequest where a volume fraction leaves its span in a body, at points in it and on its faces."""
    faces = faces_of(body.shape)
    spacing = box_diagonal(body.shape) / SPAN_POINTS_PER_DIAGONAL
    try:
        field(np.concatenate([sample_body(body), sample_faces(faces, spacing).points]))
    except OutsideSpan as error:
        raise InvalidRequest(f"{error}. The place lies in {body.name}") from error


def expand_body_box(low: Array, high: Array) -> tuple[Array, Array]:
    """The box in which a field is fitted for a body: the body's own box and a margin around it."""
    margin = FIELD_BLOCK_MARGIN_FRACTION * float((high - low).max())
    return low - margin, high + margin
