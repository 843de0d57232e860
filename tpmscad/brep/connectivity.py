"""Topology of a boundary representation from its shared edges alone: closedness, shells, Euler characteristic."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.linked_items import label_sharing


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
    before = np.arange(-1, len(uses) - 1)
    before[start[:-1]] = start[1:] - 1
    loop_of_use = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return np.unique(loop_of_use[first != last[before]])


def label_shells(brep: Brep) -> tuple[int, IntArray]:
    """The number of shells (edge-connected components), and the shell of each face (F,), numbered by first face."""
    label = label_sharing(len(brep.faces), brep.face_of_use, brep.uses.edge)
    return 1 + int(label.max(initial=-1)), label


def euler_characteristic(brep: Brep, shell_of_face: IntArray) -> NDArray[np.int64]:
    """V - E + F of each shell of a Brep, a face with h holes counted as 1 - h: (n_shells,)."""
    n = int(shell_of_face.max(initial=-1)) + 1
    edge_shell = np.zeros(len(brep.edges), np.int64)
    edge_shell[brep.uses.edge] = shell_of_face[brep.face_of_use]
    ends = np.concatenate([brep.edges.start, brep.edges.end])
    vertices = np.unique(np.stack([ends, np.concatenate([edge_shell, edge_shell])]), axis=1)
    holes = np.bincount(shell_of_face, weights=np.diff(brep.faces.loop_start) - 1, minlength=n)
    used = np.unique(brep.uses.edge)
    return np.asarray(
        np.bincount(vertices[1], minlength=n)
        - np.bincount(edge_shell[used], minlength=n)
        + np.bincount(shell_of_face, minlength=n)
        - holes.astype(np.int64)
    )
