"""Ranges of levels in which one side of each catalogued surface is one connected piece in all of space.

The table is measured by `python -m benchmarks.one_piece_ranges levels`: components with their translations on two grids, their
ends critical values of the function. Surfaces without a row are measured at first use, on one grid, to about a hundredth of the
range of their function. A sheet between two levels is one piece wherever both sides of a level in it are: the border of a
connected set whose complement is connected, too, is connected. Its channels are what lies on the sides of its levels.

Between normal offsets that a surface allows, both sides of all surfaces are one piece (`... offsets`): their curvature limits
the offsets before anything comes apart. The effect, for unit cells of nodal functions: arXiv 2402.12109.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np

from tpmscad.fields.kinds.nodal_field import tpms
from tpmscad.topology import periodic_pieces

GRID = 64
"""Samples along a cell of a surface without a row in the table."""

SHARE = 1e-9
"""Of a level: how far beyond the end of a range it is still in it."""


@dataclass(frozen=True, slots=True)
class LevelRange:
    """Levels, and the volume fractions of a side at them, between which the side is one piece: the thin end first.

    The other end is infinite where the side stays one piece until it fills the cell.
    """

    level: float
    to_level: float
    fraction: float
    to_fraction: float

    def contains(self, level: float) -> bool:
        """Whether the side is one piece at a level."""
        slack = SHARE * max(1.0, abs(level))
        low, high = sorted((self.level, self.to_level))
        return low - slack <= level <= high + slack

    def describe(self) -> str:
        """Levels and volume fractions in words."""
        if math.isinf(self.to_level):
            return f"from {self.level:.5g} (volume fraction {self.fraction:.3g}) on"
        return f"from {self.level:.5g} to {self.to_level:.5g} (volume fractions {self.fraction:.3g} to {self.to_fraction:.3g})"


def find_level_ranges(name: str, reference: str, side: str) -> tuple[LevelRange, ...]:
    """The ranges of a side, "-" for {f <= level} and "+" for {f >= level}, of a surface and its reference."""
    rows = _RANGES.get((name, reference, side)) or _measure_ranges(name, reference, side)
    return tuple(LevelRange(*row) for row in rows)


@cache
def _measure_ranges(name: str, reference: str, side: str) -> tuple[tuple[float, float, float, float], ...]:
    """The rows of a side as samples of one period show them, joined by faces alone."""
    sign = -1.0 if side == "+" else 1.0
    axis = np.arange(GRID) / GRID
    values = sign * tpms(name, 1.0, reference=reference).on_grid(axis, axis, axis)
    return tuple(
        (sign * float(low), sign * float(high), float((values <= low).mean()), float((values <= high).mean()))
        for low, high in periodic_pieces(values).one_piece_levels
    )


def is_one_piece(name: str, reference: str, side: str, level: float) -> bool:
    """Whether a side of a surface is one piece at a level."""
    return any(each.contains(level) for each in find_level_ranges(name, reference, side))


def find_sheet_limit(name: str, reference: str) -> float:
    """The greatest c at which both channels beside the sheet |f| <= c are one piece each."""
    below, above = (find_level_ranges(name, reference, side) for side in "-+")
    reach = [abs(each.level) for ranges in (below, above) for each in ranges if each.contains(0.0)]
    return min(reach, default=0.0)


def note_side(name: str, reference: str, side: str, level: float, what: str) -> tuple[str, ...]:
    """A note if a side of a surface, called `what`, is not one piece at a level; it names the levels at which it is."""
    if math.isnan(level) or is_one_piece(name, reference, side, level):
        return ()
    ranges = " and ".join(each.describe() for each in find_level_ranges(name, reference, side))
    sense = "the levels fall" if side == "+" else "the levels rise"
    return (
        f"{what} of the {name} is not one piece at the level {level:.5g}, even without any boundary: it is one piece {ranges}, "
        f"as {sense}",
    )


def note_sheet(name: str, reference: str, low: float, high: float) -> tuple[str, ...]:
    """Notes if the sheet between two levels, or a channel beside it, is not one piece; nan for levels that vary."""
    notes = (
        *note_side(name, reference, "-", low, "the channel on the side -"),
        *note_side(name, reference, "+", high, "the channel on the side +"),
    )
    if math.isnan(low) or math.isnan(high):
        return notes
    spans = [
        [sorted((each.level, each.to_level)) for each in find_level_ranges(name, reference, side)] for side in "-+"
    ]
    whole = [(max(a[0], b[0]), min(a[1], b[1])) for a in spans[0] for b in spans[1]]
    whole = [(a, b) for a, b in whole if a <= b]
    if any(a <= high and low <= b for a, b in whole):
        return notes
    ranges = " or ".join(f"from {a:.5g} to {b:.5g}" for a, b in whole)
    return (
        f"the sheet of the {name} between the levels {low:.5g} and {high:.5g} may be several pieces, even without any boundary: "
        f"it is one piece if it holds a level {ranges}",
        *notes,
    )


INF = math.inf

_RANGES: Mapping[tuple[str, str, str], tuple[tuple[float, float, float, float], ...]] = MappingProxyType(
    {
        ("gyroid", "minimal", "-"): ((-1.365449, INF, 0.0304, 1.0),),
        ("gyroid", "minimal", "+"): ((1.365449, -INF, 0.0304, 1.0),),
        ("gyroid", "nodal", "-"): ((-1.414214, INF, 0.0167, 1.0),),
        ("gyroid", "nodal", "+"): ((1.414214, -INF, 0.0167, 1.0),),
        ("diamond", "minimal", "-"): ((-1.054908, INF, 0.06, 1.0),),
        ("diamond", "minimal", "+"): ((1.054908, -INF, 0.06, 1.0),),
        ("diamond", "nodal", "-"): ((-1.0, INF, 0.0806, 1.0),),
        ("diamond", "nodal", "+"): ((1.0, -INF, 0.0806, 1.0),),
        ("schwarz_p", "minimal", "-"): ((-1.087134, INF, 0.1897, 1.0),),
        ("schwarz_p", "minimal", "+"): ((1.087134, -INF, 0.1897, 1.0),),
        ("schwarz_p", "nodal", "-"): ((-1.0, INF, 0.2133, 1.0),),
        ("schwarz_p", "nodal", "+"): ((1.0, -INF, 0.2133, 1.0),),
        ("iwp", "nodal", "-"): ((-3.0, INF, 0.1005, 1.0),),
        ("iwp", "nodal", "+"): ((3.0, -INF, 0.0, 1.0),),
        ("iwp", "minimal", "-"): ((-1.43846, 0.296259, 0.0827, 0.5531), (0.354222, INF, 0.5834, 1.0)),
        ("iwp", "minimal", "+"): ((0.354331, -INF, 0.4165, 1.0),),
        ("neovius", "nodal", "-"): ((-0.75, INF, 0.3354, 1.0),),
        ("neovius", "nodal", "+"): ((0.75, -INF, 0.3354, 1.0),),
        ("neovius", "minimal", "-"): ((-0.179868, INF, 0.321, 1.0),),
        ("neovius", "minimal", "+"): ((0.179868, -INF, 0.321, 1.0),),
        ("frd", "nodal", "-"): ((-1.098208, 1.0, 0.2143, 0.6692), (1.863833, INF, 0.9106, 1.0)),
        ("frd", "nodal", "+"): ((1.0, -INF, 0.3308, 1.0),),
        ("frd", "minimal", "-"): ((-0.170245, INF, 0.3349, 1.0),),
        ("frd", "minimal", "+"): ((0.254974, -0.13092, 0.3908, 0.6163), (-0.169335, -INF, 0.6622, 1.0)),
        ("lidinoid", "nodal", "-"): ((-0.173937, INF, 0.2538, 1.0),),
        ("lidinoid", "nodal", "+"): ((0.15, -INF, 0.4952, 1.0),),
        ("split_p", "nodal", "-"): ((-0.97047, INF, 0.1413, 1.0),),
        ("split_p", "nodal", "+"): ((0.6, -INF, 0.2754, 1.0),),
        ("fischer_koch_s", "nodal", "-"): ((-0.749168, INF, 0.1148, 1.0),),
        ("fischer_koch_s", "nodal", "+"): ((0.749168, -INF, 0.1148, 1.0),),
        ("fischer_koch_s", "minimal", "-"): ((-0.874712, INF, 0.0735, 1.0),),
        ("fischer_koch_s", "minimal", "+"): ((0.874712, -INF, 0.0735, 1.0),),
        ("octo", "nodal", "-"): ((-0.216667, INF, 0.2267, 1.0),),
        ("octo", "nodal", "+"): ((0.05, -INF, 0.4748, 1.0),),
    }
)
"""Rows of `LevelRange` by surface, reference and side."""
