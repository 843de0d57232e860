"""Isolated components and isolated holes of a sampled solid, counted on the safe side.

Solid {f <= 0} is joined through the six faces of a sample, and so is void {f > 0}: one component and no cavity in both of these
strict senses imply the same of the trilinear interpolant. A cavity is a component of the void that does not reach the box.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.topology.components import Runs, count_voxels, label_runs, paint_labels
from tpmscad.topology.voxels import Labels


@dataclass(frozen=True, eq=False)
class PhaseComponents:
    """One phase: labels from 1 (0 is the other phase); `main` are those that belong, `errors` those that do not."""

    runs: Runs
    shape: tuple[int, int, int]
    main: IntArray
    errors: IntArray

    @cached_property
    def labels(self) -> Labels:
        """The label of each sample, (nx, ny, nz)."""
        return paint_labels(self.runs, self.shape)

    @property
    def count(self) -> int:
        """One more than the greatest label."""
        return self.runs.count + 1

    def of(self, errors: IntArray) -> BoolArray:
        """The samples of the labels given."""
        chosen = np.zeros(self.count, bool)
        chosen[errors] = True
        return chosen[self.labels] if len(errors) else np.zeros(self.shape, bool)


@dataclass(frozen=True, slots=True, eq=False)
class DefectCensus:
    """Both phases. n0: solid components beside the greatest; n2: void components that do not reach the box."""

    solid: PhaseComponents
    void: PhaseComponents

    @property
    def n0(self) -> int:
        return len(self.solid.errors)

    @property
    def n2(self) -> int:
        return len(self.void.errors)


def count_defects(values: Array) -> DefectCensus:
    """The census of sampled values (nx, ny, nz)."""
    values = np.ascontiguousarray(values)
    return DefectCensus(label_solid(values), label_void(values))


def label_solid(values: Array) -> PhaseComponents:
    """The components of {f <= 0}; the greatest belongs."""
    found = label_runs(values, 0.0, True, 6, exterior=False)
    labels = np.arange(1, found.count + 1)
    main = 1 + int(np.argmax(count_voxels(found)[1:])) if found.count else 0
    nx, ny, nz = values.shape
    return PhaseComponents(found, (nx, ny, nz), labels[labels == main], labels[labels != main])


def label_void(values: Array) -> PhaseComponents:
    """The components of {f > 0}; those that reach the border of the array are one, with label 1."""
    found = label_runs(values, 0.0, False, 6, exterior=True)
    found = replace(found, label=found.label + np.int32(1), count=found.count + 1)
    nx, ny, nz = values.shape
    return PhaseComponents(found, (nx, ny, nz), np.array([1]), np.arange(2, found.count + 1))
