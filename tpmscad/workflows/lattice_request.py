"""What a lattice is asked to be, checked once: after this every value is finite, in range and free of contradictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpmscad import surfaces
from tpmscad.errors import InvalidRequest

MIN_TOL = 2e-7
"""Model units: the kernel merges points closer than 1e-7, so no solid can be held to less than twice that."""

MIN_TOL_CELLS = 1e-7
"""Of the cell: the finest that patches of degree 18 reach before float64 loses the joints' smoothness."""

DEFAULT_TOL_CELLS = 1e-3
"""Of the smallest cell edge, where no tolerance is given."""

KINDS, SIDES, REFERENCES, BOUNDARIES = ("sheet", "skeletal"), ("-", "+"), ("minimal", "nodal"), ("box", "natural")


@dataclass(frozen=True, slots=True)
class LatticeRequest:
    """A checked request. Lengths in model units; `cell` are the three edges, `offset` the normal distances of the two walls
    (sheet) or of the one surface twice (skeletal), `phase` in cells."""

    surface: str
    cell: tuple[float, float, float]
    cells: tuple[int, int, int]
    offset: tuple[float, float]
    kind: str
    side: str
    reference: str
    boundary: str
    phase: tuple[float, float, float]
    tol: float

    @property
    def layer_offsets(self) -> tuple[float | None, float | None]:
        """Normal distances of the lower and the upper bounding surface; None where the solid has no wall on that side.

        The lower one faces the nodal value's decrease: it bounds a skeletal solid on the "+" side.
        """
        if self.kind == "sheet":
            return self.offset
        return (self.offset[0], None) if self.side == "+" else (None, self.offset[0])


def resolve_lattice_request(
    surface: str,
    *,
    cell: float | Sequence[float],
    cells: int | Sequence[int],
    thickness: float | None,
    offset: float | Sequence[float] | None,
    volume_fraction: float | None,
    kind: str,
    side: str,
    reference: str | None,
    boundary: str,
    phase: Sequence[float],
    tol: float | None,
    mapped: bool,
) -> LatticeRequest:
    """The request with its thickness, offsets or volume fraction resolved; InvalidRequest names what is wrong."""
    info = surfaces.find_surface(surface)
    name = info.name
    if reference is None:
        reference = info.references[0] if info.references else REFERENCES[0]
    for label, value, choices in (
        ("kind", kind, KINDS),
        ("side", side, SIDES),
        ("reference", reference, REFERENCES),
        ("boundary", boundary, BOUNDARIES),
    ):
        if value not in choices:
            raise InvalidRequest(f"{label} {value!r} is unknown; choose one of {', '.join(map(repr, choices))}")
    surfaces.check_reference(info, reference)
    if kind == "skeletal" and boundary == "natural":
        raise InvalidRequest(
            "a skeletal solid has no natural boundary: nothing bridges one surface; use boundary='box'"
        )
    edges = _check_positive_triple("cell", cell)
    counts = _check_cell_counts(cells)
    shift = _check_triple("phase", phase)
    stretched = mapped or len(set(edges)) > 1
    if stretched and surfaces.has_mirrors(name):
        raise InvalidRequest(
            f"a map or unequal cell edges {list(edges)} bend the {info.title}'s mirrors, between which its patches are made: "
            "give one cell edge and no map, or make a solid of the mapped field with tpmscad.solidify"
        )
    bound = DEFAULT_TOL_CELLS * min(edges) if tol is None else _check_positive("tol", tol)
    least = max(MIN_TOL, MIN_TOL_CELLS * min(edges))
    if bound < least:
        raise InvalidRequest(
            f"tol {bound:g} is below {least:g}, the least that float64 and the kernel's 1e-7 allow at cell {min(edges):g}; "
            "ask for more, or scale the model up"
        )
    walls = _resolve_offsets(name, reference, kind, side, thickness, offset, volume_fraction, edges[0], stretched)
    if not stretched:
        for wall in walls:
            surfaces.check_offset(name, reference, wall, edges[0])
    return LatticeRequest(name, edges, counts, walls, kind, side, reference, boundary, shift, bound)


def _resolve_offsets(
    name: str,
    reference: str,
    kind: str,
    side: str,
    thickness: float | None,
    offset: float | Sequence[float] | None,
    volume_fraction: float | None,
    cell: float,
    stretched: bool,
) -> tuple[float, float]:
    given = {"thickness": thickness, "offset": offset, "volume_fraction": volume_fraction}
    named = [k for k, v in given.items() if v is not None]
    if kind == "skeletal":
        if thickness is not None:
            raise InvalidRequest("a skeletal solid has no thickness; give offset= (one distance) or volume_fraction=")
        if not named:
            return 0.0, 0.0
    if len(named) != 1:
        what = " and ".join(named) if named else "none of them"
        raise InvalidRequest(f"give exactly one of thickness, offset, volume_fraction; here: {what}")
    if volume_fraction is not None:
        fraction = _check_positive("volume_fraction", volume_fraction)
        if fraction >= 1:
            raise InvalidRequest(f"volume_fraction {fraction:g} must lie below 1")
        if stretched:
            raise InvalidRequest(
                "volume_fraction is solved for cubic cells without a map; give thickness or offset instead"
            )
        return surfaces.offsets_for(name, reference, fraction, kind, cell, side)
    if thickness is not None:
        half = _check_positive("thickness", thickness) / 2
        return -half, half
    values = np.atleast_1d(np.asarray(offset, float))
    if not np.isfinite(values).all():
        raise InvalidRequest(f"offset {values.tolist()} must be finite")
    if kind == "skeletal":
        if values.size != 1:
            raise InvalidRequest(f"a skeletal solid has one offset, not {values.size}")
        return float(values[0]), float(values[0])
    if values.size != 2 or values[0] >= values[1]:
        raise InvalidRequest(f"offset {values.tolist()} of a sheet must be two distances, the lower first")
    return float(values[0]), float(values[1])


def check_finite(label: str, value: Any) -> float:
    """The value as a finite number; InvalidRequest if it is none."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InvalidRequest(f"{label} {value!r} is no number") from None
    if not np.isfinite(number):
        raise InvalidRequest(f"{label} {number:g} must be finite")
    return number


def _check_positive(label: str, value: Any) -> float:
    number = check_finite(label, value)
    if number <= 0:
        raise InvalidRequest(f"{label} {number:g} must be positive")
    return number


def _check_triple(label: str, value: Any) -> tuple[float, float, float]:
    values = list(value) if np.ndim(value) else [value]
    if len(values) != 3:
        raise InvalidRequest(f"{label} takes three numbers, one for each axis; here {len(values)}")
    x, y, z = (check_finite(label, v) for v in values)
    return x, y, z


def _check_positive_triple(label: str, value: Any) -> tuple[float, float, float]:
    x, y, z = (_check_positive(label, v) for v in _check_triple(label, [value] * 3 if not np.ndim(value) else value))
    return x, y, z


def _check_cell_counts(cells: Any) -> tuple[int, int, int]:
    x, y, z = _check_positive_triple("cells", cells)
    for value in (x, y, z):
        if value != int(value):
            raise InvalidRequest(f"cells {value:g} must be whole; trim the solid to take part of a cell")
    return int(x), int(y), int(z)
