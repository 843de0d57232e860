"""What follows from shared edges alone: closedness, open borders, shells, Euler characteristic."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tpmscad.patches.complex import Ints, PatchComplex


def edge_uses(complex: PatchComplex) -> Ints:
    """How many loop sides each edge is: (E,)."""
    return np.bincount(complex.uses.edge, minlength=len(complex.edges))


def unmatched_edges(complex: PatchComplex) -> Ints:
    """Edges that are not used exactly twice, once in each direction as seen along the outward normals."""
    seen_from_outside = complex.uses.sense * complex.faces.sense[complex.face_of_use]
    balance = np.bincount(complex.uses.edge, weights=seen_from_outside, minlength=len(complex.edges))
    return np.flatnonzero((edge_uses(complex) != 2) | (balance != 0))


def is_closed(complex: PatchComplex) -> bool:
    """Whether the faces bound a region consistently: no unmatched edge."""
    return len(unmatched_edges(complex)) == 0


def shells(complex: PatchComplex) -> tuple[int, Ints]:
    """The number of edge-connected components and each face's, numbered by first face: n, (F,)."""
    face = complex.face_of_use
    n_faces, n_edges = len(complex.faces), len(complex.edges)
    incidence = coo_array(
        (np.ones(len(face), bool), (face, n_faces + complex.uses.edge)), shape=(n_faces + n_edges,) * 2
    )
    _, label = connected_components(incidence, directed=False)
    _, first, compact = np.unique(label[:n_faces], return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return len(first), rank[compact]


def euler_characteristic(complex: PatchComplex, shell: Ints) -> NDArray[np.int64]:
    """V - E + F of each shell, a face with h holes counting as 1 - h: (n_shells,). `shell` is each face's, as from `shells`."""
    n = int(shell.max(initial=-1)) + 1
    of_use = shell[complex.face_of_use]
    edge_shell = np.zeros(len(complex.edges), np.int64)
    edge_shell[complex.uses.edge] = of_use
    ends = np.concatenate([complex.edges.start, complex.edges.end])
    vertices = np.unique(np.stack([ends, np.concatenate([edge_shell, edge_shell])]), axis=1)
    holes = np.bincount(shell, weights=np.diff(complex.faces.loop_start) - 1, minlength=n)
    used = np.unique(complex.uses.edge)
    return np.asarray(
        np.bincount(vertices[1], minlength=n)
        - np.bincount(edge_shell[used], minlength=n)
        + np.bincount(shell, minlength=n)
        - holes.astype(np.int64)
    )
