"""STEP files of any OCCT shape, as one product or as an assembly of named products.

The schema is AP242 or AP214 and the unit millimetre; names, colours and validation properties are as in `brep_writer`, which
writes boundary representations without the kernel.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from OCP.TopAbs import TopAbs_FACE, TopAbs_SOLID
from OCP.TopExp import TopExp_Explorer

from tpmscad._typing import Array
from tpmscad.atomic_file import atomic_write, validate_output_path
from tpmscad.brep.solid_names import name_pieces
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.occt.exploration import faces_of, require_shape, solids_of, vertices_of
from tpmscad.kernel.step.face_labels import NamedSolid
from tpmscad.kernel.step.occt_topology import write_occt_solids
from tpmscad.kernel.step.part21 import STEP_SUFFIXES, DataSection, find_schema, write_exchange_structure
from tpmscad.kernel.step.product_entities import (
    MassProperties,
    write_assembly,
    write_face_colours,
    write_file_context,
    write_product,
    write_validation_properties,
)


def write_named_solids(
    solids: Sequence[NamedSolid],
    moments: Array,
    path: str | os.PathLike[str],
    *,
    accuracy: float,
    schema: str = "ap242",
    name: str | None = None,
    assembly: bool = False,
    time_stamp: str | None = None,
    verify: Callable[[Path], None] | None = None,
) -> None:
    """Write solids with their names, labels and colours to a STEP file in mm.

    moments: of each solid (n, 5), its area, volume and volume times centroid, for the validation properties. accuracy: how far in
    mm edges lie off faces at most. assembly: each solid is a product of its own under one of the whole, so that readers show its
    name; otherwise all are items of one product. Other arguments and errors as `write_step`; KernelError if a surface or curve
    has no form in STEP.
    """
    target, protocol = validate_output_path(path, STEP_SUFFIXES), find_schema(schema)
    if not solids:
        raise InvalidRequest("the shape holds no solid: STEP files are written of solids")
    stamp = time_stamp or datetime.now(UTC).isoformat(timespec="seconds")
    title = name or target.stem
    section = DataSection()
    setting = write_file_context(section, protocol, accuracy)
    written = write_occt_solids(section, solids)
    kind = "ADVANCED_BREP_SHAPE_REPRESENTATION"
    groups = [[i] for i in range(len(solids))] if assembly else [list(range(len(solids)))]
    parts = []
    for group in groups:
        label = solids[group[0]].name if assembly else title
        part = write_product(section, setting, label, kind, [written[i].solid for i in group])
        write_face_colours(
            section,
            part.context,
            [
                (number, solids[i].colour_of(label))
                for i in group
                for number, label in _faces_or_solid(written[i], solids[i])
            ],
        )
        write_validation_properties(section, setting, part, _mass_properties(moments[group]))
        parts.append(part)
    if assembly:
        still, nowhere = np.tile(np.eye(3), (len(parts), 1, 1)), np.zeros((len(parts), 3))
        names = [of.name for of in solids]
        whole = write_assembly(section, setting, title, parts, names, still, nowhere)
        write_validation_properties(section, setting, whole, _mass_properties(moments))
    with atomic_write(target) as aside:
        write_exchange_structure(aside, section, schema=protocol, name=target.name, time_stamp=stamp, author="")
        if verify is not None:
            verify(aside)


def _faces_or_solid(written: Any, of: NamedSolid) -> list[tuple[int, str]]:
    """What is coloured: the solid as a whole if it has a colour, else each face, with its label."""
    if of.colour is not None:
        return [(written.solid, of.name)]
    return list(zip(written.faces, of.labels, strict=True))


def _mass_properties(moments: Array) -> MassProperties:
    """Volume, area and centroid of solids together, given the moments of each (n, 5); InvalidRequest without a volume."""
    area, volume, *first = moments.sum(axis=0).tolist()
    if volume == 0.0:
        raise InvalidRequest(
            "the solid encloses no volume: its faces do not close, or cover each other; check the shape first"
        )
    x, y, z = (value / volume for value in first)
    return MassProperties(volume, area, (x, y, z))


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
