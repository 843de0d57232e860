"""CAD bodies as input: build123d, CadQuery or TopoDS shapes, or CAD files, reduced to valid closed solids."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from OCP.TopoDS import TopoDS_Shape, TopoDS_Solid

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.body_import.healing import describe_faults
from tpmscad.kernel.body_import.isolated_reader import read_foreign_solids
from tpmscad.kernel.body_import.overlapping_spheres import require_disjoint_spheres
from tpmscad.kernel.body_import.solid_choice import ALL, LARGEST, choose_solids, list_reported_solids
from tpmscad.kernel.build.primitive_solids import PrimitiveRegion, make_region_solid
from tpmscad.kernel.measure.shape_report import ShapeReport, check_shape, check_solids
from tpmscad.kernel.measure.solid_list import SolidEntry, tabulate_solids, title_solids
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.exploration import faces_of, solids_of, unwrap
from tpmscad.kernel.step.face_labels import name_body_face
from tpmscad.result_display import fit_lines

MAX_COORDINATE = 1e9
"""Model units. OCCT represents infinity by 2e100, and its tolerance of 1e-7 is meaningless beyond this limit."""


@dataclass(frozen=True, slots=True, eq=False)
class CadBody:
    """One valid, closed solid with the report of its check, a name for messages, and notes on the file that it came from.

    face_names: of the solid's faces in the order of `faces_of`, as the file states them, "" where it names none.
    title: of the solid among several, for the names of what is made of it. accuracy: what the file states, mm. role: the first
    word of the labels of its faces.
    """

    shape: TopoDS_Solid
    report: ShapeReport
    name: str
    notes: tuple[str, ...] = ()
    face_names: tuple[str, ...] = ()
    title: str = "body"
    accuracy: float | None = None
    role: str = "body"

    @property
    def face_labels(self) -> tuple[str, ...]:
        """Labels of the faces in the order of `faces_of`, "body 0" and so on, with their names in the file."""
        names = self.face_names or [""] * len(faces_of(self.shape))
        return tuple(name_body_face(index, name, self.role) for index, name in enumerate(names))

    @property
    def volume(self) -> float:
        """Volume in model units."""
        return self.report.volume

    @property
    def box(self) -> tuple[Array, Array]:
        """Opposite corners (3,), (3,) of its true extent; the kernel's box of spline faces is that of their poles."""
        low, high = self.report.bounds
        return np.array(low), np.array(high)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class BodyFile:
    """What a CAD file holds, and the solids of it that were chosen, sound and ready to be filled.

    Attributes
    ----------
    file : str
        Path of the file.
    solids : tuple of SolidEntry
        All solids of the file: number, name, size, volume, faces by kind, largest edge tolerance.
    bodies : tuple of CadBody
        Those that were chosen.
    healed : tuple of str
        What was repaired, in words, with volumes before and after; empty if nothing was.
    accuracy : float or None
        The accuracy that the file states, mm.
    notes : tuple of str
        What a user should know of the file, with what was repaired.
    """

    file: str
    solids: tuple[SolidEntry, ...]
    bodies: tuple[CadBody, ...]
    healed: tuple[str, ...]
    accuracy: float | None
    notes: tuple[str, ...]

    @property
    def shape(self) -> TopoDS_Shape:
        """The TopoDS solid that was chosen, or the compound of several."""
        return self.bodies[0].shape if len(self.bodies) == 1 else make_compound(body.shape for body in self.bodies)

    @property
    def wrapped(self) -> TopoDS_Shape:
        """The shape, under the name that build123d, CadQuery and viewers use."""
        return self.shape

    def __repr__(self) -> str:
        count = "1 solid" if len(self.solids) == 1 else f"{len(self.solids)} solids"
        return fit_lines([f"{self.file}: {count}", *map(str, self.solids), *self.notes], ".solids and .notes")

    def _repr_html_(self) -> str:
        return tabulate_solids(self.file, self.solids)


def read_body_file(path: str | os.PathLike[str], solid: int | str | None, *, heal: bool = True) -> BodyFile:
    """The solids of a STEP, IGES or BREP file; see `read_chosen_solids`."""
    found = read_foreign_solids(path, solid, heal=heal)
    bodies, titles = [], title_solids(found.entries)
    for number, shape, report, names in zip(found.numbers, found.solids, found.reports, found.face_names, strict=True):
        name = str(path) if len(found.entries) == 1 else f"solid {found.entries[number - 1].label} of {path}"
        _require_possible(shape, name)
        bodies.append(CadBody(shape, report, name, found.notes, names, titles[number], found.accuracy))
    return BodyFile(os.fspath(path), found.entries, tuple(bodies), found.healed, found.accuracy, found.notes)


def read_bodies(source: Any, solid: int | str | None = None, unlabelled: str = "the body") -> tuple[CadBody, ...]:
    """Solids of a build123d or CadQuery object (builders and workplanes too), a TopoDS shape, a region or a CAD file.

    Regions are `fields.box`, `fields.sphere` and `fields.cylinder` with a height. `solid` is a number from 1, "largest" or "all";
    by default there has to be one solid only. Faces of spheres that the kernel has read as the rest of their sphere are
    exchanged, and a note says so. `unlabelled`: what a shape without a label is called in messages.

    Raises InvalidRequest, with a description of what was found, if there is no solid, or more than one and none is chosen, if the
    solid is open, invalid or inside out, unless it is a file's and can be healed, or if the file cannot be read.
    """
    if isinstance(source, CadBody | BodyFile):
        bodies = (source,) if isinstance(source, CadBody) else source.bodies
        if solid is not None:
            raise InvalidRequest("the body has been read: give solid= to tpmscad.read_body, or the path here")
        return bodies
    if isinstance(source, str | os.PathLike):
        return read_body_file(source, solid).bodies
    shape, name = _resolve_shape(source, unlabelled)
    solids = solids_of(shape)
    if not solids:
        raise InvalidRequest(f"{name} holds no solid ({shape.ShapeType().name.removeprefix('TopAbs_').lower()})")
    if len(solids) == 1 and solid in (None, 1, ALL, LARGEST):
        return (_check_body(solids[0], name),)
    for one in solids:
        _require_possible(one, name)
    _, reports = check_solids(solids)
    numbers = choose_solids(list_reported_solids(solids, reports), solid, name)
    named = (replace(_check_body(solids[n - 1], f"solid {n} of {name}"), title=f"solid {n}") for n in numbers)
    return tuple(named)


def read_body(source: Any, solid: int | str | None = None) -> CadBody:
    """The single solid of what `read_bodies` takes; errors as there, and if several solids were chosen."""
    bodies = read_bodies(source, solid)
    if len(bodies) > 1:
        raise InvalidRequest(
            f"{len(bodies)} solids were chosen, where one body is filled at a time: choose one by its number"
        )
    return bodies[0]


def _check_body(solid: TopoDS_Solid, name: str) -> CadBody:
    """The solid as a body; InvalidRequest unless it is finite, valid and closed, and has a positive volume."""
    _require_possible(solid, name)
    report = check_shape(solid)
    if faults := describe_faults(solid, report):
        raise InvalidRequest(f"{name} {faults}; repair it where it was modelled")
    return CadBody(solid, report, name)


def _require_possible(solid: TopoDS_Solid, name: str) -> None:
    """InvalidRequest if a solid reaches beyond MAX_COORDINATE, or faces of one sphere cover each other."""
    low, high = enclosing_box(solid)
    if not np.isfinite([low, high]).all() or np.abs([low, high]).max() > MAX_COORDINATE:
        raise InvalidRequest(f"{name} has coordinates beyond {MAX_COORDINATE:g}: a body must be finite")
    require_disjoint_spheres(solid, name)


def _resolve_shape(source: Any, unlabelled: str) -> tuple[TopoDS_Shape, str]:
    """TopoDS shape and display name of anything but a file that `read_body` accepts."""
    if isinstance(source, PrimitiveRegion):
        return make_region_solid(source), f"the {type(source).__name__.removesuffix('Region').lower()}"
    if hasattr(source, "findSolid"):  # a CadQuery Workplane: the solid on its stack or in its parents
        try:
            source = source.findSolid()
        except ValueError as error:
            raise InvalidRequest(f"the workplane holds no solid: {error}") from error
    elif hasattr(source, "part") and not hasattr(source, "wrapped"):  # a build123d builder
        source = source.part
    shape = unwrap(source)
    if not isinstance(shape, TopoDS_Shape) or shape.IsNull():
        raise InvalidRequest(
            f"{type(source).__name__} is no body: give a build123d or CadQuery shape, a TopoDS shape, the path of a CAD file, or "
            "a box, sphere or cylinder of tpmscad.fields"
        )
    return shape, str(getattr(source, "label", "") or unlabelled)
