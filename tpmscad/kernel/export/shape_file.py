"""STEP files of any OCCT shape, as one product or as an assembly of named products.

The schema is AP242 or AP214 and the unit millimetre; names and colours are as in `brep_writer`, which writes boundary
representations without the kernel, and so are the validation properties, which are measured on the faces.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from OCP.TopAbs import TopAbs_FACE, TopAbs_SOLID
from OCP.TopExp import TopExp_Explorer

from tpmscad._typing import Array, Colour, triple
from tpmscad.brep.solid_names import name_pieces
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.measure.edge_gaps import measure_accuracy
from tpmscad.kernel.measure.mass_properties import solid_moments
from tpmscad.kernel.occt.exploration import faces_of, require_shape, solids_of, vertices_of
from tpmscad.kernel.step.face_labels import NamedSolid, find_label_colour
from tpmscad.kernel.step.occt_topology import WrittenSolid, write_occt_solids
from tpmscad.kernel.step.product_entities import (
    BREP_REPRESENTATION,
    MassProperties,
    open_step_file,
    write_assembly,
    write_colours,
    write_product,
    write_validation_properties,
)


def write_solids(
    solids: Sequence[NamedSolid],
    path: str | os.PathLike[str],
    *,
    schema: str = "ap242",
    name: str | None = None,
    assembly: bool = False,
    accuracy: float | None = None,
    moments: Array | None = None,
    time_stamp: str | None = None,
    verify: Callable[[Path], None] | None = None,
) -> None:
    """Write solids with their names, labels and colours to a STEP file in mm.

    assembly: each solid is a product of its own under one of the whole, so that readers show its name; otherwise all are items
    of one product. accuracy: how far in mm edges lie off faces at most; moments: (n, 5) of `solid_moments`; both are measured
    unless they are given. Other arguments and errors as `write_step`; KernelError if a surface or curve has no form in STEP.
    """
    if accuracy is None:
        accuracy = measure_accuracy(of.solid for of in solids)
    envelope = open_step_file(path, schema=schema, accuracy=accuracy, time_stamp=time_stamp, verify=verify)
    with envelope as (target, section, setting):
        if not solids:
            raise InvalidRequest("the shape holds no solid: STEP files are written of solids")
        if moments is None:
            moments = np.array([solid_moments(of.solid) for of in solids])
        title = name or target.stem
        written = write_occt_solids(section, solids)
        parts = []
        for group in [[i] for i in range(len(solids))] if assembly else [list(range(len(solids)))]:
            label = solids[group[0]].name if assembly else title
            part = write_product(section, setting, label, BREP_REPRESENTATION, [written[i].solid for i in group])
            coloured = [pair for i in group for pair in _colour_items(written[i], solids[i])]
            write_colours(section, part.context, coloured)
            write_validation_properties(section, setting, part, sum_moments(moments[group]))
            parts.append(part)
        if assembly:
            still, nowhere = np.tile(np.eye(3), (len(parts), 1, 1)), np.zeros((len(parts), 3))
            names = [of.name for of in solids]
            whole = write_assembly(section, setting, title, parts, names, still, nowhere)
            write_validation_properties(section, setting, whole, sum_moments(moments))


def write_shape(
    shape: Any,
    path: str | os.PathLike[str],
    *,
    schema: str = "ap242",
    name: str | None = None,
    time_stamp: str | None = None,
) -> None:
    """Write the solids of a TopoDS, build123d or CadQuery shape as one STEP product in mm; arguments and errors as `write_step`.

    Raises InvalidRequest if the shape has no solid, or faces outside of solids, and KernelError if a surface or curve has no form
    in STEP.
    """
    solids = name_solids(shape, name or Path(path).stem)
    write_solids(solids, path, schema=schema, name=name, time_stamp=time_stamp)


def _colour_items(written: WrittenSolid, of: NamedSolid) -> list[tuple[int, Colour]]:
    """What is coloured: the solid as a whole if it has a colour, else each face by its label."""
    if of.colour is not None:
        return [(written.solid, of.colour)]
    return [(face, find_label_colour(label)) for face, label in zip(written.faces, of.labels, strict=True)]


def sum_moments(moments: Array) -> MassProperties:
    """Volume, area and centroid of faces or solids together by the moments of each (n, 5); InvalidRequest without a volume."""
    area, volume, *first = moments.sum(axis=0).tolist()
    if volume == 0.0:
        raise InvalidRequest(
            "the solid encloses no volume: its faces do not close, or cover each other; check the shape first"
        )
    return MassProperties(volume, area, triple(value / volume for value in first))


def name_solids(shape: Any, name: str) -> tuple[NamedSolid, ...]:
    """The solids of a shape under one name, from the second on with their place (`name_pieces`); their faces have no labels.

    Raises InvalidRequest if the shape has no solid, or faces outside of its solids.
    """
    if TopExp_Explorer(require_shape(shape), TopAbs_FACE, TopAbs_SOLID).More():
        raise InvalidRequest("the shape has faces that bound no solid: leave them out, or make a solid of them first")
    solids = solids_of(shape)
    if not solids:
        raise InvalidRequest("the shape holds no solid: make a solid of its faces first")
    return tuple(
        NamedSolid(own_name, solid, ("",) * len(faces_of(solid)))
        for own_name, solid in zip(name_pieces(name, [*map(vertices_of, solids)]), solids, strict=True)
    )
