"""OCCT's own BREP format: the exact shape with its shared faces, edges and vertices, without names, colours or a unit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from OCP.BRep import BRep_Builder
from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy
from OCP.BRepTools import BRepTools
from OCP.TopAbs import TopAbs_FACE, TopAbs_SHELL
from OCP.TopoDS import TopoDS_Shape

from tpmscad.atomic_file import atomic_write
from tpmscad.errors import KernelError
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.convert import encode_file_name
from tpmscad.kernel.occt.exploration import count_subshape_uses, unwrap

VOLUME_RTOL = 1e-9
"""Relative difference allowed between the volumes of the shape and of what the file holds: numbers are written with 15 digits."""


def write_brep_file(shape: Any, path: Path, volume: float) -> None:
    """Write a shape without its triangulation, read the file back and check it.

    Raises KernelError unless the file holds valid closed solids of the total `volume`, whose faces are shared as in the shape.
    """
    topods = unwrap(shape)
    with atomic_write(path) as aside:
        plain = _without_triangles(topods)
        if not BRepTools.Write_s(plain, encode_file_name(aside)):
            raise KernelError("write BREP", f"OCCT cannot write {path}", topods)
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


def _without_triangles(shape: TopoDS_Shape) -> TopoDS_Shape:
    """Copy of the topology without triangulations, which a viewer may have left on the shape."""
    return BRepBuilderAPI_Copy(shape, False, False).Shape()
