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

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from tpmscad import fields, surfaces
from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.one_piece_ranges import note_sheet
from tpmscad.requests.lattice_options import LatticeOptions
from tpmscad.sources.pore_radii import PoreRadii, find_level_pore_radii, find_pore_radii

WALL_KEYWORDS = ("thickness", "offset", "volume_fraction", "porosity")
"""Keywords of which exactly one defines a wall."""

USABLE_OFFSET_FRACTION = 0.8
"""Fraction of the offset limits up to which walls off the middle are placed: nearer to it their surfaces are nearly sharp."""


@dataclass(frozen=True, slots=True)
class Wall:
    """Normal offsets of the lower and the upper surface in model units (equal for a skeletal solid).

    `levels`: nodal values of the two surfaces, if the wall lies between levels instead; the offsets are then 0. `thickness`: that
    of a graded wall, a function of points of the model; the offsets are then multiples of it. `notes` for the certificate.
    """

    offset: tuple[float, float]
    levels: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()
    thickness: Callable[[Array], Array] | None = None


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
    if options.volume_fraction is not None or options.porosity is not None:
        if has_mapping:
            raise InvalidRequest(
                f"`{named[0]}` is solved for cubic cells without a map; give `thickness` or `offset` instead"
            )
        return _solve_for_fraction(options, cell)
    if callable(options.thickness):
        if options.map is None:
            raise InvalidRequest(
                "a thickness that is a function is for a lattice under a map, whose patches are fitted one by one: give `map`, "
                "stretching by 1 along each axis for instance, or a number"
            )
        return Wall((-0.5, 0.5), thickness=options.thickness)
    if options.thickness is not None:
        return Wall((-options.thickness / 2, options.thickness / 2))
    return Wall(_check_offsets(options.offset, options.kind))


def _check_offsets(offset: Any, kind: str) -> tuple[float, float]:
    """The lower and the upper offset; the one of a skeletal solid twice."""
    values = np.atleast_1d(np.asarray(offset, float))
    if kind == "skeletal":
        if values.size != 1:
            raise InvalidRequest(f"a skeletal solid has one offset, not {values.size}")
        return float(values[0]), float(values[0])
    if values.size != 2 or values[0] >= values[1]:
        raise InvalidRequest(f"offset {values.tolist()} of a sheet must be two distances, the lower first")
    return float(values[0]), float(values[1])


def _solve_for_fraction(options: LatticeOptions, cell: float) -> Wall:
    """The wall of a volume fraction: symmetric if possible, else off the middle, else between levels."""
    name, reference, kind, side = options.surface, str(options.reference), options.kind, options.side
    fraction = 1 - options.porosity if options.porosity is not None else float(options.volume_fraction or 0.0)
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
