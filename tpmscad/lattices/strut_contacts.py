"""Where struts touch that have no node in common, or ends of a strut meet: what keeps a graph from being a solid by its nodes.

Each distance is compared with the sum of the radii that must fit in it. The smallest ratio of both is that of the place where the
struts touch first as they grow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.near_balls import find_near_balls
from tpmscad.lattices.strut_classes import group_ends
from tpmscad.lattices.strut_ends import greatest_sum

FEWER_STRUTS = "use fewer or shorter struts"

PAIRS_AT_A_TIME = 200_000
"""Pairs of struts whose distance is found together."""

DIAMETER_DIGITS = 1e-3
"""Relative margin of the diameter that is named as one that fits."""


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """The place (3,) where struts are nearest to a contact, the distance there, and what they need of it.

    What: in words. They are apart if the distance is greater.
    """

    place: Array
    distance: float
    needed: float
    what: str

    @property
    def ratio(self) -> float:
        """Distance per what is needed of it; above 1 where they are apart."""
        return self.distance / self.needed


def find_contact(
    points: Array, struts: IntArray, radius: float, node_radius: float, box: tuple[Array, Array] | None = None
) -> Contact | None:
    """The contact with the smallest ratio of those that are nearer than four times what is needed; None if there is none."""
    found = [
        *_measure_ends(points, struts, radius, node_radius, box),
        *_measure_pairs(points, struts, radius),
        *_measure_nodes(points, struts, radius, node_radius),
    ]
    return min(found, key=lambda contact: contact.ratio, default=None)


def _measure_ends(
    points: Array, struts: IntArray, radius: float, node_radius: float, box: tuple[Array, Array] | None
) -> list[Contact]:
    """What the two ends take of the length of each strut: the worst."""
    lengths = np.linalg.norm(points[struts[:, 1]] - points[struts[:, 0]], axis=1)
    classes = group_ends(points, struts, radius, node_radius, box)
    taken = np.array([greatest_sum(a.cylinder, b.cylinder) for a, b in classes.pairs])[classes.label]
    taken = np.maximum(radius * taken, 1e-300)
    worst = int(np.argmin(lengths / taken))
    middle = points[struts[worst]].mean(axis=0)
    return [Contact(middle, float(lengths[worst]), float(taken[worst]), "the joints at both ends of a strut meet")]


def _measure_pairs(points: Array, struts: IntArray, radius: float) -> list[Contact]:
    """The nearest two struts without a common node."""
    start, along = points[struts[:, 0]], points[struts[:, 1]] - points[struts[:, 0]]
    middle, half = start + 0.5 * along, 0.5 * np.linalg.norm(along, axis=1)
    i, j = find_near_balls(middle, half, 4 * radius, "struts", FEWER_STRUTS)
    common = (struts[i][:, :, None] == struts[j][:, None, :]).any(axis=(1, 2))
    i, j = i[~common], j[~common]
    best: list[Contact] = []
    for k in range(0, len(i), PAIRS_AT_A_TIME):
        own, other = i[k : k + PAIRS_AT_A_TIME], j[k : k + PAIRS_AT_A_TIME]
        distance = _segment_distances(start[own], along[own], start[other], along[other])
        at = int(np.argmin(distance))
        place = 0.5 * (middle[own[at]] + middle[other[at]])
        best.append(Contact(place, float(distance[at]), 2 * radius, "two struts without a common node touch"))
    return best


def _measure_nodes(points: Array, struts: IntArray, radius: float, node_radius: float) -> list[Contact]:
    """The node that is nearest to a strut which does not end in it."""
    used = np.unique(struts)
    start, along = points[struts[:, 0]], points[struts[:, 1]] - points[struts[:, 0]]
    half = 0.5 * np.linalg.norm(along, axis=1)
    nodes = points[used], np.zeros(len(used))
    strut, node = find_near_balls(
        start + 0.5 * along, half, 2 * (radius + node_radius), "struts and nodes", FEWER_STRUTS, nodes
    )
    node = used[node]
    other = (struts[strut] != node[:, None]).all(axis=1)
    strut, node = strut[other], node[other]
    if not len(node):
        return []
    arm = points[node] - start[strut]
    t = np.clip(np.einsum("ni,ni->n", arm, along[strut]) / np.einsum("ni,ni->n", along[strut], along[strut]), 0, 1)
    distance = np.linalg.norm(arm - t[:, None] * along[strut], axis=1)
    at = int(np.argmin(distance))
    return [
        Contact(
            points[node[at]],
            float(distance[at]),
            radius + node_radius,
            "a node touches a strut that does not end in it",
        )
    ]


def _segment_distances(p: Array, u: Array, q: Array, v: Array) -> Array:
    """Distances (n,) of segments p + s u and q + t v, s and t from 0 to 1 (Ericson, Real-Time Collision Detection, 5.1.9)."""
    r = p - q
    a, e = np.einsum("ni,ni->n", u, u), np.einsum("ni,ni->n", v, v)
    b, c, f = np.einsum("ni,ni->n", u, v), np.einsum("ni,ni->n", u, r), np.einsum("ni,ni->n", v, r)
    denominator = a * e - b * b
    parallel = denominator <= 1e-14 * a * e
    s = np.where(parallel, 0.0, np.clip((b * f - c * e) / np.where(parallel, 1.0, denominator), 0, 1))
    t = np.clip((b * s + f) / e, 0, 1)
    s = np.clip((b * t - c) / a, 0, 1)
    t = np.clip((b * s + f) / e, 0, 1)
    return np.asarray(np.linalg.norm(r + s[:, None] * u - t[:, None] * v, axis=1))
