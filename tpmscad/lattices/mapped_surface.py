"""The exact mid surface of a lattice under a coordinate map: points, tangents and normals, and the checks that the map must pass.

A map is *regular* where its Jacobian keeps its orientation and is well conditioned; only there has the surface a normal. It is
*closed* along an axis of the lattice if it repeats after the length of the lattice: the lattice then meets itself there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray, triple
from tpmscad.api.public_calls import call_for_array
from tpmscad.brep.welding import cluster_points
from tpmscad.errors import InvalidRequest, format_point
from tpmscad.lattices.coordinate_maps import IDENTITY, Map
from tpmscad.rigid_motion import Motion
from tpmscad.surfaces import PatchSymmetry, SurfacePatch

MAX_CONDITION = 1e3
"""Greatest ratio of the singular values of a map's Jacobian: a patch that is squeezed more has no use, and soon no digits."""

REGULARITY_SAMPLES_PER_CELL = 4
"""Samples along each edge of a cell at which the Jacobian is checked inside the box, besides those on the patches."""

CHECKED_SAMPLES = 5
"""Samples along each parameter of all patches at which graded walls are checked."""

COMMON_POINT_CELLS = 1e-9
"""In cells: points that are nearer to each other, as those on common sides of patches, are asked for one value."""

CLOSING_TOL_FRACTION = 1e-10
"""A map closes if what it repeats agrees to this fraction of the lattice: below the kernel's tolerance for parts up to 1 m."""

CLOSING_SAMPLES = 200
"""Points around an end of the lattice at which a map is compared with itself at the other end."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """Points of the mapped mid surface: lattice coordinates, images, tangents by u and v, unit normals, (..., 3) each."""

    lattice: Array
    position: Array
    du: Array
    dv: Array
    normal: Array


@dataclass(frozen=True, eq=False)
class MappedSurface:
    """The mapped mid surface over given placements of the primitive patch (in cells); `map` acts on cell * x.

    `periods`, in cells, are the lengths after which the lattice meets itself along the axes; 0 where it ends. Of a graded wall
    `thickness` and `centre` are functions of points of the model: signed distances are multiples of the thickness at the point of
    the mid surface, counted from the centre. Where walls are cut off, `limits` are the corners of a box in lattice coordinates
    that holds what is left, and `in_body` tells points (n, 3) of the mid surface so near a body that their wall reaches it.
    """

    patch: SurfacePatch
    symmetry: PatchSymmetry
    placements: Motion
    map: Map
    cell: float
    periods: tuple[float, float, float] = (0.0, 0.0, 0.0)
    thickness: Callable[[Array], Array] | None = None
    centre: Callable[[Array], Array] | None = None
    limits: tuple[Array, Array] | None = None
    in_body: Callable[[Array], BoolArray] | None = None

    @property
    def is_graded(self) -> bool:
        """Whether the signed distances of a wall vary."""
        return self.thickness is not None or self.centre is not None

    def points(self, u: Array, v: Array, index: int | slice | IntArray = slice(None)) -> SurfacePoints:
        """Points at (u, v) of every chosen placement: (P, ..., 3), or (..., 3) of one."""
        rotation = self.placements.rotation[index]
        at = (*rotation.shape[:-2], *(1,) * np.ndim(u))
        return self._points(u, v, rotation.reshape(*at, 3, 3), self.placements.translation[index].reshape(*at, 3))

    def points_at(self, index: IntArray, u: Array, v: Array) -> SurfacePoints:
        """The point at (u[i], v[i]) of placement index[i]: (n, 3)."""
        return self._points(u, v, self.placements.rotation[index], self.placements.translation[index])

    def _points(self, u: Array, v: Array, turn: Array, translation: Array) -> SurfacePoints:
        jet = self.patch.jet(u, v)
        lattice = self.cell * ((turn @ jet.position[..., None])[..., 0] + translation)
        if self.map is IDENTITY:
            du, dv, normal = ((turn @ t[..., None])[..., 0] for t in (jet.du, jet.dv, jet.normal))
            return SurfacePoints(lattice, lattice, self.cell * du, self.cell * dv, normal)
        position, jacobian = self.map.images_and_jacobians(lattice, self.cell)
        du, dv = (self.cell * (jacobian @ (turn @ t[..., None]))[..., 0] for t in (jet.du, jet.dv))
        normal = (turn @ jet.normal[..., None])[..., 0]
        # Normals are mapped by the inverse transpose, which keeps them on the side where the nodal field increases.
        normal = np.linalg.solve(np.swapaxes(jacobian, -1, -2), normal[..., None])[..., 0]
        return SurfacePoints(lattice, position, du, dv, normal / np.linalg.norm(normal, axis=-1, keepdims=True))

    def shift(self, points: SurfacePoints, distance: float) -> Array:
        """The points (..., 3) at the signed normal distance from those of the mid surface."""
        unit, centre = self.grading(points.position)
        return points.position + (centre + distance * unit)[..., None] * points.normal

    def grading(self, points: Array) -> tuple[Array, Array]:
        """At points (..., 3) of the mid surface what signed distances are multiples of, and what they are counted from: (...)."""
        return grading(self.thickness, self.centre, points)

    def lie_within(self, lattice: Array) -> BoolArray:
        """Whether points (..., 3) in lattice coordinates lie within the limits."""
        low, high = (-np.inf, np.inf) if self.limits is None else self.limits
        return np.asarray(((lattice >= low) & (lattice <= high)).all(axis=-1))

    @cached_property
    def checked(self) -> tuple[SurfacePoints, Array, Array]:
        """Points (P, m, m) of all patches, and the grading there: values of a field may be dear, and are asked for once."""
        t = np.linspace(0.0, 1.0, CHECKED_SAMPLES)
        points = self.points(*np.meshgrid(t, t))
        rows = points.position.reshape(-1, 3)
        label, first = cluster_points(rows, COMMON_POINT_CELLS * self.cell)
        unit, centre = (values[label].reshape(-1, len(t), len(t)) for values in self.grading(rows[first]))
        return points, unit, centre

    def orientation(self) -> int:
        """Sign of the Jacobian determinant of the map; InvalidRequest where the map is not regular on the surface."""
        if self.map is IDENTITY:
            return 1
        u, v = (g.ravel() for g in np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 5)))
        return require_regular(
            self.map, self.cell * self.placements[:, None].apply(self.patch.jet(u, v).position), self.cell
        )


def grading(
    thickness: Callable[[Array], Array] | None, centre: Callable[[Array], Array] | None, points: Array
) -> tuple[Array, Array]:
    """The thickness of a graded wall, 1 of an even one, and its centre at points (..., 3) of the mid surface: (...) each."""
    shape = points.shape[:-1]
    unit = np.ones(shape) if thickness is None else evaluate_grading("thickness", thickness, points)
    return unit, np.zeros(shape) if centre is None else evaluate_grading("offset", centre, points)


def evaluate_grading(name: str, function: Callable[[Array], Array], points: Array) -> Array:
    """Values (...) of a graded distance at points (..., 3) of the model; InvalidRequest where it is not finite."""
    rows = points.reshape(-1, 3)
    values = call_for_array(f"the {name}", function, rows)
    if values.shape != rows.shape[:-1]:
        raise InvalidRequest(
            f"the {name} returned shape {values.shape} for points of shape {rows.shape}; it takes points (n, 3) of the model and "
            "returns a number for each"
        )
    if not np.isfinite(values).all():
        raise InvalidRequest(
            f"the {name} is not finite at {format_point(rows[~np.isfinite(values)][0], 6)} in the model: give a smooth function, "
            "which must hold a patch beyond the lattice"
        )
    return values.reshape(points.shape[:-1])


def box_points(cells: tuple[int, int, int], cell: float) -> Array:
    """Points (n, 3) of a grid over the box of the lattice, its faces included."""
    axes = [cell * np.linspace(0, n, n * REGULARITY_SAMPLES_PER_CELL + 1) for n in cells]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def require_regular(map: Map, points: Array, cell: float) -> int:
    """Sign of the Jacobian determinant at lattice points (..., 3); InvalidRequest where the map folds or squeezes space flat."""
    points = points.reshape(-1, 3)
    jacobian = map.jacobian(points, cell)
    if not np.isfinite(jacobian).all():
        where = points[~np.isfinite(jacobian).all(axis=(1, 2))][0]
        raise InvalidRequest(f"the Jacobian of {map.name} is not finite at {format_point(where, 6)}: give a smooth map")
    sizes = np.linalg.svd(jacobian, compute_uv=False)
    sign = np.sign(np.linalg.det(jacobian))
    worst = int(np.argmin(sizes[:, 2] / np.maximum(sizes[:, 0], np.finfo(float).tiny)))
    place = f"near lattice point {format_point(points[worst], 6)}, {format_point(map(points[worst]))} in the model"
    if sign.min() != sign.max():
        raise InvalidRequest(
            f"{map.name} folds: its Jacobian determinant changes sign over the lattice, {place}; "
            "a map must be one-to-one over the lattice and a cell beyond: enlarge its radius (for a closed ring: more cells "
            "round), or take a smaller cell"
        )
    if sizes[worst, 2] * MAX_CONDITION < sizes[worst, 0] or sizes[worst, 0] == 0:
        raise InvalidRequest(
            f"{map.name} squeezes the lattice flat {place}: it stretches by {sizes[worst, 0]:.3g} in one direction and by "
            f"{sizes[worst, 2]:.3g} in another, more than {MAX_CONDITION:g} apart; keep the lattice away from there, or use "
            "a map that is one-to-one"
        )
    return int(sign[0])


def find_closed_axes(map: Map, cells: tuple[int, int, int], cell: float) -> tuple[bool, bool, bool]:
    """Whether the map repeats after the length of the lattice along each axis, so that the lattice meets itself."""
    return triple(float(np.abs(moved).max()) <= limit for moved, limit in _compare_ends(map, cells, cell))


def find_translation_periods(map: Map, cells: tuple[int, int, int], cell: float) -> tuple[float, float, float]:
    """How far along x, y and z the far end of the mapped lattice is a translate of the near end; 0 where it is none.

    A stretch repeats the lattice so; a grading does not along its axis, a bend nowhere.
    """
    periods = []
    for axis, (moved, limit) in enumerate(_compare_ends(map, cells, cell)):
        length = float(moved[0, axis])
        miss = float(np.abs(moved - length * np.eye(3)[axis]).max())
        periods.append(length if length > limit and miss <= limit else 0.0)
    return triple(periods)


def _compare_ends(map: Map, cells: tuple[int, int, int], cell: float) -> Iterator[tuple[Array, float]]:
    """For each axis the steps (n, 3) between images of points around both ends of the lattice, and the greatest miss allowed.

    The points lie within half a cell of the ends, where the map has to be defined anyway.
    """
    unit = np.random.default_rng(0).random((CLOSING_SAMPLES, 3))
    size = cell * np.array(cells, float)
    for axis in range(3):
        points = unit * size
        points[:, axis] = cell * (unit[:, axis] - 0.5)
        yield map(points + size * np.eye(3)[axis]) - map(points), CLOSING_TOL_FRACTION * float(size.max())


def repeats_after(map: Map, step: Array, points: Array) -> bool:
    """Whether the map has the same images after a translation of lattice points (n, 3) by `step` (3,)."""
    miss = float(np.abs(map(points + step) - map(points)).max())
    return miss <= CLOSING_TOL_FRACTION * float(np.abs(step).max())
