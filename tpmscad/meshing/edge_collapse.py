"""Short edges of flat tetrahedra collapsed: one end goes to the other, and the elements between them vanish.

Patches of a fitted surface end where they like, so that a side of the box may pass a corner of patches at a hundredth of the
element size. A mesh that has a node in every vertex is as flat there as the edge is short. An edge of an element below the
quality wanted is collapsed if it is short, if all facets at the end which goes continue facets at the edge, in group and
normal, if they do not turn, and if the worst element around gets better. Nodes that are images of each other go together.

Source of the condition that keeps the topology: Dey, Edelsbrunner, Guha and Nekhayev, Topology preserving edge contraction,
Publ. Inst. Math. 66 (1999) 23.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.meshing.editable_mesh import CREASE_COSINE, Change, EditableMesh, unit_normal
from tpmscad.meshing.element_shapes import TETRA_EDGES

LEAST_COSINE = 0.98
"""Of the angle by which a facet may turn: that of a curved surface turns by its curvature times the length of the edge."""

FAR_SHORTER = 0.05
"""Of the longest edge that is collapsed: it makes an element as flat as itself whatever is done around it."""


def collapse_shortest_edge(mesh: EditableMesh, cell: int, longest: float) -> int:
    """Collapse the shortest edge of an element that can be; the number of edges collapsed, images included.

    One that is far shorter than `longest` goes where this helps the elements with straight edges: what it leaves of curved ones
    that are poor can be repaired, the short edge cannot.
    """
    ends = mesh.cells[cell, :4][np.array(TETRA_EDGES)]
    lengths = np.linalg.norm(mesh.points[ends[:, 0]] - mesh.points[ends[:, 1]], axis=1)
    for i in np.argsort(lengths):
        if lengths[i] > longest:
            return 0
        for gone, kept in (ends[i].tolist(), ends[i][::-1].tolist()):
            pairs = find_images(mesh, gone, kept)
            found = [_examine(mesh, a, b) for a, b in pairs]
            changes = [each for each in found if each is not None]
            if (
                changes
                and len(changes) == len(pairs)
                and mesh.judge_changes(changes, straight=lengths[i] < FAR_SHORTER * longest) is not None
            ):
                for each in changes:
                    mesh.apply(each)
                return len(pairs)
    return 0


def find_images(mesh: EditableMesh, gone: int, kept: int) -> list[tuple[int, int]]:
    """An edge and its images; none if the end that goes has an image that has no such edge."""
    own = mesh.images_of(gone)
    if len(own) == 1:
        return [(gone, kept)]
    off = mesh.periods_off[kept] - mesh.periods_off[gone]
    others = {tuple(mesh.periods_off[n]): n for n in mesh.images_of(kept)}
    found = [(node, others.get(tuple(mesh.periods_off[node] + off), -1)) for node in own]
    return found if all(b >= 0 for _, b in found) else []


def _examine(mesh: EditableMesh, gone: int, kept: int) -> Change | None:
    """The collapse of an edge, None if it would change the topology or what nodes lie on."""
    between = mesh.cells_at[gone] & mesh.cells_at[kept]
    facets = mesh.facets_at[gone] & mesh.facets_at[kept]
    changed_facets = sorted(mesh.facets_at[gone] - facets)
    if not between or not all(_continues(mesh, facet, facets) for facet in changed_facets):
        return None
    ring = _list_corners(mesh.cells[:, :4], between) - {gone, kept}
    if mesh.neighbours(gone) & mesh.neighbours(kept) != ring:
        return None
    rim = _list_corners(mesh.facets[:, :3], facets) - {gone, kept}
    beside = (_list_corners(mesh.facets[:, :3], mesh.facets_at[node]) - {gone, kept} for node in (gone, kept))
    if set.intersection(*beside) != rim:
        return None
    opposite = {frozenset(set(mesh.cells[cell, :4].tolist()) - {gone, kept}) for cell in between}
    if _ring_edges(mesh, gone, ring) & _ring_edges(mesh, kept, ring) != opposite:
        return None
    if any(_turns(mesh, facet, gone, kept) for facet in changed_facets):
        return None
    renamed: dict[int, int] = {gone: kept}
    moved: dict[int, Array] = {}
    if mesh.is_curved:
        middle = {node: mesh.middle(gone, node) for node in mesh.neighbours(gone)}
        for node in ring:
            renamed[middle[node]] = mesh.middle(kept, node)
        start, end = mesh.points[[gone, kept]]
        for node in middle.keys() - ring - {kept}:
            moved[middle[node]] = mesh.place_middle(node, start, end, middle[node], mesh.facets_near(gone, node))
    changed = sorted(mesh.cells_at[gone] - between)
    return Change(
        [*changed, *sorted(between)],
        _rename(mesh.cells[changed], renamed),
        changed,
        moved,
        [*changed_facets, *sorted(facets)],
        _rename(mesh.facets[changed_facets], renamed),
        changed_facets,
    )


def _continues(mesh: EditableMesh, facet: int, others: set[int]) -> bool:
    """Whether one of other facets is of the same groups, with no crease between both."""
    normal = mesh.normal(facet)
    return any(
        mesh.label_of(other) == mesh.label_of(facet) and normal @ mesh.normal(other) > CREASE_COSINE for other in others
    )


def _list_corners(corners: IntArray, rows: set[int]) -> set[int]:
    """The corners of some elements or facets."""
    return set(corners[list(rows)].ravel().tolist())


def _ring_edges(mesh: EditableMesh, node: int, ring: set[int]) -> set[frozenset[int]]:
    """Edges between nodes of a ring that make a triangle with a node, where an element has it."""
    return {
        frozenset(pair)
        for cell in mesh.cells_at[node]
        for pair in combinations([n for n in mesh.cells[cell, :4].tolist() if n in ring], 2)
    }


def _turns(mesh: EditableMesh, facet: int, gone: int, kept: int) -> bool:
    """Whether the normal of a facet turns too far."""
    corners = mesh.facets[facet, :3]
    after = np.where((corners == gone)[:, None], mesh.points[kept], mesh.points[corners])
    return not mesh.normal(facet) @ unit_normal(after) > LEAST_COSINE


def _rename(nodes: IntArray, renamed: dict[int, int]) -> IntArray:
    found = nodes.copy()
    for old, new in renamed.items():
        found[nodes == old] = new
    return found
