"""Reading of STEP files with the names and colours of their solids and faces, by OCCT's document of extended data (XCAF)."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from OCP.IFSelect import IFSelect_RetDone
from OCP.Interface import Interface_Static
from OCP.Quantity import Quantity_Color
from OCP.STEPCAFControl import STEPCAFControl_Reader
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDF import TDF_Label
from OCP.TDocStd import TDocStd_Document
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Solid
from OCP.XCAFApp import XCAFApp_Application
from OCP.XCAFDoc import XCAFDoc_ColorGen, XCAFDoc_ColorSurf, XCAFDoc_ColorTool, XCAFDoc_DocumentTool, XCAFDoc_ShapeTool

from tpmscad._typing import Colour
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.convert import encode_file_name
from tpmscad.kernel.occt.exploration import ShapeKey, faces_of, solids_of
from tpmscad.kernel.step.step_reader import (
    NO_NAME,
    fine_precision,
    missing_solid,
    require_step_file,
    silence_occt,
    unreadable_file,
)

SRGB_LINEAR_LIMIT, SRGB_EXPONENT = 0.0031308, 2.4
"""IEC 61966-2-1: where the transfer curve of sRGB turns from a line to a power."""


@dataclass(frozen=True, slots=True, eq=False)
class ColouredSolid:
    """A placed solid of a file: its product's or its own name; colours and names of its faces, None and "" where it has none."""

    name: str
    solid: TopoDS_Solid
    face_colours: tuple[Colour | None, ...]
    face_names: tuple[str, ...]


def read_coloured_solids(path: str | os.PathLike[str]) -> tuple[ColouredSolid, ...]:
    """The solids of a STEP file in mm, placed copies included, in the order of its products.

    Errors as `read_step`.
    """
    path = require_step_file(Path(path))
    document = TDocStd_Document(TCollection_ExtendedString("BinXCAF"))
    XCAFApp_Application.GetApplication_s().InitDocument(document)
    reader = STEPCAFControl_Reader()
    reader.SetColorMode(True)
    reader.SetNameMode(True)
    Interface_Static.SetIVal_s("read.stepcaf.subshapes.name", 1)
    with silence_occt(), fine_precision():
        if reader.ReadFile(encode_file_name(path)) != IFSelect_RetDone:
            raise unreadable_file(path)
        if not reader.Transfer(document):
            raise missing_solid(path)
    roots = convert.label_sequence()
    XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetFreeShapes(roots)
    solids = tuple(solid for root in _items(roots) for solid in _solids_below(root, TopLoc_Location(), "", None))
    if not solids:
        raise missing_solid(path)
    return solids


def _solids_below(label: Any, place: Any, name: str, colour: Colour | None) -> Iterator[ColouredSolid]:
    """The solids of a label, placed; they inherit the name and the colour of their assembly if they have none."""
    colour = _colour(label) or colour
    if XCAFDoc_ShapeTool.IsAssembly_s(label):
        components = convert.label_sequence()
        XCAFDoc_ShapeTool.GetComponents_s(label, components)
        for component in _items(components):
            part = TDF_Label()
            if XCAFDoc_ShapeTool.GetReferredShape_s(component, part):
                moved = place.Multiplied(XCAFDoc_ShapeTool.GetLocation_s(component))
                yield from _solids_below(part, moved, _name(part) or _name(component), _colour(component) or colour)
        return
    shape = XCAFDoc_ShapeTool.GetShape_s(label)
    found = convert.label_sequence()
    XCAFDoc_ShapeTool.GetSubShapes_s(label, found)
    parts = {ShapeKey(XCAFDoc_ShapeTool.GetShape_s(part)): part for part in _items(found)}
    for solid in solids_of(shape):
        own = parts.get(ShapeKey(solid))
        of_solid = (own and _colour(own)) or colour
        of_faces = [parts.get(ShapeKey(face)) for face in faces_of(solid)]
        names = (_name(face) if face else "" for face in of_faces)
        colours = tuple((face and _colour(face)) or of_solid for face in of_faces)
        title = (own and _name(own)) or name or _name(label)
        yield ColouredSolid(
            title, convert.as_solid(solid.Moved(place)), colours, tuple(n if n != NO_NAME else "" for n in names)
        )


def _items(labels: Any) -> Iterator[Any]:
    """The labels of a sequence."""
    return (labels.Value(i) for i in range(1, labels.Length() + 1))


def _name(label: Any) -> str:
    """The name of a label, empty if it has none."""
    attribute, kind = TDataStd_Name(), TDataStd_Name.GetID_s()
    if not label.IsAttribute(kind):  # to ask for one that is missing crashes some builds of the bindings
        return ""
    label.FindAttribute(kind, attribute)
    return str(attribute.Get().ToExtString())


def _colour(label: Any) -> Colour | None:
    """The colour of a label's surfaces, as red, green and blue from 0 to 1."""
    value = Quantity_Color()
    for kind in (XCAFDoc_ColorSurf, XCAFDoc_ColorGen):
        if XCAFDoc_ColorTool.GetColor_s(label, kind, value):
            red, green, blue = _encode_srgb(np.array([value.Red(), value.Green(), value.Blue()])).tolist()
            return red, green, blue
    return None


def _encode_srgb(linear: Any) -> Any:
    """OCCT's linear colour as the sRGB values that files hold."""
    bent = 1.055 * np.maximum(linear, SRGB_LINEAR_LIMIT) ** (1 / SRGB_EXPONENT) - 0.055
    return np.where(linear <= SRGB_LINEAR_LIMIT, 12.92 * linear, bent).clip(0.0, 1.0).round(6)
