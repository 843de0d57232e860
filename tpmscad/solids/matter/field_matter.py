"""The solid of a field as matter for a body: patches that are fitted in the box of the body, or operands that cross."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import select_spline_faces
from tpmscad.errors import CrossingSurfaces, InvalidRequest, OutsideSpan, format_point
from tpmscad.fields.field import Field
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.levelset.crossing_operands import has_meeting_quadrics
from tpmscad.results.certificate import require
from tpmscad.solids.cut import Matter
from tpmscad.solids.matter.crossing_fields import fit_crossing_fields
from tpmscad.solids.matter.field_patches import fit_field_patches
from tpmscad.solids.matter.lattice_block import LatticeBlock
from tpmscad.solids.matter.patch_measures import measure_field_patches
from tpmscad.solids.matter.reference_distance import field_distance
from tpmscad.stage_timer import StageTimer

FIELD_BLOCK_MARGIN_FRACTION = 0.0137
"""Fraction of the body's extent by which a field's block reaches beyond the body's box."""


def build_field_matter(field: Field, body: CadBody, tol: float, stages: StageTimer) -> Matter:
    """The solid of a field in the body's box and a margin around it; its operands where its level sets cross."""
    low, high = expand_body_box(*enclosing_box(body.shape))
    with _name_box_of_body(body):
        if tol > 0 and has_meeting_quadrics(field, low, high, tol):
            return fit_crossing_fields(field, low, high, tol, stages)
        try:
            found = fit_field_patches(field, low, high, tol, stages)
        except CrossingSurfaces:
            return fit_crossing_fields(field, low, high, tol, stages)
    measures = measure_field_patches(found)
    closed = require(found.properties.closed, "the field's patches do not close in the body's box")
    measures = replace(measures, checks=(*measures.checks, closed))
    patches = select_spline_faces(found.fitted.brep)  # the caps lie outside the body
    return LatticeBlock("field infill", patches, measures, field_distance(field), lambda: found.fitted.brep)


@contextmanager
def _name_box_of_body(body: CadBody) -> Iterator[None]:
    """Add to an error that names a place where the field of a body is evaluated: the place may lie outside the body."""
    try:
        yield
    except OutsideSpan as error:
        low, high = (format_point(corner) for corner in expand_body_box(*enclosing_box(body.shape)))
        raise InvalidRequest(
            f"{error}. The field is made in the whole box from {low} to {high} around {body.name}, its corners included"
        ) from error


def expand_body_box(low: Array, high: Array) -> tuple[Array, Array]:
    """The box in which a field is fitted for a body: the body's own box and a margin around it."""
    margin = FIELD_BLOCK_MARGIN_FRACTION * float((high - low).max())
    return low - margin, high + margin
