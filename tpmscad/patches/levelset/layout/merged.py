"""Where vertices of a layout would be that two of its own are merged to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.fields.field import Field
from tpmscad.patches.levelset.layout.octree import Array, Ints, Mask
from tpmscad.patches.levelset.layout.vectors import TINY, unit


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Vertices (V, 3) of a layout on a field, the surface's normals there, and which coordinates lie on the box."""

    field: Field
    vertices: Array
    normals: Array
    fixed: Mask

    def with_merged(self, goes: Ints, stays: Ints) -> Surface:
        """With a vertex more for each pair, (n,), of which one goes into the other, near where that would be."""
        one, other = self.vertices[goes], self.vertices[stays]
        fixed = self.fixed[stays]
        points, normals = other.copy(), self.normals[stays].copy()
        between = np.flatnonzero(fixed.sum(axis=1) <= self.fixed[goes].sum(axis=1))
        chord, free = (other - one)[between], ~fixed[between]
        # the middle of the cubic along the chord that is tangent to the surface at its ends, and one step of Newton's
        lift = [np.einsum("ni,ni->n", chord, n)[:, None] * n for n in (self.normals[goes[between]], normals[between])]
        middle = 0.5 * (one + other)[between] + np.where(free, lift[1] - lift[0], 0.0) / 8
        value, slope = self.field.value_and_gradient(middle)
        along = np.where(free, slope, 0.0)
        step = -(value / np.maximum(np.einsum("ni,ni->n", along, along), TINY))[:, None] * along
        reach = np.linalg.norm(chord, axis=1) / np.maximum(np.linalg.norm(step, axis=1), TINY)
        points[between] = middle + np.minimum(1.0, reach)[:, None] * step
        normals[between] = unit(slope)
        return Surface(
            self.field,
            np.concatenate([self.vertices, points]),
            np.concatenate([self.normals, normals]),
            np.concatenate([self.fixed, fixed]),
        )
