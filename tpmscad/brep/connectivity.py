"""Topology of a boundary representation from its shared edges alone: closedness, shells, Euler characteristic.

Round a vertex lie one or more fans, faces one after the other that share edges there. Where there are several, the boundary
touches itself, or two pieces touch: each fan counts as a vertex of its own, as if the boundary were opened a little there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.linked_items import label_linked, label_sharing
from tpmscad.index_ranges import list_preceding


def find_unmatched_edges(brep: Brep) -> IntArray:
    """Edges that are not used exactly twice, once in each direction as seen from outside: (n,)."""
    seen_from_outside = brep.uses.sense * brep.faces.sense[brep.face_of_use]
    count = np.bincount(brep.uses.edge, minlength=len(brep.edges))
    balance = np.bincount(brep.uses.edge, weights=seen_from_outside, minlength=len(brep.edges))
    return np.flatnonzero((count != 2) | (balance != 0))


def is_closed(brep: Brep) -> bool:
    """Whether the faces bound a region consistently (watertight): there is no unmatched edge."""
    return len(find_unmatched_edges(brep)) == 0


def find_broken_loops(brep: Brep) -> IntArray:
    """Loops in which an edge use does not begin at the vertex where the use before it ends: (n,)."""
    edges, uses, start = brep.edges, brep.uses, brep.faces.use_start
    forward = uses.sense > 0
    first = np.where(forward, edges.start[uses.edge], edges.end[uses.edge])
    last = np.where(forward, edges.end[uses.edge], edges.start[uses.edge])
    before = list_preceding(start)
    loop_of_use = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return np.unique(loop_of_use[first != last[before]])


def label_shells(brep: Brep) -> tuple[int, IntArray]:
    """The number of shells (edge-connected components), and the shell of each face (F,), numbered by first face."""
    label = label_sharing(len(brep.faces), brep.face_of_use, brep.uses.edge)
    return 1 + int(label.max(initial=-1)), label


def label_fans(brep: Brep) -> tuple[IntArray, IntArray]:
    """The vertex (n,) of each fan of faces round a vertex, and an edge (n,) of it."""
    uses, edges = brep.uses, brep.edges
    against = (uses.sense < 0).astype(np.int64)
    first, last = 2 * uses.edge + against, 2 * uses.edge + 1 - against  # the ends of edges, 0 and 1 of each
    fan = label_linked(2 * len(edges), np.column_stack([last[list_preceding(brep.faces.use_start)], first]))
    ends = np.concatenate([first, last])
    _, at = np.unique(fan[ends], return_index=True)
    edge, end = np.divmod(ends[at], 2)
    return np.where(end > 0, edges.end[edge], edges.start[edge]), edge


def find_touching_vertices(brep: Brep) -> IntArray:
    """Vertices (n,) with several fans, in which the boundary touches itself."""
    return np.flatnonzero(np.bincount(label_fans(brep)[0], minlength=len(brep.vertices)) > 1)


def euler_characteristic(brep: Brep, shell_of_face: IntArray) -> NDArray[np.int64]:
    """V - E + F of each shell of a Brep, with its fans as vertices, a face with h holes counted as 1 - h: (n_shells,)."""
    n = int(shell_of_face.max(initial=-1)) + 1
    edge_shell = np.zeros(len(brep.edges), np.int64)
    edge_shell[brep.uses.edge] = shell_of_face[brep.face_of_use]
    holes = np.bincount(shell_of_face, weights=np.diff(brep.faces.loop_start) - 1, minlength=n)
    used = np.unique(brep.uses.edge)
    return np.asarray(
        np.bincount(edge_shell[label_fans(brep)[1]], minlength=n)
        - np.bincount(edge_shell[used], minlength=n)
        + np.bincount(shell_of_face, minlength=n)
        - holes.astype(np.int64)
    )
