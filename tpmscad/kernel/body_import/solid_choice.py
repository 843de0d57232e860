"""The solids of a CAD file that a caller asks for, made of faces and healed where need be; what was done is told."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from OCP.TopoDS import TopoDS_Solid

from tpmscad.errors import InvalidRequest
from tpmscad.kernel.body_import.cad_formats import STEP, read_cad_file, recognise_format
from tpmscad.kernel.body_import.closed_shells import make_solids_of_faces
from tpmscad.kernel.body_import.healing import Healed, StepArcs, describe_faults, heal_solid
from tpmscad.kernel.measure.edge_gaps import measure_accuracy
from tpmscad.kernel.measure.shape_report import ShapeReport, check_solids, note_missing_unit
from tpmscad.kernel.measure.solid_list import SolidEntry, describe_solids, list_solids
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.step.coloured_reader import MADE_UP_NAME, read_solid_names
from tpmscad.kernel.step.step_reader import StepContent, missing_solid

ALL, LARGEST = "all", "largest"

TOLD_GAP = 1e-6
"""Millimetres: ten times the kernel's confusion. Edges that lie farther off their faces are told."""

MAX_NAMED_INSTANCES = 1000
"""Solids of an assembly above which names are not read: the file is read once more for them."""


@dataclass(frozen=True, slots=True, eq=False)
class ChosenSolids:
    """Solids of a file that were chosen, all sound.

    solids, reports, face_names: of those chosen; entries: of all solids of the file; numbers: of those chosen, from 1.
    healed: what was done, in words; accuracy: what the file states, mm; notes: what a user should know, with what was done.
    """

    solids: tuple[TopoDS_Solid, ...]
    reports: tuple[ShapeReport, ...]
    face_names: tuple[tuple[str, ...], ...]
    entries: tuple[SolidEntry, ...]
    numbers: tuple[int, ...]
    healed: tuple[str, ...]
    accuracy: float | None
    notes: tuple[str, ...]


def choose_solids(entries: Sequence[SolidEntry], solid: int | str | None, name: str) -> tuple[int, ...]:
    """Numbers of the solids asked for: "all", "largest", a number from 1, or None for the only one.

    InvalidRequest, with the list, if there are several and none is asked for, or if the number is not among them.
    """
    if solid == ALL:
        return tuple(entry.number for entry in entries)
    if solid == LARGEST:
        return (max(entries, key=lambda entry: abs(entry.volume)).number,)
    if solid is None:
        if len(entries) == 1:
            return (1,)
        raise InvalidRequest(
            f'{name} holds {len(entries)} solids: choose one by its number, solid=1 say, or by solid="largest"; '
            'infill also takes solid="all", and `tpmscad.read_body` takes any of these. They are '
            + describe_solids(entries)
        )
    if not isinstance(solid, int) or not 1 <= solid <= len(entries):
        count = "1 solid" if len(entries) == 1 else f"{len(entries)} solids"
        raise InvalidRequest(f"{name} has no solid {solid}, but {count}: {describe_solids(entries)}")
    return (solid,)


def read_chosen_solids(path: str | os.PathLike[str], solid: int | str | None, heal: bool) -> ChosenSolids:
    """Solids of a STEP, IGES or BREP file as `choose_solids` says, valid, closed and with positive volume.

    A file without solids is taken as faces, which are made solids. Raises InvalidRequest if the file cannot be read, if there is
    no solid, if one cannot be healed, or if there is something to heal and not `heal`.
    """
    content, made = _read_solids(path, heal)
    _, reports = check_solids(content.solids)
    entries = list_reported_solids(content.solids, reports, list_solid_names(path, content))
    numbers = choose_solids(entries, solid, str(path))
    chosen = [_make_sound(path, content, number, reports[number - 1], heal) for number in numbers]
    for number, sound in zip(numbers, chosen, strict=True):
        if sound.words:
            (entry,) = list_reported_solids([sound.solid], [sound.report], [entries[number - 1].name])
            entries = (*entries[: number - 1], replace(entry, number=number), *entries[number:])
    healed = (*made, *(sound.words for sound in chosen if sound.words))
    notes = note_missing_unit(Path(path).name, content.units)
    if len(entries) > len(numbers):
        notes += (f"taken of the {len(entries)} solids of the file: {entries[numbers[0] - 1].title}",)
    solids = tuple(sound.solid for sound in chosen)
    return ChosenSolids(
        solids,
        tuple(sound.report for sound in chosen),
        tuple(_names_of_faces(content, number, of) for number, of in zip(numbers, solids, strict=True)),
        entries,
        numbers,
        healed,
        content.accuracy,
        (*notes, *(f"healed: {words}" for words in healed), *_note_gap(solids, content.accuracy)),
    )


def read_all_solids(
    path: str | os.PathLike[str],
    *,
    with_face_names: bool = False,
    with_clear_seams: bool = False,
    turned_arcs: Collection[int] = (),
) -> StepContent:
    """The content of a file as `read_cad_file` reads it, without solids that have no faces; it may have no solid at all."""
    content = read_cad_file(
        path,
        with_face_names=with_face_names,
        with_clear_seams=with_clear_seams,
        turned_arcs=turned_arcs,
        require_solid=False,
    )
    kept = [i for i, solid in enumerate(content.solids) if faces_of(solid)]
    return replace(
        content,
        solids=tuple(content.solids[i] for i in kept),
        face_names=tuple(content.face_names[i] for i in kept) if content.face_names else (),
        solid_names=tuple(content.solid_names[i] for i in kept if i < len(content.solid_names)),
    )


def list_solid_names(path: str | os.PathLike[str], content: StepContent) -> tuple[str, ...]:
    """Names of the solids of a file, in its order; empty if they are unknown."""
    count = len(content.solids)
    if content.is_assembly:
        names = read_solid_names(path) if count <= MAX_NAMED_INSTANCES else ()
        return names if len(names) == count else ()
    own = content.solid_names + ("",) * (count - len(content.solid_names))
    parts = [(name, *(content.products if len(content.products) == 1 else ())) for name in own]
    telling = [[name for name in reversed(of) if name and not MADE_UP_NAME.fullmatch(name)] for of in parts]
    return tuple("/".join(dict.fromkeys(of)) for of in telling)


def list_reported_solids(
    solids: Sequence[TopoDS_Solid], reports: Sequence[ShapeReport], names: Sequence[str] = ()
) -> tuple[SolidEntry, ...]:
    """The list of solids with their reports."""
    return list_solids(solids, [(report.volume, report.bounds) for report in reports], names)


def _read_solids(path: str | os.PathLike[str], heal: bool) -> tuple[StepContent, tuple[str, ...]]:
    """The content of a file with at least one solid, and how its solids were made if it states none, in words."""
    content = read_all_solids(path, with_face_names=True, with_clear_seams=True)
    if content.solids:
        return content, ()
    made = make_solids_of_faces(content.shape, content.accuracy)
    if made.solids and heal:
        return replace(content, solids=made.solids), (made.words,)
    remedy = "heal=True makes solids of its faces, which close" if made.solids else made.words
    raise InvalidRequest(f"{missing_solid(Path(path))}; {remedy}")


def _make_sound(
    path: str | os.PathLike[str], content: StepContent, number: int, report: ShapeReport, heal: bool
) -> Healed:
    """A solid of the content of a file, valid, closed and with positive volume."""
    solid, alone = content.solids[number - 1], len(content.solids) == 1
    faults = describe_faults(solid, report)
    if not faults:
        return Healed(solid, report, "")

    def read_turned(arcs: Collection[int]) -> TopoDS_Solid | None:
        found = read_all_solids(path, with_clear_seams=True, turned_arcs=arcs).solids
        return found[number - 1] if len(found) == len(content.solids) else None

    is_step = recognise_format(path) == STEP
    healed = heal_solid(solid, report, StepArcs(path, read_turned) if is_step else None) if heal else None
    if healed is None:
        remedy = (
            "no way of healing makes it sound: repair it where it was modelled"
            if heal
            else "heal=True repairs it if it can be repaired"
        )
        raise InvalidRequest(f"{path if alone else f'solid {number} of {path}'} {faults}; {remedy}")
    return healed if alone else replace(healed, words=f"solid {number}: {healed.words}")


def _names_of_faces(content: StepContent, number: int, solid: TopoDS_Solid) -> tuple[str, ...]:
    """Names of the faces of a solid, "" if the file has none or healing has changed their number."""
    names = content.face_names[number - 1] if content.face_names else ()
    n_faces = len(faces_of(solid))
    return names if len(names) == n_faces else ("",) * n_faces


def _note_gap(solids: Sequence[TopoDS_Solid], accuracy: float | None) -> tuple[str, ...]:
    """A note on edges that lie off their faces by more than TOLD_GAP."""
    gap = measure_accuracy(solids)
    if gap <= TOLD_GAP:
        return ()
    stated = f"; the file states an accuracy of {accuracy:.3g} mm" if accuracy is not None else ""
    return (f"edges lie up to {gap:.2g} mm off their faces{stated}",)
