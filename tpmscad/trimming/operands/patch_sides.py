"""The four sides of every patch of a lattice: the edge that bounds each side, its direction and the vertex where it starts.

A lattice that can be trimmed consists of whole B-spline patches: each face has one loop of four edge uses, and the pcurve of
each use is one side of the patch's parameter rectangle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import InvalidRequest
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface

SIDE_END_TOL = 1e-12
"""Tolerance on the ends of a side's pcurve, relative to the parameter domain."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchSides:
    """Side s of face f, numbered and directed counter-clockwise as in `splines.bspline`; every array is (F, 4).

    `forward`: the side has the direction of its edge. `corner`: the vertex where the side starts.
    """

    edge: IntArray
    forward: BoolArray
    pcurve: IntArray
    corner: IntArray


def read_patch_sides(brep: Brep) -> PatchSides:
    """The sides of a boundary representation of whole B-spline patches; InvalidRequest if a face is anything else."""
    faces, uses, edges = brep.faces, brep.uses, brep.edges
    n = len(faces)
    whole = (
        all(isinstance(brep.carriers[i], BSplineSurface) for i in np.unique(faces.carrier))
        and np.array_equal(faces.loop_start, np.arange(n + 1))
        and np.array_equal(faces.use_start, 4 * np.arange(n + 1))
    )
    if not whole:
        raise InvalidRequest("only a lattice of whole patches, with one loop of four sides each, can be trimmed")

    carrier = np.repeat(faces.carrier, 4)
    start_is_low = uses.sense > 0
    span = edges.span[uses.edge]
    keys, key = np.unique(np.column_stack([carrier, uses.pcurve, uses.sense, span]), axis=0, return_inverse=True)
    side_of_key = np.array([_identify_side(brep, row) for row in keys])
    order = np.argsort(4 * np.repeat(np.arange(n), 4) + side_of_key[key.ravel()], kind="stable")
    if not np.array_equal(side_of_key[key.ravel()][order].reshape(n, 4), np.tile(np.arange(4), (n, 1))):
        raise InvalidRequest("the four edges of a face are not the four sides of its patch")
    vertex = np.where(start_is_low, edges.start[uses.edge], edges.end[uses.edge])
    edge, pcurve, corner = (a[order].reshape(n, 4) for a in (uses.edge, uses.pcurve, vertex))
    return PatchSides(edge, start_is_low[order].reshape(n, 4), pcurve, corner)


def _identify_side(brep: Brep, key: Array) -> int:
    """The side of the edge use with this carrier, pcurve, sense and span; -1 if the pcurve is not a whole side."""
    surface, line = brep.carriers[int(key[0])], brep.pcurves[int(key[1])]
    assert isinstance(surface, BSplineSurface)
    ends = line(key[3:] if key[2] > 0 else key[:2:-1])
    corners = surface.corners
    for side in range(4):
        whole = np.array_equal(ends, corners[[side, (side + 1) % 4]]) or np.allclose(
            ends, corners[[side, (side + 1) % 4]], rtol=0, atol=SIDE_END_TOL * np.ptp(corners)
        )
        if whole and line.degree == 1 and len(line.poles) == 2:
            return side
    return -1


def read_spline_curves(brep: Brep) -> tuple[BSplineCurve, ...]:
    """The edge curves of a boundary representation; InvalidRequest if one of them is no B-spline."""
    curves = tuple(c for c in brep.curves if isinstance(c, BSplineCurve))
    if len(curves) != len(brep.curves):
        raise InvalidRequest("the edges of a lattice to be trimmed must be B-splines")
    return curves


def read_patches(brep: Brep) -> dict[int, BSplineSurface]:
    """The B-spline carriers of a boundary representation, by carrier number."""
    return {c: patch for c, patch in enumerate(brep.carriers) if isinstance(patch, BSplineSurface)}
