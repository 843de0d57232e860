"""The shape of the solid that a complex bounds: pieces, volume, area, centroid, Betti numbers; from the arrays alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.patches import connectivity, measure
from tpmscad.patches.complex import PatchComplex


@dataclass(frozen=True, slots=True)
class Piece:
    """A connected part of the solid: its outer shell's volume and a point of it (centre of the shell's vertices)."""

    volume: float
    near: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Summary:
    """Model units. `betti` are (pieces, tunnels, voids) and None where the complex is open."""

    closed: bool
    volume: float
    area: float
    centroid: tuple[float, float, float]
    betti: tuple[int, int, int] | None
    pieces: tuple[Piece, ...]


def summary(complex: PatchComplex, moments: measure.Moments | None = None) -> Summary:
    """Measure the complex; pieces come largest first. `moments` are its faces', where they are known already.

    A shell that bounds its inside has positive volume, a void's shell negative. For a solid M in space, chi(M) is half of
    chi(boundary), which gives the number of tunnels (Alexander duality).
    """
    moments = measure.face_moments(complex) if moments is None else moments
    count, shell = connectivity.shells(complex)
    volumes = measure.volume(moments, shell)
    closed = connectivity.is_closed(complex)
    outer = np.flatnonzero(volumes > 0)
    betti = None
    if closed:
        euler = int(connectivity.euler_characteristic(complex, shell).sum())
        pieces, voids = len(outer), count - len(outer)
        betti = (pieces, pieces + voids - euler // 2, voids)
    vertex_shell = np.zeros(len(complex.vertices), np.int64)
    vertex_shell[complex.edges.start[complex.uses.edge]] = shell[complex.face_of_use]
    order = outer[np.argsort(-volumes[outer], kind="stable")]
    x, y, z = measure.centroid(moments)
    return Summary(
        closed=closed,
        volume=float(volumes.sum()),
        area=float(moments.area.sum()),
        centroid=(float(x), float(y), float(z)),
        betti=betti,
        pieces=tuple(
            Piece(float(volumes[s]), tuple(complex.vertices[vertex_shell == s].mean(axis=0).tolist())) for s in order
        ),
    )
