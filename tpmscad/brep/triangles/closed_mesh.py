"""Closed triangle meshes in arrays: moments, pieces, closedness, and the boolean operations of the library Manifold."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._compiled_loops import njit_cached
from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array, BoolArray, IntArray, UIntArray
from tpmscad.brep.linked_items import label_linked
from tpmscad.brep.sections.polygon_regions import Operation
from tpmscad.errors import TrimmingError

OPERATIONS: dict[Operation, str] = {"intersection": "Intersect", "union": "Add", "difference": "Subtract"}
"""Manifold's names for them."""


@dataclass(frozen=True, slots=True, eq=False)
class SolidMesh:
    """A closed mesh: points (n, 3), triangles (m, 3) with outward normals, and the face of the solid of each triangle (m,).

    Faces are numbers, of single faces or of groups of them.
    """

    points: Array
    triangles: IntArray
    face: IntArray

    @property
    def volume(self) -> float:
        """The volume enclosed."""
        return float(self._measures[0])

    @property
    def area(self) -> float:
        """Area of the triangles."""
        return float(self._measures[1])

    @property
    def center_of_mass(self) -> Array:
        """Centre of mass (3,) of the solid enclosed."""
        found = self._measures
        return np.asarray(self.points.mean(axis=0) + found[2:] / found[0])

    @property
    def component(self) -> IntArray:
        """The connected component of each triangle (m,), by shared points, as the number of one of them."""
        return np.asarray(_find_components(self.triangles, len(self.points)))

    def measure_components(self, component: IntArray) -> Array:
        """Signed volumes within components (m,), by their numbers, which not all occur: (n,)."""
        return np.asarray(_measure_components(self.points, self.triangles, component, self.points.mean(axis=0)))

    @property
    def _measures(self) -> Array:
        return np.asarray(_measure_triangles(self.points, self.triangles, self.points.mean(axis=0)))

    def select(self, kept: BoolArray) -> SolidMesh:
        """The mesh of some triangles, on the points that they use."""
        triangles, used = self.triangles[kept], np.zeros(len(self.points), bool)
        used[triangles.ravel()] = True
        number = narrow_indices(np.cumsum(used, dtype=np.int32)) - np.int32(1)
        return SolidMesh(self.points[used], number[triangles], self.face[kept])


def narrow_indices(values: Any) -> Any:
    """Indices in 32 bits, which halves the memory of large meshes."""
    return np.asarray(values).astype(np.int32, copy=False)


def join_meshes(meshes: Sequence[SolidMesh]) -> SolidMesh:
    """Meshes side by side; points are not identified, faces keep their numbers."""
    starts = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    return SolidMesh(
        np.concatenate([mesh.points for mesh in meshes]),
        np.concatenate(
            [m.triangles + first for m, first in zip(meshes, starts[:-1].tolist(), strict=True)], dtype=np.int32
        ),
        np.concatenate([mesh.face for mesh in meshes]),
    )


def point_normals(points: Array, triangles: IntArray) -> Array:
    """Unit normals (n, 3) at points, averaged by area over the triangles (m, 3); along z where there are none, or they cancel."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    total = [np.bincount(triangles.T.ravel(), np.tile(across[:, axis], 3), len(points)) for axis in range(3)]
    normals = np.stack(total, axis=1)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.tile([0.0, 0.0, 1.0], (len(points), 1)), where=length > 0)


def weld_points(points: Array, tol: float) -> tuple[Array, IntArray]:
    """Points without those within `tol` of another, and the index of each old point (n,) among them."""
    label = label_linked(len(points), cKDTree(points).query_pairs(tol, output_type="ndarray"))
    _, first = np.unique(label, return_index=True)
    return points[first], label


@njit_cached
def mix_bits(word: np.uint64) -> np.uint64:
    """A 64-bit word scrambled, one to one, so that sums of them tell sets apart (the finaliser of MurmurHash3, A. Appleby)."""
    word = (word ^ (word >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
    word = (word ^ (word >> np.uint64(33))) * np.uint64(0xC4CEB9FE1A85EC53)
    return word ^ (word >> np.uint64(33))


@njit_cached
def _label_words(words: UIntArray) -> UIntArray:
    labels = np.empty(len(words), np.uint64)
    for i in range(len(words)):
        label = np.uint64(0)
        for k in range(3):
            label += mix_bits(np.uint64(words[i, k]) + np.uint64(k)) * np.uint64(2 * k + 1)
        labels[i] = label
    return labels


def label_points(points: Array) -> UIntArray:
    """A 64-bit label of each point (n, 3), equal for equal coordinates in single or double precision."""
    bits = np.ascontiguousarray(points + points.dtype.type(0))  # -0 becomes 0
    return np.asarray(_label_words(bits.view(np.uint64 if bits.itemsize == 8 else np.uint32)))


@njit_cached
def sum_open_sides(triangles: IntArray, labels: UIntArray) -> Any:
    """0 if triangles (m, 3) of points with these labels (n,), 64 bits, run through every side as often in either direction.

    The sum of a scrambled number for each directed side, less that of the sides reversed, modulo 2^64; sums of parts of a mesh
    may be added. An open mesh gives 0 once in 2^64 times. Triangles that repeat a corner do not count.
    """
    total = np.uint64(0)
    for t in range(len(triangles)):
        for k in range(3):
            a, b = labels[triangles[t, k]], labels[triangles[t, (k + 1) % 3]]
            total += mix_bits(a + np.uint64(3) * b) - mix_bits(b + np.uint64(3) * a)
    return total


def is_closed(triangles: IntArray) -> bool:
    """Whether triangles (m, 3) run through every side as often in either direction."""
    labels = _label_words(np.arange(3 * (int(triangles.max(initial=-1)) + 1), dtype=np.uint64).reshape(-1, 3))
    return int(sum_open_sides(triangles, labels)) == 0


@njit_cached
def _measure_triangles(points: Array, triangles: IntArray, about: Array) -> Array:
    """Volume, area and first moments (5,) of what triangles enclose, the moments about a point, which keeps the digits."""
    volume, area, mx, my, mz = 0.0, 0.0, 0.0, 0.0, 0.0
    for t in range(len(triangles)):
        (ax, ay, az), (ux, uy, uz), (vx, vy, vz), (x, y, z) = span_triangle(points, triangles[t], about)
        cone = (ax * x + ay * y + az * z) / 6.0
        volume += cone
        area += 0.5 * np.sqrt(x * x + y * y + z * z)
        mx += cone * (3.0 * ax + ux + vx)
        my += cone * (3.0 * ay + uy + vy)
        mz += cone * (3.0 * az + uz + vz)
    return np.array([volume, area, mx / 4.0, my / 4.0, mz / 4.0])


@njit_cached
def _measure_components(points: Array, triangles: IntArray, component: IntArray, about: Array) -> Array:
    found = np.zeros(len(points))
    for t in range(len(triangles)):
        (ax, ay, az), _, _, (x, y, z) = span_triangle(points, triangles[t], about)
        found[component[t]] += (ax * x + ay * y + az * z) / 6.0
    return found


@njit_cached
def span_triangle(points: Array, corners: IntArray, about: Array) -> Any:
    """The first corner about a point, the sides from it to the two others, and their vector product, as numbers."""
    i, j, k = corners[0], corners[1], corners[2]
    x, y, z = points[i, 0], points[i, 1], points[i, 2]
    ux, uy, uz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
    vx, vy, vz = points[k, 0] - x, points[k, 1] - y, points[k, 2] - z
    across = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return (x - about[0], y - about[1], z - about[2]), (ux, uy, uz), (vx, vy, vz), across


@njit_cached
def _find_components(triangles: IntArray, n: int) -> Any:
    """The least point of the component of each triangle, by union and find with halved paths."""
    parent = np.arange(n).astype(np.int32)
    for t in range(len(triangles)):
        for k in range(1, 3):
            a, b = triangles[t, 0], triangles[t, k]
            while parent[a] != a:
                parent[a] = parent[parent[a]]
                a = parent[a]
            while parent[b] != b:
                parent[b] = parent[parent[b]]
                b = parent[b]
            if a < b:
                parent[b] = a
            elif b < a:
                parent[a] = b
    found = np.empty(len(triangles), np.int32)
    for t in range(len(triangles)):
        a = triangles[t, 0]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        found[t] = a
    return found


def load_manifold() -> Any:
    """The module manifold3d; InvalidRequest says how to install it."""
    return import_extra("manifold3d", "triangles without a solid", "triangles")


def combine_meshes(operation: Operation, meshes: Iterable[SolidMesh]) -> SolidMesh:
    """The intersection or union of closed meshes, or the first without the others.

    Its triangles have the faces of those that they are pieces of. Points that stay keep their coordinates, bit for bit.
    TrimmingError if an operand is not closed.
    """
    manifold = load_manifold()
    faces = {}

    def load(mesh: SolidMesh) -> Any:
        original = manifold.Manifold.reserve_ids(1)
        points, triangles = np.ascontiguousarray(mesh.points), np.ascontiguousarray(mesh.triangles, np.uint64)
        run = {
            "run_index": np.array([0, triangles.size], np.uint64),
            "run_original_id": np.array([original], np.uint32),
        }
        if (mesh.face != mesh.face[:1]).any():  # of one face, those in one plane are merged
            run["face_id"] = np.arange(len(triangles), dtype=np.uint64)
        found = manifold.Manifold(manifold.Mesh64(points, triangles, **run))
        if found.status() != manifold.Error.NoError:
            raise TrimmingError(f"a mesh is not closed: {found.status().name}")
        faces[original] = mesh.face if "face_id" in run else np.broadcast_to(mesh.face[:1], len(triangles))
        return found

    solids = [load(mesh) for mesh in meshes]
    result = manifold.Manifold.batch_boolean(solids, getattr(manifold.OpType, OPERATIONS[operation])).to_mesh64()
    origin, face = np.asarray(result.face_id, np.int64), narrow_indices(np.zeros(len(result.tri_verts)))
    limits = np.asarray(result.run_index, np.int64) // 3
    for original, start, stop in zip(result.run_original_id, limits[:-1].tolist(), limits[1:].tolist(), strict=True):
        face[start:stop] = faces[int(original)][origin[start:stop]]
    return SolidMesh(np.array(result.vert_properties), narrow_indices(result.tri_verts), face)
