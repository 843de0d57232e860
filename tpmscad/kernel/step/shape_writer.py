"""STEP files of any OCCT shape, by OCCT's writer; `brep_writer` is preferred for boundary representations."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from OCP.APIHeaderSection import APIHeaderSection_MakeHeader
from OCP.IFSelect import IFSelect_RetDone
from OCP.Interface import Interface_Static
from OCP.STEPControl import STEPControl_AsIs, STEPControl_Writer
from OCP.TCollection import TCollection_HAsciiString

from tpmscad.errors import KernelError
from tpmscad.kernel.occt.exploration import unwrap
from tpmscad.kernel.step.atomic_file import atomic_write, validate_output_path
from tpmscad.kernel.step.part21 import SOFTWARE, STEP_SUFFIXES, find_schema
from tpmscad.kernel.step.step_reader import silence_occt

SOLID_ENTITY_TYPES = ("StepShape_ManifoldSolidBrep", "StepShape_BrepWithVoids")


def write_shape(
    shape: Any,
    path: str | os.PathLike[str],
    *,
    schema: str = "ap242",
    name: str | None = None,
    time_stamp: str | None = None,
    names: Sequence[str] = (),
    verify: Callable[[Path], None] | None = None,
) -> None:
    """Write a TopoDS, build123d or CadQuery shape as one STEP product in mm; arguments and errors as `write_step`.

    names: of its solids in their order, which become products of an assembly.

    Raises KernelError if OCCT cannot translate the shape.
    """
    target, protocol = validate_output_path(path, STEP_SUFFIXES), find_schema(schema)
    topods = unwrap(shape)
    title = name or target.stem
    writer = STEPControl_Writer()  # the first writer registers the settings below
    with silence_occt(), _temporary_settings({"write.step.schema": protocol.occt_name, "write.step.unit": "MM"}):
        writer = STEPControl_Writer()
        if writer.Transfer(topods, STEPControl_AsIs) != IFSelect_RetDone:
            raise KernelError("write STEP", "OCCT cannot translate the shape", topods)
        _set_product_names(writer, title, target.name, time_stamp, names)
        _name_solids(writer, names)
        with atomic_write(target) as aside:
            if writer.Write(str(aside)) != IFSelect_RetDone:
                raise KernelError("write STEP", f"OCCT cannot write {target}", topods)
            if verify is not None:
                verify(aside)


@contextmanager
def _temporary_settings(settings: Mapping[str, str]) -> Iterator[None]:
    """Set OCCT's global settings, and restore them at the end."""
    before = {key: Interface_Static.CVal_s(key) for key in settings}
    try:
        for key, value in settings.items():
            Interface_Static.SetCVal_s(key, value)
        yield
    finally:
        for key, value in before.items():
            Interface_Static.SetCVal_s(key, value)


def _set_product_names(
    writer: STEPControl_Writer, title: str, file: str, time_stamp: str | None, names: Sequence[str] = ()
) -> None:
    """Name the products and the header.

    OCCT numbers products through the life of the process, so that equal requests would write different files.
    """
    model = writer.Model()
    text = TCollection_HAsciiString
    products = [
        e for i in range(1, model.NbEntities() + 1) if (e := model.Value(i)).DynamicType().Name() == "StepBasic_Product"
    ]
    labels = [title, *(f"{title} {i}" for i in range(2, len(products) + 1))]
    if len(products) == 1 + len(names):  # an assembly of solids
        labels[1:] = names
    for label, product in zip(labels, products, strict=True):
        product.SetId(text(label))
        product.SetName(text(label))
    header = APIHeaderSection_MakeHeader(model)
    header.SetName(text(file))
    header.SetOriginatingSystem(text(SOFTWARE))
    header.SetPreprocessorVersion(text(SOFTWARE))
    if time_stamp is not None:
        header.SetTimeStamp(text(time_stamp))


def _name_solids(writer: STEPControl_Writer, names: Sequence[str]) -> None:
    """Name the solid entities in their order."""
    if not names:
        return
    model = writer.Model()
    entities = [model.Value(i) for i in range(1, model.NbEntities() + 1)]
    solids = [e for e in entities if e.DynamicType().Name() in SOLID_ENTITY_TYPES]
    if len(solids) != len(names):
        raise KernelError("write STEP", f"OCCT translated {len(solids)} solids instead of {len(names)}")
    for solid, name in zip(solids, names, strict=True):
        solid.SetName(TCollection_HAsciiString(name))
