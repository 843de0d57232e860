"""Porous structures of a field by thresholds: rod, pore and sheet types (porous blending, section 2.2).

A threshold is a number or a field, the threshold distribution field of the paper. The structure is the difference of the field
and its threshold, so its gradient is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import FIELD
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import ConstantField, Field, FieldLike, MinMaxField, SumField, as_field
from tpmscad.fields.kinds.nodal_field import NodalField
from tpmscad.fields.kinds.one_piece_ranges import note_sheet, note_side


@dataclass(frozen=True, slots=True)
class NotedSum(SumField):
    """first + second, with what the certificate says of the pieces of the structure."""

    notes: tuple[str, ...] = ()


@validate_call()
def rod(
    phi: Annotated[FieldLike, FIELD, 'The field, for example `fields.tpms("gyroid")`.'],
    c: Annotated[FieldLike, FIELD.described_as(example="-0.4"), "The threshold."],
) -> Field:
    """Return the rod structure {phi <= c} as the field phi - c.

    Returns
    -------
    Field
        phi - c.

    Raises
    ------
    InvalidRequest
        If a constant threshold makes nothing or everything of a catalogued surface solid.

    Examples
    --------
    >>> from tpmscad import fields
    >>> rods = fields.rod(fields.tpms("schwarz_p", 10.0), -0.8)
    """
    phi, c = as_field(phi), as_field(c)
    _check_range(phi, -np.inf, _constant_value(c), f"rod threshold {_constant_value(c):g}")
    return NotedSum(phi, -c, _note_two_sides(phi, c, "-"))


@validate_call()
def pore(
    phi: Annotated[FieldLike, FIELD, "The field."],
    c: Annotated[FieldLike, FIELD.described_as(example="-0.4"), "The threshold."],
) -> Field:
    """Return the pore structure {phi >= c} as the field c - phi.

    Returns
    -------
    Field
        c - phi.

    Raises
    ------
    InvalidRequest
        If a constant threshold makes nothing or everything of a catalogued surface solid.

    Examples
    --------
    >>> from tpmscad import fields
    >>> pores = fields.pore(fields.tpms("gyroid", 10.0), 0.3)
    >>> float(pores((0.0, 0.0, 0.0)))
    0.3
    """
    phi, c = as_field(phi), as_field(c)
    _check_range(phi, _constant_value(c), np.inf, f"pore threshold {_constant_value(c):g}")
    return NotedSum(c, -phi, _note_two_sides(phi, c, "+"))


@validate_call()
def sheet(
    phi: Annotated[
        FieldLike, FIELD, "The field. For a signed distance the sheet is the layer between two offset surfaces."
    ],
    lo: Annotated[FieldLike, FIELD.described_as(example="-0.3"), "The thresholds, lo < hi."],
    hi: Annotated[FieldLike, FIELD.described_as(example="0.3"), "The thresholds, lo < hi."],
) -> Field:
    """Return the sheet structure {lo <= phi <= hi} as the field max(lo - phi, phi - hi).

    Returns
    -------
    Field
        max(lo - phi, phi - hi).

    Raises
    ------
    InvalidRequest
        If the sheet is empty, or constant thresholds make nothing or everything of a catalogued surface solid.

    Examples
    --------
    >>> from tpmscad import fields
    >>> wall = fields.sheet(fields.tpms("gyroid", 10.0), -0.4, 0.4)
    >>> float(wall((0.0, 0.0, 0.0)))
    -0.4
    """
    phi, lo, hi = as_field(phi), as_field(lo), as_field(hi)
    low, high = _constant_value(lo), _constant_value(hi)
    if low >= high:
        raise InvalidRequest(
            f"sheet from {low:g} to {high:g} is empty: the lower threshold must be below the upper one"
        )
    _check_range(phi, low, high, f"sheet from {low:g} to {high:g}")
    notes = note_sheet(phi.name, phi.reference, low, high) if isinstance(phi, NodalField) else ()
    return MinMaxField(NotedSum(lo, -phi, notes), phi - hi, +1)


def _note_two_sides(phi: Field, threshold: Field, solid_side: str) -> tuple[str, ...]:
    """Notes if the solid or the void on either side of a constant threshold of a catalogued surface is not one piece."""
    if not isinstance(phi, NodalField):
        return ()
    level, void_side = _constant_value(threshold), "+" if solid_side == "-" else "-"
    return (
        *note_side(phi.name, phi.reference, solid_side, level, "the solid"),
        *note_side(phi.name, phi.reference, void_side, level, "the void"),
    )


def _constant_value(threshold: Field) -> float:
    """Value of a constant threshold; nan for a field, with which every comparison is false."""
    return threshold.value if isinstance(threshold, ConstantField) else np.nan


def _check_range(phi: Field, low: float, high: float, what: str) -> None:
    """Raise InvalidRequest if nothing or everything of a catalogued surface lies between two thresholds."""
    if not isinstance(phi, NodalField):
        return
    minimum, maximum = phi.value_range
    if low >= maximum or high <= minimum:
        state = "leaves nothing solid"
    elif low <= minimum and high >= maximum:
        state = "makes everything solid"
    else:
        return
    raise InvalidRequest(f"{what} {state}: {phi.name} takes values from {minimum:g} to {maximum:g}")
