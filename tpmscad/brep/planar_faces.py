"""Planar faces whose loops are simple beyond doubt: they lie in the plane, cross nothing, and bound one region.

The edges become chords, each fattened by a bound on its distance from the curve. If all chords that do not share an end stay
farther apart than their fat and the tolerance, the loops neither cross nor touch; orientation and nesting follow from areas and
from rays. What is in doubt (short edges, spikes, near contacts) is left out: such a face may be valid, but another check has to
say so.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Plane
from tpmscad.brep.near_balls import find_near_balls
from tpmscad.errors import OutOfMemory

CHORDS_PER_EDGE = (6, 12, 24, 48)
"""Chords of an edge of median length, in successive attempts; longer and shorter edges have chords of the same length."""

MAX_CHORDS = 20_000
"""Chords of a face, besides two of each edge: a loop of short edges and a few that are a million times as long has longer ones,
and stays in doubt if they do not show that it is simple."""

LENGTH_SAMPLES = 9
"""Points from which the length of an edge is estimated."""

FAT_SAFETY = 4.0
"""Factor from the distance of the curve from the middles of its chords to the bound on its distance anywhere."""

WEDGE_SAFETY = 2.0
"""Consecutive chords must enclose more than this times the angles, fat over length, by which their curves may leave them."""


def find_simple_planar_faces(brep: Brep, tol: float, among: IntArray | None = None) -> BoolArray:
    """Whether a face is planar and its loops are certainly simple, nested and oriented, with gaps up to `tol` at most.

    One flag for each face of `among`, by default for all faces.
    """
    faces = brep.faces
    among = np.arange(len(faces)) if among is None else among
    on_plane = np.array([isinstance(c, Plane) for c in brep.carriers], bool)[faces.carrier]
    return np.array([on_plane[face] and _is_simple_planar(brep, face, tol) for face in among.tolist()], bool)


def _is_simple_planar(brep: Brep, face: int, tol: float) -> bool:
    faces, edge = brep.faces, brep.uses.edge
    starts = faces.use_start[int(faces.loop_start[face]) : int(faces.loop_start[face + 1]) + 1]
    uses = np.arange(starts[0], starts[-1])
    plane, motion = brep.carriers[int(faces.carrier[face])], faces.motion[face]
    assert isinstance(plane, Plane)
    loop_of_use = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    spans = np.column_stack([brep.edges.curve[edge[uses]], brep.edges.span[edge[uses]]])
    distinct, of_use = np.unique(spans, axis=0, return_inverse=True)
    samples = (brep.curves[int(k)](np.linspace(low, high, LENGTH_SAMPLES)) for k, low, high in distinct.tolist())
    lengths = np.array([np.linalg.norm(np.diff(points, axis=0), axis=1).sum() for points in samples])[of_use.ravel()]
    for count in CHORDS_PER_EDGE:
        step = max(float(np.median(lengths)) / count, float(lengths.sum()) / MAX_CHORDS)
        chords = np.maximum(np.ceil(lengths / step), 2).astype(int)
        points = motion.apply_inverse(_sample(brep, uses, 2 * chords + 1))
        if float(np.abs(plane.distance(points)).max()) > tol:
            return False
        flat = np.split(plane.parameters(points), np.cumsum(2 * chords + 1)[:-1])
        if _is_simple(flat, loop_of_use, tol):
            return True
    return False


def _sample(brep: Brep, uses: IntArray, counts: IntArray) -> Array:
    """Points (sum of counts, 3) at equal steps of the parameter along each use, one use after another."""
    edges, edge = brep.edges, brep.uses.edge[uses]
    known: dict[tuple[int, float, float, int], Array] = {}
    unplaced = []
    rows = zip(edges.curve[edge].tolist(), *edges.span[edge].T.tolist(), counts.tolist(), strict=True)
    for key, sense in zip(rows, brep.uses.sense[uses].tolist(), strict=True):
        if key not in known:
            known[key] = brep.curves[key[0]](np.linspace(*key[1:]))
        unplaced.append(known[key][::sense])
    return edges.motion[np.repeat(edge, counts)].apply(np.concatenate(unplaced))


def _is_simple(flat: list[Array], loop_of_use: IntArray, tol: float) -> bool:
    """Whether the loops of sampled uses (each (2 n + 1, 2)) are certainly simple, nested and oriented."""
    start = np.concatenate([points[:-2:2] for points in flat])
    end = np.concatenate([points[2::2] for points in flat])
    middle = np.concatenate([points[1::2] for points in flat])
    loop = np.repeat(loop_of_use, [len(points) // 2 for points in flat])
    fat = FAT_SAFETY * np.linalg.norm(middle - 0.5 * (start + end), axis=1) + tol
    following = np.arange(1, len(start) + 1)
    last = np.flatnonzero(np.diff(loop, append=-1))
    following[last] = np.concatenate([[0], last[:-1] + 1])
    along = end - start
    length = np.linalg.norm(along, axis=1)
    if (length <= 2 * fat).any() or (np.linalg.norm(start[following] - end, axis=1) > 2 * tol).any():
        return False
    cosine = np.einsum("ni,ni->n", along, along[following]) / (length * length[following])
    wedge, leave = np.pi - np.arccos(np.clip(cosine, -1.0, 1.0)), fat / length
    if (wedge < WEDGE_SAFETY * (leave + leave[following])).any() or not _are_apart(start, end, fat, following):
        return False
    return _are_nested(start, start[following], loop)


def _are_apart(start: Array, end: Array, fat: Array, following: IntArray) -> bool:
    """Whether all segments but consecutive ones are farther apart than their fat."""
    half = 0.5 * np.linalg.norm(end - start, axis=1) + fat
    try:
        i, j = find_near_balls(0.5 * (start + end), half, 0.0, "chords", "let another check decide")
    except OutOfMemory:
        return False
    own = (following[i] != j) & (following[j] != i)
    i, j = i[own], j[own]
    near = np.minimum.reduce(
        [
            _distance_to_segment(start[i], start[j], end[j]),
            _distance_to_segment(end[i], start[j], end[j]),
            _distance_to_segment(start[j], start[i], end[i]),
            _distance_to_segment(end[j], start[i], end[i]),
        ]
    )
    crossing = (_side(start[i], end[i], start[j]) * _side(start[i], end[i], end[j]) <= 0) & (
        _side(start[j], end[j], start[i]) * _side(start[j], end[j], end[i]) <= 0
    )
    return bool((near > fat[i] + fat[j]).all() and not crossing.any())


def _distance_to_segment(points: Array, start: Array, end: Array) -> Array:
    along = end - start
    t = np.einsum("ni,ni->n", points - start, along) / np.einsum("ni,ni->n", along, along)
    return np.asarray(np.linalg.norm(points - start - np.clip(t, 0.0, 1.0)[:, None] * along, axis=1))


def _side(start: Array, end: Array, points: Array) -> Array:
    """Twice the signed area of each triangle."""
    a, b = end - start, points - start
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _are_nested(start: Array, end: Array, loop: IntArray) -> bool:
    """Whether one loop runs counter-clockwise around all others, which run clockwise and lie outside each other."""
    area = np.bincount(loop, start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0])
    outer = int(np.argmax(area))
    if area[outer] <= 0 or (np.delete(area, outer) >= 0).any():
        return False
    for hole in np.delete(np.arange(len(area)), outer).tolist():
        x, y = start[np.argmax(loop == hole)]
        above = (start[:, 1] > y) != (end[:, 1] > y)
        a, b = start[above], end[above]
        crossed = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1]) > x
        inside = np.bincount(loop[above][crossed], minlength=len(area)) % 2
        inside[hole] = 0
        if inside[outer] != 1 or inside.sum() != 1:
            return False
    return True
