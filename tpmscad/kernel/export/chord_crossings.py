"""Chords of a face's edges that cross each other in its parameters: OCCT's triangulation of such loops may never end.

Two edges that lie close together, as at a thin sliver or at a cusp, cross where the chord of one leaves its curve by more than
the distance between the two. It is that chord, the one with the greater sagitta, that has to become shorter: where both edges are
divided further, the chords of a cusp go on crossing, as their lengths keep their ratio.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve2d
from OCP.TopoDS import TopoDS_Face

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.kernel.measure.loop_nodes import evaluate_pcurve
from tpmscad.kernel.occt.exploration import edges_of

CROSSING_REL_TOL = 1e-9
"""In extents of the loops: chords whose ends lie no farther beyond the line of the other touch, and do not cross."""


def find_crossing_uses(face: TopoDS_Face, lines: Sequence[tuple[Array, Array]], ends: IntArray) -> BoolArray:
    """The uses of edges, with nodes at given parameters, whose chords cross others and have the greater sagitta.

    ends (k, 2): the vertices of each use at its first and last node. Chords with a common vertex do not cross.
    """
    edges = [edge for edge in edges_of(face) if not BRep_Tool.Degenerated_s(edge)]
    pcurves = [BRepAdaptor_Curve2d(edge, face) for edge in edges]
    counts = np.array([len(t) for t, _ in lines])
    uv = np.concatenate([evaluate_pcurve(curve, t) for curve, (t, _) in zip(pcurves, lines, strict=True)])
    start = np.cumsum(counts) - counts
    begin = np.delete(np.arange(len(uv)), start + counts - 1)
    node = ends.max() + 1 + np.arange(len(uv))
    node[start], node[start + counts - 1] = ends.T
    size = np.ptp(uv, axis=0)
    order = np.argsort(np.minimum(uv[begin, 0], uv[begin + 1, 0]), kind="stable")
    begin = begin[order]
    pairs = _cross_chords(uv / size, begin, node, CROSSING_REL_TOL)
    crossing = np.zeros(len(edges), bool)
    use = np.searchsorted(start, begin, side="right") - 1
    for pair in pairs:
        sagitta = [_measure_sagitta(pcurves[use[i]], lines[use[i]][0], begin[i] - start[use[i]], size) for i in pair]
        if max(sagitta) > CROSSING_REL_TOL:  # of straight edges no division helps
            crossing[use[pair[int(np.argmax(sagitta))]]] = True
    return crossing


def _measure_sagitta(pcurve: BRepAdaptor_Curve2d, t: Array, at: int, size: Array) -> float:
    """Distance of the middle of a pcurve between two nodes from the middle of its chord, in extents of the loops."""
    points = evaluate_pcurve(pcurve, np.array([t[at], 0.5 * (t[at] + t[at + 1]), t[at + 1]])) / size
    return float(np.linalg.norm(points[1] - 0.5 * (points[0] + points[2])))


@njit_cached
def _cross_chords(uv: Array, begin: IntArray, node: IntArray, tol: float) -> IntArray:
    """Pairs of chords, sorted by their least u, from points begin[i] to begin[i] + 1, that cross."""
    found = []
    for i in range(len(begin)):
        a, b = begin[i], begin[i] + 1
        far = max(uv[a, 0], uv[b, 0])
        for j in range(i + 1, len(begin)):
            c, d = begin[j], begin[j] + 1
            if min(uv[c, 0], uv[d, 0]) > far:
                break
            if min(uv[c, 1], uv[d, 1]) > max(uv[a, 1], uv[b, 1]) or max(uv[c, 1], uv[d, 1]) < min(uv[a, 1], uv[b, 1]):
                continue
            if node[a] == node[c] or node[a] == node[d] or node[b] == node[c] or node[b] == node[d]:
                continue
            if _parts(uv[a], uv[b], uv[c], uv[d], tol) and _parts(uv[c], uv[d], uv[a], uv[b], tol):
                found.append((i, j))
    pairs = np.empty((len(found), 2), np.int64)
    for k in range(len(found)):
        pairs[k, 0], pairs[k, 1] = found[k]
    return pairs


@njit_cached
def _parts(a: Array, b: Array, p: Array, q: Array, tol: float) -> bool:
    """Whether two points lie on different sides of the line through a and b, both farther from it than `tol`."""
    x, y = b[0] - a[0], b[1] - a[1]
    one = x * (p[1] - a[1]) - y * (p[0] - a[0])
    two = x * (q[1] - a[1]) - y * (q[0] - a[0])
    bound = tol * math.sqrt(x * x + y * y)
    return (one > bound and two < -bound) or (one < -bound and two > bound)
