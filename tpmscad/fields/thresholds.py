"""Porous structures cut from a field by thresholds: rod, pore and sheet types (porous blending, section 2.2).

A threshold is a number or a field, the threshold distribution field of the paper. The values are differences of the field and its
threshold, so their gradients are exact, too.
"""

from __future__ import annotations

import numpy as np

from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import ConstantField, Field, FieldLike, MinMaxField, as_field
from tpmscad.fields.nodal_field import NodalField


def rod(phi: FieldLike, c: FieldLike) -> Field:
    """{phi <= c}, as phi - c."""
    phi, c = as_field(phi), as_field(c)
    _check_range(phi, -np.inf, _constant_value(c), f"rod threshold {_constant_value(c):g}")
    return phi - c


def pore(phi: FieldLike, c: FieldLike) -> Field:
    """{phi >= c}, as c - phi."""
    phi, c = as_field(phi), as_field(c)
    _check_range(phi, _constant_value(c), np.inf, f"pore threshold {_constant_value(c):g}")
    return c - phi


def sheet(phi: FieldLike, lo: FieldLike, hi: FieldLike) -> Field:
    """{lo <= phi <= hi}, as max(lo - phi, phi - hi). Of a signed distance it is the layer between two offsets."""
    phi, lo, hi = as_field(phi), as_field(lo), as_field(hi)
    low, high = _constant_value(lo), _constant_value(hi)
    if low >= high:
        raise InvalidRequest(
            f"sheet from {low:g} to {high:g} is empty: the lower threshold must be below the upper one"
        )
    _check_range(phi, low, high, f"sheet from {low:g} to {high:g}")
    return MinMaxField(lo - phi, phi - hi, +1)


def _constant_value(threshold: Field) -> float:
    """The value of a constant threshold; nan, with which every comparison is false, of a field."""
    return threshold.value if isinstance(threshold, ConstantField) else np.nan


def _check_range(phi: Field, low: float, high: float, what: str) -> None:
    """Refuse thresholds between which a surface of the catalogue has nothing, or everything."""
    if not isinstance(phi, NodalField):
        return
    least, most = phi.info.value_range
    if low >= most or high <= least:
        state = "leaves nothing solid"
    elif low <= least and high >= most:
        state = "makes everything solid"
    else:
        return
    raise InvalidRequest(f"{what} {state}: {phi.name} takes values from {least:g} to {most:g}")
