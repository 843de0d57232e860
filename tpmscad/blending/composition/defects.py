"""Topological defects of a sampled solid: isolated components and cavities, counted on the safe side.

The solid phase {f <= 0} and the void phase {f > 0} are both labelled with face connectivity. A defect of the solid is a component
besides the largest one (n0); a defect of the void is a cavity, that is a component that does not reach the border of the array
(n2). One component and no cavity in this sense imply the same for the trilinear interpolant of the samples.

The paper counts n0 and n2 in a cubical complex on the samples as vertices (section 2.3), where void voxels also join through
edges and corners. Such a count can miss cavities that the interpolant has.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.topology.components import Runs, count_voxels, label_runs, paint_labels
from tpmscad.topology.voxels import Labels

FACE_CONNECTIVITY = 6
"""Number of neighbours of a sample: those that share a face with it."""


@dataclass(frozen=True, eq=False)
class PhaseComponents:
    """The components of one phase, labelled from 1 (0 is the other phase); `sign` is +1 for solid and -1 for void.

    `main_labels` are the components that belong: the largest solid one, or the void that reaches the border. `defects` are the
    labels of all others.
    """

    sign: int
    runs: Runs
    shape: tuple[int, int, int]
    main_labels: IntArray
    defects: IntArray

    @cached_property
    def labels(self) -> Labels:
        """The label of each sample: (nx, ny, nz)."""
        return paint_labels(self.runs, self.shape)

    @property
    def n_labels(self) -> int:
        """Number of labels with that of the other phase, 0."""
        return self.runs.count + 1

    def mask_of(self, labels: IntArray) -> BoolArray:
        """Mask (nx, ny, nz) of the samples with any of the labels."""
        chosen = np.zeros(self.n_labels, bool)
        chosen[labels] = True
        return chosen[self.labels] if len(labels) else np.zeros(self.shape, bool)


@dataclass(frozen=True, slots=True, eq=False)
class DefectCensus:
    """The components of both phases. n0: number of isolated solid components; n2: number of cavities."""

    solid: PhaseComponents
    void: PhaseComponents

    @property
    def n0(self) -> int:
        """Number of isolated solid components."""
        return len(self.solid.defects)

    @property
    def n2(self) -> int:
        """Number of cavities."""
        return len(self.void.defects)


def count_defects(values: Array) -> DefectCensus:
    """The topological defects of sampled values (nx, ny, nz)."""
    values = np.ascontiguousarray(values)
    return DefectCensus(label_solid(values), label_void(values))


def label_solid(values: Array) -> PhaseComponents:
    """The components of {f <= 0}; all but the largest are defects."""
    runs = label_runs(values, 0.0, True, FACE_CONNECTIVITY, exterior=False)
    labels = np.arange(1, runs.count + 1)
    main = 1 + int(np.argmax(count_voxels(runs)[1:])) if runs.count else 0
    nx, ny, nz = values.shape
    return PhaseComponents(1, runs, (nx, ny, nz), labels[labels == main], labels[labels != main])


def label_void(values: Array) -> PhaseComponents:
    """The components of {f > 0}; those that reach the border of the array count as one, with label 1, and are no defect."""
    runs = label_runs(values, 0.0, False, FACE_CONNECTIVITY, exterior=True)
    runs = replace(runs, label=runs.label + np.int32(1), count=runs.count + 1)
    nx, ny, nz = values.shape
    return PhaseComponents(-1, runs, (nx, ny, nz), np.array([1]), np.arange(2, runs.count + 1))
