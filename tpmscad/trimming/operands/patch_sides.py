"""The sides of every patch of a lattice: the edges that bound each side, their directions and the vertices where they start.

A lattice that can be trimmed consists of whole B-spline patches: each face has one loop, and the pcurves of its edge uses run
round the patch's parameter rectangle. A side with T-vertices, at which smaller patches meet it, has several edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import InvalidRequest
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface

SIDE_END_TOL = 1e-12
"""Tolerance on the ends of a use's pcurve, relative to the parameter domain."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchSides:
    """The U edge uses on the sides of F patches, patch by patch and counter-clockwise from the start of side 0.

    `start` (F + 1,): patch f has the uses start[f] to start[f + 1] - 1. `first` (4 F + 1,): side s of patch f has the uses
    first[4 f + s] to first[4 f + s + 1] - 1. Of each use (U,): `face`, `side` (0 to 3, as in `splines.bspline`), `edge`,
    `forward` (whether it has the direction of its edge), `pcurve`, `vertex` where it starts, and the fractions of the side
    between which it lies, `span` (U, 2).
    """

    start: IntArray
    first: IntArray
    face: IntArray
    side: IntArray
    edge: IntArray
    forward: BoolArray
    pcurve: IntArray
    vertex: IntArray
    span: Array

    @property
    def corner(self) -> IntArray:
        """The vertices at which the sides of the patches start: (F, 4)."""
        return self.vertex[self.first[:-1]].reshape(-1, 4)

    @property
    def following(self) -> IntArray:
        """The next use of the same patch: (U,)."""
        result = np.arange(1, len(self.face) + 1)
        result[self.start[1:] - 1] = self.start[:-1]
        return result

    @property
    def preceding(self) -> IntArray:
        """The use before in the same patch: (U,)."""
        result = np.arange(-1, len(self.face) - 1)
        result[self.start[:-1]] = self.start[1:] - 1
        return result

    def uses_of(self, face: int) -> range:
        """The uses of a patch, counter-clockwise."""
        return range(int(self.start[face]), int(self.start[face + 1]))

    def uses_on(self, face: int, side: int) -> range:
        """The uses on a side of a patch, in its direction."""
        return range(int(self.first[4 * face + side]), int(self.first[4 * face + side + 1]))


def read_patch_sides(brep: Brep) -> PatchSides:
    """The sides of a boundary representation of whole B-spline patches; InvalidRequest if a face is anything else."""
    faces, uses, edges = brep.faces, brep.uses, brep.edges
    n = len(faces)
    splines = all(isinstance(brep.carriers[i], BSplineSurface) for i in np.unique(faces.carrier))
    if not splines or not np.array_equal(faces.loop_start, np.arange(n + 1)):
        raise InvalidRequest("only a lattice of whole patches, with one loop each, can be trimmed")

    face = np.repeat(np.arange(n), np.diff(faces.use_start))
    start_is_low = uses.sense > 0
    keys, key = np.unique(
        np.column_stack([faces.carrier[face], uses.pcurve, uses.sense, edges.span[uses.edge]]),
        axis=0,
        return_inverse=True,
    )
    side_and_span = np.array([_locate_on_side(brep, row) for row in keys]).reshape(-1, 3)[key.ravel()]
    order = np.lexsort((side_and_span[:, 1], side_and_span[:, 0], face))
    side, span = side_and_span[order, 0].astype(np.int64), side_and_span[order, 1:]
    vertex = np.where(start_is_low, edges.start[uses.edge], edges.end[uses.edge])[order]
    first = np.searchsorted(4 * face + side, np.arange(4 * n + 1))
    found = PatchSides(
        faces.use_start, first, face, side, uses.edge[order], start_is_low[order], uses.pcurve[order], vertex, span
    )
    ends = np.where(start_is_low, edges.end[uses.edge], edges.start[uses.edge])[order]
    begins_side = np.isin(np.arange(len(face)), first)
    whole = (
        (side >= 0).all()
        and len(np.unique(first)) == len(first)
        and np.array_equal(ends, vertex[found.following])
        and np.allclose(span[:, 0], np.where(begins_side, 0.0, np.roll(span[:, 1], 1)), rtol=0, atol=SIDE_END_TOL)
        and np.allclose(span[first[1:] - 1, 1], 1.0, rtol=0, atol=SIDE_END_TOL)
    )
    if not whole:
        raise InvalidRequest("the edges of a face do not run round the four sides of its patch")
    return found


def _locate_on_side(brep: Brep, key: Array) -> tuple[float, float, float]:
    """The side on which the use with this carrier, pcurve, sense and span lies, and the fractions of it; side -1 for none."""
    surface, line = brep.carriers[int(key[0])], brep.pcurves[int(key[1])]
    assert isinstance(surface, BSplineSurface)
    if line.degree == 1 and len(line.poles) == 2:
        ends = line(key[3:] if key[2] > 0 else key[:2:-1])
        corners = surface.corners
        for side in range(4):
            begin, along = corners[side], corners[(side + 1) % 4] - corners[side]
            low, high = ((ends - begin) @ along / (along @ along)).tolist()
            off = np.abs(begin + np.outer([low, high], along) - ends).max()
            on_side = off <= SIDE_END_TOL * np.ptp(corners) and low < high
            if on_side and low >= -SIDE_END_TOL and high <= 1.0 + SIDE_END_TOL:
                return side, low, high
    return -1, 0.0, 0.0


def read_spline_curves(brep: Brep) -> tuple[BSplineCurve, ...]:
    """The edge curves of a boundary representation; InvalidRequest if one of them is no B-spline."""
    curves = tuple(c for c in brep.curves if isinstance(c, BSplineCurve))
    if len(curves) != len(brep.curves):
        raise InvalidRequest("the edges of a lattice to be trimmed must be B-splines")
    return curves


def read_patches(brep: Brep) -> dict[int, BSplineSurface]:
    """The B-spline carriers of a boundary representation, by carrier number."""
    return {c: patch for c, patch in enumerate(brep.carriers) if isinstance(patch, BSplineSurface)}
