"""Product data of a STEP file: product, units, accuracy, validation properties, assembly of instances, and face colours.

Validation properties follow the CAx-IF Recommended Practices for Geometric and Assembly Validation Properties, release 4.4.

An assembly of copies of one cell holds few of them side by side, many in rows, layers of rows and a block of layers. A placement
takes seven entities and 0.7 kB. 20 x 20 x 20 copies side by side are 5.9 MB, which OCCT 7.9 reads in 22 s; 20 cells to a row, 20
rows to a layer and 20 layers to the block are 60 placements. Either way a CAD system shows every copy.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from tpmscad._typing import Array, Colour
from tpmscad.atomic_file import atomic_write, validate_output_path
from tpmscad.errors import InvalidRequest
from tpmscad.file_suffixes import STEP_SUFFIXES
from tpmscad.kernel.step.geometry_entities import write_placement
from tpmscad.kernel.step.part21 import (
    SCHEMAS,
    DataSection,
    StepSchema,
    find_schema,
    format_real,
    format_reals,
    format_references,
    format_string,
    write_exchange_structure,
)
from tpmscad.rigid_motion import Motion

BREP_REPRESENTATION = "ADVANCED_BREP_SHAPE_REPRESENTATION"
"""Entity of the shape representation of a product that holds solids itself."""

ROTATION_TOL = 1e-9
"""Departure of a placement's matrix from a rotation."""

MAX_SIDE_BY_SIDE = 64
"""Copies that one assembly holds without rows and layers."""

LEVEL_NAMES = ("cell", "row", "layer")
"""What an assembly of each level is made of, innermost first."""


@dataclass(frozen=True, slots=True)
class MassProperties:
    """Volume, surface area and centroid of a solid, in mm."""

    volume: float
    area: float
    centroid: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class FileContext:
    """Numbers of the entities that all others refer to.

    `organization` is an organization and its role, in AP214 only.
    """

    application: int
    millimetre: int
    units: tuple[int, ...]
    uncertainty: int
    organization: tuple[int, int] | None


@dataclass(frozen=True, slots=True)
class ProductEntities:
    """Numbers of the definition, definition shape and shape representation of a product, and its context and origin."""

    definition: int
    definition_shape: int
    representation: int
    context: int
    origin: int


@contextmanager
def open_step_file(
    path: str | os.PathLike[str],
    *,
    schema: str,
    accuracy: float,
    time_stamp: str | None,
    verify: Callable[[Path], None] | None,
) -> Iterator[tuple[Path, DataSection, FileContext]]:
    """The path of a STEP file, its data section, to which the caller adds what the file holds, and what all entities refer to.

    The file is written at the end under a temporary name, and `verify` is called with it; if it raises, no file is left.
    `time_stamp` is the current time by default. Raises InvalidRequest for an unknown schema, a missing folder or an extension
    other than .step and .stp.
    """
    target, protocol = validate_output_path(path, STEP_SUFFIXES), find_schema(schema)
    stamp = time_stamp or datetime.now(UTC).isoformat(timespec="seconds")
    section = DataSection()
    yield target, section, write_file_context(section, protocol, accuracy)
    with atomic_write(target) as aside:
        write_exchange_structure(aside, section, schema=protocol, name=target.name, time_stamp=stamp)
        if verify is not None:
            verify(aside)


def write_file_context(section: DataSection, schema: StepSchema, accuracy: float) -> FileContext:
    """Write the application, the units (mm, radian, steradian) and the accuracy.

    Points closer than `accuracy` (mm) count as one.
    """
    application = section.add(f"APPLICATION_CONTEXT({format_string(schema.application)})")
    section.add(
        f"APPLICATION_PROTOCOL_DEFINITION('international standard',{format_string(schema.protocol)},{schema.year},#{application})"
    )
    millimetre = section.add("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
    radian = section.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    steradian = section.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    uncertainty = section.add(
        f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE({format_real(accuracy)}),#{millimetre},"
        "'distance_accuracy_value','confusion accuracy')"
    )
    organization = None
    if schema == SCHEMAS["ap214"]:  # rule product_requires_id_owner; the owner of the names is unknown here
        organization = section.add("ORGANIZATION($,'',$)"), section.add("ORGANIZATION_ROLE('id owner')")
    return FileContext(application, millimetre, (millimetre, radian, steradian), uncertainty, organization)


def write_product(
    section: DataSection, setting: FileContext, name: str, kind: str, items: Sequence[int]
) -> ProductEntities:
    """Write a part or an assembly.

    `kind` is the entity of its shape representation, and `items` are its contents besides the origin. Each product has its own
    context: an instance is moved from the context of its part to that of the assembly, which must differ.
    """
    label = format_string(name)
    scene = section.add(f"PRODUCT_CONTEXT('',#{setting.application},'mechanical')")
    product = section.add(f"PRODUCT({label},{label},'',(#{scene}))")
    section.add(f"PRODUCT_RELATED_PRODUCT_CATEGORY('part',$,(#{product}))")
    if setting.organization is not None:
        holder, role = setting.organization
        section.add(f"APPLIED_ORGANIZATION_ASSIGNMENT(#{holder},#{role},(#{product}))")
    formation = section.add(f"PRODUCT_DEFINITION_FORMATION('','',#{product})")
    view = section.add(f"PRODUCT_DEFINITION_CONTEXT('part definition',#{setting.application},'design')")
    definition = section.add(f"PRODUCT_DEFINITION('design','',#{formation},#{view})")
    shape = section.add(f"PRODUCT_DEFINITION_SHAPE('','',#{definition})")
    context = section.add(
        f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#{setting.uncertainty}))"
        f"GLOBAL_UNIT_ASSIGNED_CONTEXT({format_references(setting.units)})REPRESENTATION_CONTEXT('',''))"
    )
    origin = write_placement(section, np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    representation = section.add(f"{kind}({label},{format_references([origin, *items])},#{context})")
    section.add(f"SHAPE_DEFINITION_REPRESENTATION(#{shape},#{representation})")
    return ProductEntities(definition, shape, representation, context, origin)


def write_validation_properties(
    section: DataSection, setting: FileContext, product: ProductEntities, mass: MassProperties
) -> None:
    """Write volume, surface area and centroid, which a reader compares with its own values."""
    square = section.add(f"DERIVED_UNIT((#{section.add(f'DERIVED_UNIT_ELEMENT(#{setting.millimetre},2.)')}))")
    cubic = section.add(f"DERIVED_UNIT((#{section.add(f'DERIVED_UNIT_ELEMENT(#{setting.millimetre},3.)')}))")
    x, y, z = format_reals(mass.centroid)
    for name, item in (
        (
            "volume",
            f"MEASURE_REPRESENTATION_ITEM('volume measure',VOLUME_MEASURE({format_real(mass.volume)}),#{cubic})",
        ),
        (
            "surface area",
            f"MEASURE_REPRESENTATION_ITEM('surface area measure',AREA_MEASURE({format_real(mass.area)}),#{square})",
        ),
        ("centroid", f"CARTESIAN_POINT('centre point',({x},{y},{z}))"),
    ):
        held = section.add(item)
        representation = section.add(f"REPRESENTATION('{name}',(#{held}),#{product.context})")
        property_ = section.add(
            f"PROPERTY_DEFINITION('geometric validation property','{name}',#{product.definition_shape})"
        )
        section.add(f"PROPERTY_DEFINITION_REPRESENTATION(#{property_},#{representation})")


def write_assembly(
    section: DataSection,
    setting: FileContext,
    name: str,
    parts: Sequence[ProductEntities],
    labels: Sequence[str],
    rotation: Array,
    translation: Array,
) -> ProductEntities:
    """Write an assembly of N parts, which may be the same, placed by proper rotations (N, 3, 3) and translations (N, 3)."""
    frames = [write_placement(section, t, r[:, 2], r[:, 0]) for r, t in zip(rotation, translation, strict=True)]
    assembly = write_product(section, setting, name, "SHAPE_REPRESENTATION", frames)
    for i, (part, label, frame) in enumerate(zip(parts, labels, frames, strict=True), 1):
        usage = section.add(
            f"NEXT_ASSEMBLY_USAGE_OCCURRENCE('{i}',{format_string(label)},'',#{assembly.definition},#{part.definition},$)"
        )
        shape = section.add(f"PRODUCT_DEFINITION_SHAPE('Placement','Placement of an item',#{usage})")
        motion = section.add(f"ITEM_DEFINED_TRANSFORMATION('','',#{part.origin},#{frame})")
        relation = section.add(
            f"(REPRESENTATION_RELATIONSHIP('','',#{part.representation},#{assembly.representation})"
            f"REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION(#{motion})SHAPE_REPRESENTATION_RELATIONSHIP())"
        )
        section.add(f"CONTEXT_DEPENDENT_SHAPE_REPRESENTATION(#{relation},#{shape})")
    return assembly


def write_colours(section: DataSection, context: int, coloured: Sequence[tuple[int, Colour]]) -> None:
    """Style faces or solids, given as pairs of entity number and colour: red, green and blue from 0 to 1."""
    styles = {colour: _style(section, colour) for colour in dict.fromkeys(colour for _, colour in coloured)}
    if coloured:
        items = section.extend([f"STYLED_ITEM('color',(#{styles[colour]}),#{item})" for item, colour in coloured])
        section.add(
            f"MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',{format_references(items)},#{context})"
        )


def _style(section: DataSection, colour: Colour) -> int:
    """Presentation style of one colour."""
    if not all(0.0 <= c <= 1.0 for c in colour):
        raise InvalidRequest(f"colour {colour} is not valid: give red, green and blue from 0 to 1")
    red, green, blue = format_reals([float(c) for c in colour])
    rgb = section.add(f"COLOUR_RGB('',{red},{green},{blue})")
    fill = section.add(f"FILL_AREA_STYLE_COLOUR('',#{rgb})")
    style = section.add(f"FILL_AREA_STYLE('',(#{fill}))")
    area = section.add(f"SURFACE_STYLE_FILL_AREA(#{style})")
    side = section.add(f"SURFACE_SIDE_STYLE('',(#{area}))")
    usage = section.add(f"SURFACE_STYLE_USAGE(.BOTH.,#{side})")
    return section.add(f"PRESENTATION_STYLE_ASSIGNMENT((#{usage}))")


def arrange_cells(edges: Sequence[float], counts: tuple[int, int, int]) -> tuple[Motion, ...]:
    """The levels of an assembly, innermost first, of `counts` cells with the given edge lengths (mm), from the origin."""
    steps = [np.arange(float(n))[:, None] * edge * axis for n, edge, axis in zip(counts, edges, np.eye(3), strict=True)]
    levels = [Motion.translations(step) for step in steps if len(step) > 1] or [Motion.translations(steps[0])]
    if math.prod(counts) > MAX_SIDE_BY_SIDE:
        return tuple(levels)
    return (compose_levels(levels),)


def compose_levels(levels: Sequence[Motion]) -> Motion:
    """The placements of every copy of the innermost part, those of inner levels fastest."""
    whole = levels[0]
    for level in levels[1:]:
        placed = level[:, None] @ whole[None]
        whole = Motion(placed.rotation.reshape(-1, 3, 3), placed.translation.reshape(-1, 3))
    return whole


def write_cell_assembly(
    section: DataSection,
    setting: FileContext,
    title: str,
    cell: ProductEntities,
    mass: MassProperties,
    levels: Sequence[Motion],
) -> None:
    """Write the assemblies of all levels with their validation properties; the outermost bears the title.

    InvalidRequest unless the copies are placed by proper rotations, which is all that a STEP placement can state.
    """
    part = cell
    for depth, level in enumerate(levels):
        _require_proper_rotations(level)
        held = LEVEL_NAMES[depth]
        name = title if depth == len(levels) - 1 else f"{title} {LEVEL_NAMES[depth + 1]}"
        labels = [f"{held} {i}" for i in range(1, len(level) + 1)]
        part = write_assembly(section, setting, name, [part] * len(level), labels, level.rotation, level.translation)
        mass = _mass_of_copies(mass, level)
        write_validation_properties(section, setting, part, mass)


def _require_proper_rotations(instances: Motion) -> None:
    """InvalidRequest if a copy is mirrored or distorted."""
    off = np.abs(instances.rotation @ np.swapaxes(instances.rotation, 1, 2) - np.eye(3)).max(initial=0.0)
    if off > ROTATION_TOL or (instances.handedness < 0).any():
        raise InvalidRequest(
            "instances of a cell are placed by proper rotations: mirror the boundary representation instead"
        )


def _mass_of_copies(mass: MassProperties, instances: Motion) -> MassProperties:
    """Mass properties of all copies together."""
    n = len(instances)
    x, y, z = instances.apply(np.array(mass.centroid)).mean(axis=0)
    return MassProperties(n * mass.volume, n * mass.area, (float(x), float(y), float(z)))
