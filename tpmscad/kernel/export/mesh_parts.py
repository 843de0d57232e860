"""Named and coloured meshes, as the writers of STL, 3MF and glTF take them, and the check of what a file holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tpmscad._typing import Array, Colour, IntArray
from tpmscad.brep.triangles.closed_mesh import SolidMesh
from tpmscad.errors import KernelError
from tpmscad.kernel.export.solid_mesh import count_open_sides


@dataclass(frozen=True, slots=True, eq=False)
class MeshPart:
    """A closed mesh with a name, and the group of each triangle (m,): an index of `groups`, pairs of label and colour."""

    name: str
    mesh: SolidMesh
    group: IntArray
    groups: tuple[tuple[str, Colour], ...]


def group_faces(name: str, mesh: SolidMesh, labels: Sequence[str], colour_of: Callable[[str], Colour]) -> MeshPart:
    """The mesh with its triangles in groups of equal labels; `labels` are those of the solid's faces."""
    distinct = list(dict.fromkeys(labels))
    of_face = np.array([distinct.index(label) for label in labels], np.int64)
    return MeshPart(name, mesh, of_face[mesh.face], tuple((label, colour_of(label)) for label in distinct))


def allowed_volume_error(part: MeshPart) -> float:
    """By how much the volume of a mesh may differ from that of its file.

    Coordinates of a file have at least 24 bits: each may be off by 2^-24 of the largest one, and the volume by that times the
    area.
    """
    return 2.0**-23 * float(np.abs(part.mesh.points).max()) * part.mesh.area


def check_read_meshes(found: Sequence[tuple[Array, IntArray]], written: Sequence[MeshPart], path: Path) -> None:
    """Raise KernelError unless meshes read from a file, as points and triangles, are closed and have the volumes written."""
    if len(found) != len(written):
        raise KernelError("export", f"{path.name} reads back with {len(found)} meshes instead of {len(written)}")
    for (points, triangles), part in zip(found, written, strict=True):
        read = SolidMesh(points, triangles, np.zeros(len(triangles), np.int64))
        if count_open_sides(triangles) or not abs(read.volume - part.mesh.volume) <= allowed_volume_error(part):
            raise KernelError(
                "export",
                f"{part.name} was written with volume {part.mesh.volume:.9g} and reads back from {path.name} with "
                f"{read.volume:.9g} and {count_open_sides(triangles)} open sides",
            )
