"""Volume fractions of sheets and skeletal solids between offset surfaces, and the offsets that give a volume fraction.

Volumes follow from Steiner's formula with the integrals of `curvature_integrals`; the inverse problem is solved by Brent's
method between the offset limits. Lengths are in cells unless a `cell` is given. The solid on side "-" is the one where the nodal
function is negative.
"""

from __future__ import annotations

from typing import Annotated

from scipy.optimize import brentq

from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import Reference, SurfaceName
from tpmscad.api.shared_kinds import FRACTION, NUMBER, POSITIVE
from tpmscad.catalogue import find_surface
from tpmscad.errors import InvalidRequest
from tpmscad.surfaces.curvature_integrals import cell_measures

OFFSET_ROOT_XTOL_CELLS = 1e-17
"""Absolute tolerance of an offset found by root search: below round-off, so that the bracket closes completely."""


@validate_call()
def volume_fraction(
    name: SurfaceName,
    reference: Reference,
    lower: Annotated[float, NUMBER, "Offsets of the two sides, in cells; lower < upper."],
    upper: Annotated[float, NUMBER, "Offsets of the two sides, in cells; lower < upper."],
) -> float:
    """Return the volume fraction of the sheet between two offsets.

    Returns
    -------
    float
        Volume of the sheet per volume of the cell.

    Raises
    ------
    InvalidRequest
        If the offsets are out of order or beyond the surface's curvature radius.

    Notes
    -----
    Steiner's formula; exact for every admissible pair of offsets.

    Examples
    --------
    >>> from tpmscad import surfaces
    >>> round(surfaces.volume_fraction("gyroid", "minimal", -0.05, 0.05), 6)
    0.304956
    """
    measures = cell_measures(name, reference)
    for offset in (lower, upper):
        check_offset(name, reference, offset)
    if not lower < upper:
        raise InvalidRequest(f"lower offset {lower:g} is not below the upper {upper:g}; swap them or thicken the wall")
    return measures.swept_volume(upper) - measures.swept_volume(lower)


@validate_call()
def skeletal_volume_fraction(
    name: SurfaceName,
    reference: Reference,
    offset: Annotated[float, NUMBER, "Offset of the surface, in cells."] = 0.0,
    side: Annotated[str, choice_of("-", "+"), "The side where the nodal function is negative, or positive."] = "-",
) -> float:
    """Return the volume fraction on one side of an offset surface.

    Returns
    -------
    float
        Volume of the side per volume of the cell.

    Raises
    ------
    InvalidRequest
        If the offset is beyond the curvature radius or the side is unknown.

    Examples
    --------
    >>> from tpmscad import surfaces
    >>> round(surfaces.skeletal_volume_fraction("gyroid", "minimal"), 6)
    0.5
    """
    measures = cell_measures(name, reference)
    check_offset(name, reference, offset)
    below = measures.fraction_below + measures.swept_volume(offset)
    return below if _side_sign(side) > 0 else 1 - below


@validate_call()
def thickness_for(
    name: SurfaceName,
    reference: Reference,
    volume_fraction: Annotated[float, FRACTION, "Volume of the sheet per volume of the cell."],
) -> float:
    """Return the wall thickness, symmetric about the mid surface, that gives a volume fraction.

    Returns
    -------
    float
        The thickness, in cells.

    Raises
    ------
    InvalidRequest
        If the volume fraction needs offsets beyond the curvature radius. The message states the attainable range.

    Examples
    --------
    >>> from tpmscad import surfaces
    >>> round(surfaces.thickness_for("gyroid", "minimal", 0.3), 4)
    0.0983
    """
    measures = cell_measures(name, reference)
    limit = min(measures.max_offset, -measures.min_offset)
    max_fraction = measures.swept_volume(limit) - measures.swept_volume(-limit)
    if not 0 < volume_fraction < max_fraction:
        raise _unreachable_fraction(name, reference, "sheet", volume_fraction, 0.0, max_fraction)
    return 2 * float(
        brentq(
            lambda d: measures.swept_volume(d) - measures.swept_volume(-d) - volume_fraction,
            0.0,
            limit,
            xtol=OFFSET_ROOT_XTOL_CELLS,
        )
    )


@validate_call()
def skeletal_offset_for(
    name: SurfaceName,
    reference: Reference,
    volume_fraction: Annotated[float, FRACTION, "Volume of the side per volume of the cell."],
    side: Annotated[str, choice_of("-", "+"), "The side where the nodal function is negative, or positive."] = "-",
) -> float:
    """Return the offset of the surface that has a volume fraction on one side.

    Returns
    -------
    float
        The offset, in cells.

    Raises
    ------
    InvalidRequest
        If no admissible offset gives the volume fraction. The message states the attainable range.

    Examples
    --------
    >>> from tpmscad import surfaces
    >>> round(surfaces.skeletal_offset_for("gyroid", "minimal", 0.3), 4)
    -0.0663
    """
    measures = cell_measures(name, reference)
    below = volume_fraction if _side_sign(side) > 0 else 1 - volume_fraction
    min_fraction, max_fraction = (
        measures.fraction_below + measures.swept_volume(d) for d in (measures.min_offset, measures.max_offset)
    )
    if not (min_fraction < below < max_fraction and 0 < volume_fraction < 1):
        min_fraction, max_fraction = max(min_fraction, 0.0), min(max_fraction, 1.0)
        attainable = (min_fraction, max_fraction) if _side_sign(side) > 0 else (1 - max_fraction, 1 - min_fraction)
        raise _unreachable_fraction(name, reference, "skeletal solid", volume_fraction, *attainable)
    return float(
        brentq(
            lambda d: measures.fraction_below + measures.swept_volume(d) - below,
            measures.min_offset,
            measures.max_offset,
            xtol=OFFSET_ROOT_XTOL_CELLS,
        )
    )


@validate_call()
def offsets_for(
    name: SurfaceName,
    reference: Reference,
    volume_fraction: Annotated[float, FRACTION, "Volume of the solid per volume of the cell."],
    kind: Annotated[
        str,
        choice_of("sheet", "skeletal"),
        "A wall symmetric about the surface, or the volume on one side of an offset surface.",
    ],
    cell: Annotated[float, POSITIVE, "Edge of the cubic cell, in model units."],
    side: Annotated[str, choice_of("-", "+"), "The solid side of a skeletal solid."] = "-",
) -> tuple[float, float]:
    """Return the offsets of a sheet or of a skeletal solid that give a volume fraction.

    Returns
    -------
    tuple of float
        Lower and upper offset in the units of `cell`; equal for a skeletal solid.

    Raises
    ------
    InvalidRequest
        If the kind or side is unknown or the volume fraction is not attainable.

    Examples
    --------
    >>> from tpmscad import surfaces
    >>> lower, upper = surfaces.offsets_for("gyroid", "minimal", 0.3, "sheet", cell=10.0)
    >>> round(lower, 4), round(upper, 4)
    (-0.4917, 0.4917)
    """
    if kind == "sheet":
        half = thickness_for(name, reference, volume_fraction) / 2 * cell
        return -half, half
    offset = skeletal_offset_for(name, reference, volume_fraction, side) * cell
    return offset, offset


@validate_call()
def check_offset(
    name: SurfaceName,
    reference: Reference,
    offset: Annotated[float, NUMBER, "Signed distance from the mid surface, in the units of `cell`."],
    cell: Annotated[float, POSITIVE, "Edge of the cubic cell."] = 1.0,
) -> None:
    """Raise InvalidRequest if an offset reaches the surface's curvature radius.

    Raises
    ------
    InvalidRequest
        If the offset surface has cusps. The message states the admissible offsets and thickness.

    Examples
    --------
    >>> from tpmscad import surfaces
    >>> surfaces.check_offset("gyroid", "minimal", 0.05)
    >>> surfaces.check_offset("gyroid", "minimal", 0.5)
    Traceback (most recent call last):
        ...
    tpmscad.errors.InvalidRequest: offset 0.5 (thickness 1 if symmetric) of the minimal gyroid passes its curvature radius ...
    """
    measures = cell_measures(name, reference)
    min_offset, max_offset = measures.min_offset * cell, measures.max_offset * cell
    if min_offset < offset < max_offset:
        return
    raise InvalidRequest(
        f"offset {offset:g} (thickness {2 * abs(offset):g} if symmetric) of the {reference} {find_surface(name).name} passes its "
        f"curvature radius at cell {cell:g}: offsets stay {_describe_limits(min_offset, max_offset)}, thickness below "
        f"{2 * min(max_offset, -min_offset):.6g}; thin the wall or enlarge the cell"
    )


def _unreachable_fraction(
    name: str, reference: str, solid: str, fraction: float, min_fraction: float, max_fraction: float
) -> InvalidRequest:
    measures = cell_measures(name, reference)
    return InvalidRequest(
        f"volume fraction {fraction:g} is out of reach of a {find_surface(name).name} {solid}: offsets stay "
        f"{_describe_limits(measures.min_offset, measures.max_offset)} cells ({reference} surface), so volume fractions between "
        f"{min_fraction:.6g} and {max_fraction:.6g}"
    )


def _describe_limits(min_offset: float, max_offset: float) -> str:
    """Text on the admissible offsets, one number if they are symmetric."""
    return f"below {max_offset:.6g}" if max_offset == -min_offset else f"between {min_offset:.6g} and {max_offset:.6g}"


def _side_sign(side: str) -> int:
    """+1 for side "-", whose volume grows with the offset; -1 for side "+"."""
    return 1 if side == "-" else -1
