"""Classes of congruent faces: equal carriers with equal loops, seen from the faces' own frames.

A face is described in the coordinates of its unplaced carrier: the carrier itself, and for each edge use the curve, its pcurve
and its ends, along the loop. Two faces with equal descriptions are rigid copies of each other, mirrors included, whichever
neighbour their edges were taken from. A check of the one, as a face on its own, then holds for the other as well.

Descriptions are rounded to a resolution and hashed to 128 bits by multilinear hashing (Carter and Wegman 1979). Rounding may
split a class, which costs a further check; it merges faces only if they differ by less than the resolution.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Carrier, EdgeCurve, Plane
from tpmscad.brep.conics import Circle
from tpmscad.brep.quadrics import ConicalSurface, CylindricalSurface, SphericalSurface
from tpmscad.index_ranges import list_following
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface

Hashes = NDArray[np.uint64]

HASH_SEED = 20_240_614
"""Seed of the multipliers of the hash: equal Breps have equal classes in every run."""

PARAMETER_RESOLUTION = 1e-9
"""Resolution of directions, knots and parameters as fractions of the span of their edge."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceClasses:
    """`label` (F,): the class of each face; `first` (n,): the first face of each class.

    use_order (K,): the edge uses face by face, those of a face in an order that is the same for all faces of its class.
    """

    label: IntArray
    first: IntArray
    use_order: IntArray


def group_congruent_faces(brep: Brep, resolution: float) -> FaceClasses:
    """The classes of congruent faces, descriptions rounded to `resolution` (model units)."""
    carrier = _hash_each([_describe_carrier(c, resolution) for c in brep.carriers])
    uses = _hash_uses(brep, resolution)
    loops = _hash_loops(brep, uses)
    face = np.repeat(np.arange(len(brep.faces)), np.diff(brep.faces.loop_start))
    total = np.zeros((len(brep.faces), 2), np.uint64)
    np.add.at(total, face, _mix(loops))
    total = _mix(3 * carrier[brep.faces.carrier] + 5 * total)
    _, first, label = np.unique(total, axis=0, return_index=True, return_inverse=True)
    return FaceClasses(label.ravel(), first, np.lexsort((*uses.T, brep.face_of_use)))


def group_translated_faces(brep: Brep, resolution: float) -> FaceClasses:
    """As `group_congruent_faces`, but faces of a class are translated copies: their motions have the same rotation."""
    congruent = group_congruent_faces(brep, resolution)
    rotation = _round(brep.faces.motion.rotation.reshape(-1, 9), PARAMETER_RESOLUTION)
    keys = np.column_stack([congruent.label, rotation])
    _, first, label = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return FaceClasses(label.ravel(), first, congruent.use_order)


def _hash_loops(brep: Brep, uses: Hashes) -> Hashes:
    """Hash of each loop (L, 2), the same wherever the loop begins: a sum over pairs of consecutive uses."""
    start = brep.faces.use_start
    total = np.zeros((len(start) - 1, 2), np.uint64)
    loop = np.repeat(np.arange(len(start) - 1), np.diff(start))
    np.add.at(total, loop, _mix(7 * uses + 11 * uses[list_following(start)]))
    return total


def _hash_uses(brep: Brep, resolution: float) -> Hashes:
    """Hash of each edge use (K, 2): curve, ends and pcurve along the loop, in the frame of the face."""
    edges, uses = brep.edges, brep.uses
    backwards = uses.sense < 0
    frame = brep.faces.motion[brep.face_of_use]
    motion = edges.motion[uses.edge].relative_to(frame)
    own = _relative_hashes(brep, motion, backwards, resolution)
    first = np.where(backwards, edges.end[uses.edge], edges.start[uses.edge])
    last = np.where(backwards, edges.start[uses.edge], edges.end[uses.edge])
    ends = np.stack([frame.apply_inverse(brep.vertices[v]) for v in (first, last)], axis=1)
    levels = np.maximum(edges.deviation, resolution)
    vertex_level = np.full(len(brep.vertices), resolution)
    for vertex in (edges.start, edges.end):
        np.maximum.at(vertex_level, vertex, levels)
    # magnitudes of the deviations, which set the tolerances of edges and vertices
    magnitude = np.ceil(np.log2(np.stack([levels[uses.edge], vertex_level[first], vertex_level[last]], 1) / resolution))
    rows = np.column_stack([_round(ends.reshape(-1, 6), resolution), magnitude.astype(np.int64)])
    return _mix(own + _hash_rows(rows))


def _relative_hashes(brep: Brep, motion: Motion, backwards: BoolArray, resolution: float) -> Hashes:
    """Hash of the curve and the pcurve of each use (K, 2), moved by `motion` and turned round where `backwards`."""
    uses, span = brep.uses, brep.edges.span[brep.uses.edge]
    keys = np.column_stack([brep.edges.curve[uses.edge], uses.pcurve, backwards])
    order = np.lexsort((span[:, 1], span[:, 0], *keys.T))
    changes = (np.diff(keys[order], axis=0) != 0).any(axis=1) | (np.diff(span[order], axis=0) != 0).any(axis=1)
    result = np.empty((len(uses), 2), np.uint64)
    for group in np.split(order, np.flatnonzero(changes) + 1):
        if not len(group):
            continue
        k = group[0]
        curve, p = brep.curves[int(keys[k, 0])], int(keys[k, 1])
        flip = -1 if backwards[k] else 1
        points = motion[group, None].apply(_points_of_curve(curve))
        low, high = span[k].tolist()
        fixed = _knot_row(curve, low, high, flip)
        if p >= 0:
            flat = brep.pcurves[p]
            fixed = np.concatenate(
                [fixed, _knot_row(flat, low, high, flip), _round(flat.poles[::flip].ravel(), resolution)]
            )
        if isinstance(curve, BSplineCurve):
            points = points[:, ::flip]
        result[group] = _hash_rows(_round(points.reshape(len(group), -1), resolution)) + _hash_rows(fixed[None])
    return result


def _points_of_curve(curve: EdgeCurve) -> Array:
    """Points (n, 3) that fix a curve and move with it."""
    if isinstance(curve, BSplineCurve):
        return curve.poles
    axes = (curve.radius, curve.radius) if isinstance(curve, Circle) else (curve.major, curve.minor)
    y = np.cross(curve.normal, curve.x_axis)
    return np.stack([curve.origin, curve.origin + axes[0] * curve.x_axis, curve.origin + axes[1] * y])


def _knot_row(curve: EdgeCurve, low: float, high: float, flip: int) -> IntArray:
    """Kind, degree and knots of a curve, as fractions of the span [low, high] in the direction `flip`; of conics the span."""
    if isinstance(curve, BSplineCurve):
        fractions = (curve.knots - low) / (high - low)
        knots = fractions if flip > 0 else 1.0 - fractions[::-1]
        return np.concatenate([[1, curve.degree], _round(knots, PARAMETER_RESOLUTION)])
    return np.concatenate([[2, flip], _round(np.array([low, high]), PARAMETER_RESOLUTION)])


def _describe_carrier(carrier: Carrier, resolution: float) -> IntArray:
    """Rounded numbers that fix a carrier."""
    if isinstance(carrier, BSplineSurface):
        rows, columns, _ = carrier.poles.shape
        knots = _round(np.concatenate([carrier.knots_u, carrier.knots_v]), PARAMETER_RESOLUTION)
        shape = [1, carrier.degree_u, carrier.degree_v, rows, columns]
        return np.concatenate([shape, knots, _round(carrier.poles.ravel(), resolution)])
    lengths, angles, kind = _describe_frame(carrier)
    return np.concatenate([[kind], _round(lengths, resolution), _round(angles, PARAMETER_RESOLUTION)])


def _describe_frame(carrier: Carrier) -> tuple[Array, Array, int]:
    """Lengths, and directions and angles, of a plane or quadric, and the number of its kind."""
    if isinstance(carrier, Plane):
        return carrier.origin, np.concatenate([carrier.x_axis, carrier.normal]), 2
    assert not isinstance(carrier, BSplineSurface)
    angles = np.concatenate([carrier.x_axis, carrier.axis])
    if isinstance(carrier, ConicalSurface):
        return np.append(carrier.origin, carrier.radius), np.append(angles, carrier.angle), 3
    if isinstance(carrier, CylindricalSurface | SphericalSurface):
        return np.append(carrier.origin, carrier.radius), angles, 4 + isinstance(carrier, SphericalSurface)
    return np.append(carrier.origin, [carrier.major, carrier.minor]), angles, 6


def _round(values: Array, resolution: float) -> IntArray:
    return np.rint(values / resolution).astype(np.int64)


def _hash_each(rows: list[IntArray]) -> Hashes:
    """Hashes (n, 2) of rows of different lengths."""
    return np.concatenate([np.zeros((0, 2), np.uint64), *(_hash_rows(row[None]) for row in rows)])


def _hash_rows(rows: IntArray) -> Hashes:
    """Hashes (n, 2) of integer rows (n, m)."""
    return _mix(rows.astype(np.uint64) @ _multipliers(rows.shape[1]) + np.uint64(rows.shape[1]))


@cache
def _multipliers(count: int) -> Hashes:
    """Odd random factors (count, 2)."""
    generator = np.random.default_rng([HASH_SEED, count])
    return generator.integers(0, 2**64 - 1, (count, 2), np.uint64, endpoint=True) | np.uint64(1)


def _mix(values: Hashes) -> Hashes:
    """A bijection of 64-bit integers that spreads all bits (splitmix64, Steele et al. 2014)."""
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return values ^ (values >> np.uint64(31))
