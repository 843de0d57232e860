"""Binary STL: triangles in single precision, without unit, names or colours.

Points that single precision cannot tell apart are one point of the file. Triangles that this collapses are left out in pairs,
so that the mesh stays closed.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.atomic_file import atomic_write
from tpmscad.kernel.export.mesh_parts import MeshPart, check_read_meshes

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""One triangle of a binary STL file."""

HEADER_BYTES = 80


def write_stl(parts: Sequence[MeshPart], path: Path, title: str) -> None:
    """Write the meshes, one after another, in model units; the file is read back and checked before it gets its name."""
    corners = np.concatenate([part.mesh.points[part.mesh.triangles] for part in parts])
    single = corners.astype("<f4")
    distinct = [(single[:, i] != single[:, i - 1]).any(axis=1) for i in range(3)]
    kept = np.logical_and.reduce(distinct)
    records = np.zeros(int(kept.sum()), RECORD)
    records["corners"] = single[kept]
    a, b, c = (corners[kept][:, k] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    records["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    header = f"tpmscad {title}, unit mm".encode("ascii", "replace")[:HEADER_BYTES].ljust(HEADER_BYTES)
    with atomic_write(path) as aside:
        aside.write_bytes(header + np.uint32(len(records)).tobytes() + records.tobytes())
        starts = np.cumsum([0, *(len(part.mesh.triangles) for part in parts[:-1])])
        counts = [int(n) for n in np.add.reduceat(kept, starts)]
        check_read_meshes(read_stl(aside, counts), parts, path)


def read_stl(path: Path, counts: Sequence[int]) -> list[tuple[Array, IntArray]]:
    """Points and triangles of consecutive meshes of `counts` triangles; equal points are one."""
    content = path.read_bytes()
    records = np.frombuffer(content, RECORD, offset=HEADER_BYTES + 4)
    found = []
    for of in np.split(records["corners"], np.cumsum(counts)[:-1]):
        points, index = np.unique(of.reshape(-1, 3), axis=0, return_inverse=True)
        found.append((points.astype(float), index.reshape(-1, 3).astype(np.int64)))
    return found
