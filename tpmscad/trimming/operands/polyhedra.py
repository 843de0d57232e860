"""Polyhedra and boxes as boundary representations to trim a lattice by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces
from tpmscad.brep.carriers import Plane
from tpmscad.errors import InvalidRequest
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import line_segment

FLATNESS_FRACTION = 1e-9
"""Largest distance of a corner from the plane of its face, relative to the size of the polyhedron."""


def polyhedron(corners: ArrayLike, loops: Sequence[Sequence[int]]) -> Brep:
    """The polyhedron with the given corners (N, 3), whose faces are loops of corner numbers, counter-clockwise from outside.

    The plane of a face passes through its first three corners; the second one must be convex. InvalidRequest if a face is not
    planar or the faces do not close.
    """
    points = np.asarray(corners, float)
    planes = []
    for loop in loops:
        a, b, c = points[list(loop[:3])]
        x = (b - a) / np.linalg.norm(b - a)
        normal = np.cross(x, c - a)
        planes.append(Plane(a, x, normal / np.linalg.norm(normal)))
        if np.abs(planes[-1].distance(points[list(loop)])).max() > FLATNESS_FRACTION * np.ptp(points):
            raise InvalidRequest(f"the corners {list(loop)} of a polyhedron's face do not lie in one plane")
    directed = [pair for loop in loops for pair in zip(loop, [*loop[1:], loop[0]], strict=True)]
    edges = [(i, j) for i, j in directed if i < j]
    number = {edge: n for n, edge in enumerate(edges)}
    if sorted(directed) != sorted(edges + [(j, i) for i, j in edges]) or len(number) != len(edges):
        raise InvalidRequest("each edge of a polyhedron must join two faces that use it in opposite directions")
    n, m = len(loops), len(edges)
    ends = np.array(edges, np.int64).reshape(-1, 2)
    length = np.linalg.norm(points[ends[:, 1]] - points[ends[:, 0]], axis=1)
    return Brep(
        carriers=tuple(planes),
        curves=tuple(
            line_segment(points[i], points[j], (0.0, float(s))) for (i, j), s in zip(edges, length, strict=True)
        ),
        pcurves=(),
        vertices=points,
        edges=Edges(
            curve=np.arange(m),
            motion=Motion.identity(m),
            span=np.column_stack([np.zeros(m), length]),
            start=ends[:, 0].copy(),
            end=ends[:, 1].copy(),
            deviation=np.zeros(m),
        ),
        uses=EdgeUses(
            edge=np.array([number[min(p), max(p)] for p in directed], np.int64),
            sense=np.array([1 if i < j else -1 for i, j in directed], np.int64),
            pcurve=np.full(2 * m, -1),
        ),
        faces=Faces(
            carrier=np.arange(n),
            motion=Motion.identity(n),
            sense=np.ones(n, np.int64),
            tag=np.zeros(n, np.int64),
            loop_start=np.arange(n + 1),
            use_start=np.concatenate([[0], np.cumsum([len(loop) for loop in loops])]).astype(np.int64),
        ),
        tags=("cap",),
    )


def box(lo: ArrayLike, hi: ArrayLike) -> Brep:
    """The box between two corners; the planes of its faces are exactly x, y, z = lo, then x, y, z = hi."""
    low, high = np.asarray(lo, float), np.asarray(hi, float)
    if low.shape != (3,) or high.shape != (3,) or not np.isfinite([low, high]).all() or (high <= low).any():
        raise InvalidRequest(f"a box needs finite corners lo < hi in x, y and z, not {low} and {high}")
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])  # corner number = x + 2 y + 4 z
    loops = [(0, 4, 6, 2), (0, 1, 5, 4), (0, 2, 3, 1), (1, 3, 7, 5), (2, 6, 7, 3), (4, 5, 7, 6)]
    return polyhedron(np.where(corners, high, low), loops)
