"""Repairs of topological defects on a grid: the cheapest joins and removals, as constraints on one stage's weight.

A defect is either joined to another component along the cheapest path of samples, or removed with all its samples, whichever
changes the weight less. The cost of a path is the sum of the changes of weight that its samples need, found by Dijkstra's
algorithm on the grid; the joins of several defects form a minimum spanning tree (Kruskal). Solid and void are treated alike, with
the sign of f reversed. Samples whose sign no attainable weight can change are never used.

This replaces the gradient step of the porous-blending paper (eqs 20 to 23), which moves one critical sample for each defect: the
cheapest path need not pass through the critical sample, and that sample may be one that the weight cannot change.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.blending.composition.affine_form import AffineBlend, find_bounding_window, tighten_weight_range
from tpmscad.blending.composition.defects import PhaseComponents
from tpmscad.blending.weights.constraints import NO_CONSTRAINTS, WeightConstraints, make_sign_constraints
from tpmscad.blending.weights.weight_protocol import SplineWeight
from tpmscad.topology.voxels import Labels

PATH_STEP_COST = 0.01
"""Cost of each sample of a path in addition to its change of weight: of equally cheap paths the shortest is taken."""

INITIAL_SEARCH_COST, MAX_SEARCH_COST, SEARCH_COST_GROWTH = 0.5, 64.0, 4.0
"""First and last radius of the path search, in cost, and the ratio of successive ones: most defects have a near neighbour."""

SEARCH_MARGIN_SAMPLES = 10
"""Width of the region around the defects that is searched first."""

REACHABLE_FRACTION = 0.5
"""Fraction of the attainable value that replaces the margin where the margin is out of reach."""

UNREACHABLE_COST = np.inf

NODE_OPEN, NODE_SOURCE, NODE_TARGET = 1, 2, 3
"""Kinds of samples in the path search: may become part of the phase; in a defect; in a main component."""


@dataclass(frozen=True, slots=True, eq=False)
class RepairProposal:
    """Groups of constraints that repair one defect each, cheapest first, and the labels of defects without a repair."""

    groups: list[WeightConstraints]
    unrepairable: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class RepairRequest:
    """Defects to be repaired: labels of one phase of sampled values (nx, ny, nz).

    `margin` is the value of |f| to reach. `active_constraints` narrow the attainable weights. `removal_cost_factor` multiplies
    the cost of removals, so that joins or removals can be preferred.
    """

    values: Array
    phase: PhaseComponents
    labels: IntArray
    margin: float
    active_constraints: WeightConstraints = NO_CONSTRAINTS
    removal_cost_factor: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class _PhaseWindow:
    """A window of one phase, with the sign of f such that the phase is {value <= 0}; all arrays have the window's shape."""

    value: Array
    slope: Array
    min_weight: Array
    max_weight: Array
    weight: Array
    labels: Labels

    def attainable(self, sign: float) -> Array:
        """The values that are greatest (sign 1) or least (sign -1) among those of attainable weights."""
        extreme = np.maximum if sign > 0 else np.minimum
        down, up = self.min_weight - self.weight, self.max_weight - self.weight
        return self.value + extreme(self.slope * down, self.slope * up)


def propose_repairs(affine: AffineBlend, weight: SplineWeight, request: RepairRequest) -> RepairProposal:
    """Repairs of defects: from a local search first, then, if that misses any, wherever the weight acts."""
    window = affine.window
    defects = request.phase.mask_of(request.labels)[window]
    if not defects.any():
        return RepairProposal([], request.labels)
    x, y, z = (
        slice(w.start + n.start, w.start + n.stop)
        for w, n in zip(window, find_bounding_window(defects, SEARCH_MARGIN_SAMPLES), strict=True)
    )
    local = x, y, z
    proposal = _propose_in_window(replace(affine, window=local), weight, request)
    if len(proposal.unrepairable) and local != window:
        return _propose_in_window(affine, weight, request)
    return proposal


def _propose_in_window(affine: AffineBlend, weight: SplineWeight, request: RepairRequest) -> RepairProposal:
    """Repairs of the defects in the window of the affine form."""
    sign, phase, labels = request.phase.sign, request.phase, request.phase.labels[affine.window]
    low, high = tighten_weight_range(affine.weight_range(weight), affine, weight, request.active_constraints)
    window = _PhaseWindow(
        sign * request.values[affine.window],
        sign * affine.slope[affine.window],
        low,
        high,
        weight.on_grid(*affine.axes),
        labels,
    )
    present = np.intersect1d(request.labels, np.unique(labels))
    removal = request.removal_cost_factor * _removal_costs(window, present, phase.n_labels, request.margin)
    joins = _find_joins(window, present, phase.main_labels, phase.n_labels, request.margin)
    return _choose_repairs(affine, window, removal, joins, request.labels, request.margin)


def _removal_costs(window: _PhaseWindow, labels: IntArray, n_labels: int, margin: float) -> Array:
    """The greatest change of weight that the removal of each label needs; inf if a sample cannot leave the phase."""
    is_defect = np.zeros(n_labels, bool)
    is_defect[labels] = True
    inside = is_defect[window.labels]
    sample_labels, value, slope = window.labels[inside], window.value[inside], window.slope[inside]
    goal = np.minimum(margin, REACHABLE_FRACTION * window.attainable(1)[inside])
    movable = (slope != 0) & (goal > 0)
    change = np.where(movable, (goal - value) / np.where(movable, np.abs(slope), 1.0), UNREACHABLE_COST)
    cost = np.zeros(n_labels)
    np.maximum.at(cost, sample_labels, change)
    cost[~is_defect] = UNREACHABLE_COST
    return cost


@dataclass(frozen=True, slots=True, eq=False)
class _Join:
    """A path between two components: its greatest change of weight, their labels (0: main), its samples."""

    max_change: float
    first: int
    second: int
    path: IntArray


def _find_joins(
    window: _PhaseWindow, labels: IntArray, main_labels: IntArray, n_labels: int, margin: float
) -> list[_Join]:
    """Cheapest paths between defects with adjacent search regions, and from defects to main components; cheapest first."""
    if len(labels) == 0:
        return []
    goal = np.minimum(margin, -REACHABLE_FRACTION * window.attainable(-1))
    is_passable = (window.labels == 0) & (window.slope != 0) & (goal > 0)
    change = np.where(
        is_passable, (window.value + goal) / np.where(is_passable, np.abs(window.slope), 1.0), 0.0
    ).ravel()
    kind = np.zeros(n_labels, np.int8)
    kind[labels], kind[main_labels] = NODE_SOURCE, NODE_TARGET
    source, target = (kind[window.labels] == NODE_SOURCE).ravel(), (kind[window.labels] == NODE_TARGET).ravel()
    source_label = np.where(source, window.labels.ravel(), 0)
    graph, nodes = _build_path_graph(window.labels.shape, is_passable.ravel(), source, target, change)
    starts = np.flatnonzero(source[nodes])
    limit = INITIAL_SEARCH_COST
    while True:
        distance, previous, origin = dijkstra(
            graph, indices=starts, min_only=True, return_predecessors=True, limit=limit
        )
        links = _find_cheapest_links(graph, nodes, distance, origin, source_label, target)
        all_linked = len(np.unique(np.concatenate(links[:2]))) > len(labels)
        if all_linked or limit >= MAX_SEARCH_COST:
            break
        limit *= SEARCH_COST_GROWTH
    joins = []
    for first, second, u, v in zip(*links, strict=True):
        path = nodes[np.array(_trace_path(previous, u) + (_trace_path(previous, v) if v >= 0 else []), np.int64)]
        path = path[is_passable.ravel()[path]]
        joins.append(_Join(float(change[path].max(initial=0.0)), int(first), int(second), path))
    return joins


def _build_path_graph(
    shape: tuple[int, ...], is_passable: BoolArray, source: BoolArray, target: BoolArray, change: Array
) -> tuple[csr_array, IntArray]:
    """Directed edges between face neighbours: out of sources, among passable samples, into targets; and its samples."""
    kind = np.zeros(is_passable.size, np.int8)
    kind[is_passable], kind[source], kind[target] = NODE_OPEN, NODE_SOURCE, NODE_TARGET
    passable = np.flatnonzero(is_passable)
    index = np.unravel_index(passable, shape)
    stride = (shape[1] * shape[2], shape[2], 1)
    heads, tails = [], []
    for axis in range(3):
        for direction, border in ((-1, 0), (1, shape[axis] - 1)):
            sample = passable[index[axis] != border]
            neighbour = sample + direction * stride[axis]
            neighbour_kind = kind[neighbour]
            is_next = (neighbour_kind == NODE_OPEN) | (neighbour_kind == NODE_TARGET)
            is_previous = neighbour_kind == NODE_SOURCE
            heads += [sample[is_next], neighbour[is_previous]]
            tails += [neighbour[is_next], sample[is_previous]]
    head, tail = np.concatenate(heads), np.concatenate(tails)
    used = np.zeros(is_passable.size, bool)
    used[head] = used[tail] = True
    nodes, compact = np.flatnonzero(used), np.cumsum(used) - 1
    cost = np.where(is_passable, change + PATH_STEP_COST, 0.0)
    length = (cost[head] + cost[tail]) / 2
    graph = csr_array((length, (compact[head], compact[tail])), shape=(len(nodes), len(nodes)))
    return graph, nodes


def _find_cheapest_links(
    graph: csr_array, nodes: IntArray, distance: Array, origin: IntArray, source_label: IntArray, target: BoolArray
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """The cheapest link of each pair of labels, cheapest first: the two labels (0: main) and its two end nodes (-1: none)."""
    reached = np.isfinite(distance)
    label = np.where(reached, source_label[nodes[np.where(reached, origin, 0)]], -1)
    ends = np.flatnonzero(reached & target[nodes])
    edges = graph.tocoo()
    u, v = edges.coords
    is_link = reached[u] & reached[v] & (label[u] != label[v]) & ~target[nodes[u]] & ~target[nodes[v]]
    u, v = u[is_link], v[is_link]
    cost = np.concatenate([distance[ends], distance[u] + edges.data[is_link] + distance[v]])
    first = np.concatenate([label[ends], np.minimum(label[u], label[v])])
    second = np.concatenate([np.zeros(len(ends), label.dtype), np.maximum(label[u], label[v])])
    a, b = np.concatenate([ends, u]), np.concatenate([np.full(len(ends), -1), v])
    order = np.argsort(cost, kind="stable")
    _, first_of_pair = np.unique(np.stack([first[order], second[order]]), axis=1, return_index=True)
    order = order[np.sort(first_of_pair)]
    return first[order], second[order], a[order], b[order]


def _trace_path(previous: IntArray, node: int) -> list[int]:
    path = []
    while node >= 0:
        path.append(int(node))
        node = previous[node]
    return path


def _choose_repairs(
    affine: AffineBlend, window: _PhaseWindow, removal: Array, joins: list[_Join], labels: IntArray, margin: float
) -> RepairProposal:
    """Removals where they are cheaper than the cheapest join, then the minimum spanning tree of the rest (Kruskal)."""
    cheapest = np.full(len(removal), UNREACHABLE_COST)
    for join in joins:
        for label in (join.first, join.second):
            cheapest[label] = min(cheapest[label], join.max_change)
    removed = {int(label) for label in labels if removal[label] < cheapest[label]}
    parent = {int(label): int(label) for label in (0, *labels)}

    def root(label: int) -> int:
        while parent[label] != label:
            parent[label] = parent[parent[label]]
            label = parent[label]
        return label

    groups = [
        _sample_constraints(affine, window, np.flatnonzero(window.labels.ravel() == label), 1, margin)
        for label in sorted(removed)
    ]
    for join in joins:
        if join.first in removed or join.second in removed or root(join.first) == root(join.second):
            continue
        parent[max(root(join.first), root(join.second))] = min(root(join.first), root(join.second))
        groups.append(_sample_constraints(affine, window, join.path, -1, margin))
    unrepairable = [label for label in labels if int(label) not in removed and root(int(label)) != 0]
    return RepairProposal(groups, np.array(unrepairable, np.int64))


def _sample_constraints(
    affine: AffineBlend, window: _PhaseWindow, index: IntArray, sign: int, margin: float
) -> WeightConstraints:
    """Constraints sign * value >= margin at samples of the window, or half of what is attainable if that is less."""
    value, slope, weight, low, high = (
        values.ravel()[index]
        for values in (window.value, window.slope, window.weight, window.min_weight, window.max_weight)
    )
    extreme = np.where(sign * slope > 0, high, low)
    attainable = sign * (value + slope * (extreme - weight))
    goal = np.minimum(margin, REACHABLE_FRACTION * attainable)
    parts = np.unravel_index(index, window.value.shape)
    points = np.stack([axis[part] for axis, part in zip(affine.axes, parts, strict=True)], axis=-1)
    return make_sign_constraints(points.reshape(-1, 3), value, slope, sign, goal, weight)
