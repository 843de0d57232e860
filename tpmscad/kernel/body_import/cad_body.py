"""CAD bodies as input: a build123d, CadQuery or TopoDS shape, or a STEP file, reduced to one valid closed solid."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.TopoDS import TopoDS_Shape, TopoDS_Solid

from tpmscad.errors import InvalidRequest
from tpmscad.kernel.body_import.isolated_reader import read_foreign_step
from tpmscad.kernel.body_import.overlapping_spheres import require_disjoint_spheres
from tpmscad.kernel.build.primitive_solids import PrimitiveRegion, make_region_solid
from tpmscad.kernel.measure.shape_report import ShapeReport, check_shape
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.exploration import faces_of, solids_of, unwrap
from tpmscad.kernel.step.face_labels import name_body_face

MAX_COORDINATE = 1e9
"""Model units. OCCT represents infinity by 2e100, and its tolerance of 1e-7 is meaningless beyond this limit."""


@dataclass(frozen=True, slots=True, eq=False)
class CadBody:
    """One valid, closed solid with the report of its check, a name for messages, and notes on the file that it came from.

    face_names: of the solid's faces in the order of `faces_of`, as the file states them, "" where it names none.
    """

    shape: TopoDS_Solid
    report: ShapeReport
    name: str
    notes: tuple[str, ...] = ()
    face_names: tuple[str, ...] = ()

    @property
    def face_labels(self) -> tuple[str, ...]:
        """Labels of the faces in the order of `faces_of`, "body 0" and so on, with their names in the file."""
        names = self.face_names or [""] * len(faces_of(self.shape))
        return tuple(name_body_face(index, name) for index, name in enumerate(names))

    @property
    def volume(self) -> float:
        """Volume in model units."""
        return self.report.volume


def read_body(source: Any) -> CadBody:
    """The single solid of a build123d or CadQuery object (builders and workplanes too), a TopoDS shape, a region or a STEP file.

    Regions are `fields.box`, `fields.sphere` and `fields.cylinder` with a height. Faces of spheres that the kernel has read as
    the rest of their sphere are exchanged, and a note says so.

    Raises InvalidRequest, with a description of what was found, if there is no solid or more than one, if the solid is open,
    invalid or inside out, or if the file is no STEP file.
    """
    if isinstance(source, CadBody):
        return source
    foreign = read_foreign_step(source) if isinstance(source, str | os.PathLike) else None
    shape, name = (foreign.shape, str(source)) if foreign else _resolve_shape(source)
    solids = solids_of(shape)
    if len(solids) != 1:
        found = (
            f"{len(solids)} solids"
            if solids
            else f"no solid ({shape.ShapeType().name.removeprefix('TopAbs_').lower()})"
        )
        raise InvalidRequest(
            f"{name} holds {found}: a body is one solid; fill several solids one at a time, or unite them first"
        )
    low, high = enclosing_box(solids[0])
    if not np.isfinite([low, high]).all() or np.abs([low, high]).max() > MAX_COORDINATE:
        raise InvalidRequest(f"{name} has coordinates beyond {MAX_COORDINATE:g}: a body must be finite")
    solid = solids[0]
    require_disjoint_spheres(solid, name)
    report = check_shape(solid)
    for failed, what in (
        (not report.closed, "is not closed: some of its edges bound one face only"),
        (not report.valid, "is invalid for the kernel (BRepCheck)"),
        (report.volume <= 0, f"is inside out: its volume is {report.volume:.6g}"),
    ):
        if failed:
            raise InvalidRequest(f"{name} {what}; repair it where it was modelled")
    notes, names = (foreign.notes, foreign.face_names) if foreign else ((), ())
    return CadBody(solid, report, name, notes, *names)


def _resolve_shape(source: Any) -> tuple[TopoDS_Shape, str]:
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
            f"{type(source).__name__} is no body: give a build123d or CadQuery shape, a TopoDS shape, a STEP file's path, or "
            "a box, sphere or cylinder of tpmscad.fields"
        )
    return shape, str(getattr(source, "label", "") or "the body")
