"""Files of CAD shapes by what they hold, whatever their names say: STEP, IGES, and OCCT's own BREP.

A STEP file begins with its magic words, a BREP file with those of OCCT. IGES has none: each of its lines has 80 columns, of which
the last eight are the letter of a section and the number of the line, "S      1" in the first.
"""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path

from OCP.BRep import BRep_Builder
from OCP.BRepTools import BRepTools
from OCP.IFSelect import IFSelect_RetDone
from OCP.IGESControl import IGESControl_Reader
from OCP.TopoDS import TopoDS_Shape

from tpmscad.errors import InvalidRequest
from tpmscad.kernel.occt.convert import encode_file_name
from tpmscad.kernel.occt.exploration import solids_of
from tpmscad.kernel.step.step_reader import (
    PART21_MAGIC,
    StepContent,
    missing_solid,
    read_step,
    require_file,
    silence_occt,
    unreadable_file,
)

STEP, IGES, BREP = "STEP", "IGES", "BREP"

SUFFIXES = {".brep": BREP, ".iges": IGES, ".igs": IGES}
"""The format that a name promises, for messages; other names promise STEP."""

BREP_MAGIC, LAST_BREP_SECTION = b"CASCADE Topology", b"\nTShapes "

IGES_COLUMNS = 80


def recognise_format(path: str | os.PathLike[str]) -> str:
    """STEP, IGES or BREP; InvalidRequest if there is no such file, or it is none of them."""
    path = Path(path)
    if not path.is_file():
        raise InvalidRequest(f"there is no file {path}")
    with path.open("rb") as file:
        start = file.read(1024)
    if PART21_MAGIC in start:
        return STEP
    if BREP_MAGIC in start:
        return BREP
    line = start.splitlines()[0] if start.strip() else b""
    if len(line) >= IGES_COLUMNS and line[72:73] == b"S" and line[73:IGES_COLUMNS].strip().isdigit():
        return IGES
    promised = SUFFIXES.get(path.suffix.lower(), STEP)
    if promised == IGES:
        raise InvalidRequest(f"{path} is not an IGES file: columns 73 to 80 of its first line do not number it as S 1")
    require_file(path, promised, BREP_MAGIC if promised == BREP else PART21_MAGIC)
    raise AssertionError("the mark of its kind was sought above")


def read_cad_file(
    path: str | os.PathLike[str],
    *,
    with_face_names: bool = False,
    with_clear_seams: bool = False,
    turned_arcs: Collection[int] = (),
    require_solid: bool = True,
) -> StepContent:
    """The content of a file in mm; keywords as in `read_step`, which apply to STEP only.

    A BREP file has neither units nor names, and an IGES file no names that are read. Raises InvalidRequest if the file cannot be
    parsed, or if it holds no solid and `require_solid`.
    """
    kind, path = recognise_format(path), Path(path)
    try:
        if kind == STEP:
            return read_step(
                path,
                with_face_names=with_face_names,
                with_clear_seams=with_clear_seams,
                turned_arcs=turned_arcs,
                require_solid=require_solid,
            )
        content = _read_iges(path) if kind == IGES else _read_brep(path)
    except InvalidRequest:
        raise
    except Exception as error:  # OCCT's exceptions have no common base class
        raise unreadable_file(path) from error
    if require_solid and not content.solids:
        raise missing_solid(path)
    return content


def _read_brep(path: Path) -> StepContent:
    """The shape of a BREP file."""
    shape = TopoDS_Shape()
    if not _is_whole_brep(path.read_bytes()) or not BRepTools.Read_s(shape, encode_file_name(path), BRep_Builder()):
        raise unreadable_file(path)
    if shape.IsNull():
        raise missing_solid(path)
    return StepContent(shape, tuple(solids_of(shape)), (), ())


def _is_whole_brep(content: bytes) -> bool:
    """Whether a BREP file has all of its last section; OCCT may read without end in one that breaks off.

    The section states the number of its shapes. Each ends in an asterisk, and the root is named after the last.
    """
    shapes = content.partition(LAST_BREP_SECTION)[2]
    number = shapes.split(maxsplit=1)[:1]
    ends, _, root = shapes.rpartition(b"*")
    return bool(number and number[0].isdigit() and ends.count(b"*") + 1 >= int(number[0]) and root.strip())


def _read_iges(path: Path) -> StepContent:
    """The shape of an IGES file; its faces share no edges unless it holds solids."""
    reader = IGESControl_Reader()
    with silence_occt():
        if reader.ReadFile(encode_file_name(path)) != IFSelect_RetDone:
            raise unreadable_file(path)
        if reader.TransferRoots() == 0:
            raise missing_solid(path)
    shape, header = reader.OneShape(), reader.IGESModel().GlobalSection()
    if shape.IsNull():
        raise missing_solid(path)
    unit = header.UnitName()
    units = (unit.ToCString(),) if unit is not None else ()
    accuracy = header.Resolution() * header.UnitValue()
    return StepContent(shape, tuple(solids_of(shape)), units, (), (), accuracy or None)
