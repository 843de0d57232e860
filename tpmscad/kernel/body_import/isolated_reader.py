"""Files of CAD shapes that this process has not written, read and checked in a child process.

Some damaged files make OCCT's reader or its checks access invalid memory or run without end. The child hands over the shape as
binary BREP with the report of its check; if it crashes or exceeds its time limit, an error names the file.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from OCP.TopoDS import TopoDS_Shape

from tpmscad._typing import Colour
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.body_import.cad_formats import STEP, read_cad_file, recognise_format
from tpmscad.kernel.body_import.solid_choice import (
    ALL,
    ChosenSolids,
    choose_solids,
    list_reported_solids,
    list_solid_names,
    read_all_solids,
    read_chosen_solids,
)
from tpmscad.kernel.measure.face_table import tabulate_solid_faces
from tpmscad.kernel.measure.shape_report import StepReport, check_shape, check_solids, note_missing_unit
from tpmscad.kernel.occt.child_process import ChildFailure, call_in_child
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.convert import shape_from_bytes, shape_to_bytes
from tpmscad.kernel.occt.exploration import faces_of, solids_of
from tpmscad.kernel.step.coloured_reader import ColouredSolid, read_coloured_solids

T = TypeVar("T")

BASE_SECONDS, SECONDS_PER_MEGABYTE = 60.0, 15.0
"""Time limit of a child. OCCT reads, heals and checks 1 MB of a lattice in about 1 s."""


@dataclass(frozen=True, slots=True, eq=False)
class ForeignShape:
    """The shape of a file in mm, what a user should know of the file, and the names of the faces of each solid."""

    shape: TopoDS_Shape
    notes: tuple[str, ...]
    face_names: tuple[tuple[str, ...], ...]


def check_foreign_step(path: str | os.PathLike[str], *, faces: bool = False, solid: int | None = None) -> StepReport:
    """Report on a CAD file or on one of its solids, with its faces if asked for, and on what healing it would do.

    Errors as `read_foreign_step`, but for a file without solids whose faces can be made solids.
    """
    report = _call_for_file(partial(_check, faces=faces, solid=solid), path)
    if report.ok:
        return report
    try:
        healed = read_foreign_solids(path, ALL if solid is None else solid, heal=True).healed
    except InvalidRequest as error:
        if not report.shape.solids:
            raise
        healed = (f"it cannot be healed: {error}",)
    return replace(report, healing=healed)


def read_foreign_step(path: str | os.PathLike[str]) -> ForeignShape:
    """The shape of a STEP, IGES or BREP file as it is.

    Raises InvalidRequest if the file does not exist or is none of them, if OCCT cannot read it or finds no solid, or if OCCT
    crashes or does not end.
    """
    content, notes, names = _call_for_file(_read_and_check, path)
    return ForeignShape(shape_from_bytes(content), notes, names)


def read_foreign_solids(path: str | os.PathLike[str], solid: int | str | None, *, heal: bool) -> ChosenSolids:
    """Sound solids of a file, see `read_chosen_solids`; errors also as `read_foreign_step`."""
    content, chosen = _call_for_file(partial(_choose, solid=solid, heal=heal), path)
    return replace(chosen, solids=tuple(solids_of(shape_from_bytes(content))))


def read_foreign_coloured_solids(path: str | os.PathLike[str]) -> tuple[ColouredSolid, ...]:
    """The solids of a file with names and colours of solids and faces, if it is STEP; errors as `read_foreign_step`."""
    content, titles = _call_for_file(_read_coloured, path)
    solids = solids_of(shape_from_bytes(content))
    return tuple(
        ColouredSolid(name, solid, colours, names) for solid, (name, colours, names) in zip(solids, titles, strict=True)
    )


def _call_for_file(function: Callable[[str], T], path: str | os.PathLike[str]) -> T:
    """`function` of the path of a CAD file, called in a child process."""
    recognise_format(path)
    seconds = BASE_SECONDS + SECONDS_PER_MEGABYTE * Path(path).stat().st_size / 1e6
    try:
        return call_in_child(function, os.fspath(path), seconds=seconds)
    except ChildFailure as failure:
        raise InvalidRequest(
            f"{path} is damaged: the kernel {failure.reason} while it read and checked the file; export it again from the "
            "program that made it"
        ) from None


def _check(path: str, faces: bool, solid: int | None) -> StepReport:
    content = read_all_solids(path, with_face_names=faces)
    report, reports = check_solids(content.solids)
    entries = list_reported_solids(content.solids, reports, list_solid_names(path, content))
    shown = slice(None)
    if solid is not None:
        (number,) = choose_solids(entries, solid, path)
        report, shown = reports[number - 1], slice(number - 1, number)
    return StepReport(
        Path(path).name,
        report,
        content.units,
        content.products,
        tabulate_solid_faces(content.solids[shown], content.face_names[shown]) if faces else (),
        entries[shown],
        content.accuracy,
    )


def _choose(path: str, solid: int | str | None, heal: bool) -> tuple[bytes, ChosenSolids]:
    """The compound of the chosen solids as bytes, and what is told of them."""
    chosen = read_chosen_solids(path, solid, heal)
    return shape_to_bytes(make_compound(chosen.solids)), replace(chosen, solids=())


def _read_and_check(path: str) -> tuple[bytes, tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """The shape as bytes, after a check that may crash as the reader may, notes on the file, and the names of faces."""
    content = read_cad_file(path, with_face_names=True, with_clear_seams=True)
    check_shape(content.shape)
    return shape_to_bytes(content.shape), note_missing_unit(Path(path).name, content.units), content.face_names


def _read_coloured(path: str) -> tuple[bytes, list[tuple[str, tuple[Colour | None, ...], tuple[str, ...]]]]:
    """The compound of all solids as bytes, and the name of each with the colours and the names of its faces."""
    if recognise_format(path) != STEP:
        content = read_cad_file(path).shape
        counts = [len(faces_of(solid)) for solid in solids_of(content)]
        return shape_to_bytes(content), [("", (None,) * n, ("",) * n) for n in counts]
    solids = read_coloured_solids(path)
    titles = [(read.name, read.face_colours, read.face_names) for read in solids]
    return shape_to_bytes(make_compound(read.solid for read in solids)), titles
