"""The points in which two cuts meet on a patch: the patch, and both planes, in one vertex that two arcs share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpmscad.patches.complex import PatchComplex
from tpmscad.splines.bspline import Curve, Surface
from tpmscad.trimming.cuts import PatchCuts
from tpmscad.trimming.strands import Crossings, Strands, points_on
from tpmscad.trimming.tool import Array, Ints, Tool, TrimmingError

APART = 100.0
"""The same point found along two arcs differs by their deviations over the sine of their angle: at most this many tolerances."""


def meeting_points(
    lattice: PatchComplex, cuts: PatchCuts, arcs: Strands, hits: Crossings, tool: Tool, first_vertex: int, tol: float
) -> tuple[Ints, Array, Array]:
    """A vertex for every root of an arc on another plane, the new vertices' points, and the roots moved next to them.

    TrimmingError where the two arcs do not agree on the points that they share.
    """
    n = len(hits.root)
    if n == 0:
        return np.zeros(0, np.int64), np.zeros((0, 3)), hits.root
    curves = [cut.curve for cut in cuts.cuts]
    pairs = _pairs(cuts, hits, points_on(curves, arcs, hits.root_strand, hits.root), APART * tol)
    points = _on_both(lattice, cuts, hits, tool, pairs[:, 0])
    vertex = np.empty(n, np.int64)
    vertex[pairs] = first_vertex + np.arange(len(pairs))[:, None]
    root = hits.root
    for _ in range(2):  # the nearest parameter: along an arc the root of the other plane is off by more
        along = _velocity(curves, arcs, hits.root_strand, root)
        gap = points[vertex - first_vertex] - points_on(curves, arcs, hits.root_strand, root)
        root = root + np.einsum("ni,ni->n", gap, along) / np.einsum("ni,ni->n", along, along)
    return vertex, points, root


def _pairs(cuts: PatchCuts, hits: Crossings, place: Array, apart: float) -> Ints:
    """Roots (m, 2) that are one point, found on the arc of one plane and on that of the other."""
    own, other = cuts.plane[hits.root_strand], hits.root_plane
    groups: dict[tuple[int, int, int], tuple[list[int], list[int]]] = {}
    keys = zip(cuts.face[hits.root_strand].tolist(), own.tolist(), other.tolist(), strict=True)
    for i, (face, a, b) in enumerate(keys):
        groups.setdefault((face, min(a, b), max(a, b)), ([], []))[a > b].append(i)
    result = []
    for (_, a, b), (first, second) in groups.items():
        if len(first) != len(second):
            raise TrimmingError(
                f"two cuts meet on a patch seen along plane {a}, but not along plane {b}, or the reverse"
            )
        left = set(second)
        for i in first:
            j = min(left, key=lambda j: float(np.linalg.norm(place[i] - place[j])))
            if np.linalg.norm(place[i] - place[j]) > apart:
                raise TrimmingError(f"two cuts on one patch do not meet in one point near {place[i].round(6)}")
            left.remove(j)
            result.append((i, j))
    return np.array(result)


def _on_both(lattice: PatchComplex, cuts: PatchCuts, hits: Crossings, tool: Tool, root: Ints) -> Array:
    """Points on the patch and on both planes, by Newton's method from the roots (m,): (m, 3)."""
    arc = hits.root_strand[root]
    face, planes = cuts.face[arc], np.column_stack([cuts.plane[arc], hits.root_plane[root]])
    rotation, translation = lattice.faces.rotation[face], lattice.faces.translation[face]
    normal = np.einsum("mpi,mij->mpj", tool.normals[planes], rotation)
    constant = np.einsum("mpi,mi->mp", tool.normals[planes], translation) - tool.heights[planes]
    uv = np.array([cuts.cuts[c].pcurve(t) for c, t in zip(cuts.cut[arc], hits.root[root], strict=True)])
    local = np.empty((len(root), 3))
    for carrier in np.unique(lattice.faces.carrier[face]):
        at = np.flatnonzero(lattice.faces.carrier[face] == carrier)
        surface = lattice.carriers[carrier]
        assert isinstance(surface, Surface)
        p = uv[at]
        for _ in range(3):
            g = np.einsum("mpk,mk->mp", normal[at], surface(p[:, 0], p[:, 1])) + constant[at]
            slope = np.stack([surface(p[:, 0], p[:, 1], *d) for d in ((1, 0), (0, 1))], axis=2)
            p = p - np.linalg.solve(normal[at] @ slope, g[..., None])[..., 0]
        local[at] = surface(p[:, 0], p[:, 1])
    return np.einsum("mij,mj->mi", rotation, local) + translation


def _velocity(curves: Sequence[Curve], arcs: Strands, index: Ints, t: Array) -> Array:
    local = np.array([curves[arcs.curve[i]](x, 1) for i, x in zip(index, t, strict=True)])
    return np.einsum("nij,nj->ni", arcs.rotation[index], local)
