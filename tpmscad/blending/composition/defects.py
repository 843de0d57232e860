"""Topological defects of a sampled solid: isolated components and cavities, counted on the safe side.

The solid phase {f <= 0} and the void phase {f > 0} are both labelled with face connectivity. A defect of the solid is a component
besides the largest one (n0); a defect of the void is a cavity, that is a component that does not reach the border of the array
(n2). One component and no cavity in this sense imply the same for the trilinear interpolant of the samples.

The paper counts n0 and n2 in a cubical complex on the samples as vertices (section 2.3), where void voxels also join through
edges and corners. Such a count can miss cavities that the interpolant has.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.topology.components import EXTERIOR, label_samples
from tpmscad.topology.voxels import Labels

FACE_CONNECTIVITY = 6
"""Number of neighbours of a sample: those that share a face with it."""


@dataclass(frozen=True, eq=False)
class PhaseComponents:
    """The components of one phase: `sign` is +1 for solid and -1 for void.

    `labels` (nx, ny, nz) are from 1 on and less than `n_labels`; 0 is the other phase. `main_labels` are the components that
    belong: the largest solid one, or the void that reaches the border. `defects` are the labels of all others.
    """

    sign: int
    labels: Labels
    n_labels: int
    main_labels: IntArray
    defects: IntArray

    def mask_of(self, labels: IntArray) -> BoolArray:
        """Mask (nx, ny, nz) of the samples with any of the labels."""
        chosen = np.zeros(self.n_labels, bool)
        chosen[labels] = True
        return chosen[self.labels] if len(labels) else np.zeros(self.labels.shape, bool)


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
    labels, count = label_samples(values <= 0.0, FACE_CONNECTIVITY)
    numbers = np.arange(1, count + 1)
    main = 1 + int(np.argmax(np.bincount(labels.reshape(-1))[1:])) if count else 0
    return PhaseComponents(1, labels, count + 1, numbers[numbers == main], numbers[numbers != main])


def label_void(values: Array) -> PhaseComponents:
    """The components of {f > 0}; those that reach the border of the array count as one, and are no defect."""
    labels, count = label_samples(values > 0.0, FACE_CONNECTIVITY, exterior=True)
    return PhaseComponents(-1, labels, count + 1, np.array([EXTERIOR]), np.arange(EXTERIOR + 1, count + 1))
