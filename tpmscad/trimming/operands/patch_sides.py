"""The sides of whole patches: which edge bounds each side of each face, from which vertex, in which direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import InvalidRequest
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface


@dataclass(frozen=True, slots=True, eq=False)
class PatchSides:
    """Side s of face f, numbered and run counter-clockwise as in `splines.bspline`; every array is (F, 4).

    `forward`: the side runs along the edge's parameter. `corner`: the vertex where the side starts.
    """

    edge: IntArray
    forward: NDArray[np.bool_]
    pcurve: IntArray
    corner: IntArray


def read_patch_sides(brep: Brep) -> PatchSides:
    """The sides of a complex of whole B-spline patches; InvalidRequest where a face is anything else."""
    faces, uses, edges = brep.faces, brep.uses, brep.edges
    n = len(faces)
    whole = (
        all(isinstance(brep.carriers[i], BSplineSurface) for i in np.unique(faces.carrier))
        and np.array_equal(faces.loop_start, np.arange(n + 1))
        and np.array_equal(faces.use_start, 4 * np.arange(n + 1))
    )
    if not whole:
        raise InvalidRequest("only a complex of whole patches, one loop of four sides each, can be trimmed")

    carrier = np.repeat(faces.carrier, 4)
    start_is_low = uses.sense > 0
    span = edges.span[uses.edge]
    keys, key = np.unique(np.column_stack([carrier, uses.pcurve, uses.sense, span]), axis=0, return_inverse=True)
    side_of_key = np.array([_identify_side(brep, row) for row in keys])
    order = np.argsort(4 * np.repeat(np.arange(n), 4) + side_of_key[key.ravel()], kind="stable")
    if not np.array_equal(side_of_key[key.ravel()][order].reshape(n, 4), np.tile(np.arange(4), (n, 1))):
        raise InvalidRequest("a face's four uses are not the four sides of its patch")
    vertex = np.where(start_is_low, edges.start[uses.edge], edges.end[uses.edge])
    edge, pcurve, corner = (a[order].reshape(n, 4) for a in (uses.edge, uses.pcurve, vertex))
    return PatchSides(edge, start_is_low[order].reshape(n, 4), pcurve, corner)


def _identify_side(brep: Brep, key: Array) -> int:
    """Which side the use with this carrier, parameter curve, sense and span is; -1 if its line is no whole side."""
    surface, line = brep.carriers[int(key[0])], brep.pcurves[int(key[1])]
    assert isinstance(surface, BSplineSurface)
    ends = line(key[3:] if key[2] > 0 else key[:2:-1])
    corners = surface.corners
    for side in range(4):
        whole = np.array_equal(ends, corners[[side, (side + 1) % 4]]) or np.allclose(
            ends, corners[[side, (side + 1) % 4]], rtol=0, atol=1e-12 * np.ptp(corners)
        )
        if whole and line.degree == 1 and len(line.poles) == 2:
            return side
    return -1


def read_spline_curves(brep: Brep) -> tuple[BSplineCurve, ...]:
    """The curves of the complex's edges, which whole B-spline patches have as B-splines too; else InvalidRequest."""
    curves = tuple(c for c in brep.curves if isinstance(c, BSplineCurve))
    if len(curves) != len(brep.curves):
        raise InvalidRequest("the edges of a lattice to be trimmed must be B-splines")
    return curves
