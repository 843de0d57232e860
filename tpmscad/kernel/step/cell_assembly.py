"""Assemblies of copies of one cell: few of them side by side, many in rows, layers of rows and a block of layers.

A placement takes seven entities and 0.7 kB. 20 x 20 x 20 copies side by side are 5.9 MB, which OCCT 7.9 reads in 22 s; 20 cells
to a row, 20 rows to a layer and 20 layers to the block are 60 placements. Either way a CAD system shows every copy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.step.part21 import DataSection
from tpmscad.kernel.step.product_entities import (
    FileContext,
    MassProperties,
    ProductEntities,
    write_assembly,
    write_validation_properties,
)

ROTATION_TOL = 1e-9
"""Departure of a placement's matrix from a rotation."""

MAX_SIDE_BY_SIDE = 64
"""Copies that one assembly holds without rows and layers."""

LEVEL_NAMES = ("cell", "row", "layer")
"""What an assembly of each level is made of, innermost first."""


@dataclass(frozen=True, slots=True, eq=False)
class Instances:
    """Placements of a part in an assembly: proper rotations (N, 3, 3) and translations (N, 3) in mm."""

    rotation: Array
    translation: Array

    def __post_init__(self) -> None:
        off = np.abs(self.rotation @ np.swapaxes(self.rotation, 1, 2) - np.eye(3)).max(initial=0.0)
        if off > ROTATION_TOL or (np.linalg.det(self.rotation) < 0).any():
            raise InvalidRequest(
                "instances of a cell are placed by proper rotations: mirror the boundary representation instead"
            )

    def __len__(self) -> int:
        return len(self.translation)

    @classmethod
    def translated(cls, translation: Array) -> Instances:
        """Placements by translations (N, 3) alone."""
        return cls(np.tile(np.eye(3), (len(translation), 1, 1)), translation)

    def of(self, inner: Instances) -> Instances:
        """The placements of the parts of an inner assembly when it is placed by these: (N * M), the inner ones fastest."""
        rotation = np.einsum("nij,mjk->nmik", self.rotation, inner.rotation)
        translation = np.einsum("nij,mj->nmi", self.rotation, inner.translation) + self.translation[:, None]
        return Instances(rotation.reshape(-1, 3, 3), translation.reshape(-1, 3))


def arrange_cells(edges: Sequence[float], counts: tuple[int, int, int]) -> tuple[Instances, ...]:
    """The levels of an assembly, innermost first, of `counts` cells with the given edge lengths (mm), from the origin."""
    steps = [np.arange(float(n))[:, None] * edge * axis for n, edge, axis in zip(counts, edges, np.eye(3), strict=True)]
    levels = [Instances.translated(step) for step in steps if len(step) > 1] or [Instances.translated(steps[0])]
    if math.prod(counts) > MAX_SIDE_BY_SIDE:
        return tuple(levels)
    return (compose_levels(levels),)


def compose_levels(levels: Sequence[Instances]) -> Instances:
    """The placements of every copy of the innermost part."""
    whole = levels[0]
    for level in levels[1:]:
        whole = level.of(whole)
    return whole


def write_cell_assembly(
    section: DataSection,
    setting: FileContext,
    title: str,
    cell: ProductEntities,
    mass: MassProperties,
    levels: Sequence[Instances],
) -> None:
    """Write the assemblies of all levels with their validation properties; the outermost bears the title."""
    part = cell
    for depth, level in enumerate(levels):
        held = LEVEL_NAMES[depth]
        name = title if depth == len(levels) - 1 else f"{title} {LEVEL_NAMES[depth + 1]}"
        labels = [f"{held} {i}" for i in range(1, len(level) + 1)]
        part = write_assembly(section, setting, name, [part] * len(level), labels, level.rotation, level.translation)
        mass = _mass_of_copies(mass, level)
        write_validation_properties(section, setting, part, mass)


def _mass_of_copies(mass: MassProperties, instances: Instances) -> MassProperties:
    """Mass properties of all copies together."""
    n = len(instances)
    x, y, z = (instances.rotation @ np.array(mass.centroid) + instances.translation).mean(axis=0)
    return MassProperties(n * mass.volume, n * mass.area, (float(x), float(y), float(z)))
