"""Isolated components and isolated holes of a sampled solid, counted on the safe side.

Solid {f <= 0} is joined through the six faces of a sample, and so is void {f > 0}: one component and no cavity in both of these
strict senses imply the same of the trilinear interpolant. A cavity is a component of the void that does not reach the box.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tpmscad.blend.grid import Array, Ints, Mask

Labels = NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class Phase:
    """One phase labelled: labels (nx, ny, nz) from 1, 0 in the other phase; `main` labels that belong, `errors` that do not."""

    labels: Labels
    sizes: Ints
    main: Ints
    errors: Ints

    def of(self, errors: Ints) -> Mask:
        """The samples of the labels given."""
        chosen = np.zeros(len(self.sizes), bool)
        chosen[errors] = True
        return chosen[self.labels]


@dataclass(frozen=True, slots=True, eq=False)
class Census:
    """Both phases. n0: solid components beside the greatest; n2: void components that do not reach the box."""

    solid: Phase
    void: Phase

    @property
    def n0(self) -> int:
        return len(self.solid.errors)

    @property
    def n2(self) -> int:
        return len(self.void.errors)


def census(values: Array) -> Census:
    """The census of sampled values (nx, ny, nz)."""
    solid = values <= 0
    return Census(solid_phase(solid), void_phase(~solid))


def solid_phase(solid: Mask) -> Phase:
    labels, count = ndimage.label(solid)
    sizes = np.bincount(labels.ravel(), minlength=count + 1) if count > 1 else np.array([0] * (count + 1))
    if count <= 1:
        return Phase(labels, sizes, np.arange(1, count + 1), np.arange(0))
    main = 1 + int(np.argmax(sizes[1:]))
    errors = np.delete(np.arange(1, count + 1), main - 1)
    return Phase(labels, sizes, np.array([main]), errors)


def void_phase(void: Mask) -> Phase:
    labels, count = ndimage.label(void)
    outside = np.zeros(count + 1, bool)
    for axis in range(3):
        for end in (0, -1):
            outside[np.unique(np.take(labels, end, axis))] = True
    outside[0] = False
    errors = np.flatnonzero(~outside[1:]) + 1
    sizes = np.bincount(labels.ravel(), minlength=count + 1) if len(errors) else np.zeros(count + 1, np.int64)
    return Phase(labels, sizes, np.flatnonzero(outside), errors)
