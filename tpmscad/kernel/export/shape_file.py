"""STEP files of OCCT shapes, as one product or as an assembly of named products, by the kernel's own writer.

The schema is AP242 or AP214 and the unit millimetre. A document of extended data (XCAF) holds names of solids and faces, colours,
and validation properties that are measured on the faces. Parameter curves are written: readers then search for none, which
takes OCCT a third of the time and fails on small surfaces.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
from OCP.gp import gp_Pnt
from OCP.IFSelect import IFSelect_RetDone
from OCP.Interface import Interface_Static
from OCP.Quantity import Quantity_Color, Quantity_TOC_sRGB
from OCP.STEPCAFControl import STEPCAFControl_Writer
from OCP.STEPControl import STEPControl_AsIs
from OCP.TCollection import TCollection_ExtendedString, TCollection_HAsciiString
from OCP.TDataStd import TDataStd_Name
from OCP.TDocStd import TDocStd_Document
from OCP.TopAbs import TopAbs_FACE, TopAbs_SOLID
from OCP.TopExp import TopExp_Explorer
from OCP.TopLoc import TopLoc_Location
from OCP.XCAFApp import XCAFApp_Application
from OCP.XCAFDoc import XCAFDoc_Area, XCAFDoc_Centroid, XCAFDoc_ColorSurf, XCAFDoc_DocumentTool, XCAFDoc_Volume

from tpmscad._typing import Array
from tpmscad.atomic_file import atomic_write, validate_output_path
from tpmscad.brep.solid_names import name_pieces
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.kernel.measure.edge_gaps import measure_accuracy
from tpmscad.kernel.measure.mass_properties import solid_moments
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.convert import encode_file_name
from tpmscad.kernel.occt.exploration import faces_of, require_shape, solids_of, vertices_of
from tpmscad.kernel.step.face_labels import NamedSolid
from tpmscad.kernel.step.part21 import SOFTWARE, STEP_SUFFIXES, find_schema
from tpmscad.kernel.step.product_entities import Colour
from tpmscad.kernel.step.step_reader import silence_occt

STATED_ACCURACY = 2
"""OCCT's "session" mode: the uncertainty in the file is the value that is given, not a mean of tolerances."""


def write_solids(
    solids: Sequence[NamedSolid],
    path: str | os.PathLike[str],
    *,
    schema: str = "ap242",
    name: str | None = None,
    assembly: bool = False,
    accuracy: float | None = None,
    time_stamp: str | None = None,
    verify: Callable[[Path], None] | None = None,
) -> None:
    """Write solids with their names, labels and colours to a STEP file in mm.

    accuracy: how far in mm edges lie off faces at most; measured unless it is given. assembly: each solid is a product of its
    own under one of the whole, so that readers show its name; otherwise all are items of one product. Other arguments and
    errors as `write_step`; KernelError if the kernel cannot write the shape.
    """
    target, protocol = validate_output_path(path, STEP_SUFFIXES), find_schema(schema)
    if not solids:
        raise InvalidRequest("the shape holds no solid: STEP files are written of solids")
    if accuracy is None:
        accuracy = measure_accuracy([of.solid for of in solids])
    stamp = time_stamp or datetime.now(UTC).isoformat(timespec="seconds")
    document = _make_document(solids, name or target.stem, assembly)
    settings = {"write.step.schema": protocol.occt_name, "write.precision.mode": STATED_ACCURACY}
    settings |= {"write.precision.val": accuracy, "write.stepcaf.subshapes.name": 1, "write.surfacecurve.mode": 1}
    with atomic_write(target) as aside:
        with silence_occt(), _occt_settings(settings):
            writer = STEPCAFControl_Writer()
            writer.SetPropsMode(True)
            transferred = writer.Transfer(document, STEPControl_AsIs)
            header = APIHeaderSection_MakeHeader(writer.ChangeWriter().Model())
            header.SetName(TCollection_HAsciiString(target.name))
            header.SetTimeStamp(TCollection_HAsciiString(stamp))
            header.SetOriginatingSystem(TCollection_HAsciiString(SOFTWARE))
            if not transferred or writer.Write(encode_file_name(aside)) != IFSelect_RetDone:
                raise KernelError(
                    "write STEP", "OCCT cannot write the shape", make_compound([of.solid for of in solids])
                )
        if verify is not None:
            verify(aside)


def write_shape(shape: Any, path: str | os.PathLike[str], *, name: str | None = None, **how: Any) -> None:
    """Write the solids of a TopoDS, build123d or CadQuery shape as one STEP product in mm; other arguments as `write_solids`.

    Raises InvalidRequest if the shape has no solid, or faces outside of solids.
    """
    write_solids(name_solids(shape, name or Path(path).stem), path, name=name, **how)


def name_solids(shape: Any, name: str, label: str = "") -> tuple[NamedSolid, ...]:
    """The solids of a shape under one name, from the second on with their place (`piece_names`); all their faces have one label.

    Raises InvalidRequest if the shape has no solid, or faces outside of its solids.
    """
    if TopExp_Explorer(require_shape(shape), TopAbs_FACE, TopAbs_SOLID).More():
        raise InvalidRequest("the shape has faces that bound no solid: leave them out, or make a solid of them first")
    solids = solids_of(shape)
    if not solids:
        raise InvalidRequest("the shape holds no solid: make a solid of its faces first")
    return tuple(
        NamedSolid(own_name, solid, (label,) * len(faces_of(solid)))
        for own_name, solid in zip(name_pieces(name, [*map(vertices_of, solids)]), solids, strict=True)
    )


@contextmanager
def _occt_settings(values: Mapping[str, Any]) -> Iterator[None]:
    """OCCT's settings of the process, which other programs in it may rely on, set for a while."""
    STEPCAFControl_Writer()  # the first writer registers the settings
    before = {key: Interface_Static.CVal_s(key) for key in values}
    try:
        for key, value in values.items():
            if not Interface_Static.SetCVal_s(key, str(value)):
                raise KernelError("write STEP", f"OCCT refuses {key} = {value}")
        yield
    finally:
        for key, text in before.items():
            Interface_Static.SetCVal_s(key, text)


def _make_document(solids: Sequence[NamedSolid], title: str, assembly: bool) -> TDocStd_Document:
    """The solids as a document of extended data."""
    document = TDocStd_Document(TCollection_ExtendedString("BinXCAF"))
    XCAFApp_Application.GetApplication_s().InitDocument(document)
    tool = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    moments = [solid_moments(of.solid, None) for of in solids]
    if not assembly:
        _describe(_add_part(document, solids), title, np.sum(moments, axis=0))
        return document
    whole = tool.NewShape()
    for of, own in zip(solids, moments, strict=True):
        part = _add_part(document, [of])
        _describe(part, of.name, own)
        _set_name(tool.AddComponent(whole, part, TopLoc_Location()), of.name)
    tool.UpdateAssemblies()
    _describe(whole, title, np.sum(moments, axis=0))
    return document


def _add_part(document: TDocStd_Document, solids: Sequence[NamedSolid]) -> Any:
    """The label of a part of these solids, with the names and colours of the solids and their faces."""
    tool = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    colours = XCAFDoc_DocumentTool.ColorTool_s(document.Main())

    def colour(label: Any, value: Colour) -> None:
        colours.SetColor(label, Quantity_Color(*value, Quantity_TOC_sRGB), XCAFDoc_ColorSurf)

    part = tool.AddShape(make_compound([of.solid for of in solids]), False)
    for of in solids:
        label = tool.AddSubShape(part, of.solid)
        _set_name(label, of.name)
        if of.colour is not None:
            colour(label, of.colour)
        for face, text in zip(faces_of(of.solid), of.labels, strict=True):
            label = tool.AddSubShape(part, face)
            _set_name(label, text)
            if of.colour is None:
                colour(label, of.colour_of(text))
    return part


def _describe(label: Any, name: str, moments: Array) -> None:
    """Give a product its name, area, volume and centroid; InvalidRequest without a volume."""
    area, volume, *first = moments.tolist()
    if volume == 0.0:
        raise InvalidRequest(
            "the solid encloses no volume: its faces do not close, or cover each other; check the shape first"
        )
    _set_name(label, name)
    XCAFDoc_Area.Set_s(label, area)
    XCAFDoc_Volume.Set_s(label, volume)
    XCAFDoc_Centroid.Set_s(label, gp_Pnt(*(value / volume for value in first)))


def _set_name(label: Any, name: str) -> None:
    TDataStd_Name.Set_s(label, TCollection_ExtendedString(name, True))
