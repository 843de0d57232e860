"""STEP files of patch complexes, straight from the arrays: AP242 or AP214, millimetres, one product, or an assembly of cells."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from tpmscad.errors import InvalidRequest
from tpmscad.kernel.build import TOLERANCE
from tpmscad.kernel.files import step_path, written_aside
from tpmscad.kernel.nesting import Nesting
from tpmscad.kernel.step.brep import write_solids
from tpmscad.kernel.step.colour import Colour, write_colours
from tpmscad.kernel.step.product import Mass, write_instances, write_product, write_setting, write_validation
from tpmscad.kernel.step.text import SCHEMAS, Entities, part21
from tpmscad.patches import measure
from tpmscad.patches.complex import Array, PatchComplex

SOFTWARE = "tpmscad"

ROTATION = 1e-9
"""How far a placement may be from a proper rotation: a STEP placement can hold nothing else."""


@dataclass(frozen=True, slots=True, eq=False)
class Instances:
    """Where copies of a cell go in an assembly: proper rotations (N, 3, 3) and translations (N, 3) in mm."""

    rotation: Array
    translation: Array

    def __post_init__(self) -> None:
        off = np.abs(self.rotation @ np.swapaxes(self.rotation, 1, 2) - np.eye(3)).max(initial=0.0)
        if off > ROTATION or (np.linalg.det(self.rotation) < 0).any():
            raise InvalidRequest("instances of a cell are placed by proper rotations: mirror the complex instead")

    @classmethod
    def shifted(cls, translation: Array) -> Instances:
        return cls(np.tile(np.eye(3), (len(translation), 1, 1)), translation)


def write_step(
    complex: PatchComplex,
    nesting: Nesting,
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
    target = step_path(path)
    if schema not in SCHEMAS:
        raise InvalidRequest(f"schema {schema!r} is not known: use one of {', '.join(SCHEMAS)}")
    stamp = time_stamp or datetime.now(UTC).isoformat(timespec="seconds")
    title = name or target.stem
    entities = Entities()
    setting = write_setting(entities, schema, TOLERANCE)
    written = write_solids(entities, _voids_turned(complex, nesting), nesting, replicas)
    part_name = title if instances is None else f"{title} cell"
    part = write_product(entities, setting, part_name, "ADVANCED_BREP_SHAPE_REPRESENTATION", written.solids)
    if colours:
        tags = [complex.tags[t] for t in complex.faces.tag.tolist()]
        write_colours(entities, part.context, written.faces, tags, colours)
    mass = mass_of(nesting)
    write_validation(entities, setting, part, mass)
    if instances is not None:
        assembly = write_instances(entities, setting, title, part, instances.rotation, instances.translation)
        write_validation(entities, setting, assembly, _repeated(mass, instances))
    text = part21(entities, schema=schema, name=target.name, time_stamp=stamp, author="", software=SOFTWARE)
    with written_aside(target) as aside:
        aside.write_text(text, encoding="ascii", newline="\n")
        if verify is not None:
            verify(aside)


def _voids_turned(complex: PatchComplex, nesting: Nesting) -> PatchComplex:
    """The complex with the faces of voids looking out of them, into the material: STEP turns whole shells over."""
    voids = [v for _, *of_piece in nesting.pieces for v in of_piece]
    faces = complex.faces
    sense = np.where(np.isin(nesting.shell, voids), -faces.sense, faces.sense)
    return replace(complex, faces=replace(faces, sense=sense))


def mass_of(nesting: Nesting) -> Mass:
    """Volume, area and centroid of all solids together, by the complex's own quadrature."""
    x, y, z = measure.centroid(nesting.moments)
    volume = float(measure.volume(nesting.moments)[0])
    return Mass(volume, float(nesting.moments.area.sum()), (float(x), float(y), float(z)))


def _repeated(mass: Mass, instances: Instances) -> Mass:
    n = len(instances.translation)
    x, y, z = (instances.rotation @ np.array(mass.centroid) + instances.translation).mean(axis=0)
    return Mass(n * mass.volume, n * mass.area, (float(x), float(y), float(z)))
