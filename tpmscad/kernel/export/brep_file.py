"""OCCT's own BREP format: the exact shape with its shared faces, edges and vertices, without names, colours or a unit."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from OCP.BRep import BRep_Builder
from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy
from OCP.BRepTools import BRepTools
from OCP.TopAbs import TopAbs_FACE, TopAbs_SHELL
from OCP.TopoDS import TopoDS_Shape

from tpmscad._typing import Array, IntArray
from tpmscad.atomic_file import atomic_write
from tpmscad.errors import KernelError
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.convert import encode_file_name
from tpmscad.kernel.occt.exploration import ShapeKey, count_subshape_uses, faces_of, unwrap, vertices_of

VOLUME_RTOL = 1e-9
"""Relative difference allowed between the volumes of the shape and of what the file holds: numbers are written with 15 digits."""

HEADER = b"DBRep_DrawableShape\n"
"""First line of a BREP file, before the text of its shape."""


def write_brep_file(shape: Any, path: Path, volume: float) -> None:
    """Write a shape without its triangulation, read the file back and check it.

    Raises KernelError unless the file holds valid closed solids of the total `volume`, whose faces are shared as in the shape.
    """
    topods = unwrap(shape)
    with atomic_write(path) as aside:
        plain = BRepBuilderAPI_Copy(
            topods, False, False
        ).Shape()  # without triangles, which a viewer may have left on the shape
        _write_shape(plain, aside)
        found = read_brep_file(aside)
        report = check_shape(found)
        faces = count_distinct_faces(topods), count_distinct_faces(found)
        if not report.ok or abs(report.volume - volume) > VOLUME_RTOL * volume or faces[0] != faces[1]:
            raise KernelError(
                "write BREP",
                f"written with volume {volume:.12g} and {faces[0]} faces, {path.name} reads back as: {report}",
            )


def read_brep_file(path: Path) -> TopoDS_Shape:
    """The shape of a BREP file."""
    shape = TopoDS_Shape()
    if not BRepTools.Read_s(shape, encode_file_name(path), BRep_Builder()):
        raise KernelError("read BREP", f"OCCT cannot read {path}")
    return shape


def count_distinct_faces(shape: TopoDS_Shape) -> int:
    """Number of faces, each counted once however many solids share it."""
    return len(count_subshape_uses(shape, TopAbs_FACE, TopAbs_SHELL))


def write_plain_brep(solids: Sequence[Any], path: Path) -> None:
    """Write solids as one compound with the faces that they share; the file is for another program."""
    _write_shape(make_compound(solids), path)


def _write_shape(shape: TopoDS_Shape, path: Path) -> None:
    """Write a shape to a new file; OSError with the system's reason, which OCCT's own writing of files does not tell."""
    text = io.BytesIO()
    BRepTools.Write_s(shape, text)
    path.write_bytes(HEADER + text.getvalue())


def number_distinct_faces(solids: Sequence[Any]) -> tuple[list[IntArray], Array]:
    """For each solid the numbers of its faces in the order of `faces_of`, and the mean (n, 3) of each distinct face's vertices.

    Faces are numbered as they are met first, solid by solid.
    """
    number: dict[ShapeKey, int] = {}
    places, numbers = [], []
    for solid in solids:
        own = []
        for face in faces_of(solid):
            key = ShapeKey(face)
            if key not in number:
                number[key] = len(number)
                places.append(vertices_of(face).mean(axis=0))
            own.append(number[key])
        numbers.append(np.array(own, np.int64))
    return numbers, np.array(places).reshape(-1, 3)
