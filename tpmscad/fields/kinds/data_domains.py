"""Where fields of data end: data that are moved, or combined with other fields, are empty beyond the box of their samples.

The spline through samples goes on beyond them, which a fit at the sides of their box needs. As a solid in a larger box, turned,
or in a union, data end exactly in the planes of their box: the field is the maximum of theirs and of these planes. The planes are
so steep that values within the box are those of the data but for a hundredth of a sample at its sides. Data without a solid at
their border need none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, BoxCorners
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data_box import DataBox
from tpmscad.fields.field import Field, MinMaxField, ScaledField, multiply_fields
from tpmscad.fields.kinds.booleans import RoundedMinMaxField, join_extremes
from tpmscad.fields.kinds.primitive_regions import HalfSpaceRegion

STEEPNESS = 100.0
"""Greatest values of data at their border, in a sample, by which the planes of their box rise."""

WIDER = 0.03
"""Of the longest edge: by which the box of a fit is wider than turned data, whose edges would lie in its sides."""

SAME_SIDE, SAME_SIDE_OF_BODY = 1e-9, 1e-6
"""Of the longest edge: distance up to which sides of two boxes are one; of the kernel's box of a body, which is wider."""


@dataclass(frozen=True, slots=True)
class BoundedData(MinMaxField):
    """Data (`first`), or unions, intersections and differences of data in one box, within its planes (`second`).

    The sign is that of a maximum.
    """

    box: DataBox

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed of the data."""
        return tuple(getattr(self.first, "notes", ()))

    def data_box(self) -> DataBox | None:
        """The box of the data."""
        return self.box

    @property
    def domain(self) -> BoxCorners | None:
        """The box along the axes that holds that of the data."""
        return self.box.domain


@dataclass(frozen=True, slots=True, eq=False)
class _Probe(Field):
    """A field of which only the box of its data matters."""

    box: DataBox

    def data_box(self) -> DataBox | None:
        """The box."""
        return self.box


def bound_data(field: Field) -> Field:
    """The field with the data in its unions, intersections and complements bounded, where their solid reaches their border."""
    return _share_planes(_bound_parts(field))


def _bound_parts(field: Field) -> Field:
    """The field with the planes of each of its data."""
    if isinstance(field, BoundedData):
        return field
    box = field.data_box()
    if box is not None:
        values = field(box.border)
        if not (values < 0).any():
            return field
        return _bound(field, box, STEEPNESS * float(np.abs(values).max()) / box.least_step)
    return _change_operands(field, _bound_parts)


def _change_operands(field: Field, change: Callable[[Field], Field]) -> Field:
    """A union, intersection or multiple of changed fields; other fields, and those of which nothing changes, as they are."""
    if isinstance(field, MinMaxField | RoundedMinMaxField):
        first, second = change(field.first), change(field.second)
        return field if first is field.first and second is field.second else replace(field, first=first, second=second)
    if isinstance(field, ScaledField):
        inner = change(field.field)
        return field if inner is field.field else replace(field, field=inner)
    return field


def _bound(field: Field, box: DataBox, slope: float) -> BoundedData:
    """Data within all sides of their box, whose planes rise by a slope."""
    planes = [multiply_fields(plane, slope) for plane in _make_planes(box)]
    return BoundedData(field, join_extremes(+1, planes), +1, box)


def _share_planes(field: Field) -> Field:
    """The field whose parts of data in one box have its planes once: those of two parts would coincide."""
    bounded = list_bounded(field)
    if len(bounded) < 2:
        return field
    if field.domain is not None and all(each.box.is_same(bounded[0].box) for each in bounded):
        return replace(bounded[0], first=_strip_planes(field))
    return _change_operands(field, _share_planes)


def _strip_planes(field: Field) -> Field:
    """The field without the planes of its data."""
    return field.first if isinstance(field, BoundedData) else _change_operands(field, _strip_planes)


def _make_planes(box: DataBox) -> list[Field]:
    """The half-spaces behind the sides of a box."""
    sides = ((point.tolist(), normal.tolist()) for point, normal in box.sides)
    return [HalfSpaceRegion((px, py, pz), (nx, ny, nz)) for (px, py, pz), (nx, ny, nz) in sides]


def bound_by_data(field: Field, data: Field) -> tuple[Field, BoxCorners]:
    """A field that is graded by data, within their box if it is turned, and the box in which its solid is made."""
    box = data.data_box()
    assert box is not None
    if box.is_aligned:
        return field, box.domain
    low, high = np.array(box.domain)
    margin = WIDER * float((high - low).max())
    return join_extremes(+1, [field, *_make_planes(box)]), ((low - margin).tolist(), (high + margin).tolist())


def move_data(field: Field, move: Callable[[Field], Field]) -> Field:
    """A field that `move` places, with the data in it bounded; unions, intersections and complements of data move by part."""
    bounded = bound_data(field)
    return _move_parts(bounded, move) if list_bounded(bounded) else move(bounded)


def _move_parts(field: Field, move: Callable[[Field], Field]) -> Field:
    if isinstance(field, BoundedData):
        first, probe = _move_parts(field.first, move), move(_Probe(field.box))
        box = probe.data_box()
        if box is None:  # a map that is no motion: its planes are bent
            return MinMaxField(first, move(field.second), +1)
        slope = max(abs(plane.factor) for plane in _list_planes(field.second) if isinstance(plane, ScaledField))
        return _bound(first, box, slope)
    if type(field) is MinMaxField:
        return replace(field, first=_move_parts(field.first, move), second=_move_parts(field.second, move))
    if isinstance(field, ScaledField):
        return replace(field, field=_move_parts(field.field, move))
    return move(field)


def list_bounded(field: Field) -> list[BoundedData]:
    """The data with planes in the unions, intersections and complements of a field."""
    if isinstance(field, BoundedData):
        return [field]
    if isinstance(field, MinMaxField | RoundedMinMaxField):
        return [*list_bounded(field.first), *list_bounded(field.second)]
    return list_bounded(field.field) if isinstance(field, ScaledField) else []


def settle_data(field: Field, lo: Array, hi: Array) -> tuple[Field, Array, Array, tuple[str, ...]]:
    """The field with its data bounded, the part [lo, hi] of a box in which its solid is made, and notes.

    A box that reaches beyond all data of a solid ends in the sides of their box if these run along the axes, and just beyond it
    else. Planes in the sides of the box, or beyond it, are left out. InvalidRequest if there are no data in the box.
    """
    field = bound_data(field)
    bounded = list_bounded(field)
    if not bounded:
        return field, lo, hi, ()
    notes: tuple[str, ...] = ()
    same = SAME_SIDE * float((hi - lo).max())
    domain = field.domain
    if domain is not None:
        first, last = (np.array(corner) for corner in domain)
        if (first > hi - same).any() or (last < lo + same).any():
            raise InvalidRequest(
                f"there are no data in the box from {tuple(lo.tolist())} to {tuple(hi.tolist())}: they reach from {domain[0]} to "
                f"{domain[1]}"
            )
        beyond = (lo < first - same) | (hi > last + same)
        if beyond.any():
            notes = (f"the solid ends with the data, which reach from {_show(first)} to {_show(last)}",)
        margin = 0.0 if all(each.box.is_aligned for each in bounded) else WIDER * float((last - first).max())
        lo, hi = np.where(lo <= first + same, first - margin, lo), np.where(hi >= last - same, last + margin, hi)
    settled = _leave_out_planes(field, lo, hi, same)
    if not notes and domain is None and (left := list_bounded(settled)):
        ends = "; ".join(
            f"from {_show(np.array(a))} to {_show(np.array(b))}" for a, b in (each.box.domain for each in left)
        )
        notes = (f"data in it end within the box, at theirs: {ends}",)
    return settled, lo, hi, notes


def bound_data_in_body(field: Field, lo: Array, hi: Array) -> Field:
    """The field with its data bounded, without the planes that do not cut a body in the box [lo, hi]."""
    return _leave_out_planes(bound_data(field), lo, hi, SAME_SIDE_OF_BODY * float((hi - lo).max()))


def _show(point: Array) -> str:
    return f"({', '.join(f'{c:.6g}' for c in point)})"


def _leave_out_planes(field: Field, lo: Array, hi: Array, same: float) -> Field:
    """The field without the planes of data that do not cut a box."""
    if isinstance(field, BoundedData):
        cut = [plane for plane in _list_planes(field.second) if _reach(plane, lo, hi) > same]
        return replace(field, second=join_extremes(+1, cut)) if cut else field.first
    return _change_operands(field, lambda part: _leave_out_planes(part, lo, hi, same))


def _list_planes(field: Field) -> list[Field]:
    return [*_list_planes(field.first), *_list_planes(field.second)] if isinstance(field, MinMaxField) else [field]


def _reach(plane: Field, lo: Array, hi: Array) -> float:
    """The greatest distance of a point of a box in front of a plane."""
    assert isinstance(plane, ScaledField)
    assert isinstance(plane.field, HalfSpaceRegion)
    normal = np.array(plane.field.normal)
    return float(np.where(normal > 0, hi, lo) @ normal - np.array(plane.field.point) @ normal)
