"""The largest sphere in the void of a lattice, and the cell for which it has a wanted diameter.

The pore size is the diameter of the largest sphere in the void of the infinite lattice. Its centre is the point that lies deepest
in the void, at the distance R from the mid surface; a wall that reaches the distance h from the mid surface on that side leaves
a sphere of the radius R - h. So R, in cells, is found once for either side of a surface, and the cell follows in closed form.
"""

from __future__ import annotations

from dataclasses import replace

from tpmscad.errors import InvalidRequest
from tpmscad.requests.lattice_options import LatticeOptions
from tpmscad.requests.wall_request import Wall, resolve_wall
from tpmscad.sources.pore_radii import PoreRadii, find_level_pore_radii, find_pore_radii


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
        radii = find_level_pore_radii(name, wall.levels)
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
