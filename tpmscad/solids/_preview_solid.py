"""What can be said about the solid of a field before it is made: the box, the volume fraction, and whatever would be refused.

`preview_solid` does everything that `solidify` does before its fits, so that a request which cannot be carried out fails within
seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from tpmscad._typing import BoxCorners, triple
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import DOMAIN, FIELD, POSITIVE
from tpmscad.fields import volume_fraction
from tpmscad.fields.field import Field, as_field
from tpmscad.fields.kinds.data_domains import bound_data, settle_data
from tpmscad.fields.kinds.linear_extension import extend_level_sets_linearly
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.levelset.field_solid import validate_box
from tpmscad.solids._solidify import is_numeric_box, parse_corners
from tpmscad.solids.matter.field_matter import expand_body_box
from tpmscad.solids.matter.field_patches import check_field_in_box

PREVIEW_SAMPLES = 48
"""Samples along each axis for the volume fraction: accurate to a per cent if a cell is ten samples wide."""


@dataclass(frozen=True, slots=True)
class SolidPreview:
    """The box of a solid or of its body, model units, and the part of the box in which the field is solid."""

    box: BoxCorners
    volume_fraction: float


@validate_call()
def preview_solid(
    field: Annotated[Field | Callable[..., Any], FIELD, "The field of `solidify`; negative is solid."],
    domain: Annotated[BoxCorners | Any, DOMAIN, "A box in model units, or a body, as in `solidify`."],
    *,
    tol: Annotated[float, POSITIVE.described_as(example="0.01"), "The tolerance of `solidify`, model units."],
) -> SolidPreview:
    """The preview of ``solidify(field, domain, tol=tol)``; it raises what `solidify` would raise before its fits."""
    field = bound_data(as_field(field))
    if is_numeric_box(domain):
        low, high = validate_box(*parse_corners(domain), tol)
        settled, first, last, _ = settle_data(field, low, high)
        check_field_in_box(settled, first, last, tol)
    else:
        body = read_body(domain)
        low, high = body.box
        extended = extend_level_sets_linearly(field, low, high)
        check_field_in_box(extended, *expand_body_box(low, high), tol)
    corners = triple(low.tolist()), triple(high.tolist())
    return SolidPreview(corners, volume_fraction(field, corners, samples=PREVIEW_SAMPLES))
