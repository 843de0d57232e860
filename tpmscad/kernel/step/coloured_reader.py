"""Reading of STEP files with the names and colours of their solids and faces, by OCCT's document of extended data (XCAF)."""

from __future__ import annotations

import os
import re
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

MADE_UP_NAME = re.compile(r"SOLID|COMPOUND|Document|NONE|=>\[[\d:]+\]|Open CASCADE STEP translator [\d. ]+")
"""Names that programs, or the kernel, give to what has none."""


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
    document = _read_document(path, colours=True)
    solids = tuple(solid for root in _roots(document) for solid in _solids_below(root, TopLoc_Location(), "", None))
    if not solids:
        raise missing_solid(Path(path))
    return solids


def read_solid_names(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Names of the solids of a STEP file, in its order: those of instances and products from the whole assembly down.

    Names that the kernel makes up are left out, and so are repetitions: "as1/rod-assembly_1/rod-assembly/nut_1/nut".
    """
    document = _read_document(path, colours=False)
    return tuple(name for root in _roots(document) for name in _names_below(root, (_name(root),)))


def _read_document(path: str | os.PathLike[str], *, colours: bool) -> TDocStd_Document:
    """The document of a STEP file with names, and colours if they are asked for; labels live as long as it does."""
    path = require_step_file(Path(path))
    document = TDocStd_Document(TCollection_ExtendedString("BinXCAF"))
    XCAFApp_Application.GetApplication_s().InitDocument(document)
    reader = STEPCAFControl_Reader()
    reader.SetNameMode(True)
    reader.SetColorMode(colours)
    if not colours:
        for set_mode in (
            reader.SetLayerMode,
            reader.SetPropsMode,
            reader.SetGDTMode,
            reader.SetMatMode,
            reader.SetViewMode,
        ):
            set_mode(False)
    Interface_Static.SetIVal_s("read.stepcaf.subshapes.name", 1)
    with silence_occt(), fine_precision():
        if reader.ReadFile(encode_file_name(path)) != IFSelect_RetDone:
            raise unreadable_file(path)
        if not reader.Transfer(document):
            raise missing_solid(path)
    return document


def _roots(document: TDocStd_Document) -> Iterator[Any]:
    """The labels of shapes that are part of no other."""
    roots = convert.label_sequence()
    XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetFreeShapes(roots)
    return _items(roots)


def _solids_below(label: Any, place: Any, name: str, colour: Colour | None) -> Iterator[ColouredSolid]:
    """The solids of a label, placed; they inherit the name and the colour of their assembly if they have none."""
    colour = _colour(label) or colour
    if XCAFDoc_ShapeTool.IsAssembly_s(label):
        for component, part in _components(label):
            moved = place.Multiplied(XCAFDoc_ShapeTool.GetLocation_s(component))
            yield from _solids_below(part, moved, _name(part) or _name(component), _colour(component) or colour)
        return
    parts = _named_parts(label)
    for solid in solids_of(XCAFDoc_ShapeTool.GetShape_s(label)):
        own = parts.get(ShapeKey(solid))
        of_solid = (own and _colour(own)) or colour
        of_faces = [parts.get(ShapeKey(face)) for face in faces_of(solid)]
        names = (_name(face) if face else "" for face in of_faces)
        colours = tuple((face and _colour(face)) or of_solid for face in of_faces)
        title = (own and _name(own)) or name or _name(label)
        yield ColouredSolid(
            title, convert.as_solid(solid.Moved(place)), colours, tuple(n if n != NO_NAME else "" for n in names)
        )


def _names_below(label: Any, path: tuple[str, ...]) -> Iterator[str]:
    """A name for each solid of a label; `path` leads to it."""
    if XCAFDoc_ShapeTool.IsAssembly_s(label):
        for component, part in _components(label):
            yield from _names_below(part, (*path, _name(component), _name(part)))
        return
    parts = _named_parts(label)
    for solid in solids_of(XCAFDoc_ShapeTool.GetShape_s(label)):
        names = (*path, _name(parts[key]) if (key := ShapeKey(solid)) in parts else "")
        yield "/".join(dict.fromkeys(name for name in names if name and not MADE_UP_NAME.fullmatch(name)))


def _components(label: Any) -> Iterator[tuple[Any, Any]]:
    """The instances in an assembly, each with the label of its product."""
    components = convert.label_sequence()
    XCAFDoc_ShapeTool.GetComponents_s(label, components)
    for component in _items(components):
        part = TDF_Label()
        if XCAFDoc_ShapeTool.GetReferredShape_s(component, part):
            yield component, part


def _named_parts(label: Any) -> dict[ShapeKey, Any]:
    """The labels of those parts of a shape that have one."""
    found = convert.label_sequence()
    XCAFDoc_ShapeTool.GetSubShapes_s(label, found)
    return {ShapeKey(XCAFDoc_ShapeTool.GetShape_s(part)): part for part in _items(found)}


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
