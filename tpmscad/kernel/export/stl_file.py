"""Binary STL: triangles in single precision, without unit, names or colours.

Points that single precision cannot tell apart are one point of the file. Triangles that this collapses are left out in pairs,
so that the mesh stays closed. Files are written and checked in batches, so that their size is not limited by memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array
from tpmscad.atomic_file import atomic_write
from tpmscad.brep.triangles.closed_mesh import SolidMesh, label_points, sum_open_sides
from tpmscad.errors import KernelError
from tpmscad.kernel.export.mesh_parts import MeshPart, allowed_volume_error

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""One triangle of a binary STL file."""

HEADER_BYTES = 80

BATCH = 500_000
"""Triangles that are written or read at a time: some hundred megabytes."""


def write_stl(parts: Sequence[MeshPart], path: Path, title: str) -> None:
    """Write the meshes, one after another, in model units; the file is read back and checked before it gets its name."""
    header = f"tpmscad {title}, unit mm".encode("ascii", "replace")[:HEADER_BYTES].ljust(HEADER_BYTES)
    with atomic_write(path) as aside:
        counts = []
        with aside.open("wb") as file:
            file.write(header + np.uint32(0).tobytes())
            for part in parts:
                counts.append(0)
                for records in _records(part.mesh):
                    file.write(records.tobytes())
                    counts[-1] += len(records)
            file.seek(HEADER_BYTES)
            file.write(np.uint32(sum(counts)).tobytes())
        first = 0
        for part, count in zip(parts, counts, strict=True):
            _check_part(aside, first, count, part, path)
            first += count


def _records(mesh: SolidMesh) -> Iterator[NDArray[np.void]]:
    """The triangles of a mesh in batches, without those that single precision collapses."""
    for start in range(0, len(mesh.triangles), BATCH):
        corners = mesh.points[mesh.triangles[start : start + BATCH]]
        single = corners.astype("<f4")
        distinct = [(single[:, i] != single[:, i - 1]).any(axis=1) for i in range(3)]
        kept = np.logical_and.reduce(distinct)
        records = np.zeros(int(kept.sum()), RECORD)
        records["corners"] = single[kept]
        a, b, c = (corners[kept][:, k] for k in range(3))
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        records["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
        yield records


def read_corners(path: Path, first: int, count: int) -> Iterator[Array]:
    """Corners (m, 3, 3) of consecutive triangles of a file, in batches."""
    with path.open("rb") as file:
        file.seek(HEADER_BYTES + 4 + first * RECORD.itemsize)
        for start in range(0, count, BATCH):
            yield np.fromfile(file, RECORD, min(BATCH, count - start))["corners"]


def _check_part(file: Path, first: int, count: int, part: MeshPart, path: Path) -> None:
    """Raise KernelError unless triangles read from a file are closed, as points of equal coordinates, and have their volume."""
    about, open_sides, volume = part.mesh.points.mean(axis=0), 0, 0.0
    for corners in read_corners(file, first, count):
        open_sides += sum_open_sides(label_points(corners))
        a, b, c = np.moveaxis(corners.astype(float) - about, 1, 0)
        volume += float(np.einsum("md,md->", a, np.cross(b, c))) / 6.0
    if open_sides % 2**64 or not abs(volume - part.mesh.volume) <= allowed_volume_error(part):
        raise KernelError(
            "export",
            f"{part.name} was written with volume {part.mesh.volume:.9g} and reads back from {path.name} with {volume:.9g}"
            + (", not closed" if open_sides % 2**64 else ""),
        )
