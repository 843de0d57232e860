"""Volume fractions of fields, and the thresholds that give a volume fraction, uniform or varying in space.

A box, by default one period, is divided into cells. In each cell the field is linearised from its value and gradient at the
center, and the volume that the linear function cuts off the cell is exact. The method is of second order, and Richardson
extrapolation from two grids reaches FRACTION_ACCURACY. (`volume_quadrature` integrates along lines between exact roots; it takes
longer and is the reference for certified solids.)

A threshold field for a varying volume fraction is that of a uniform structure with the local fraction. It is evaluated by a
spline of the threshold as a function of the fraction.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, is_dataclass, replace
from dataclasses import fields as dataclass_fields
from functools import partial
from typing import Annotated, Any, cast

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from tpmscad._typing import Array, BoxCorners
from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import BOX, COUNT, FIELD, FRACTION, NUMBER, PAIR
from tpmscad.errors import InvalidRequest, OutsideSpan, format_point
from tpmscad.fields.field import Field, FieldLike, as_field
from tpmscad.fields.kinds.ramps import RampField
from tpmscad.fields.tape.evaluation import Triple
from tpmscad.fields.tape.tape_nodes import Node, piecewise_polynomial
from tpmscad.memory_limit import require_memory

SAMPLES_PER_AXIS = 96
"""Cells per axis of the finer grid; the coarser one has half as many."""

FRACTION_ACCURACY = 3e-5
"""Error bound of a volume fraction with SAMPLES_PER_AXIS cells in the period of a smooth field; creases may cost a digit."""

MIN_SLOPE_SHARE = 1e-3
"""Least share of an axis in a cell's slope, since the cut volume is a difference of cubes divided by the three shares."""

THRESHOLD_RTOL = 1e-10
"""Tolerance of a threshold relative to the range of the field, far below the error of the quadrature."""

BRACKET_RANGE_FRACTION = 1e-3
"""Half width of the first bracket around the threshold of the coarse grid, as a fraction of the field's range."""

THRESHOLD_NODES = 17
"""Thresholds at which fractions are sampled for the spline; its error is of the order of FRACTION_ACCURACY."""


@dataclass(frozen=True, slots=True, eq=False)
class _CellSamples:
    """Cells of a grid: values at the centers (n,), changes along the edges (n, 3), bounds of the linear function (n,)."""

    center_values: Array
    edge_changes: Array
    lower_bounds: Array
    upper_bounds: Array


@validate_call()
def volume_fraction(
    field: Annotated[FieldLike, FIELD, "The field; f <= 0 is solid."],
    domain: Annotated[BoxCorners | None, BOX, "The box, in model units; by default one period."] = None,
    *,
    samples: Annotated[
        int, COUNT.described_as(example="96"), "Cells per axis of the finer of two grids, at least 4."
    ] = SAMPLES_PER_AXIS,
) -> float:
    """Return the volume fraction of the solid of a field in a box.

    Returns
    -------
    float
        Volume of the solid per volume of the box, to 3e-5 for a smooth field with the default samples.

    Raises
    ------
    InvalidRequest
        If the field is not periodic and no domain is given, or the domain or samples are invalid.

    Notes
    -----
    Exact volumes of linear functions in cells, extrapolated from two grids.

    Examples
    --------
    >>> from tpmscad import fields
    >>> round(fields.volume_fraction(fields.tpms("gyroid", 10.0)), 4)
    0.5
    """
    fine, coarse = _sample_two_grids(as_field(field), domain, samples)
    return _richardson(_fraction_below(fine, 0.0), _fraction_below(coarse, 0.0))


@validate_call()
def threshold_for(
    phi: Annotated[FieldLike, FIELD, "The field."],
    volume_fraction: Annotated[
        float | None,
        FRACTION,
        "Volume of the solid per volume of the box, between 0 and 1. Give exactly one of `volume_fraction` and `porosity`.",
    ] = None,
    kind: Annotated[str, choice_of("rod", "pore", "sheet"), "The structure cut from phi."] = "rod",
    *,
    porosity: Annotated[float | None, FRACTION, "Void per volume of the box, 1 - volume fraction."] = None,
    level: Annotated[float, NUMBER.described_as(example="0.0"), "Isovalue in the middle of a sheet."] = 0.0,
    domain: Annotated[BoxCorners | None, BOX, "The box, in model units; by default one period."] = None,
    samples: Annotated[
        int, COUNT.described_as(example="96"), "Cells per axis of the finer of two grids, at least 4."
    ] = SAMPLES_PER_AXIS,
) -> float | tuple[float, float]:
    """Return the threshold with which a structure has a volume fraction.

    Returns
    -------
    float or (float, float)
        The threshold of `rod` or `pore`, or the thresholds level - t and level + t of `sheet`.

    Raises
    ------
    InvalidRequest
        If the fraction is not between 0 and 1, both or none of fraction and porosity are given, the kind is unknown, or the box
        is invalid.

    Examples
    --------
    >>> from tpmscad import fields
    >>> phi = fields.tpms("gyroid", 10.0)
    >>> structure = fields.rod(phi, fields.threshold_for(phi, porosity=0.7))
    """
    if (volume_fraction is None) == (porosity is None):
        given = "none of them" if porosity is None else "both"
        raise InvalidRequest(f"give exactly one of `volume_fraction` and `porosity`; here: {given}")
    fraction = 1.0 - porosity if porosity is not None else float(volume_fraction or 0.0)
    grids = _sample_two_grids(as_field(phi), domain, samples)
    part = _fraction_function(kind, level)

    def excess(cells: _CellSamples, t: float) -> float:
        return part(cells, t) - fraction

    minimum = min(float(cells.lower_bounds.min()) for cells in grids)
    maximum = max(float(cells.upper_bounds.max()) for cells in grids)
    if minimum == maximum:
        raise InvalidRequest(
            f"the field is {minimum:g} everywhere in the domain: no threshold cuts off a volume fraction of {fraction:g}; "
            "give a field that varies"
        )
    low, high = (0.0, max(maximum - level, level - minimum)) if kind == "sheet" else (minimum, maximum)
    reached = sorted(part(grids[1], t) for t in (low, high))
    if not reached[0] <= fraction <= reached[1]:
        raise InvalidRequest(
            f"volume fraction {fraction:g} is out of reach: the field is constant in a part of the domain, so that a "
            f"{kind} fills between {reached[0]:.4g} and {reached[1]:.4g} of it; give a field that varies, or another fraction"
        )
    t = _solve_threshold(excess, grids, low, high)
    return (level - t, level + t) if kind == "sheet" else t


def volume_fractions(
    phi: FieldLike, thresholds: Array, kind: str = "rod", *, level: float = 0.0, domain: BoxCorners | None = None
) -> Array:
    """Volume fractions (n,) of `rod` or `pore` of phi with thresholds t (n,), or of sheets from level - t to level + t."""
    fine, coarse = _sample_two_grids(as_field(phi), domain, SAMPLES_PER_AXIS)
    part = _fraction_function(kind, level)
    return np.array([_richardson(part(fine, t), part(coarse, t)) for t in thresholds.tolist()])


def _fraction_function(kind: str, level: float) -> Callable[[_CellSamples, float], float]:
    """Function (cells, t) -> fraction of the cells that the structure of threshold t fills."""
    if kind == "sheet":
        return lambda cells, t: _fraction_below(cells, level + t) - _fraction_below(cells, level - t)
    if kind == "rod":
        return _fraction_below
    if kind == "pore":
        return lambda cells, t: 1 - _fraction_below(cells, t)
    raise InvalidRequest(f"kind {kind!r}: choose rod, pore or sheet")


def _solve_threshold(
    excess: Callable[[_CellSamples, float], float], grids: tuple[_CellSamples, _CellSamples], low: float, high: float
) -> float:
    """Root of the extrapolated excess, bracketed first around the root of the coarse grid alone."""
    tol, span = THRESHOLD_RTOL * max(abs(low), abs(high)), BRACKET_RANGE_FRACTION * (high - low)
    guess = brentq(partial(excess, grids[1]), low, high, xtol=tol)
    bracket = max(low, guess - span), min(high, guess + span)

    def extrapolated(c: float) -> float:
        return _richardson(excess(grids[0], c), excess(grids[1], c))

    if extrapolated(bracket[0]) * extrapolated(bracket[1]) > 0:
        bracket = low, high
    return float(brentq(extrapolated, *bracket, xtol=tol))


BYTES_PER_CELL = 120
"""Of the finer grid: values, gradients, changes along the edges and bounds."""


def _sample_two_grids(field: Field, domain: BoxCorners | None, samples: int) -> tuple[_CellSamples, _CellSamples]:
    """Cells of the fine grid and of the coarse one."""
    if samples < 4:
        raise InvalidRequest(f"{samples} samples per axis are too few: at least 4, or 96 for five digits")
    require_memory(float(samples) ** 3, BYTES_PER_CELL, f"{samples} samples along each axis", "use fewer samples")
    low, high = _resolve_box(field, domain)
    make = partial(_sample_cells, field, low, high)
    return make(samples), make(samples // 2)


def _resolve_box(field: Field, domain: BoxCorners | None) -> tuple[Array, Array]:
    """Corners of the domain, by default of one period."""
    if domain is None:
        periods = field.periods()
        if periods is None or 0 in periods:
            raise InvalidRequest(
                "the field is not periodic: give the box of the volume as domain=((x0, y0, z0), (x1, y1, z1))"
            )
        return np.zeros(3), np.array(periods)
    low, high = np.array(domain)
    return low, high


def _sample_cells(field: Field, low: Array, high: Array, samples: int) -> _CellSamples:
    size = (high - low) / samples
    axes = (low[axis] + size[axis] * (np.arange(samples) + 0.5) for axis in range(3))
    values, gradients = field.value_and_gradient_on_grid(*axes)
    changes = np.abs(gradients.reshape(-1, 3)) * size
    flat, half_range = values.reshape(-1), (changes[:, 0] + changes[:, 1] + changes[:, 2]) / 2
    return _CellSamples(flat, changes, flat - half_range, flat + half_range)


def _richardson(fine: float, coarse: float) -> float:
    """Extrapolation of a second-order method from steps h and 2 h."""
    return fine + (fine - coarse) / 3


def _fraction_below(cells: _CellSamples, c: float) -> float:
    """Fraction of the cells' volume where the linearised field is below c."""
    full = cells.upper_bounds <= c
    cut = np.flatnonzero((cells.lower_bounds < c) & ~full)
    return float(
        (np.count_nonzero(full) + cube_volumes_below(c - cells.center_values[cut], cells.edge_changes[cut]).sum())
        / full.size
    )


def cube_volumes_below(height: Array, changes: Array) -> Array:
    """Volume of {changes . u <= height} in the unit cube |u| <= 1/2, by inclusion-exclusion over its corners."""
    total = np.maximum(changes.sum(axis=1), np.finfo(float).tiny)
    a, b, c = np.maximum(changes / total[:, None], MIN_SLOPE_SHARE).T
    depth = np.clip(height / total, -0.5, 0.5)
    # of the two parts the smaller: fewer terms of the formula cancel
    t = (0.5 - np.abs(depth)) * (a + b + c)
    corners = t**3
    for edge in (a, b, c):
        corners -= np.maximum(t - edge, 0) ** 3
    for pair in (a + b, a + c, b + c):
        corners += np.maximum(t - pair, 0) ** 3
    part = corners / (6 * a * b * c)
    return np.where(depth > 0, 1 - part, part)


@dataclass(frozen=True, slots=True, eq=False)
class GradedThreshold(Field):
    """Threshold as a spline of the field `fraction`; `sign` is -1 for the lower threshold of a sheet.

    Evaluation raises InvalidRequest where the fraction leaves the spline's range, or continues it along its tangents.
    """

    fraction: Field
    threshold_of_fraction: CubicSpline
    level: float
    sign: float
    is_continued: bool = False

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        spline = self.threshold_of_fraction
        low, high = spline.x[[0, -1]]
        if self.is_continued:
            slopes, ends = spline([low, high], 1), spline([low, high])
            first, last = [[0, 0, slope, end] for slope, end in zip(slopes, ends - [slopes[0], 0], strict=True)]
            knots = np.concatenate([[low - 1], spline.x, [high + 1]])
            pieces = np.column_stack([first, spline.c, last])
            fraction = self.fraction.trace(x, y, z)
            return self.sign * piecewise_polynomial(knots, pieces, fraction) + self.level
        fraction = x.recorder.require_within(
            self.fraction.trace(x, y, z), low - FRACTION_ACCURACY, high + FRACTION_ACCURACY, self._refuse
        )
        return self.sign * piecewise_polynomial(spline.x, spline.c, fraction) + self.level

    def _refuse(self, fraction: float, place: Triple) -> InvalidRequest:
        low, high = self.threshold_of_fraction.x[[0, -1]]
        return OutsideSpan(
            f"the volume fraction takes the value {fraction:.4g} at {format_point(place)}, outside the span from {low:g} to "
            f"{high:g}: widen the span, or limit the fraction, by fields.clip(fraction, {low:g}, {high:g})"
        )


def continue_thresholds(field: Field) -> Field:
    """The field with every graded threshold in it continued beyond the span of its volume fraction, along the tangents.

    It is the same where the fractions stay within their spans, and elsewhere raises nothing.
    """

    def change(value: Any) -> Any:
        if isinstance(value, tuple):
            new = tuple(map(change, value))
            return value if all(a is b for a, b in zip(new, value, strict=True)) else new
        return continue_thresholds(value) if isinstance(value, Field) else value

    if isinstance(field, GradedThreshold):
        return replace(field, fraction=continue_thresholds(field.fraction), is_continued=True)
    parts: Any = field
    own = {f.name: getattr(parts, f.name) for f in dataclass_fields(parts) if f.init} if is_dataclass(parts) else {}
    changed = {name: new for name, value in own.items() if (new := change(value)) is not value}
    return cast(Field, replace(parts, **changed)) if changed else field


@validate_call()
def graded_threshold(
    phi: Annotated[FieldLike, FIELD, "The field."],
    fraction: Annotated[FieldLike, FIELD.described_as(example="0.3"), "The local volume fraction."],
    span: Annotated[
        Sequence[float] | None,
        PAIR,
        "Range of the volume fraction, between 0 and 1; by default the values between which a ramp runs.",
    ] = None,
    kind: Annotated[str, choice_of("rod", "pore", "sheet"), "The structure cut from phi."] = "rod",
    *,
    level: Annotated[float, NUMBER.described_as(example="0.0"), "Isovalue in the middle of a sheet."] = 0.0,
    domain: Annotated[
        BoxCorners | None, BOX, "Box in which volume fractions are measured, in model units; by default one period."
    ] = None,
) -> Field | tuple[Field, Field]:
    """Return the threshold field with which a structure has a volume fraction that varies slowly in space.

    Returns
    -------
    Field or (Field, Field)
        The threshold of `rod` or `pore`, or the lower and upper threshold of `sheet`. Everywhere it is the threshold of the
        uniform structure with the local fraction.

    Raises
    ------
    InvalidRequest
        If the span or kind is invalid, or missing for a fraction that is no ramp; on evaluation, if the fraction leaves the span.

    Examples
    --------
    >>> from tpmscad import fields
    >>> phi = fields.tpms("gyroid", 10.0)
    >>> part = fields.rod(phi, fields.graded_threshold(phi, fields.ramp("x", (0, 40), (0.2, 0.5))))
    """
    local_fraction = as_field(fraction)
    if span is None:
        if not isinstance(local_fraction, RampField):
            raise InvalidRequest("a fraction that is no ramp needs its range: give span=(least, greatest)")
        span = sorted((local_fraction.low, local_fraction.high))
    low, high = span
    if not 0 < low < high < 1:
        raise InvalidRequest(f"span {span!r} must be two volume fractions between 0 and 1, the least first")
    ends = [threshold_for(phi, f, kind, level=level, domain=domain) for f in (low, high)]
    first, last = (e[1] - level if isinstance(e, tuple) else e for e in ends)
    thresholds = np.linspace(first, last, THRESHOLD_NODES)
    fractions = volume_fractions(phi, thresholds, kind, level=level, domain=domain)
    fractions[0], fractions[-1] = low, high
    if not (np.diff(fractions) > 0).all():
        raise InvalidRequest(
            f"the threshold is not a function of the volume fraction from {low:g} to {high:g}: narrow the span"
        )
    spline = CubicSpline(fractions, thresholds)
    if kind == "sheet":
        lower, upper = (GradedThreshold(local_fraction, spline, level, sign) for sign in (-1.0, 1.0))
        return lower, upper
    return GradedThreshold(local_fraction, spline, 0.0, 1.0)
