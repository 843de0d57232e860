"""Cores of sandwich panels: straight cells side by side along an axis, with walls of one thickness, as a field.

Across the axis the cells tile the plane: regular hexagons, squares, triangles, or hexagons whose slanted walls lean inwards,
which widen when they are stretched (negative Poisson's ratio).

Source: L. J. Gibson and M. F. Ashby, Cellular Solids, 2nd ed., Cambridge University Press (1997), chapter 4.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Self

import numpy as np
from scipy.optimize import brentq

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.api.argument_kinds import choice_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import ANGLE, DIRECTION, POSITIVE
from tpmscad.catalogue import CORES
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.fields.periods_and_directions import Direction, as_unit_vector
from tpmscad.fields.tape.evaluation import FieldJet, Triple, stack_points

DEFAULT_ANGLE = 30.0
"""Degrees by which the slanted walls of a re-entrant cell lean inwards: in-plane Poisson's ratios are then -1."""

ON_AXIS = 1e-12
"""Components of a unit vector that are taken for zero."""


@dataclass(frozen=True, slots=True, eq=False)
class CoreCells:
    """The voids of the unit that is repeated, in the plane across a core.

    lattice (2, 2): rows are the vectors by which it repeats; rectangle: sides, along the axes, of the smallest rectangle that
    does. corners: of each void, counter-clockwise, (n, 2). parts: the sides of the convex parts whose union each void is; side
    i runs from corner i to the next one.
    """

    lattice: Array
    rectangle: tuple[float, float]
    corners: tuple[Array, ...]
    parts: tuple[tuple[int, ...], ...]

    def half_planes(self) -> tuple[Array, Array, IntArray]:
        """Outward normals (s, 2) and offsets (s,) of the sides of all convex parts; where those of each begin, and s."""
        normals, offsets = [], []
        for corners in self.corners:
            normal = _outward_normals(corners)
            for part in map(list, self.parts):
                normals.append(normal[part])
                offsets.append((normal * corners).sum(axis=1)[part])
        return np.concatenate(normals), np.concatenate(offsets), np.cumsum([0, *map(len, offsets)])

    def within(self, low: Array, high: Array) -> Iterator[tuple[Array, Array]]:
        """The corners of each void, and the translations (n, 2) at which it meets the rectangle between two points (2,)."""
        reach = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])]) @ np.linalg.inv(self.lattice)
        first, last = np.floor(reach.min(axis=0)).astype(int) - 2, np.ceil(reach.max(axis=0)).astype(int) + 3
        numbers = np.stack(np.meshgrid(*map(np.arange, first, last), indexing="ij"), axis=-1).reshape(-1, 2)
        moves = numbers @ self.lattice
        for corners in self.corners:
            meets = (moves + corners.min(axis=0) < high) & (moves + corners.max(axis=0) > low)
            yield corners, moves[meets.all(axis=1)]


@dataclass(frozen=True, slots=True)
class CoreField(Field):
    """Distance from the voids of a core, negative in the walls; in a void, positive, that from the nearest wall.

    In walls the planes of a void's sides count beyond its corners, so that distances are too small there. origin: the centre of a
    cell. axes: unit vectors, the last one along the cells; they are left-handed if the core was mirrored.
    """

    structure: str
    cell: float
    thickness: float
    angle: float
    origin: Triple
    axes: tuple[Triple, Triple, Triple]

    @property
    def cells(self) -> CoreCells:
        """The voids, in the plane of the first two axes."""
        return make_core_cells(self.structure, self.cell, self.thickness, self.angle)

    def at(self, x: Array, y: Array, z: Array) -> Array:
        """Values at coordinates that broadcast."""
        return self.jet(x, y, z)[0]

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        """Value and partial derivatives at coordinates that broadcast; the gradient is a unit vector."""
        points, shape = stack_points(x, y, z)
        across, cells = np.array(self.axes)[:2], self.cells
        normals, offsets, starts = cells.half_planes()
        inverse = np.linalg.inv(cells.lattice)
        shifted = points - np.array(self.origin)
        values, sides = _measure_voids(shifted, across, inverse, cells.lattice, normals, offsets, starts)
        gradients = (-normals @ across)[sides]
        gx, gy, gz = (gradients[:, k].reshape(shape) for k in range(3))
        return values.reshape(shape), gx, gy, gz

    def periods(self) -> Triple | None:
        """Return the periods along the axes: of the rectangle that repeats, and a cell along the voids, where nothing changes.

        None if the axes are not those of coordinates.
        """
        axes = np.abs(np.array(self.axes))
        if not ((axes <= ON_AXIS) | (axes >= 1 - ON_AXIS)).all():
            return None
        px, py, pz = (axes.T @ np.array([*self.cells.rectangle, self.cell])).tolist()
        return px, py, pz

    def move(self, rotation: Array, shift: Array, factor: float) -> Self:
        """The core of the points p with factor * rotation @ p + shift in this one."""
        x, y, z = (rotation.T @ (np.array(self.origin) - shift) / factor).tolist()
        first, second, third = map(tuple, (np.array(self.axes) @ rotation).tolist())
        return replace(
            self,
            cell=self.cell / factor,
            thickness=self.thickness / factor,
            origin=(x, y, z),
            axes=(first, second, third),
        )

    def facing_z(self) -> tuple[Self, Array]:
        """The core with its cells along z, and the rotation (3, 3) that takes it to this one."""
        rotation = np.array(self.axes).T
        rotation[:, 2] *= np.linalg.det(rotation)  # nothing changes along the cells: either way
        return self.move(rotation, np.zeros(3), 1.0), rotation

    def thicken(self, by: float) -> Self | None:
        """The core with walls thicker by a length; None if nothing is left of the walls or of the voids."""
        thickness = self.thickness + by
        if not 0 < thickness < limit_thickness(self.structure, self.cell, self.angle):
            return None
        return replace(self, thickness=thickness)


@njit_cached  # type: ignore[untyped-decorator]  # numba has no types
def _measure_voids(
    points: Array, across: Array, inverse: Array, lattice: Array, normals: Array, offsets: Array, starts: IntArray
) -> tuple[Array, IntArray]:  # pragma: no cover - compiled
    """The depths of points (n, 3) in the voids, of the parts in which they are deepest, and the nearest sides of those (n,)."""
    values, sides = np.empty(len(points)), np.empty(len(points), np.int64)
    for k in range(len(points)):
        x = points[k, 0] * across[0, 0] + points[k, 1] * across[0, 1] + points[k, 2] * across[0, 2]
        y = points[k, 0] * across[1, 0] + points[k, 1] * across[1, 1] + points[k, 2] * across[1, 2]
        i0 = np.floor(x * inverse[0, 0] + y * inverse[1, 0] + 0.5)
        j0 = np.floor(x * inverse[0, 1] + y * inverse[1, 1] + 0.5)
        deepest, side = -np.inf, 0
        for i in range(-1, 2):
            for j in range(-1, 2):
                ox = x - (i0 + i) * lattice[0, 0] - (j0 + j) * lattice[1, 0]
                oy = y - (i0 + i) * lattice[0, 1] - (j0 + j) * lattice[1, 1]
                for part in range(len(starts) - 1):
                    depth, nearest = np.inf, 0
                    for s in range(starts[part], starts[part + 1]):
                        own = offsets[s] - normals[s, 0] * ox - normals[s, 1] * oy
                        if own < depth:
                            depth, nearest = own, s
                    if depth > deepest:
                        deepest, side = depth, nearest
        values[k], sides[k] = deepest, side
    return values, sides


def make_core_cells(structure: str, cell: float, thickness: float, angle: float) -> CoreCells:
    """The voids between walls of a thickness that leaves some."""
    unit = _tile_plane(structure, angle)
    return CoreCells(
        cell * unit.lattice,
        (cell * unit.rectangle[0], cell * unit.rectangle[1]),
        tuple(_inset(cell * corners, thickness / 2) for corners in unit.corners),
        unit.parts,
    )


def limit_thickness(structure: str, cell: float, angle: float) -> float:
    """The thickness of the walls at which the voids are filled, or fall apart."""
    corners = _tile_plane(structure, angle).corners[0]
    lengths = _side_lengths(corners, corners)
    # the sides of a void change in proportion to the thickness, until the first is gone
    lost = lengths - _side_lengths(_inset(corners, 0.5), corners)
    limits = [length / loss for length, loss in zip(lengths.tolist(), lost.tolist(), strict=True) if loss > 0]
    if structure == "re-entrant":  # the slanted walls meet in the waist
        limits.append(1 - math.sin(math.radians(angle)))
    return cell * min(limits)


def thickness_of_fraction(structure: str, cell: float, fraction: float, angle: float = DEFAULT_ANGLE) -> float:
    """The thickness of walls that fill a fraction of space."""
    limit = limit_thickness(structure, cell, angle)

    def void_share(thickness: float) -> float:
        cells = make_core_cells(structure, cell, thickness, angle)
        return sum(map(_polygon_area, cells.corners)) / abs(float(np.linalg.det(cells.lattice)))

    least = void_share(limit)
    if not fraction < 1 - least:
        raise InvalidRequest(
            f"volume_fraction = {fraction:g} of a {structure} core is {1 - least:.6g} at most, where its voids fall apart"
        )
    found: float = brentq(lambda thickness: void_share(thickness) - (1 - fraction), 0.0, limit, xtol=1e-15 * cell)
    return found


def _polygon_area(corners: Array) -> float:
    """The area of a polygon that is given counter-clockwise."""
    x, y = corners.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _tile_plane(structure: str, angle: float) -> CoreCells:
    """Cells of size 1 without walls, whose first one has its centre at the origin."""
    rhombus = np.array([[1.0, 0.0], [0.5, math.sqrt(0.75)]])
    if structure == "square":
        return CoreCells(np.eye(2), (1.0, 1.0), (_regular_polygon(4, math.sqrt(0.5), 45.0),), ((0, 1, 2, 3),))
    if structure == "honeycomb":
        corners = _regular_polygon(6, math.sqrt(1 / 3), 30.0)
        return CoreCells(rhombus, (1.0, math.sqrt(3)), (corners,), ((0, 1, 2, 3, 4, 5),))
    if structure == "triangular":
        upright, inverted = (_regular_polygon(3, math.sqrt(1 / 3), start) for start in (90.0, -90.0))
        inverted = inverted + np.array([0.5, math.sqrt(1 / 12)])
        return CoreCells(rhombus, (1.0, math.sqrt(3)), (upright, inverted), ((0, 1, 2),))
    lean = math.radians(angle)
    slanted = 0.5 / math.cos(lean)  # upright walls are twice as long
    rise = slanted * math.sin(lean)
    right = np.array([[0.5, -slanted], [0.5, slanted], [0.0, slanted - rise]])
    corners = np.concatenate([right, -right])
    lattice = np.array([[1.0, 0.0], [0.5, 2 * slanted - rise]])
    # sides: 0 upright on the right, 1 and 2 above, 3 upright on the left, 4 and 5 below; the left half and the right one reach
    # into each other, to their own slanted sides
    return CoreCells(lattice, (1.0, 2 * (2 * slanted - rise)), (corners,), ((0, 1, 5, 3), (0, 2, 3, 4)))


def _regular_polygon(count: int, radius: float, start: float) -> Array:
    """Corners on a circle, the first at an angle in degrees."""
    turn = np.radians(start + 360.0 / count * np.arange(count))
    return radius * np.column_stack([np.cos(turn), np.sin(turn)])


def _outward_normals(corners: Array) -> Array:
    """Unit normals of the sides of a polygon that is given counter-clockwise."""
    along = np.roll(corners, -1, axis=0) - corners
    return np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]


def _side_lengths(corners: Array, parallel: Array) -> Array:
    """The lengths of sides, negative where they run against those of a polygon with parallel sides."""
    along, directions = (np.roll(each, -1, axis=0) - each for each in (corners, parallel))
    return (along * directions).sum(axis=1) / np.linalg.norm(directions, axis=1)


def _inset(corners: Array, distance: float) -> Array:
    """The corners of the polygon whose sides lie inwards by a distance."""
    normals = _outward_normals(corners)
    before = np.roll(normals, 1, axis=0)
    # the corner moves by a vector whose products with the normals of both its sides are -distance
    return corners - distance * (before + normals) / (1 + (before * normals).sum(axis=1))[:, None]


@validate_call()
def core(
    structure: Annotated[str, choice_of(*CORES), "Kind of cells."],
    cell: Annotated[
        float,
        POSITIVE.described_as(example="6.0"),
        "Size of a cell between the middles of walls, model units: across the flats of a hexagon, the side of a square or a "
        "triangle, the width of a re-entrant cell between its upright walls.",
    ],
    thickness: Annotated[float, POSITIVE, "Thickness of the walls, model units."],
    axis: Annotated[Direction, DIRECTION, "Direction of the cells: 'x', 'y', 'z', or a vector (3,)."] = (0.0, 0.0, 1.0),
    angle: Annotated[float, ANGLE, "Degrees by which the slanted walls of `re-entrant` lean inwards."] = DEFAULT_ANGLE,
) -> CoreField:
    """Return the core of a sandwich panel: the walls between straight cells along an axis, without ends.

    The centre of a cell lies at the origin. Cells follow each other along the coordinate axis that is most nearly across `axis`:
    along x for cells along z or y. The upright walls of re-entrant cells are twice as long as the slanted ones.

    Returns
    -------
    CoreField
        The walls, negative inside, whose sides are exact planes.

    Raises
    ------
    InvalidRequest
        If the walls fill the cells.

    Notes
    -----
    Of hexagons and squares the solid fraction is 1 - (1 - t/c)^2 for walls t and cells c, of triangles 1 - (1 - sqrt(3) t/c)^2.

    Examples
    --------
    >>> from tpmscad import fields
    >>> float(fields.core("square", cell=6.0, thickness=0.5)((0.0, 0.0, 0.0)))
    2.75
    """
    limit = limit_thickness(structure, cell, angle)
    if thickness >= limit:
        raise InvalidRequest(
            f"thickness = {thickness:g} fills the cells of a {structure} core of cell = {cell:g}: make it less than {limit:.6g}"
        )
    along = np.array(as_unit_vector(axis))
    across = np.eye(3)[int(np.argmin(np.abs(along).round(12)))]
    across = across - (across @ along) * along
    across /= np.linalg.norm(across)
    first, second, third = map(tuple, np.stack([across, np.cross(along, across), along]).tolist())
    return CoreField(structure, float(cell), float(thickness), float(angle), (0.0, 0.0, 0.0), (first, second, third))
