"""STEP files of patch complexes, straight from the arrays: AP242 or AP214, millimetres, one product, or an assembly of cells."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.build.shell_nesting import ShellNesting
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.step.atomic_file import atomic_write, validate_step_path
from tpmscad.kernel.step.part21 import SCHEMAS, DataSection, format_exchange_structure
from tpmscad.kernel.step.product_entities import (
    Colour,
    MassProperties,
    write_colours,
    write_file_context,
    write_instances,
    write_product,
    write_validation_properties,
)
from tpmscad.kernel.step.topology_entities import write_solids

SOFTWARE = "tpmscad"

ROTATION_TOL = 1e-9
"""How far a placement may be from a proper rotation: a STEP placement can hold nothing else."""


@dataclass(frozen=True, slots=True, eq=False)
class Instances:
    """Where copies of a cell go in an assembly: proper rotations (N, 3, 3) and translations (N, 3) in mm."""

    rotation: Array
    translation: Array

    def __post_init__(self) -> None:
        off = np.abs(self.rotation @ np.swapaxes(self.rotation, 1, 2) - np.eye(3)).max(initial=0.0)
        if off > ROTATION_TOL or (np.linalg.det(self.rotation) < 0).any():
            raise InvalidRequest("instances of a cell are placed by proper rotations: mirror the complex instead")

    @classmethod
    def translated(cls, translation: Array) -> Instances:
        return cls(np.tile(np.eye(3), (len(translation), 1, 1)), translation)


def write_step(
    brep: Brep,
    nesting: ShellNesting,
    path: str | os.PathLike[str],
    *,
    schema: str = "ap242",
    name: str | None = None,
    instances: Instances | None = None,
    colours: Mapping[str, Colour] | None = None,
    replicas: bool = False,
    time_stamp: str | None = None,
    verify: Callable[[Path], None] | None = None,
) -> None:
    """Write the solids of a closed complex, in mm, to a STEP file; `nesting` is what `build` found.

    Faces carry their tags as names. `name` is the product's, by default the file's. With `instances` the solids are stored once
    and placed by an assembly. `colours` (red, green and blue from 0 to 1, by tag) style the faces; TAG_COLOURS has one for each.
    `replicas` stores each primitive surface once: a smaller file that most readers take, though it breaks a rule of the standard
    (see `step.replica`). Equal requests write equal bytes, but for `time_stamp` (by default: now), which has a line of its
    own. InvalidRequest for a schema other than ap242 and ap214, a missing folder, or another extension than .step and .stp.
    `verify` gets the finished file under its passing name; if it raises, nothing is left.
    """
    target = validate_step_path(path)
    if schema not in SCHEMAS:
        raise InvalidRequest(f"schema {schema!r} is not known: use one of {', '.join(SCHEMAS)}")
    stamp = time_stamp or datetime.now(UTC).isoformat(timespec="seconds")
    title = name or target.stem
    section = DataSection()
    setting = write_file_context(section, schema, CONFUSION_TOLERANCE)
    written = write_solids(section, _reverse_void_faces(brep, nesting), nesting, replicas)
    part_name = title if instances is None else f"{title} cell"
    part = write_product(section, setting, part_name, "ADVANCED_BREP_SHAPE_REPRESENTATION", written.solids)
    if colours:
        tags = [brep.tags[t] for t in brep.faces.tag.tolist()]
        write_colours(section, part.context, written.faces, tags, colours)
    mass = compute_mass_properties(nesting)
    write_validation_properties(section, setting, part, mass)
    if instances is not None:
        assembly = write_instances(section, setting, title, part, instances.rotation, instances.translation)
        write_validation_properties(section, setting, assembly, _instanced_mass_properties(mass, instances))
    text = format_exchange_structure(
        section, schema=schema, name=target.name, time_stamp=stamp, author="", software=SOFTWARE
    )
    with atomic_write(target) as aside:
        aside.write_text(text, encoding="ascii", newline="\n")
        if verify is not None:
            verify(aside)


def _reverse_void_faces(brep: Brep, nesting: ShellNesting) -> Brep:
    """The complex with the faces of voids looking out of them, into the material: STEP turns whole shells over."""
    voids = [v for _, *of_piece in nesting.shells_of_solid for v in of_piece]
    faces = brep.faces
    sense = np.where(np.isin(nesting.shell_of_face, voids), -faces.sense, faces.sense)
    return replace(brep, faces=replace(faces, sense=sense))


def compute_mass_properties(nesting: ShellNesting) -> MassProperties:
    """Volume, area and centroid of all solids together, by the complex's own quadrature."""
    x, y, z = integral_properties.centroid(nesting.moments)
    volume = float(integral_properties.volume(nesting.moments)[0])
    return MassProperties(volume, float(nesting.moments.area.sum()), (float(x), float(y), float(z)))


def _instanced_mass_properties(mass: MassProperties, instances: Instances) -> MassProperties:
    n = len(instances.translation)
    x, y, z = (instances.rotation @ np.array(mass.centroid) + instances.translation).mean(axis=0)
    return MassProperties(n * mass.volume, n * mass.area, (float(x), float(y), float(z)))
