"""The shape of the solid that a complex bounds: pieces, volume, area, centroid, Betti numbers; from the arrays alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.moments import integral_properties


@dataclass(frozen=True, slots=True)
class SolidPiece:
    """A connected part of the solid: its outer shell's volume and a point of it (centre of the shell's vertices)."""

    volume: float
    near: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SolidProperties:
    """Model units. `betti` are (pieces, tunnels, voids) and None where the complex is open."""

    closed: bool
    volume: float
    area: float
    centroid: tuple[float, float, float]
    betti: tuple[int, int, int] | None
    pieces: tuple[SolidPiece, ...]


def measure_solid(brep: Brep, moments: integral_properties.FaceMoments | None = None) -> SolidProperties:
    """Measure the complex; pieces come largest first. `moments` are its faces', where they are known already.

    A shell that bounds its inside has positive volume, a void's shell negative. For a solid M in space, chi(M) is half of
    chi(boundary), which gives the number of tunnels (Alexander duality).
    """
    moments = integral_properties.integrate_faces(brep) if moments is None else moments
    count, shell = connectivity.label_shells(brep)
    volumes = integral_properties.volume(moments, shell)
    closed = connectivity.is_closed(brep)
    outer = np.flatnonzero(volumes > 0)
    betti = None
    if closed:
        euler = int(connectivity.euler_characteristic(brep, shell).sum())
        pieces, voids = len(outer), count - len(outer)
        betti = (pieces, pieces + voids - euler // 2, voids)
    vertex_shell = np.zeros(len(brep.vertices), np.int64)
    vertex_shell[brep.edges.start[brep.uses.edge]] = shell[brep.face_of_use]
    order = outer[np.argsort(-volumes[outer], kind="stable")]
    x, y, z = integral_properties.centroid(moments)
    return SolidProperties(
        closed=closed,
        volume=float(volumes.sum()),
        area=float(moments.area.sum()),
        centroid=(float(x), float(y), float(z)),
        betti=betti,
        pieces=tuple(
            SolidPiece(float(volumes[s]), tuple(brep.vertices[vertex_shell == s].mean(axis=0).tolist())) for s in order
        ),
    )
