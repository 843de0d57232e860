"""STEP files of boundary representations, written directly from the arrays.

The schema is AP242 or AP214 and the unit millimetre; the file holds one product, or an assembly of cells.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tpmscad._typing import Colour
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.moments import integral_properties
from tpmscad.kernel.build.shell_nesting import ShellNesting
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.step.product_entities import (
    BREP_REPRESENTATION,
    MassProperties,
    open_step_file,
    write_cell_assembly,
    write_colours,
    write_product,
    write_validation_properties,
)
from tpmscad.kernel.step.topology_entities import write_solids
from tpmscad.rigid_motion import Motion


def write_step(
    brep: Brep,
    nesting: ShellNesting,
    path: str | os.PathLike[str],
    *,
    schema: str = "ap242",
    name: str | None = None,
    instances: Sequence[Motion] = (),
    labels: Sequence[str] | None = None,
    colours: Mapping[str, Colour] | None = None,
    time_stamp: str | None = None,
    verify: Callable[[Path], None] | None = None,
) -> None:
    """Write the solids of a closed boundary representation, in mm, to a STEP file.

    nesting: from `build_solids`. name: of the product, by default that of the file. instances: the solids are stored once and
    placed by an assembly, which each further level places again (`write_cell_assembly`). labels: names of the faces, by default
    their tags. colours: red, green and blue from 0 to 1 by label. Equal requests write equal bytes, but for `time_stamp` on a
    line of its own. The file states as its accuracy the kernel's confusion, or the largest deviation of an edge from its faces
    if that is more. Other arguments and errors as `open_step_file`.
    """
    colours = colours or {}
    accuracy = float(brep.edges.deviation.max(initial=CONFUSION_TOLERANCE))
    envelope = open_step_file(path, schema=schema, accuracy=accuracy, time_stamp=time_stamp, verify=verify)
    with envelope as (target, section, setting):
        title = name or target.stem
        part_name = f"{title} cell" if instances else title
        names = [brep.tags[t] for t in brep.faces.tag.tolist()] if labels is None else labels
        solids, faces = write_solids(section, _reverse_void_faces(brep, nesting), nesting, part_name, names)
        part = write_product(section, setting, part_name, BREP_REPRESENTATION, solids)
        coloured = [(face, colours[label]) for face, label in zip(faces, names, strict=True) if label in colours]
        write_colours(section, part.context, coloured)
        mass = compute_mass_properties(nesting)
        write_validation_properties(section, setting, part, mass)
        if instances:
            write_cell_assembly(section, setting, title, part, mass, instances)


def _reverse_void_faces(brep: Brep, nesting: ShellNesting) -> Brep:
    """The boundary representation with void faces reversed, since STEP reverses whole void shells."""
    voids = [v for _, *of_piece in nesting.shells_of_solid for v in of_piece]
    faces = brep.faces
    sense = np.where(np.isin(nesting.shell_of_face, voids), -faces.sense, faces.sense)
    return replace(brep, faces=replace(faces, sense=sense))


def compute_mass_properties(nesting: ShellNesting) -> MassProperties:
    """Volume, area and centroid of all solids together, by the quadrature of the boundary representation."""
    x, y, z = integral_properties.centroid(nesting.moments)
    volume = float(integral_properties.volume(nesting.moments)[0])
    return MassProperties(volume, float(nesting.moments.area.sum()), (float(x), float(y), float(z)))
