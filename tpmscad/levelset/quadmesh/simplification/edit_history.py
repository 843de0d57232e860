"""The edits of a simplified mesh, of which those near polygons that a fit rejects can be undone.

An edit can be undone only after the later edits of the polygons that it made. The vertices round it return to where they were
before it, and are smoothed if that improves the polygons there. Polygons that are rejected again after they came back get the
original positions exactly.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.quality import corner_distortion, interior_distortion
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import AppliedEdit, PolygonMesh, extract_mesh, sides_of
from tpmscad.levelset.quadmesh.smoothing import smooth_vertices
from tpmscad.levelset.quadmesh.vectors import normalize

RINGS_AROUND_UNDONE = 2
SWEEPS_AFTER_UNDO = 40
"""Rings of polygons round restored ones that are smoothed, and the number of sweeps."""


@dataclass(frozen=True, slots=True, eq=False)
class RecordedEdit:
    """An applied edit, and vertices (n,) round it with their positions (n, 3) before."""

    applied: AppliedEdit
    vertices: IntArray
    positions: Array


class EditHistory:
    """A simplified mesh and the edits by number that led to it and still stand.

    Polygons numbered below the original's count are the original's, row by row. Positions (V, 3) and sizes (V,) are
    those of all vertices of the original.
    """

    def __init__(
        self,
        original: QuadMesh,
        polygons: PolygonMesh,
        vertices: Array,
        size: Array,
        edits: Sequence[RecordedEdit],
        field: Field,
        lo: Array,
        hi: Array,
    ) -> None:
        self._original, self._field, self._lo, self._hi = original, field, lo, hi
        self.polygons, self._vertices, self._size = polygons, vertices, size
        self.edits = dict(enumerate(edits))
        self._edit_that_made = {number: i for i, each in self.edits.items() for number in each.applied.new_numbers}
        self._edit_that_removed = {number: i for i, each in self.edits.items() for number in each.applied.old_polygons}
        self._pinned = np.zeros(len(original.vertices), bool)

    def mesh(self) -> tuple[QuadMesh, IntArray]:
        """The present mesh, and the number of each of its polygons (Q,)."""
        numbers = sorted(self.polygons.corners_of)
        return extract_mesh(self.polygons, self._vertices, self._size, numbers)[0], np.array(numbers, np.int64)

    def undo(self, numbers: Iterable[int], levels: int) -> bool:
        """Undo the edits that made the polygons of these numbers, and what surrounds them the deeper the higher `levels` is.

        The region grows by `levels` - 1 rings, and edits are undone `levels` generations back. False if nothing changes: all
        these polygons are original ones at their original positions.
        """
        corners_of, at_vertex = self.polygons.corners_of, self.polygons.polygons_at_vertex
        region = {n for n in numbers if n in corners_of}
        came_back = {v for n in region if n not in self._edit_that_made for v in corners_of[n]}
        for _ in range(levels - 1):
            region |= {f for n in region for v in corners_of[n] for f in at_vertex[v]}
        chosen: set[int] = set()
        for _ in range(levels):
            makers = {self._edit_that_made[n] for n in region if n in self._edit_that_made}
            chosen |= self._dependents_of(makers - chosen)
            region |= {n for i in chosen for n in self.edits[i].applied.old_polygons}
        while conflicting := self._conflicting_edits(chosen) - chosen:
            chosen |= self._dependents_of(conflicting)
        for i in sorted(chosen, reverse=True):
            region |= self._undo_edit(i)
        restored = list({v for n in region if n in corners_of for v in corners_of[n]})
        candidates = came_back if chosen else restored
        pin = [v for v in candidates if not any(n in self._edit_that_made for n in at_vertex[v])]
        if not chosen and self._pinned[pin].all():
            return False
        self._pinned[pin] = True
        self._size[restored] = self._original.size[restored]
        self._vertices[pin] = self._original.vertices[pin]
        self._smooth_around(set(restored))
        return True

    def _undo_edit(self, i: int) -> set[int]:
        """Undo one edit; the numbers of the polygons that come back."""
        recorded = self.edits.pop(i)
        applied = recorded.applied
        self.polygons.undo(applied)
        self._vertices[recorded.vertices] = recorded.positions
        for number in applied.new_numbers:
            del self._edit_that_made[number]
        for number in applied.old_polygons:
            del self._edit_that_removed[number]
        return set(applied.old_polygons)

    def _dependents_of(self, chosen: Iterable[int]) -> set[int]:
        """The chosen edits and all later edits of the polygons that they made."""
        found: set[int] = set()
        stack = list(chosen)
        while stack:
            i = stack.pop()
            if i not in found:
                found.add(i)
                made = self.edits[i].applied.new_numbers
                stack += [self._edit_that_removed[n] for n in made if n in self._edit_that_removed]
        return found

    def _conflicting_edits(self, chosen: set[int]) -> set[int]:
        """Edits that made a half-edge which the polygons restored by undoing the chosen edits would have, too."""
        gone = {n for i in chosen for n in self.edits[i].applied.new_numbers}
        restored = {n: p for i in chosen for n, p in self.edits[i].applied.old_polygons.items() if n not in gone}
        edges = (edge for polygon in restored.values() for edge in sides_of(polygon))
        owners = {self.polygons.polygon_of_half_edge.get(edge, -1) for edge in edges} - gone
        return {self._edit_that_made[n] for n in owners if n in self._edit_that_made}

    def _smooth_around(self, near: set[int]) -> None:
        """Smooth the vertices within RINGS_AROUND_UNDONE rings of `near` that are not pinned."""
        corners_of, at_vertex = self.polygons.corners_of, self.polygons.polygons_at_vertex
        for _ in range(RINGS_AROUND_UNDONE):
            near = {w for v in near for f in at_vertex[v] for w in corners_of[f]}
        free = np.zeros(len(self._vertices), bool)
        free[list(near)] = True
        free &= ~self._pinned
        touched = sorted({f for v in np.flatnonzero(free).tolist() for f in at_vertex[v]})
        if touched:
            part, ids = extract_mesh(self.polygons, self._vertices, self._size, touched)
            smoothed = smooth_vertices(part, free[ids], self._field, self._lo, self._hi, SWEEPS_AFTER_UNDO)
            vertices = self._vertices.copy()
            vertices[ids] = smoothed.vertices
            before, after = (self._measure_distortion(positions, touched) for positions in (self._vertices, vertices))
            if after < max(before, 1.0):  # vertices that were drawn far together tangle the polygons round them
                self._vertices = vertices

    def _measure_distortion(self, vertices: Array, numbers: list[int]) -> float:
        """The largest distortion of the polygons of these numbers, with all vertices (V, 3) at the given positions."""
        rows, fixed = self.polygons.rows[numbers], self._original.fixed
        normals = normalize(self._field.gradient(vertices))
        corner = corner_distortion(vertices, normals, fixed, rows)
        inside = interior_distortion(self._field, vertices, normals, fixed, rows)
        return float(max(corner.max(), inside.max()))
