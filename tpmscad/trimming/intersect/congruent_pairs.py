"""Classes of congruent pairs of faces: copies of a patch that meet a plane, or copies of another face, in the same place.

A pair is described in the frame of the second face, the base: the carrier of the base, the plane of the first face or its carrier
and its placement, and the parameters of the curves' ends on the base. The curves of one pair of a class, moved with the base, are
those of the others. Descriptions are rounded: that may split a class, which costs a further trace.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Plane
from tpmscad.trimming.intersect.network_hits import CurveEnds

RESOLUTION = 1e-10
"""Resolution of placements, relative to the size of the operands; that of copies is round-off, some 1e-15."""

PARAMETER_RESOLUTION = 1e-7
"""That of the ends' parameters, which tell curves of one placement apart."""


def sort_ends(ends: CurveEnds) -> CurveEnds:
    """The ends of each pair by their parameters on the second face, in the same order for all pairs of a class."""
    row = np.repeat(np.arange(len(ends.pairs)), np.diff(ends.start))
    s, r = _round(ends.parameters[:, 2:], PARAMETER_RESOLUTION).T
    order = np.lexsort((r, s, row))
    return CurveEnds(ends.pairs, ends.start, ends.parameters[order], ends.enters[order], ends.vertex[order])


def group_congruent_pairs(
    first: Brep, second: Brep, ends: CurveEnds, rows: IntArray, domains: tuple[Array, Array] | None = None
) -> IntArray:
    """Of the pairs in `rows` (n,), whose ends are sorted, the number (n,) of the first one of each one's class.

    domains: of the parameters of all faces, (F, 4) and (G, 4), which are alike in a class, too, if they are given. Curves with
    ends need none; of a quadric, faces with loops elsewhere are known in other parts.
    """
    like, count = np.arange(len(rows)), np.diff(ends.start)[rows]
    if not len(rows):
        return like
    keys = _describe_pairs(first, second, ends.pairs[rows])
    if domains is not None:
        within = [
            _round(own[face], PARAMETER_RESOLUTION) for own, face in zip(domains, ends.pairs[rows].T, strict=True)
        ]
        keys = np.column_stack([keys, *within])
    for n in np.unique(count).tolist():
        own = np.flatnonzero(count == n)
        at = ends.start[rows[own]][:, None] + np.arange(n)
        parameters = _round(ends.parameters[at, 2:].reshape(len(own), 2 * n), PARAMETER_RESOLUTION)
        key = np.column_stack([keys[own], parameters, ends.enters[at]])
        _, representative, label = np.unique(key, axis=0, return_index=True, return_inverse=True)
        like[own] = own[representative[label.ravel()]]
    return like


def _describe_pairs(first: Brep, second: Brep, pairs: IntArray) -> IntArray:
    """Rows (n, k) that are equal for pairs (n, 2) of congruent faces."""
    f, g = pairs.T
    base, placed = second.faces.motion[g], first.faces.motion[f]
    size = max(float(np.ptp(own.vertices, axis=0).max()) for own in (first, second))
    relative = placed.relative_to(base)
    numbers = np.column_stack([second.faces.carrier[g], second.faces.sense[g], base.handedness, first.faces.carrier[f]])
    sense = first.faces.sense[f]
    rotation = relative.rotation.reshape(len(f), 9)
    translation = relative.translation / size
    for c in np.unique(first.faces.carrier[f]).tolist():
        plane, own = first.carriers[c], first.faces.carrier[f] == c
        if isinstance(plane, Plane):
            motion = relative[own]
            normal = motion.apply_to_vectors(sense[own][:, None] * plane.normal)
            rotation[own], translation[own] = 0.0, 0.0
            rotation[own, :3] = normal
            translation[own, 0] = np.einsum("nd,nd->n", motion.apply(plane.origin), normal) / size
            numbers[own, 3], sense = -1, np.where(own, 0, sense)
    return np.column_stack([numbers, sense, _round(rotation), _round(translation)])


def _round(values: Array, resolution: float = RESOLUTION) -> IntArray:
    """Values as multiples of a resolution."""
    return np.rint(values / resolution).astype(np.int64)
