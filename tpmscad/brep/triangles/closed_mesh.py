"""Closed triangle meshes in arrays: moments, pieces, closedness, and the boolean operations of the library Manifold."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array, BoolArray, IntArray, UIntArray
from tpmscad.brep.linked_items import label_linked
from tpmscad.brep.sections.polygon_regions import Operation
from tpmscad.errors import TrimmingError

BATCH = 1_000_000
"""Triangles that are worked on at a time, which limits the memory."""


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
        return float(self.cone_volumes.sum())

    @property
    def cone_volumes(self) -> Array:
        """Signed volumes (m,) of the cones over the triangles, whose apex is the mean of the points, which keeps the digits."""
        found = [np.einsum("md,md->m", a, np.cross(b, c)) / 6.0 for a, b, c in self._arms()]
        return np.concatenate([np.zeros(0), *found])

    @property
    def area(self) -> float:
        """Area of the triangles."""
        return sum(float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) for a, b, c in self._arms())

    @property
    def center_of_mass(self) -> Array:
        """Centre of mass (3,) of the solid enclosed."""
        total, moment = 0.0, np.zeros(3)
        for a, b, c in self._arms():
            volumes = np.einsum("md,md->m", a, np.cross(b, c)) / 6.0
            total, moment = total + float(volumes.sum()), moment + volumes @ (a + b + c) / 4.0
        return np.asarray(self.points.mean(axis=0) + moment / total)

    @property
    def component(self) -> IntArray:
        """The connected component of each triangle (m,), by shared points."""
        a, b, c = self.triangles.T.astype(np.int32)
        links = np.concatenate([a, b]), np.concatenate([b, c])
        graph = coo_array((np.ones(len(links[0]), np.int8), links), shape=(len(self.points),) * 2)
        return np.asarray(connected_components(graph, directed=False)[1][a])

    def select(self, kept: BoolArray) -> SolidMesh:
        """The mesh of some triangles, on the points that they use."""
        used, triangles = np.unique(self.triangles[kept], return_inverse=True)
        return SolidMesh(self.points[used], triangles.reshape(-1, 3).astype(self.triangles.dtype), self.face[kept])

    def _arms(self) -> Iterator[tuple[Array, Array, Array]]:
        """The corners of the triangles about the mean of the points, in batches: (BATCH, 3) each."""
        about = self.points - self.points.mean(axis=0)
        for start in range(0, len(self.triangles), BATCH):
            a, b, c = self.triangles[start : start + BATCH].T
            yield about[a], about[b], about[c]


def narrow_indices(values: Any) -> Any:
    """Indices in 32 bits, which halves the memory of large meshes."""
    return np.asarray(values).astype(np.int32)


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


def weld_points(points: Array, tol: float) -> tuple[Array, IntArray]:
    """Points without those within `tol` of another, and the index of each old point (n,) among them."""
    label = label_linked(len(points), cKDTree(points).query_pairs(tol, output_type="ndarray"))
    _, first = np.unique(label, return_index=True)
    return points[first], label


def mix_bits(words: UIntArray) -> UIntArray:
    """64-bit words scrambled, one to one, so that their sums tell sets apart (the finaliser of MurmurHash3, A. Appleby)."""
    with np.errstate(over="ignore"):
        words = (words ^ (words >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
        words = (words ^ (words >> np.uint64(33))) * np.uint64(0xC4CEB9FE1A85EC53)
        return np.asarray(words ^ (words >> np.uint64(33)))


def label_points(points: Array) -> UIntArray:
    """A 64-bit label of each point (n, 3), equal for equal coordinates in single or double precision."""
    bits = np.ascontiguousarray(points + points.dtype.type(0))  # -0 becomes 0
    words = bits.view(np.uint64 if bits.itemsize == 8 else np.uint32).astype(np.uint64)
    with np.errstate(over="ignore"):
        x, y, z = (mix_bits(words[..., k] + np.uint64(k)) for k in range(3))
        return np.asarray(x + np.uint64(3) * y + np.uint64(5) * z)


def sum_open_sides(labels: UIntArray) -> int:
    """0 if triangles whose corners have these labels (m, 3), 64 bits, run through every side as often in either direction.

    The sum of a scrambled number for each directed side, less that of the sides reversed, modulo 2^64; sums of parts of a mesh
    may be added. An open mesh gives 0 once in 2^64 times. Triangles that repeat a corner do not count.
    """
    with np.errstate(over="ignore"):
        mixed = mix_bits(labels)
        turned = np.roll(mixed, -1, axis=1)
        along = mix_bits(mixed + np.uint64(3) * turned)
        against = mix_bits(turned + np.uint64(3) * mixed)
        return int((along - against).sum(dtype=np.uint64))


def is_closed(triangles: IntArray) -> bool:
    """Whether triangles (m, 3) run through every side as often in either direction."""
    parts = (triangles[start : start + BATCH].astype(np.uint64) for start in range(0, len(triangles), BATCH))
    return sum(map(sum_open_sides, parts)) % 2**64 == 0


def load_manifold() -> Any:
    """The module manifold3d; InvalidRequest says how to install it."""
    return import_extra("manifold3d", "triangles without a solid", "triangles")


def combine_meshes(first: SolidMesh, second: SolidMesh, operation: Operation) -> SolidMesh:
    """The intersection, union or difference of two closed meshes, with the faces of the triangles that their pieces come from.

    Points that stay keep their coordinates, bit for bit. TrimmingError if an operand is not closed.
    """
    manifold = load_manifold()
    solids, faces = [], {}
    number = manifold.Manifold.reserve_ids(2)
    for original, mesh in enumerate((first, second), number):
        points, triangles = np.ascontiguousarray(mesh.points), np.ascontiguousarray(mesh.triangles, np.uint64)
        run = {
            "run_index": np.array([0, triangles.size], np.uint64),
            "run_original_id": np.array([original], np.uint32),
        }
        found = manifold.Manifold(manifold.Mesh64(points, triangles, **run))
        if found.status() != manifold.Error.NoError:
            raise TrimmingError(f"a mesh is not closed: {found.status().name}")
        solids.append(found)
        faces[original] = mesh.face
    one, other = solids
    combine = {"intersection": one.__xor__, "union": one.__add__, "difference": one.__sub__}[operation]
    result = combine(other).to_mesh64()
    origin, face = np.asarray(result.face_id, np.int64), narrow_indices(np.zeros(len(result.tri_verts)))
    limits = np.asarray(result.run_index, np.int64) // 3
    for original, start, stop in zip(result.run_original_id, limits[:-1].tolist(), limits[1:].tolist(), strict=True):
        face[start:stop] = faces[int(original)][origin[start:stop]]
    return SolidMesh(np.array(result.vert_properties), narrow_indices(result.tri_verts), face)
