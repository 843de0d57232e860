"""Files of CAD shapes that this process has not written, read and checked in a child process.

Some damaged files make OCCT's reader or its checks access invalid memory or run without end. The child hands over the shape as
binary BREP with the report of its check; if it crashes or exceeds its time limit, an error names the file.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from OCP.BRep import BRep_Builder
from OCP.BRepTools import BRepTools
from OCP.TopoDS import TopoDS_Shape

from tpmscad._typing import Colour
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.measure.face_table import tabulate_solid_faces
from tpmscad.kernel.measure.shape_report import StepReport, check_shape, note_missing_unit
from tpmscad.kernel.occt.child_process import ChildFailure, call_in_child
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.convert import encode_file_name, shape_from_bytes, shape_to_bytes
from tpmscad.kernel.occt.exploration import faces_of, solids_of
from tpmscad.kernel.step.coloured_reader import ColouredSolid, read_coloured_solids
from tpmscad.kernel.step.step_reader import (
    StepContent,
    missing_solid,
    read_step,
    require_file,
    require_step_file,
    unreadable_file,
)

T = TypeVar("T")

BREP_SUFFIX, BREP_MAGIC = ".brep", b"CASCADE Topology"

BASE_SECONDS, SECONDS_PER_MEGABYTE = 60.0, 15.0
"""Time limit of a child. OCCT reads, heals and checks 1 MB of a lattice in about 1 s."""


@dataclass(frozen=True, slots=True, eq=False)
class ForeignShape:
    """The shape of a file in mm, what a user should know of the file, and the names of the faces of each solid."""

    shape: TopoDS_Shape
    notes: tuple[str, ...]
    face_names: tuple[tuple[str, ...], ...]


def check_foreign_step(path: str | os.PathLike[str], *, faces: bool = False) -> StepReport:
    """Report on a STEP or BREP file, with its faces if asked for; errors as `read_foreign_step`."""
    return _call_for_file(partial(_check, faces=faces), path)


def read_foreign_step(path: str | os.PathLike[str]) -> ForeignShape:
    """The shape of a STEP file, or of one in OCCT's own BREP format, whose name ends in .brep.

    Raises InvalidRequest if the file does not exist or is no STEP file, if OCCT cannot read it or finds no solid, or if OCCT
    crashes or does not end.
    """
    content, notes, names = _call_for_file(_read_and_check, path)
    return ForeignShape(shape_from_bytes(content), notes, names)


def read_foreign_coloured_solids(path: str | os.PathLike[str]) -> tuple[ColouredSolid, ...]:
    """The solids of a STEP or BREP file with names and colours of solids and faces; errors as `read_foreign_step`."""
    content, titles = _call_for_file(_read_coloured, path)
    solids = solids_of(shape_from_bytes(content))
    return tuple(
        ColouredSolid(name, solid, colours, names) for solid, (name, colours, names) in zip(solids, titles, strict=True)
    )


def _call_for_file(function: Callable[[str], T], path: str | os.PathLike[str]) -> T:
    """`function` of the path of a STEP file, called in a child process."""
    found = require_file(Path(path), "BREP", BREP_MAGIC) if _is_brep(path) else require_step_file(Path(path))
    size = found.stat().st_size
    seconds = BASE_SECONDS + SECONDS_PER_MEGABYTE * size / 1e6
    try:
        return call_in_child(function, os.fspath(path), seconds=seconds)
    except ChildFailure as failure:
        raise InvalidRequest(
            f"{path} is damaged: the kernel {failure.reason} while it read and checked the file; export it again from the "
            "program that made it"
        ) from None


def _is_brep(path: str | os.PathLike[str]) -> bool:
    return Path(path).suffix.lower() == BREP_SUFFIX


def _read(path: str, *, with_face_names: bool = False, with_clear_seams: bool = False) -> StepContent:
    """The content of a STEP or BREP file; the latter has neither units nor names."""
    if not _is_brep(path):
        return read_step(path, with_face_names=with_face_names, with_clear_seams=with_clear_seams)
    shape = TopoDS_Shape()
    if not BRepTools.Read_s(shape, encode_file_name(path), BRep_Builder()):
        raise unreadable_file(Path(path))
    solids = tuple(solids_of(shape))
    if not solids:
        raise missing_solid(Path(path))
    return StepContent(shape, solids, (), ())


def _check(path: str, faces: bool) -> StepReport:
    content = _read(path, with_face_names=faces)
    table = tabulate_solid_faces(content.solids, content.face_names) if faces else ()
    return StepReport(Path(path).name, check_shape(content.shape), content.units, content.products, table)


def _read_and_check(path: str) -> tuple[bytes, tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """The shape as bytes, after a check that may crash as the reader may, notes on the file, and the names of faces."""
    content = _read(path, with_face_names=True, with_clear_seams=True)
    check_shape(content.shape)
    return shape_to_bytes(content.shape), note_missing_unit(Path(path).name, content.units), content.face_names


def _read_coloured(path: str) -> tuple[bytes, list[tuple[str, tuple[Colour | None, ...], tuple[str, ...]]]]:
    """The compound of all solids as bytes, and the name of each with the colours and the names of its faces."""
    if _is_brep(path):
        content = _read(path).shape
        counts = [len(faces_of(solid)) for solid in solids_of(content)]
        return shape_to_bytes(content), [("", (None,) * n, ("",) * n) for n in counts]
    solids = read_coloured_solids(path)
    titles = [(read.name, read.face_colours, read.face_names) for read in solids]
    return shape_to_bytes(make_compound(read.solid for read in solids)), titles
