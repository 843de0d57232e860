"""Strands split at vertices along them, and the vertices for roots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad.splines.bspline import Curve
from tpmscad.trimming.strands import Crossings, Strands, points_on
from tpmscad.trimming.tool import Array, Ints


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """M pieces in the order of strands and parameters: those of strand i are first[i] .. first[i + 1] - 1."""

    strand: Ints
    span: Array
    start: Ints
    end: Ints
    first: Ints


def root_vertices(
    curves: Sequence[Curve], strands: Strands, crossings: Crossings, first_vertex: int, snap: float
) -> tuple[Ints, Array]:
    """A vertex for every root (R,), and the new vertices' points: roots of one strand within `snap` are one vertex."""
    order = np.lexsort((crossings.root, crossings.root_strand))
    points = points_on(curves, strands, crossings.root_strand, crossings.root)[order]
    strand = crossings.root_strand[order]
    fresh = np.ones(len(order), bool)
    fresh[1:] = (strand[1:] != strand[:-1]) | (np.linalg.norm(np.diff(points, axis=0), axis=1) > snap)
    vertex = np.empty(len(order), np.int64)
    vertex[order] = first_vertex + np.cumsum(fresh) - 1
    return vertex, points[fresh]


def split(strands: Strands, strand: Ints, t: Array, vertex: Ints) -> Pieces:
    """The pieces of every strand between the vertices (R,) at parameters t of the strands named; one may be named twice."""
    n = len(strands)
    order = np.lexsort((t, strand))
    strand, t, v = strand[order], t[order], vertex[order]
    fresh = np.ones(len(order), bool)
    fresh[1:] = (strand[1:] != strand[:-1]) | (v[1:] != v[:-1])
    strand, t, v = strand[fresh], t[fresh], v[fresh]
    cuts = np.bincount(strand, minlength=n)
    first = np.concatenate([[0], np.cumsum(cuts + 1)])
    owner = np.repeat(np.arange(n), cuts + 1)
    m = len(owner)

    # Cut c of all is followed by piece c + 1 + (number of strands before its own).
    after = np.arange(len(strand)) + 1 + strand
    span = np.empty((m, 2))
    start, end = np.empty(m, np.int64), np.empty(m, np.int64)
    span[first[:-1], 0], span[first[1:] - 1, 1] = strands.span.T
    start[first[:-1]], end[first[1:] - 1] = strands.start, strands.end
    span[after, 0], span[after - 1, 1] = t, t
    start[after], end[after - 1] = v, v
    return Pieces(owner, span, start, end, first)
