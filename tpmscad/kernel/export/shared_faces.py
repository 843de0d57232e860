"""Solids handed to a mesher: their shape as a BREP file, and which of their faces are shared."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepTools import BRepTools
from OCP.TopAbs import TopAbs_VERTEX

from tpmscad._typing import Array, IntArray
from tpmscad.errors import KernelError
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import ShapeKey, faces_of, list_subshapes


def write_plain_brep(solids: Sequence[Any], path: Path) -> None:
    """Write solids as one compound in OCCT's own format, with the faces that they share; the file is for another program.

    Raises KernelError if OCCT cannot write it.
    """
    if not BRepTools.Write_s(make_compound(solids), convert.encode_file_name(path)):
        raise KernelError("write BREP", f"OCCT cannot write {path}")


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
                places.append(_mean_of_vertices(face))
            own.append(number[key])
        numbers.append(np.array(own, np.int64))
    return numbers, np.array(places).reshape(-1, 3)


def _mean_of_vertices(face: Any) -> Array:
    """Mean (3,) of the distinct vertices of a face."""
    vertices = {ShapeKey(vertex) for vertex in list_subshapes(face, TopAbs_VERTEX)}
    points = [BRep_Tool.Pnt_s(convert.as_vertex(key.shape)).Coord() for key in vertices]
    return np.asarray(np.mean(points, axis=0))
