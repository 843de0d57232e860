"""Assemblies of copies of one cell: few of them side by side, many in rows, layers of rows and a block of layers.

A placement takes seven entities and 0.7 kB. 20 x 20 x 20 copies side by side are 5.9 MB, which OCCT 7.9 reads in 22 s; 20 cells
to a row, 20 rows to a layer and 20 layers to the block are 60 placements. Either way a CAD system shows every copy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tpmscad.errors import InvalidRequest
from tpmscad.kernel.step.part21 import DataSection
from tpmscad.kernel.step.product_entities import (
    FileContext,
    MassProperties,
    ProductEntities,
    write_assembly,
    write_validation_properties,
)
from tpmscad.rigid_motion import Motion

ROTATION_TOL = 1e-9
"""Departure of a placement's matrix from a rotation."""

MAX_SIDE_BY_SIDE = 64
"""Copies that one assembly holds without rows and layers."""

LEVEL_NAMES = ("cell", "row", "layer")
"""What an assembly of each level is made of, innermost first."""


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
