"""Whole patches become a boundary representation: coincident vertices and edges are found once and shared.

Patches made by symmetry meet to round-off, so coincidence is decided with a generous margin: a millionfold of the round-off, a
thousandth of any feature. Edges are distinguished by their points at mid-parameter, so two edges between the same vertices stay
two. How far welded sides differ is measured and becomes the `deviation` of the edge.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces
from tpmscad.brep.linked_items import label_linked
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface

WELD_RADIUS_FRACTION = 1e-5
"""Points closer than this fraction of the diagonal of the smallest patch are one point."""


class SideMismatch(ValueError):
    """Sides with common ends and middle differ elsewhere: by `gap` near the point `place` (3,), more than `limit`."""

    def __init__(self, gap: float, limit: float, place: Array) -> None:
        super().__init__(
            f"sides that share their ends and middle differ by {gap:.3g} elsewhere, more than the welding radius {limit:.3g}"
        )
        self.gap = gap
        self.limit = limit
        self.place = place


def cluster_points(points: Array, radius: float) -> tuple[IntArray, IntArray]:
    """Single-linkage clusters of points (n, 3): the label of each point (n,), and the first point of each cluster."""
    pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
    label = label_linked(len(points), pairs)
    return label, np.unique(label, return_index=True)[1]


def roll_up(points: Array, periods: Sequence[float]) -> Array:
    """Points (n, 3) with each periodic coordinate rolled up to a circle as long as its period: translates are one point."""
    columns = []
    for x, period in zip(points.T, periods, strict=True):
        if period:
            angle, radius = 2 * np.pi * x / period, period / (2 * np.pi)
            columns += [radius * np.cos(angle), radius * np.sin(angle)]
        else:
            columns.append(x)
    return np.stack(columns, axis=1)


def weld_patches(
    primitives: Sequence[BSplineSurface],
    carrier: NDArray[np.integer],
    motion: Motion,
    sense: NDArray[np.integer],
    tag: NDArray[np.integer],
    tags: Sequence[str],
) -> Brep:
    """The boundary representation of whole patches: face i is primitives[carrier[i]] moved by motion[i].

    Adjacent sides must have the same parametrisation, equal or reversed. Raises SideMismatch if sides with common ends and middle
    differ elsewhere by more than the welding radius, ValueError if their parameter ranges differ.
    """
    samples = np.stack([_sample_sides(primitive) for primitive in primitives])  # (P, 4, 5, 3), counter-clockwise
    points = motion[:, None, None].apply(samples[carrier])
    radius = WELD_RADIUS_FRACTION * float(min(np.linalg.norm(s[0, 0] - s[2, 0]) for s in samples))

    corner, first_corner = cluster_points(points[:, :, 0].reshape(-1, 3), radius)
    edge, first_use = cluster_points(points[:, :, 2].reshape(-1, 3), radius)
    start = corner.reshape(-1, 4)
    end = np.roll(start, -1, axis=1).ravel()
    start = start.ravel()

    use_sense = np.where(start == start[first_use[edge]], 1, -1)
    side_points = points.reshape(-1, 5, 3)
    shared = side_points[first_use[edge]]
    mismatch = np.linalg.norm(
        side_points - np.where(use_sense[:, None, None] > 0, shared, shared[:, ::-1]), axis=2
    ).max(axis=1)
    deviation = np.zeros(len(first_use))
    np.maximum.at(deviation, edge, mismatch)
    if deviation.max(initial=0.0) > radius:
        raise SideMismatch(float(deviation.max()), radius, side_points[np.argmax(mismatch), 2])

    domains = np.array([primitive.side(s).domain for primitive in primitives for s in range(4)])
    side = np.tile(np.arange(4), len(carrier))
    primitive_of_side = np.repeat(carrier, 4)
    curves = [primitive.side(s) for primitive in primitives for s in range(4)]
    pcurves = [primitive.side_pcurve(s) for primitive in primitives for s in range(4)]
    first_face = first_use // 4
    curve = (4 * primitive_of_side + side)[first_use]
    if not np.array_equal(domains[4 * primitive_of_side + side], domains[curve][edge]):
        raise ValueError("sides that meet must share their parameter's range")
    return Brep(
        carriers=tuple(primitives),
        curves=tuple(curves),
        pcurves=tuple(pcurve for forward in pcurves for pcurve in (forward, forward.reversed())),
        vertices=points[:, :, 0].reshape(-1, 3)[first_corner],
        edges=Edges(
            curve=curve,
            motion=motion[first_face],
            span=domains[curve],
            start=start[first_use],
            end=end[first_use],
            deviation=deviation,
        ),
        uses=EdgeUses(edge=edge, sense=use_sense, pcurve=2 * (4 * primitive_of_side + side) + (use_sense < 0)),
        faces=Faces(
            carrier=np.asarray(carrier, np.int64),
            motion=motion,
            sense=np.asarray(sense, np.int64),
            tag=np.asarray(tag, np.int64),
            loop_start=np.arange(len(carrier) + 1),
            use_start=4 * np.arange(len(carrier) + 1),
        ),
        tags=tuple(tags),
    )


def _sample_sides(surface: BSplineSurface) -> Array:
    """Five points of each side of a patch, counter-clockwise, ends included: (4, 5, 3)."""
    curves = [surface.side(s) for s in range(4)]
    return np.stack([curve(np.linspace(*curve.domain, 5)) for curve in curves])
