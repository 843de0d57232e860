"""Quadrilateral layout of the level set of a periodic field on one period, opposite faces of which are identified (a torus).

The dual mesh of a uniform grid is made on one period and a margin round it, and its polygons are reduced modulo the periods:
nothing is cut, and copies of one period fit together without seams. A grid that the isometries of the field map to itself gives a
mesh with the same symmetry, so that only one vertex, side and polygon of each orbit need be known. The vertices of the orbits'
representatives are smoothed on the level set; all others are their images.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.linked_items import label_linked
from tpmscad.brep.welding import cluster_points
from tpmscad.errors import LevelSetError
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh import octree
from tpmscad.levelset.quadmesh.dual_mesh import build_dual_mesh
from tpmscad.levelset.quadmesh.regular_polygons import MIN_WEIGHTED_SINE, WEIGHT_POWER, fit_regular_polygons
from tpmscad.levelset.quadmesh.smoothing import MAX_MOVE_FRACTION, project_to_level_set
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR, length, normalize, roll_next, sines_between_sides
from tpmscad.rigid_motion import Motion

MARGIN_LEAVES = 2
"""Leaves round the period: all dual vertices of polygons in the period then lie off the border of the grid."""

SAME_POINT_TOL_PERIODS = 1e-7
"""Distance, in the least period, within which two points are one: far above round-off, far below a side."""

SMOOTHING_SWEEPS = 150
"""Sweeps over the vertices of the representatives, of which there are few."""

REST_MOVE_FRACTION = 1e-4
"""The sweeps end when no vertex moves by more than this fraction of a leaf."""

MIN_SIDE_COSINE = -0.4
MAX_STRIP_SPLITS = 3
"""Least cosine of the angle between the normals at the ends of a side; beyond it the strip of polygons across it is halved."""

MAX_STEP_FRACTION = 0.25
MAX_NEWTON_STEPS = 40
"""Largest step of a vertex towards the level set, in leaves, and the greatest number of steps in the end."""


@dataclass(frozen=True, slots=True, eq=False)
class PeriodicMesh:
    """A quadrilateral mesh of a level set modulo the periods (3,) of its field, with its symmetry.

    Vertex v lies at vertices[v] + k * period for all whole k. Corner i of polygon q is vertex corners[q, i] in the period
    corner_period[q, i]; the corners are counter-clockwise as seen from the void, or clockwise where the motion of the polygon is
    a mirror: polygon q is the image of polygon polygon_origin[q] by polygon_motion[q], corner by corner.
    """

    period: Array
    vertices: Array
    corners: IntArray
    corner_period: IntArray
    polygon_origin: IntArray
    polygon_motion: Motion

    @property
    def representatives(self) -> IntArray:
        """The polygons (P,) of which the others are images."""
        return np.unique(self.polygon_origin)

    @property
    def representative_row(self) -> IntArray:
        """Row (Q,) of each polygon's origin among the representatives."""
        return np.searchsorted(self.representatives, self.polygon_origin)

    def side_middles(self) -> Array:
        """Middles (4 Q, 3) of the chords of all sides."""
        points = self.corner_points(np.arange(len(self.corners)))
        return np.asarray((points + np.roll(points, -1, axis=1)) / 2).reshape(-1, 3)

    def corner_points(self, polygons: IntArray) -> Array:
        """Positions (n, 4, 3) of the corners of polygons."""
        return np.asarray(self.vertices[self.corners[polygons]] + self.corner_period[polygons] * self.period)


@dataclass(frozen=True, slots=True, eq=False)
class _Quotient:
    """The dual mesh modulo the periods before smoothing: start positions (V, 3), corners and their periods (Q, 4), (Q, 4, 3)."""

    period: Array
    start: Array
    corners: IntArray
    corner_period: IntArray


def build_periodic_mesh(field: Field, isometries: Motion, n_leaves: IntArray, origin: Array) -> PeriodicMesh:
    """The mesh of {field = 0} on a uniform grid of `n_leaves` (3,) to a period, with a node at `origin` (3,).

    LevelSetError if the grid is too coarse, or if the isometries do not map the mesh to itself.
    """
    mesh = _smooth_and_place(field, isometries, _reduce_dual_mesh(field, n_leaves, origin))
    for _ in range(MAX_STRIP_SPLITS):
        split = _select_strips(mesh, field)
        if not split.any():
            break
        mesh = _smooth_and_place(field, isometries, _split_strips(mesh, split))
    return mesh


def _smooth_and_place(field: Field, isometries: Motion, quotient: _Quotient) -> PeriodicMesh:
    """The mesh of a quotient, its representatives smoothed and all others placed."""
    _check_closed(quotient)
    vertex_image, vertex_period = _match_images(quotient.start, isometries, quotient.period)
    midpoints = (quotient.start[quotient.corners] + quotient.corner_period * quotient.period).mean(axis=1)
    polygon_image, polygon_period = _match_images(midpoints, isometries, quotient.period)
    vertex_origin, vertex_motion = _choose_representatives(vertex_image, vertex_period, isometries, quotient.period)
    origin_of, motion = _choose_representatives(polygon_image, polygon_period, isometries, quotient.period)

    vertices = _smooth(field, quotient, isometries, vertex_image, vertex_period, vertex_origin, vertex_motion)
    # corners of every polygon in the order of its representative
    representative = quotient.corners[origin_of], quotient.corner_period[origin_of]
    images = motion[:, None].apply(vertices[representative[0]] + representative[1] * quotient.period)
    corners, corner_period = _locate(images, vertices, quotient.period)
    if not np.array_equal(np.sort(corners, axis=1), np.sort(quotient.corners, axis=1)):
        raise LevelSetError("the mesh of a period does not have the symmetry of its field: use a finer grid")
    return PeriodicMesh(quotient.period, vertices, corners, corner_period, origin_of, motion)


def wrap_into_period(points: Array, period: Array) -> Array:
    """Points (..., 3) moved into the first period, as a `periodic_tree` takes them."""
    return np.minimum(np.mod(points, period), np.nextafter(period, 0))


def periodic_tree(points: Array, period: Array) -> cKDTree:
    """The tree of points (n, 3) modulo the periods (3,)."""
    return cKDTree(wrap_into_period(points, period), boxsize=period)


def count_euler_characteristic(field: Field, n_leaves: IntArray, origin: Array) -> int:
    """Euler characteristic of {field = 0} in one period, on a grid as in `build_periodic_mesh`."""
    quotient = _reduce_dual_mesh(field, n_leaves, origin)
    return len(quotient.start) - len(quotient.corners)  # every side belongs to two of the quadrilaterals


def min_corner_sine(mesh: PeriodicMesh, field: Field) -> float:
    """Least signed sine of a corner angle of the mesh; negative if a polygon is folded."""
    polygons = mesh.representatives
    points = mesh.corner_points(polygons)
    normals = normalize(field.gradient(points))
    p, n = (np.moveaxis(a, -1, 0) for a in (points, normals))
    side = roll_next(p) - p
    sense = mesh.polygon_motion[polygons].handedness[:, None]
    return float((sense * sines_between_sides(side, length(side), n)).min())


def _reduce_dual_mesh(field: Field, n_leaves: IntArray, origin: Array) -> _Quotient:
    """The dual mesh of the grid modulo the periods."""
    periods = field.periods()
    assert periods is not None
    period = np.array(periods)
    leaf = period / n_leaves
    tree = octree.uniform_octree(
        origin - MARGIN_LEAVES * leaf, origin + period + MARGIN_LEAVES * leaf, n_leaves + 2 * MARGIN_LEAVES
    )
    mesh = build_dual_mesh(tree, field)
    points = mesh.start_positions[mesh.corners]
    tolerance = SAME_POINT_TOL_PERIODS * float(period.min())
    home = np.floor((points.mean(axis=1) - origin + tolerance) / period)
    return _weld_polygons(points[(home == 0).all(axis=1)], period, origin)


def _weld_polygons(points: Array, period: Array, origin: Array) -> _Quotient:
    """Polygons with corners (Q, 4, 3), one of each class modulo the periods, with common vertices."""
    tolerance = SAME_POINT_TOL_PERIODS * float(period.min())
    cell = np.floor((points - origin + tolerance) / period).astype(np.int64)
    reduced = points - cell * period
    label, first = cluster_points(reduced.reshape(-1, 3), tolerance)
    corners = label.reshape(-1, 4)
    return _Quotient(period, reduced.reshape(-1, 3)[first], corners, cell)


def _select_strips(mesh: PeriodicMesh, field: Field) -> BoolArray:
    """Sides (Q, 4) to be split: of the strips with a side along which the normal turns too far, the one with fewest polygons.

    A strip passes from each side of a polygon to the opposite one; its images by the isometries belong to it.
    """
    normals = normalize(field.gradient(mesh.vertices))[mesh.corners]
    cosine = np.einsum("qij,qij->qi", normals, np.roll(normals, -1, axis=1))
    middle, tolerance = mesh.side_middles(), SAME_POINT_TOL_PERIODS * mesh.period
    # moved into one period so that equal ones are near each other
    wrapped = middle - np.floor((middle + tolerance) / mesh.period) * mesh.period
    side, _ = cluster_points(wrapped, float(tolerance.min()))
    # nodes are the sides of representatives, joined where polygons share a side or have it opposite
    node = (4 * mesh.representative_row[:, None] + np.arange(4)).ravel()
    n_nodes = 4 * len(mesh.representatives)
    opposite = np.arange(n_nodes).reshape(-1, 4)
    links = np.concatenate(
        [
            np.column_stack([node, n_nodes + side]),
            np.column_stack([opposite[:, :2].ravel(), opposite[:, 2:].ravel()]),
        ]
    )
    strip = label_linked(n_nodes + int(side.max()) + 1, links)[node].reshape(-1, 4)
    bad = np.unique(strip[cosine < MIN_SIDE_COSINE])
    return min((strip == number for number in bad), key=np.count_nonzero, default=np.zeros(strip.shape, bool))


def _split_strips(mesh: PeriodicMesh, split: BoolArray) -> _Quotient:
    """The mesh with the polygons at split sides (Q, 4) halved or quartered across them."""
    points = mesh.corner_points(np.arange(len(mesh.corners)))
    mirrored = mesh.polygon_motion.handedness < 0
    points[mirrored], split = points[mirrored][:, ::-1], split.copy()
    split[mirrored] = split[mirrored][:, [2, 1, 0, 3]]
    # parity: sides 0 and 2 split, sides 1 and 3 split
    turned = split[:, 1] & ~split[:, 0]
    points[turned] = np.roll(points[turned], -1, axis=1)
    both = split[:, 0] & split[:, 1]
    one = (split[:, 0] ^ split[:, 1]) & ~both
    middle = (points + np.roll(points, -1, axis=1)) / 2
    centre = points.mean(axis=1)
    parts = [points[~one & ~both]]
    p, m = points[one], middle[one]
    parts.append(np.stack([p[:, 0], m[:, 0], m[:, 2], p[:, 3]], axis=1))
    parts.append(np.stack([m[:, 0], p[:, 1], p[:, 2], m[:, 2]], axis=1))
    p, m, c = points[both], middle[both], centre[both]
    parts += [np.stack([p[:, i], m[:, i], c, m[:, i - 1]], axis=1) for i in range(4)]
    return _weld_polygons(np.concatenate(parts), mesh.period, np.zeros(3))


def _check_closed(quotient: _Quotient) -> None:
    """LevelSetError unless every side is used twice, once in each direction, and no side joins a vertex to itself."""
    start, end = quotient.corners, np.roll(quotient.corners, -1, axis=1)
    step = np.roll(quotient.corner_period, -1, axis=1) - quotient.corner_period
    forward = np.column_stack([start.ravel(), end.ravel(), step.reshape(-1, 3)])
    backward = np.column_stack([end.ravel(), start.ravel(), -step.reshape(-1, 3)])
    rows, count = np.unique(forward, axis=0, return_counts=True)
    if (count > 1).any() or not np.array_equal(rows, np.unique(backward, axis=0)):
        raise LevelSetError("two sides of the mesh join the same vertices: a finer grid is needed")


def _match_images(points: Array, isometries: Motion, period: Array) -> tuple[IntArray, IntArray]:
    """The point (G, n) that each isometry maps each point (n, 3) to, and the period (G, n, 3) in which the image lies."""
    return _locate(isometries[:, None].apply(points), points, period)


def _locate(images: Array, points: Array, period: Array) -> tuple[IntArray, IntArray]:
    """Numbers (...) and periods (..., 3) of the points (n, 3) that lie at `images` (..., 3) modulo the periods."""
    low = points.min(axis=0) - 0.5 * SAME_POINT_TOL_PERIODS * period
    distance, number = periodic_tree(points - low, period).query(wrap_into_period(images - low, period))
    if distance.max() > SAME_POINT_TOL_PERIODS * period.min():
        raise LevelSetError("the grid of a period does not have the symmetry of its field: choose another grid")
    return number, np.rint((images - points[number]) / period).astype(np.int64)


def _choose_representatives(
    image: IntArray, image_period: IntArray, isometries: Motion, period: Array
) -> tuple[IntArray, Motion]:
    """The representative (n,) of each item's orbit, the first item in it, and the motion (n,) that maps it to the item."""
    n = image.shape[1]
    origin = image.min(axis=0)
    item = np.arange(n)
    # the first isometry that maps the representative to the item
    operation = np.argmax(image[:, origin] == item, axis=0)
    motion = isometries[operation]
    return origin, Motion(motion.rotation, motion.translation - image_period[operation, origin] * period)


def _smooth(
    field: Field,
    quotient: _Quotient,
    isometries: Motion,
    image: IntArray,
    image_period: IntArray,
    origin: IntArray,
    motion: Motion,
) -> Array:
    """Vertices (V, 3) on the level set, smoothed, each orbit an exact copy of its representative."""
    period = quotient.period
    chosen = np.unique(origin)
    index = np.searchsorted(chosen, origin)
    rotation, translation = _average_stabilisers(chosen, isometries, image, image_period, period)
    polygon, corner = np.nonzero(np.isin(quotient.corners, chosen))
    ring = np.take_along_axis(quotient.corners[polygon], (corner[:, None] + np.arange(4)) % 4, axis=1)
    shift = np.take_along_axis(quotient.corner_period[polygon], (corner[:, None, None] + np.arange(4)[:, None]) % 4, 1)
    shift = (shift - shift[:, :1]) * period
    centre = np.searchsorted(chosen, ring[:, 0])
    leaf = _mean_side(quotient)
    points = quotient.start[chosen]
    free = np.zeros(points.shape, bool)

    def project(points: Array, steps: int) -> tuple[Array, Array]:
        points = project_to_level_set(field, points, free, np.full(len(points), MAX_STEP_FRACTION * leaf), steps)
        points = np.einsum("nij,nj->ni", rotation, points) + translation
        return points, normalize(field.gradient(points))

    points, normals = project(points, MAX_NEWTON_STEPS)
    for _ in range(SMOOTHING_SWEEPS):
        everywhere, normal = motion.apply(points[index]), motion.apply_to_vectors(normals[index])
        p = np.moveaxis(everywhere[ring] + shift, -1, 0)
        n = np.moveaxis(normal[ring], -1, 0)
        side = roll_next(p) - p
        size = length(side)
        weight = 1.0 / np.clip(sines_between_sides(side, size, n).min(axis=1), MIN_WEIGHTED_SINE, 1.0) ** WEIGHT_POWER
        proposal = (weight * fit_regular_polygons(p)[:, :, 0]).T
        target = np.zeros(points.shape)
        np.add.at(target, centre, proposal)
        target /= np.bincount(centre, weight, len(points))[:, None]
        shortest = np.full(len(points), np.inf)
        np.minimum.at(shortest, centre, np.minimum(size[:, 0], size[:, 3]))
        move = target - points
        move -= np.einsum("ni,ni->n", move, normals)[:, None] * normals
        reach = MAX_MOVE_FRACTION * np.minimum(shortest, leaf)
        move *= np.minimum(1.0, reach / np.maximum(np.linalg.norm(move, axis=1), MIN_DIVISOR))[:, None]
        points, normals = project(points + move, 1)
        if np.linalg.norm(move, axis=1).max() < REST_MOVE_FRACTION * leaf:
            break
    points, _ = project(points, MAX_NEWTON_STEPS)
    return motion.apply(points[index])


def _mean_side(quotient: _Quotient) -> float:
    """Mean length of the sides before smoothing."""
    points = quotient.start[quotient.corners] + quotient.corner_period * quotient.period
    return float(np.linalg.norm(points - np.roll(points, -1, axis=1), axis=2).mean())


def _average_stabilisers(
    chosen: IntArray, isometries: Motion, image: IntArray, image_period: IntArray, period: Array
) -> tuple[Array, Array]:
    """The affine projections (n, 3, 3), (n, 3) onto the points that the isometries which fix each chosen vertex keep."""
    fixed = image[:, chosen] == chosen
    shift = isometries.translation[:, None] - image_period[:, chosen] * period
    count = fixed.sum(axis=0)
    rotation = np.einsum("gn,gij->nij", fixed, isometries.rotation) / count[:, None, None]
    return rotation, np.einsum("gn,gni->ni", fixed, shift) / count[:, None]
