"""What must change to mend the topological errors of a sampled blend: cheapest joins and removals, as demands on the weight.

Each error is either joined to another component along the cheapest path, or removed with all its samples, whichever moves the
weight less. Joins are chosen together, as the cheapest spanning tree of the components, each path costing the changes of weight
its samples need. Solid and void are treated alike, with the sign of f turned. Samples that no weight within reach can turn are
never asked to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from tpmscad.blend.census import Phase
from tpmscad.blend.demands import NONE, Demands
from tpmscad.blend.grid import Array, Ints, Mask
from tpmscad.blend.sampled import Sampled, block, tightened
from tpmscad.blend.weight import Weight
from tpmscad.topology.grid import Labels

STEP_COST = 0.01
"""Cost of a sample on a path beside the change of weight it needs: of equally cheap paths the short one is taken."""

FIRST_REACH, LAST_REACH = 0.5, 64.0
"""Search radii, in cost: most errors have a neighbour within the first; beyond the last nothing was ever joined."""

PAD = 10
"""Samples around the errors where repairs are looked for first."""

NO_MOVE = np.inf

OPEN, SOURCE, TARGET = 1, 2, 3
"""What a sample is to a path."""


@dataclass(frozen=True, slots=True, eq=False)
class Repair:
    """Demands that mend an error each, cheapest first; `hopeless` labels have no repair within reach."""

    groups: list[Demands]
    hopeless: Ints


@dataclass(frozen=True, slots=True, eq=False)
class _Room:
    """One phase in the window, turned so that inside is g <= 0."""

    value: Array
    slope: Array
    least: Array
    most: Array
    weight: Array
    labels: Labels


@dataclass(frozen=True, slots=True, eq=False)
class Wanted:
    """What is to be mended: error labels of one phase (sign +1 for solid, -1 for void) of sampled values (nx, ny, nz).

    margin: how far past zero f is moved. kept: demands that leave less reach. bias: what removals are taken to cost beside
    joins, so that either can be preferred.
    """

    values: Array
    phase: Phase
    errors: Ints
    sign: int
    margin: float
    kept: Demands = NONE
    bias: float = 1.0


def repair(sampled: Sampled, weight: Weight, wanted: Wanted) -> Repair:
    """Repairs of errors, looked for near them first, then wherever the weight acts."""
    window = sampled.window
    where = wanted.phase.of(wanted.errors)[window]
    if not where.any():
        return Repair([], wanted.errors)
    x, y, z = (slice(w.start + n.start, w.start + n.stop) for w, n in zip(window, block(where, PAD), strict=True))
    near = x, y, z
    found = _within(replace(sampled, window=near), weight, wanted)
    return _within(sampled, weight, wanted) if len(found.hopeless) and near != window else found


def _within(sampled: Sampled, weight: Weight, wanted: Wanted) -> Repair:
    """The same in the window of the sampled blend."""
    window, sign, labels = sampled.window, wanted.sign, wanted.phase.labels[sampled.window]
    least, most = tightened(sampled.reach(weight), sampled, weight, wanted.kept)
    acting = weight.on_grid(*sampled.axes)
    room = _Room(sign * wanted.values[window], sign * sampled.slope[window], least, most, acting, labels)
    present = np.intersect1d(wanted.errors, np.unique(labels))
    removable = wanted.bias * _removals(room, present, wanted.phase.count, wanted.margin)
    joins = _joins(room, present, wanted.phase.main, wanted.phase.count, wanted.margin)
    return _choose(sampled, room, removable, joins, wanted.errors, wanted.margin)


def _removals(room: _Room, errors: Ints, count: int, margin: float) -> Array:
    """The greatest change of weight that removing each label takes; inf where a sample cannot leave the phase."""
    highest = room.value + np.maximum(room.slope * (room.least - room.weight), room.slope * (room.most - room.weight))
    wanted = np.zeros(count, bool)
    wanted[errors] = True
    inside = wanted[room.labels]
    labels, value, slope = room.labels[inside], room.value[inside], room.slope[inside]
    past = np.minimum(margin, 0.5 * highest[inside])
    movable = (slope != 0) & (past > 0)
    need = np.where(movable, (past - value) / np.where(movable, np.abs(slope), 1.0), NO_MOVE)
    cost = np.zeros(count)
    np.maximum.at(cost, labels, need)
    cost[~wanted] = NO_MOVE
    return cost


@dataclass(frozen=True, slots=True, eq=False)
class _Join:
    cost: float
    peak: float
    first: int
    second: int
    path: Ints


def _joins(room: _Room, errors: Ints, main: Ints, count: int, margin: float) -> list[_Join]:
    """Cheapest paths between neighbouring error labels, and from them to the main ones (all called 0), cheapest first."""
    if len(errors) == 0:
        return []
    lowest = room.value + np.minimum(room.slope * (room.least - room.weight), room.slope * (room.most - room.weight))
    past = np.minimum(margin, -0.5 * lowest)
    opens = (room.labels == 0) & (room.slope != 0) & (past > 0)
    need = np.where(opens, (room.value + past) / np.where(opens, np.abs(room.slope), 1.0), 0.0).ravel()
    kind = np.zeros(count, np.int8)
    kind[errors], kind[main] = 1, 2
    source, target = (kind[room.labels] == 1).ravel(), (kind[room.labels] == 2).ravel()
    owner = np.where(source, room.labels.ravel(), 0)
    graph, nodes = _graph(room.labels.shape, opens.ravel(), source, target, need)
    starts = np.flatnonzero(source[nodes])
    reach = FIRST_REACH
    while True:
        distance, previous, origin = dijkstra(
            graph, indices=starts, min_only=True, return_predecessors=True, limit=reach
        )
        found = _links(graph, nodes, distance, origin, owner, target)
        if len(np.unique(np.concatenate([found[1], found[2]]))) > len(errors) or reach >= LAST_REACH:
            break
        reach *= 4
    joins = []
    for cost, first, second, u, v in zip(*found, strict=True):
        path = nodes[np.array(_trace(previous, u) + (_trace(previous, v) if v >= 0 else []), np.int64)]
        path = path[opens.ravel()[path]]
        joins.append(_Join(float(cost), float(need[path].max(initial=0.0)), int(first), int(second), path))
    return joins


def _graph(shape: tuple[int, ...], opens: Mask, source: Mask, target: Mask, need: Array) -> tuple[csr_array, Ints]:
    """Directed edges between neighbouring samples: out of sources, among open samples, into targets."""
    kind = np.zeros(opens.size, np.int8)
    kind[opens], kind[source], kind[target] = OPEN, SOURCE, TARGET
    middle = np.flatnonzero(opens)
    place = np.unravel_index(middle, shape)
    stride = (shape[1] * shape[2], shape[2], 1)
    heads, tails = [], []
    for axis in range(3):
        for way, end in ((-1, 0), (1, shape[axis] - 1)):
            here = middle[place[axis] != end]
            there = here + way * stride[axis]
            beside = kind[there]
            onwards, back = (beside == OPEN) | (beside == TARGET), beside == SOURCE
            heads += [here[onwards], there[back]]
            tails += [there[onwards], here[back]]
    head, tail = np.concatenate(heads), np.concatenate(tails)
    used = np.zeros(opens.size, bool)
    used[head] = used[tail] = True
    nodes, compact = np.flatnonzero(used), np.cumsum(used) - 1
    cost = np.where(opens, need + STEP_COST, 0.0)
    length = (cost[head] + cost[tail]) / 2
    graph = csr_array((length, (compact[head], compact[tail])), shape=(len(nodes), len(nodes)))
    return graph, nodes


def _links(
    graph: csr_array, nodes: Ints, distance: Array, origin: Ints, owner: Ints, target: Mask
) -> tuple[Array, Ints, Ints, Ints, Ints]:
    """Cost, the two labels (0 for main) and the two nodes (-1: none) of the cheapest link of each pair of labels."""
    reached = np.isfinite(distance)
    label = np.where(reached, owner[nodes[np.where(reached, origin, 0)]], -1)
    ends = np.flatnonzero(reached & target[nodes])
    edges = graph.tocoo()
    u, v = edges.coords
    apart = reached[u] & reached[v] & (label[u] != label[v]) & ~target[nodes[u]] & ~target[nodes[v]]
    u, v = u[apart], v[apart]
    cost = np.concatenate([distance[ends], distance[u] + edges.data[apart] + distance[v]])
    first = np.concatenate([label[ends], np.minimum(label[u], label[v])])
    second = np.concatenate([np.zeros(len(ends), label.dtype), np.maximum(label[u], label[v])])
    a, b = np.concatenate([ends, u]), np.concatenate([np.full(len(ends), -1), v])
    order = np.argsort(cost, kind="stable")
    _, once = np.unique(np.stack([first[order], second[order]]), axis=1, return_index=True)
    order = order[np.sort(once)]
    return cost[order], first[order], second[order], a[order], b[order]


def _trace(previous: Ints, node: int) -> list[int]:
    path = []
    while node >= 0:
        path.append(int(node))
        node = previous[node]
    return path


def _choose(sampled: Sampled, room: _Room, removal: Array, joins: list[_Join], errors: Ints, margin: float) -> Repair:
    """Removals where they are cheaper than the cheapest join, then the spanning tree of the rest (Kruskal)."""
    cheapest = np.full(len(removal), NO_MOVE)
    for join in joins:
        for label in (join.first, join.second):
            cheapest[label] = min(cheapest[label], join.peak)
    removed = {int(label) for label in errors if removal[label] < cheapest[label]}
    parent = {int(label): int(label) for label in (0, *errors)}

    def root(label: int) -> int:
        while parent[label] != label:
            parent[label] = parent[parent[label]]
            label = parent[label]
        return label

    groups = [
        _demands(sampled, room, np.flatnonzero(room.labels.ravel() == label), 1, margin) for label in sorted(removed)
    ]
    for join in joins:
        if join.first in removed or join.second in removed or root(join.first) == root(join.second):
            continue
        parent[max(root(join.first), root(join.second))] = min(root(join.first), root(join.second))
        groups.append(_demands(sampled, room, join.path, -1, margin))
    hopeless = np.array([e for e in errors if int(e) not in removed and root(int(e)) != 0], np.int64)
    return Repair(groups, hopeless)


def _demands(sampled: Sampled, room: _Room, index: Ints, to: int, margin: float) -> Demands:
    """to * g >= margin at the window's samples, or half of the way to what is within reach if that is nearer."""
    value, slope, weight = (a.ravel()[index] for a in (room.value, room.slope, room.weight))
    least, most = room.least.ravel()[index], room.most.ravel()[index]
    side = np.where(to * slope > 0, 1.0, -1.0)
    extreme = np.where(side > 0, most, least)
    farthest = to * (value + slope * (extreme - weight))
    past = np.minimum(margin, 0.5 * farthest)
    bound = weight + (to * past - value) / slope
    shape = room.value.shape
    parts = np.unravel_index(index, shape)
    points = np.stack([axis[part] for axis, part in zip(sampled.axes, parts, strict=True)], axis=-1)
    return Demands(points.reshape(-1, 3), bound, side)
