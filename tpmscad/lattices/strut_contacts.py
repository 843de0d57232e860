"""Where struts touch that have no node in common, or ends of a strut meet: what keeps a graph from being a solid by its nodes.

Each distance is compared with the sum of the radii that must fit in it. The smallest ratio of both is that of the place where the
struts touch first as they grow.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

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

AXES_MEET = 1e-9
"""Of the distance that two struts need: up to there their axes meet."""

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


class _Distances(NamedTuple):
    """Pairs (p, 2) of struts, or of one with itself, places (p, 3), distances there and what the struts need of these (p,)."""

    pairs: IntArray
    places: Array
    distance: Array
    needed: Array
    what: str


def find_contact(
    points: Array, struts: IntArray, radii: Array, balls: Array, box: tuple[Array, Array] | None = None
) -> Contact | None:
    """The contact with the smallest ratio of those that are nearer than four times what is needed; None if there is none.

    radii, balls (n,): of the ends of all struts at each point, and of the balls there.
    """
    best: list[Contact] = []
    for each in _measure(points, struts, radii, balls, box):
        if len(each.pairs):
            at = int(np.argmin(each.distance / each.needed))
            best.append(Contact(each.places[at], float(each.distance[at]), float(each.needed[at]), each.what))
    return min(best, key=lambda contact: contact.ratio, default=None)


def find_touching(graph: tuple[Array, IntArray, Array, Array], least: float = AXES_MEET) -> IntArray:
    """The pairs (p, 2) of struts that touch outside common nodes; of one with itself if it touches a node, or its joints meet.

    graph: the first arguments of `find_contact`; least: the ratio above which a contact counts, so that axes do not meet.
    """
    found = [np.zeros((0, 2), np.int64)]
    for each in _measure(*graph, None):
        ratio = each.distance / each.needed
        found.append(each.pairs[(ratio <= 1) & (ratio > least)])
    return np.concatenate(found)


def _measure(
    points: Array, struts: IntArray, radii: Array, balls: Array, box: tuple[Array, Array] | None
) -> Iterator[_Distances]:
    """What near struts have and need: the ends of each, those without a common node, nodes and other struts."""
    start, along = points[struts[:, 0]], points[struts[:, 1]] - points[struts[:, 0]]
    lengths = np.linalg.norm(along, axis=1)
    middle, same = start + 0.5 * along, np.arange(len(struts)).repeat(2).reshape(-1, 2)
    within = np.abs(np.diff(radii[struts], axis=1)[:, 0]) >= lengths
    if within.any():
        what = "the ball at one end of a strut holds that at the other"
        ends = points[struts[within, 0]]
        yield _Distances(same[within], ends, np.zeros(len(ends)), radii[struts[within]].max(axis=1), what)
        return
    classes = group_ends(points, struts, radii, balls, box)
    share = [measure_overlap(*pair, float(lengths[s])) for s, pair in zip(classes.first, classes.pairs, strict=True)]
    taken = np.maximum(np.array(share)[classes.label], 1e-300)
    yield _Distances(same, middle, lengths, taken * lengths, "the joints at both ends of a strut meet")

    i, j = find_near_balls(middle, 0.5 * lengths, 4 * float(radii.max()), "struts", FEWER_STRUTS)
    common = (struts[i][:, :, None] == struts[j][:, None, :]).any(axis=(1, 2))
    i, j = i[~common], j[~common]
    for k in range(0, len(i), PAIRS_AT_A_TIME):
        pair = np.column_stack([i, j])[k : k + PAIRS_AT_A_TIME]
        one, two = pair.T
        distance, needed = _measure_axes(
            start[one], along[one], radii[struts[one]], start[two], along[two], radii[struts[two]]
        )
        places = 0.5 * (middle[one] + middle[two])
        yield _Distances(pair, places, distance, needed, "two struts without a common node touch")

    used = np.unique(struts)
    reach = 2 * float(radii.max() + balls.max())
    nodes = points[used], np.zeros(len(used))
    strut, node = find_near_balls(middle, 0.5 * lengths, reach, "struts and nodes", FEWER_STRUTS, nodes)
    node = used[node]
    other = (struts[strut] != node[:, None]).all(axis=1)
    strut, node = strut[other], node[other]
    ball = np.column_stack([balls[node], balls[node]])
    distance, needed = _measure_axes(
        start[strut], along[strut], radii[struts[strut]], points[node], np.zeros((len(node), 3)), ball
    )
    yield _Distances(same[strut], points[node], distance, needed, "a node touches a strut that does not end in it")


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
