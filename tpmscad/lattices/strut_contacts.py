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
from tpmscad.lattices.strut_facets import measure_overlap

FEWER_STRUTS = "use fewer or shorter struts"

PAIRS_AT_A_TIME = 200_000
"""Pairs of struts whose distance is found together."""

STEPS_ON_CONES = 12
"""Steps by which the nearest points of two cones are found, one for each of the axes in turn."""

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
    points: Array, struts: IntArray, radii: Array, balls: Array, box: tuple[Array, Array] | None = None
) -> Contact | None:
    """The contact with the smallest ratio of those that are nearer than four times what is needed; None if there is none.

    radii, balls (n,): of the ends of all struts at each point, and of the balls there.
    """
    found = [
        *_measure_ends(points, struts, radii, balls, box),
        *_measure_pairs(points, struts, radii),
        *_measure_nodes(points, struts, radii, balls),
    ]
    return min(found, key=lambda contact: contact.ratio, default=None)


def _measure_ends(
    points: Array, struts: IntArray, radii: Array, balls: Array, box: tuple[Array, Array] | None
) -> list[Contact]:
    """What the two ends take of the length of each strut: the worst."""
    lengths = np.linalg.norm(points[struts[:, 1]] - points[struts[:, 0]], axis=1)
    within = np.abs(np.diff(radii[struts], axis=1)[:, 0]) >= lengths
    if within.any():
        s = int(np.argmax(within))
        what = "the ball at one end of a strut holds that at the other"
        return [Contact(points[struts[s, 0]], 0.0, float(radii[struts[s]].max()), what)]
    classes = group_ends(points, struts, radii, balls, box)
    share = [measure_overlap(*pair, float(lengths[s])) for s, pair in zip(classes.first, classes.pairs, strict=True)]
    taken = np.maximum(np.array(share)[classes.label], 1e-300)
    worst = int(np.argmax(taken))
    middle = points[struts[worst]].mean(axis=0)
    length = float(lengths[worst])
    return [Contact(middle, length, float(taken[worst]) * length, "the joints at both ends of a strut meet")]


def _measure_pairs(points: Array, struts: IntArray, radii: Array) -> list[Contact]:
    """The nearest two struts without a common node."""
    start, along = points[struts[:, 0]], points[struts[:, 1]] - points[struts[:, 0]]
    middle, half = start + 0.5 * along, 0.5 * np.linalg.norm(along, axis=1)
    i, j = find_near_balls(middle, half, 4 * float(radii.max()), "struts", FEWER_STRUTS)
    common = (struts[i][:, :, None] == struts[j][:, None, :]).any(axis=(1, 2))
    i, j = i[~common], j[~common]
    best: list[Contact] = []
    for k in range(0, len(i), PAIRS_AT_A_TIME):
        own, other = i[k : k + PAIRS_AT_A_TIME], j[k : k + PAIRS_AT_A_TIME]
        distance, needed = _measure_axes(
            start[own], along[own], radii[struts[own]], start[other], along[other], radii[struts[other]]
        )
        at = int(np.argmin(distance / needed))
        place = 0.5 * (middle[own[at]] + middle[other[at]])
        what = "two struts without a common node touch"
        best.append(Contact(place, float(distance[at]), float(needed[at]), what))
    return best


def _measure_nodes(points: Array, struts: IntArray, radii: Array, balls: Array) -> list[Contact]:
    """The node that is nearest to a strut which does not end in it."""
    used = np.unique(struts)
    start, along = points[struts[:, 0]], points[struts[:, 1]] - points[struts[:, 0]]
    half = 0.5 * np.linalg.norm(along, axis=1)
    nodes = points[used], np.zeros(len(used))
    reach = 2 * float(radii.max() + balls.max())
    strut, node = find_near_balls(start + 0.5 * along, half, reach, "struts and nodes", FEWER_STRUTS, nodes)
    node = used[node]
    other = (struts[strut] != node[:, None]).all(axis=1)
    strut, node = strut[other], node[other]
    if not len(node):
        return []
    still = np.zeros((len(node), 3))
    ball = np.column_stack([balls[node], balls[node]])
    distance, needed = _measure_axes(start[strut], along[strut], radii[struts[strut]], points[node], still, ball)
    at = int(np.argmin(distance / needed))
    what = "a node touches a strut that does not end in it"
    return [Contact(points[node[at]], float(distance[at]), float(needed[at]), what)]


def _measure_axes(p: Array, u: Array, a: Array, q: Array, v: Array, b: Array) -> tuple[Array, Array]:
    """Distances (n,) of axes p + s u and q + t v where struts of radii a, b (n, 2) are nearest, and their radii there, added.

    Of equal radii these are the nearest points (Ericson, Real-Time Collision Detection, 5.1.9). What is left between cones is a
    convex function of s and t, and its least value for one of them is known.
    """
    r = p - q
    uu, vv = np.einsum("ni,ni->n", u, u), np.einsum("ni,ni->n", v, v)
    uv, ur, vr = np.einsum("ni,ni->n", u, v), np.einsum("ni,ni->n", u, r), np.einsum("ni,ni->n", v, r)
    denominator = uu * vv - uv * uv
    parallel = denominator <= 1e-14 * uu * vv
    s = np.where(parallel, 0.0, np.clip((uv * vr - ur * vv) / np.where(parallel, 1.0, denominator), 0, 1))
    t = np.clip((uv * s + vr) / np.where(vv > 0, vv, 1.0), 0, 1)
    s = np.clip((uv * t - ur) / uu, 0, 1)
    t = np.clip((uv * s + vr) / np.where(vv > 0, vv, 1.0), 0, 1)
    widens = (a[:, 0] != a[:, 1]) | (b[:, 0] != b[:, 1])
    for _ in range(STEPS_ON_CONES if widens.any() else 0):
        s = np.where(widens, _nearest_on_cone(q + t[:, None] * v - p, u, uu, a), s)
        t = np.where(widens, _nearest_on_cone(p + s[:, None] * u - q, v, vv, b), t)
    distance = np.linalg.norm(r + s[:, None] * u - t[:, None] * v, axis=1)
    needed = a[:, 0] + s * (a[:, 1] - a[:, 0]) + b[:, 0] + t * (b[:, 1] - b[:, 0])
    return np.asarray(distance), np.asarray(needed)


def _nearest_on_cone(d: Array, u: Array, uu: Array, radii: Array) -> Array:
    """Where on axes u the balls lie that are nearest to points d, as fractions (n,); the radii change from start to end."""
    length = np.sqrt(np.where(uu > 0, uu, 1.0))
    along = np.einsum("ni,ni->n", d, u) / length
    away = np.sqrt(np.maximum(np.einsum("ni,ni->n", d, d) - along**2, 0))
    sine = np.clip((radii[:, 0] - radii[:, 1]) / length, -1 + 1e-12, 1 - 1e-12)
    return np.asarray(np.where(uu > 0, np.clip((along - away * sine / np.sqrt(1 - sine**2)) / length, 0, 1), 0.0))
