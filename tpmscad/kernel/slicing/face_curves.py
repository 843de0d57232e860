"""The curves in which horizontal planes cut faces, each face by itself, from edge to edge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.loops import follow_paths
from tpmscad.index_ranges import expand_ranges
from tpmscad.kernel.slicing.chord_splitting import split_chords
from tpmscad.kernel.slicing.level_crossings import LevelSets, OutlinedFaces, find_crossings
from tpmscad.kernel.slicing.level_refinement import resolve_levels

CONTOUR_REL_TOL = 1e-10
"""Distance from the level, in sizes of the solid, up to which a point counts as one of the contour."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceCurves:
    """Curves in which faces are cut, sorted by their levels; each lies in one face at one level.

    points: curve after curve, (n, 2). starts: where each begins, and n, (c + 1,). level: (c,). closed: (c,). ends: the names of
    the chords of edges on which each begins and ends, (c, 2). area: integral of x dy along each exact curve, which is the area
    within closed ones, (c,). rise: y of its end less that of its beginning, (c,). length: (c,). unresolved: number of its chords
    that are too long, (c,).
    """

    points: Array
    starts: IntArray
    level: IntArray
    closed: BoolArray
    ends: IntArray
    area: Array
    rise: Array
    length: Array
    unresolved: IntArray


def cut_faces(faces: OutlinedFaces, sets: LevelSets, chord_error: float) -> FaceCurves:
    """The curves in which faces are cut; levels are numbered as the sets have them."""
    faces = replace(faces, mesh=resolve_levels(faces.mesh, faces.surfaces, sets))
    crossings = find_crossings(faces, sets)
    arcs = split_chords(crossings, faces.surfaces, sets.heights, chord_error, CONTOUR_REL_TOL * sets.size)
    n = len(arcs.point)
    following = np.full(n, -1)
    following[arcs.tail] = arcs.head
    order, starts = follow_paths(following)
    by_level = np.argsort(arcs.level[order[starts[:-1]]], kind="stable")
    path, index = expand_ranges(starts[:-1][by_level], starts[1:][by_level])
    order, starts = order[index], np.searchsorted(path, np.arange(len(by_level) + 1))
    ends = np.stack([order[starts[:-1]], order[starts[1:] - 1]], axis=1)
    closed = following[ends[:, 1]] >= 0
    a, b = arcs.point[arcs.tail], arcs.point[arcs.head]
    own = np.empty(n, np.int64)  # the curve of each point
    own[order] = path
    areas = 0.5 * (a[:, 0] + b[:, 0]) * (b[:, 1] - a[:, 1]) + arcs.beyond
    area, length = (np.bincount(own[arcs.tail], each, len(by_level)).astype(float) for each in (areas, arcs.length))
    return FaceCurves(
        points=arcs.point[order],
        starts=starts,
        level=arcs.level[ends[:, 0]],
        closed=closed,
        ends=np.append(crossings.chord, np.full(n - len(crossings.chord), -1))[ends],
        area=area,
        rise=np.where(closed, 0.0, arcs.point[ends[:, 1], 1] - arcs.point[ends[:, 0], 1]),
        length=length,
        unresolved=np.bincount(own[arcs.unresolved], minlength=len(by_level)),
    )


def join_curves(parts: Sequence[FaceCurves], level_from: Sequence[int]) -> FaceCurves:
    """The curves of several batches of faces, whose levels are numbered from a first one on."""
    nothing, numbers = np.zeros(0), np.zeros(0, np.int64)
    pairs, flags = np.zeros((0, 2)), np.zeros(0, bool)
    none = FaceCurves(
        pairs, np.zeros(1, np.int64), numbers, flags, pairs.astype(int), nothing, nothing, nothing, numbers
    )
    parts, level_from = [none, *parts], [0, *level_from]
    sizes = np.concatenate([np.diff(part.starts) for part in parts])
    columns = ("closed", "ends", "area", "rise", "length", "unresolved")
    return FaceCurves(
        np.concatenate([part.points for part in parts]),
        np.append(0, np.cumsum(sizes)),
        np.concatenate([part.level + first for part, first in zip(parts, level_from, strict=True)]),
        *(np.concatenate([getattr(part, name) for part in parts]) for name in columns),
    )
