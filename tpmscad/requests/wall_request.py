"""The wall of a lattice from what a designer knows: thickness, offsets, volume fraction, porosity or pore size.

Whatever is given ends as a `Wall`: a pair of normal offsets from the mid surface. Volume fractions follow from Steiner's formula,
which is exact. Some surfaces of the catalogue bend so sharply that no symmetric wall of constant thickness has a wanted volume
fraction; their walls are then placed off the middle, and if that does not suffice either, between two levels of the nodal
function, |f| <= c, as such sheets are usually defined. The thickness of a wall between levels varies. `Wall.notes` say which.

The pore size is the diameter of the largest sphere in the void of the infinite lattice. Its centre is the point that lies deepest
in the void, at the distance R from the mid surface; a wall that reaches the distance h from the mid surface on that side leaves
a sphere of the radius R - h. So R, in cells, is found once for either side of a surface, and the cell follows in closed form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import brentq

from tpmscad import fields, surfaces
from tpmscad._typing import Array
from tpmscad.api.public_calls import call_for_array
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.field_notes import collect_notes
from tpmscad.fields.kinds.one_piece_ranges import note_sheet
from tpmscad.requests.lattice_options import LatticeOptions
from tpmscad.sources.pore_radii import PoreRadii, find_level_pore_radii, find_pore_radii

WALL_KEYWORDS = ("thickness", "offset", "volume_fraction", "porosity")
"""Keywords of which exactly one defines a wall."""

USABLE_OFFSET_FRACTION = 0.8
"""Fraction of the offset limits up to which walls off the middle are placed: nearer to it their surfaces are nearly sharp."""


FRACTION_STEPS = 12
"""Newton steps from the mid surface to the offset of a volume fraction: quadratic convergence from one side."""


@dataclass(frozen=True, slots=True)
class Wall:
    """Normal offsets of the lower and the upper surface in model units (equal for a skeletal solid).

    `levels`: nodal values of the two surfaces, if the wall lies between levels instead; the offsets are then 0. `notes` for the
    certificate. Of a graded wall `thickness` and `centre` are functions of points (n, 3) of the model: the offsets are multiples
    of the thickness, counted from the centre.
    """

    offset: tuple[float, float]
    levels: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()
    thickness: Callable[[Array], Array] | None = None
    centre: Callable[[Array], Array] | None = None


def resolve_wall(options: LatticeOptions, cell: float, has_mapping: bool) -> Wall:
    """The wall that the one of thickness, offset, volume_fraction and porosity asks for, at a cell edge.

    The options name a surface of the catalogue and its reference.
    """
    named = [keyword for keyword in WALL_KEYWORDS if getattr(options, keyword) is not None]
    if options.kind == "skeletal":
        if options.thickness is not None:
            raise InvalidRequest(
                "a skeletal solid has no thickness; give offset= (one distance), volume_fraction= or porosity="
            )
        if not named:
            return Wall((0.0, 0.0))
    if len(named) != 1:
        choices = ", ".join(f"`{keyword}`" for keyword in WALL_KEYWORDS)
        listed = " and ".join(f"`{keyword}`" for keyword in named) if named else "none of them"
        raise InvalidRequest(f"give exactly one of {choices}; here: {listed}")
    solved = named[0] in ("volume_fraction", "porosity")
    if solved and has_mapping:
        raise InvalidRequest(
            f"`{named[0]}` is solved for cubic cells without a map; give `thickness` or `offset` instead"
        )
    given = getattr(options, named[0])
    parts = list(given) if isinstance(given, Sequence) and not isinstance(given, str) else [given]
    if any(isinstance(part, str) or callable(part) for part in parts):
        parts = [fields.expression(part) if isinstance(part, str) else part for part in parts]
        return replace(_grade_wall(named[0], parts, options, cell), notes=collect_notes(parts))
    if solved:
        fraction = float(parts[0])
        return _solve_for_fraction(options, 1 - fraction if named[0] == "porosity" else fraction, cell)
    if options.thickness is not None:
        return Wall((-float(parts[0]) / 2, float(parts[0]) / 2))
    low, high = _check_offsets(parts, options.kind)
    return Wall((low, high))


def _check_offsets(parts: list[Any], kind: str) -> tuple[Any, Any]:
    """The lower and the upper offset; the one of a skeletal solid twice."""
    if kind == "skeletal":
        if len(parts) != 1:
            raise InvalidRequest(f"a skeletal solid has one offset, not {len(parts)}")
        return parts[0], parts[0]
    if len(parts) != 2 or (not any(map(callable, parts)) and parts[0] >= parts[1]):
        raise InvalidRequest(f"offset {parts} of a sheet must be two distances, the lower first")
    return parts[0], parts[1]


def _grade_wall(keyword: str, parts: list[Any], options: LatticeOptions, cell: float) -> Wall:
    """The graded wall of numbers and functions that a keyword gives."""
    name = options.surface
    if surfaces.find_surface(name).primitives != "exact":
        raise InvalidRequest(
            f"`{keyword}` may vary along gyroid, diamond and P only, whose patches are exact, not along {name}: give a number, "
            "or make a solid of the wall as a field, with `infill` or `solidify`"
        )
    if options.pore_size is not None:
        raise InvalidRequest(f"pore_size is solved for an even wall: give `cell`, or a number as `{keyword}`")
    if keyword == "thickness":
        return Wall((-0.5, 0.5), thickness=parts[0])
    if keyword == "offset":
        low, high = (part if callable(part) else partial(_repeat, part) for part in _check_offsets(parts, options.kind))
        if options.kind == "skeletal":
            return Wall((0.0, 0.0), centre=low)
        return Wall(
            (-0.5, 0.5),
            thickness=partial(_combine, low, high, -1.0, 1.0),
            centre=partial(_combine, low, high, 0.5, 0.5),
        )
    solved = partial(_solve_fractions, parts[0], keyword, replace(options, cell=cell))
    return Wall((-0.5, 0.5), thickness=solved) if options.kind == "sheet" else Wall((0.0, 0.0), centre=solved)


def _repeat(value: float, points: Array) -> Array:
    return np.full(len(points), value)


def _combine(low: Any, high: Any, a: float, b: float, points: Array) -> Array:
    """A * low + b * high at points (n, 3)."""
    return np.asarray(a * call_for_array("the offset", low, points) + b * call_for_array("the offset", high, points))


def _solve_fractions(given: Any, keyword: str, options: LatticeOptions, points: Array) -> Array:
    """At points (n, 3) the thickness of the sheet, or offset of the skeletal solid, whose even lattice has the fraction there."""
    values = call_for_array(f"the {keyword}", given, points)
    fraction = 1 - values if keyword == "porosity" else values
    name, reference, cell = options.surface, str(options.reference), float(options.cell)  # type: ignore[arg-type]
    for extreme in (fraction.min(), fraction.max()):  # refused if it is out of reach
        surfaces.offsets_for(name, reference, float(extreme), options.kind, cell, options.side)
    measures, d = surfaces.cell_measures(name, reference), np.zeros(fraction.shape)
    below = measures.fraction_below
    for _ in range(FRACTION_STEPS):
        if options.kind == "sheet":
            excess = measures.swept_volume(d) - measures.swept_volume(-d) - fraction
            d = d - excess / (measures.swept_area(d) + measures.swept_area(-d))
        else:
            excess = below + measures.swept_volume(d) - (fraction if options.side == "-" else 1 - fraction)
            d = d - excess / measures.swept_area(d)
    return np.asarray((2 if options.kind == "sheet" else 1) * cell * d)


def _solve_for_fraction(options: LatticeOptions, fraction: float, cell: float) -> Wall:
    """The wall of a volume fraction: symmetric if possible, else off the middle, else between levels."""
    name, reference, kind, side = options.surface, str(options.reference), options.kind, options.side
    try:
        return Wall(surfaces.offsets_for(name, reference, fraction, kind, cell, side))
    except InvalidRequest:
        if kind != "sheet" or surfaces.find_surface(name).primitives != "level set":
            raise
    measures = surfaces.cell_measures(name, reference)
    low, high = USABLE_OFFSET_FRACTION * measures.min_offset, USABLE_OFFSET_FRACTION * measures.max_offset
    title = surfaces.find_surface(name).title
    if measures.swept_volume(high) - measures.swept_volume(low) >= fraction:
        # the side with the smaller radius goes to its limit, the other one as far as needed
        if -low < high:
            below = measures.swept_volume(low)
            high = float(brentq(lambda d: measures.swept_volume(d) - below - fraction, 0.0, high))
        else:
            above = measures.swept_volume(high)
            low = float(brentq(lambda d: above - measures.swept_volume(d) - fraction, low, 0.0))
        note = (
            f"the wall reaches from {low * cell:.4g} to {high * cell:.4g} of the {title}'s surface, as its radius of curvature "
            f"allows no symmetric wall of volume fraction {fraction:g}"
        )
        return Wall((low * cell, high * cell), None, (note,))
    level = fields.threshold_for(fields.tpms(name, 1.0, reference=reference), fraction, "sheet")[1]  # type: ignore[index]
    note = (
        f"the wall lies between the levels {-level:.4g} and {level:.4g}, so its thickness varies: the radii of curvature "
        f"of the {title} allow no wall of constant thickness with volume fraction {fraction:g}"
    )
    return Wall((0.0, 0.0), (-level, level), (note, *note_sheet(name, reference, -level, level)))


def solve_cell(options: LatticeOptions) -> tuple[float, tuple[str, ...]]:
    """The cell edge for which a lattice has the pore size of its options, and a note on the pores of either side."""
    pore, name = float(options.pore_size or 0.0), options.surface
    if options.cell is not None:
        raise InvalidRequest(
            f"give `cell` or pore_size, not both: a pore_size of {pore:g} determines the cell, here {options.cell}"
        )
    if options.map is not None:
        raise InvalidRequest("pore_size is solved for a lattice without a map; give cell= instead")
    scaled = options.volume_fraction is not None or options.porosity is not None
    wall = resolve_wall(options, 1.0, False)
    if wall.levels is not None:
        radii = find_level_pore_radii(name, str(options.reference), wall.levels)
        cell = pore / (2 * max(radii.minus, radii.plus))
        return cell, _note_pores(radii, replace(wall, offset=(0.0, 0.0)), options, cell)
    radii = find_pore_radii(name, str(options.reference))
    low, high = wall.offset
    # of each void beside the wall: the radius in cells, and how far the wall reaches into it
    voids = [(radii.minus, -low), (radii.plus, high)]
    if options.kind == "skeletal":
        voids = voids[1:] if options.side == "-" else voids[:1]
    if scaled:
        cell = pore / (2 * max(radius - reach for radius, reach in voids))
        wall = replace(wall, offset=(low * cell, high * cell))
    else:
        cell = min((pore / 2 + reach) / radius for radius, reach in voids)
    if cell <= 0:
        raise InvalidRequest(f"no cell of the {name} leaves a pore of {pore:g} beside this wall: make the wall thinner")
    return cell, _note_pores(radii, wall, options, cell)


def _note_pores(radii: PoreRadii, wall: Wall, options: LatticeOptions, cell: float) -> tuple[str, ...]:
    """A note on the largest spheres in the void on either side."""
    minus, plus = 2 * (radii.minus * cell + wall.offset[0]), 2 * (radii.plus * cell - wall.offset[1])
    if options.kind == "skeletal":
        return (f"the largest sphere in the void has the diameter {plus if options.side == '-' else minus:.4g}",)
    return (f"the largest spheres in the void have the diameters {minus:.4g} (channel -) and {plus:.4g} (channel +)",)
