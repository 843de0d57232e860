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

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.blending.composition.affine_form import AffineBlend, find_bounding_window, tighten_weight_range
from tpmscad.blending.composition.defects import PhaseComponents
from tpmscad.blending.weights.constraints import NO_CONSTRAINTS, WeightConstraints
from tpmscad.blending.weights.weight_protocol import SplineWeight
from tpmscad.topology.voxels import Labels

PATH_STEP_COST = 0.01
"""Cost of a sample on a path beside the change of weight it needs: of equally cheap paths the short one is taken."""

INITIAL_SEARCH_COST, MAX_SEARCH_COST = 0.5, 64.0
"""Search radii, in cost: most errors have a neighbour within the first; beyond the last nothing was ever joined."""

SEARCH_MARGIN_SAMPLES = 10
"""Samples around the errors where repairs are looked for first."""

UNREACHABLE_COST = np.inf

NODE_OPEN, NODE_SOURCE, NODE_TARGET = 1, 2, 3
"""What a sample is to a path."""


@dataclass(frozen=True, slots=True, eq=False)
class RepairProposal:
    """Demands that mend an error each, cheapest first; `hopeless` labels have no repair within reach."""

    groups: list[WeightConstraints]
    hopeless: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _PhaseWindow:
    """One phase in the window, turned so that inside is g <= 0."""

    value: Array
    slope: Array
    least: Array
    most: Array
    weight: Array
    labels: Labels


@dataclass(frozen=True, slots=True, eq=False)
class RepairRequest:
    """What is to be mended: error labels of one phase (sign +1 for solid, -1 for void) of sampled values (nx, ny, nz).

    margin: how far past zero f is moved. kept: demands that leave less reach. bias: what removals are taken to cost beside
    joins, so that either can be preferred.
    """

    values: Array
    phase: PhaseComponents
    errors: IntArray
    sign: int
    margin: float
    kept: WeightConstraints = NO_CONSTRAINTS
    bias: float = 1.0


def propose_repairs(sampled: AffineBlend, weight: SplineWeight, wanted: RepairRequest) -> RepairProposal:
    """Repairs of errors, looked for near them first, then wherever the weight acts."""
    window = sampled.window
    where = wanted.phase.of(wanted.errors)[window]
    if not where.any():
        return RepairProposal([], wanted.errors)
    x, y, z = (
        slice(w.start + n.start, w.start + n.stop)
        for w, n in zip(window, find_bounding_window(where, SEARCH_MARGIN_SAMPLES), strict=True)
    )
    near = x, y, z
    found = _propose_in_window(replace(sampled, window=near), weight, wanted)
    return _propose_in_window(sampled, weight, wanted) if len(found.hopeless) and near != window else found


def _propose_in_window(sampled: AffineBlend, weight: SplineWeight, wanted: RepairRequest) -> RepairProposal:
    """The same in the window of the sampled blend."""
    window, sign, labels = sampled.window, wanted.sign, wanted.phase.labels[sampled.window]
    least, most = tighten_weight_range(sampled.reach(weight), sampled, weight, wanted.kept)
    acting = weight.on_grid(*sampled.axes)
    room = _PhaseWindow(sign * wanted.values[window], sign * sampled.slope[window], least, most, acting, labels)
    present = np.intersect1d(wanted.errors, np.unique(labels))
    removable = wanted.bias * _removal_costs(room, present, wanted.phase.count, wanted.margin)
    joins = _find_joins(room, present, wanted.phase.main, wanted.phase.count, wanted.margin)
    return _choose_repairs(sampled, room, removable, joins, wanted.errors, wanted.margin)


def _removal_costs(room: _PhaseWindow, errors: IntArray, count: int, margin: float) -> Array:
    """The greatest change of weight that removing each label takes; inf where a sample cannot leave the phase."""
    highest = room.value + np.maximum(room.slope * (room.least - room.weight), room.slope * (room.most - room.weight))
    wanted = np.zeros(count, bool)
    wanted[errors] = True
    inside = wanted[room.labels]
    labels, value, slope = room.labels[inside], room.value[inside], room.slope[inside]
    past = np.minimum(margin, 0.5 * highest[inside])
    movable = (slope != 0) & (past > 0)
    need = np.where(movable, (past - value) / np.where(movable, np.abs(slope), 1.0), UNREACHABLE_COST)
    cost = np.zeros(count)
    np.maximum.at(cost, labels, need)
    cost[~wanted] = UNREACHABLE_COST
    return cost


@dataclass(frozen=True, slots=True, eq=False)
class _Join:
    cost: float
    peak: float
    first: int
    second: int
    path: IntArray


def _find_joins(room: _PhaseWindow, errors: IntArray, main: IntArray, count: int, margin: float) -> list[_Join]:
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
    graph, nodes = _build_path_graph(room.labels.shape, opens.ravel(), source, target, need)
    starts = np.flatnonzero(source[nodes])
    reach = INITIAL_SEARCH_COST
    while True:
        distance, previous, origin = dijkstra(
            graph, indices=starts, min_only=True, return_predecessors=True, limit=reach
        )
        found = _find_cheapest_links(graph, nodes, distance, origin, owner, target)
        if len(np.unique(np.concatenate([found[1], found[2]]))) > len(errors) or reach >= MAX_SEARCH_COST:
            break
        reach *= 4
    joins = []
    for cost, first, second, u, v in zip(*found, strict=True):
        path = nodes[np.array(_trace_path(previous, u) + (_trace_path(previous, v) if v >= 0 else []), np.int64)]
        path = path[opens.ravel()[path]]
        joins.append(_Join(float(cost), float(need[path].max(initial=0.0)), int(first), int(second), path))
    return joins


def _build_path_graph(
    shape: tuple[int, ...], opens: BoolArray, source: BoolArray, target: BoolArray, need: Array
) -> tuple[csr_array, IntArray]:
    """Directed edges between neighbouring samples: out of sources, among open samples, into targets."""
    kind = np.zeros(opens.size, np.int8)
    kind[opens], kind[source], kind[target] = NODE_OPEN, NODE_SOURCE, NODE_TARGET
    middle = np.flatnonzero(opens)
    place = np.unravel_index(middle, shape)
    stride = (shape[1] * shape[2], shape[2], 1)
    heads, tails = [], []
    for axis in range(3):
        for way, end in ((-1, 0), (1, shape[axis] - 1)):
            here = middle[place[axis] != end]
            there = here + way * stride[axis]
            beside = kind[there]
            onwards, back = (beside == NODE_OPEN) | (beside == NODE_TARGET), beside == NODE_SOURCE
            heads += [here[onwards], there[back]]
            tails += [there[onwards], here[back]]
    head, tail = np.concatenate(heads), np.concatenate(tails)
    used = np.zeros(opens.size, bool)
    used[head] = used[tail] = True
    nodes, compact = np.flatnonzero(used), np.cumsum(used) - 1
    cost = np.where(opens, need + PATH_STEP_COST, 0.0)
    length = (cost[head] + cost[tail]) / 2
    graph = csr_array((length, (compact[head], compact[tail])), shape=(len(nodes), len(nodes)))
    return graph, nodes


def _find_cheapest_links(
    graph: csr_array, nodes: IntArray, distance: Array, origin: IntArray, owner: IntArray, target: BoolArray
) -> tuple[Array, IntArray, IntArray, IntArray, IntArray]:
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


def _trace_path(previous: IntArray, node: int) -> list[int]:
    path = []
    while node >= 0:
        path.append(int(node))
        node = previous[node]
    return path


def _choose_repairs(
    sampled: AffineBlend, room: _PhaseWindow, removal: Array, joins: list[_Join], errors: IntArray, margin: float
) -> RepairProposal:
    """Removals where they are cheaper than the cheapest join, then the spanning tree of the rest (Kruskal)."""
    cheapest = np.full(len(removal), UNREACHABLE_COST)
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
        _sample_constraints(sampled, room, np.flatnonzero(room.labels.ravel() == label), 1, margin)
        for label in sorted(removed)
    ]
    for join in joins:
        if join.first in removed or join.second in removed or root(join.first) == root(join.second):
            continue
        parent[max(root(join.first), root(join.second))] = min(root(join.first), root(join.second))
        groups.append(_sample_constraints(sampled, room, join.path, -1, margin))
    hopeless = np.array([e for e in errors if int(e) not in removed and root(int(e)) != 0], np.int64)
    return RepairProposal(groups, hopeless)


def _sample_constraints(
    sampled: AffineBlend, room: _PhaseWindow, index: IntArray, to: int, margin: float
) -> WeightConstraints:
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
    return WeightConstraints(points.reshape(-1, 3), bound, side)
