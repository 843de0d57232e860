"""Tracks: the curves that lattice and body's surfaces have in common, arcs across patches and lattice edges in a surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.patches.complex import PatchComplex
from tpmscad.trimming.cuts import PatchCuts
from tpmscad.trimming.strands import Crossings, Strands
from tpmscad.trimming.tool import Ints


@dataclass(frozen=True, slots=True, eq=False)
class Tracks:
    """T curve pieces, the A arcs first; `strands.curve` numbers the lattice's curves, then the cuts'.

    `surface` (T,): where it lies. `face` (T,): the patch of an arc, or -1. `edge` (T,): the lattice edge, or -1 for arcs.
    `sense` (T,): +1 where the surface's negative side of the patch is on the left of an arc's parameter, else -1; 0 for edges.
    """

    strands: Strands
    surface: Ints
    face: Ints
    edge: Ints
    sense: Ints

    def __len__(self) -> int:
        return len(self.surface)


def all_tracks(lattice: PatchComplex, cuts: PatchCuts, crossings: Crossings) -> Tracks:
    """The arcs, then every lattice edge that lies in one surface; an edge in two is left to its neighbours."""
    e, faces = lattice.edges, lattice.faces
    flat = crossings.sign == 0
    edge, surface = np.nonzero(flat & (flat.sum(axis=1) == 1)[:, None])
    arcs, flats = len(cuts.face), len(edge)
    return Tracks(
        strands=Strands(
            curve=np.concatenate([len(lattice.curves) + cuts.cut, e.curve[edge]]),
            rotation=np.concatenate([faces.rotation[cuts.face], e.rotation[edge]]),
            translation=np.concatenate([faces.translation[cuts.face], e.translation[edge]]),
            span=np.concatenate([np.tile([0.0, 1.0], (arcs, 1)), e.span[edge]]),
            start=np.concatenate([cuts.start, e.start[edge]]),
            end=np.concatenate([cuts.end, e.end[edge]]),
        ),
        surface=np.concatenate([cuts.surface, surface]),
        face=np.concatenate([cuts.face, np.full(flats, -1)]),
        edge=np.concatenate([np.full(arcs, -1), edge]),
        sense=np.concatenate([cuts.sense, np.zeros(flats, np.int64)]),
    )
