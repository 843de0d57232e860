"""Binary STL: triangles in single precision, without unit, names or colours.

Points that single precision cannot tell apart are one point of the file. Triangles that this collapses are left out in pairs,
so that the mesh stays closed. Files are written in batches, and read again as bytes: their checksum is that of the triangles,
which are closed, as points of equal coordinates, and have their volume.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.atomic_file import atomic_write
from tpmscad.brep.triangles.closed_mesh import SolidMesh, label_points, span_triangle, sum_open_sides
from tpmscad.errors import KernelError
from tpmscad.kernel.export.mesh_parts import MeshPart, allowed_volume_error

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""One triangle of a binary STL file."""

HEADER_BYTES = 80

BATCH = 500_000
"""Triangles that are written at a time."""

BYTES_PER_READ = 2**24


def write_stl(parts: Sequence[MeshPart], path: Path, title: str) -> None:
    """Write the meshes, one after another, in model units; the file is read back and checked before it gets its name."""
    header = f"tpmscad {title}, unit mm".encode("ascii", "replace")[:HEADER_BYTES].ljust(HEADER_BYTES)
    single = [part.mesh.points.astype("<f4") for part in parts]
    labels = [label_points(points) for points in single]
    count, checksum = 0, 0
    with atomic_write(path) as aside:
        with aside.open("wb") as file:
            file.write(header + bytes(4))
            for part, points, own in zip(parts, single, labels, strict=True):
                _check_part(part, points, own, path)
                for start in range(0, len(part.mesh.triangles), BATCH):
                    records = _make_records(part.mesh, points, own, start)
                    file.write(records.data)
                    checksum = crc32(records.data, checksum)
                    count += len(records)
            head = header + np.uint32(count).tobytes()
            file.seek(0)
            file.write(head)
        _check_file(aside, head, count, checksum, path)


def _make_records(
    mesh: SolidMesh, single: NDArray[np.float32], labels: NDArray[np.uint64], start: int
) -> NDArray[np.void]:
    """A batch of triangles as the file has them, without those that single precision collapses."""
    triangles = mesh.triangles[start : start + BATCH]
    numbers = np.zeros((len(triangles), 12), "<f4")
    written = _fill_records(mesh.points, single, labels, triangles, numbers)
    records = np.zeros(written, RECORD)
    records["normal"], records["corners"] = numbers[:written, :3], numbers[:written, 3:].reshape(-1, 3, 3)
    return records


@njit_cached
def _fill_records(
    points: Array,
    single: NDArray[np.float32],
    labels: NDArray[np.uint64],
    triangles: IntArray,
    numbers: NDArray[np.float32],
) -> int:
    """Normals and corners of triangles that stay, (m, 12), and their number."""
    written = 0
    for t in range(len(triangles)):
        i, j, k = triangles[t]
        if labels[i] == labels[j] or labels[j] == labels[k] or labels[k] == labels[i]:
            continue
        _, _, _, (x, y, z) = span_triangle(points, triangles[t], points[i])
        length = np.sqrt(x * x + y * y + z * z)
        if length > 0.0:
            numbers[written, 0], numbers[written, 1], numbers[written, 2] = x / length, y / length, z / length
        else:
            numbers[written, :3] = 0.0
        for axis in range(3):
            numbers[written, 3 + axis] = single[i, axis]
            numbers[written, 6 + axis] = single[j, axis]
            numbers[written, 9 + axis] = single[k, axis]
        written += 1
    return written


def _check_part(part: MeshPart, single: NDArray[np.float32], labels: NDArray[np.uint64], path: Path) -> None:
    """KernelError unless triangles in single precision are closed, as points of equal coordinates, and have their volume."""
    mesh = part.mesh
    open_sides = int(sum_open_sides(mesh.triangles, labels))
    volume = SolidMesh(single.astype(float), mesh.triangles, mesh.face).volume
    if open_sides or not abs(volume - mesh.volume) <= allowed_volume_error(part):
        raise KernelError(
            "export",
            f"{part.name} has volume {mesh.volume:.9g} and in single precision, as in {path.name}, {volume:.9g}"
            + (", not closed" if open_sides else ""),
        )


def _check_file(file: Path, head: bytes, count: int, checksum: int, path: Path) -> None:
    """Raise KernelError unless a file has its head, the size of its triangles and the checksum of what was written."""
    size, expected, found = file.stat().st_size, len(head) + count * RECORD.itemsize, 0
    with file.open("rb") as read:
        is_headed = read.read(len(head)) == head
        while batch := read.read(BYTES_PER_READ):
            found = crc32(batch, found)
    if not is_headed or size != expected or found != checksum:
        raise KernelError("export", f"{path.name} reads back with {size} bytes instead of {expected}, or with others")
