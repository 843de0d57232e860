"""Properties of the solid that a boundary representation bounds: pieces, volume, area, centroid, Betti numbers.

For a solid M in space, chi(M) = chi(boundary) / 2. With b0 pieces and b2 voids, both counted from the shells, the number of
tunnels is b1 = b0 + b2 - chi(M) (Alexander duality).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.moments import integral_properties


@dataclass(frozen=True, slots=True)
class SolidPiece:
    """A connected part of the solid: volume within its outer shell, and the centre of the vertices of this shell."""

    volume: float
    near: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class TouchingPlace:
    """Where the boundary of a solid touches itself, or two pieces touch: in a point, or along an edge near the point."""

    kind: str
    near: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SolidProperties:
    """Properties in model units. `betti` is (pieces, tunnels, voids), None if the Brep is open; the largest piece comes first.

    What touches in `contacts` only counts as apart. `euler` is the Euler characteristic of the boundary, shell by shell.
    """

    closed: bool
    volume: float
    area: float
    centroid: tuple[float, float, float]
    betti: tuple[int, int, int] | None
    pieces: tuple[SolidPiece, ...]
    euler: tuple[int, ...] = ()
    contacts: tuple[TouchingPlace, ...] = ()


def measure_solid(brep: Brep, moments: integral_properties.FaceMoments | None = None) -> SolidProperties:
    """Measure the solid that a Brep bounds; pass the `moments` of its faces if they are known already.

    The outer shell of a piece has positive volume, the shell of a void negative volume.
    """
    moments = integral_properties.integrate_faces(brep) if moments is None else moments
    count, shell = connectivity.label_shells(brep)
    volumes = integral_properties.volume(moments, shell)
    closed = connectivity.is_closed(brep)
    outer = np.flatnonzero(volumes > 0)
    betti, euler = None, connectivity.euler_characteristic(brep, shell)
    if closed:
        pieces, voids = len(outer), count - len(outer)
        betti = (pieces, pieces + voids - int(euler.sum()) // 2, voids)
    vertex_shell = np.zeros(len(brep.vertices), np.int64)
    vertex_shell[brep.edges.start[brep.uses.edge]] = shell[brep.face_of_use]
    outer_by_volume = outer[np.argsort(-volumes[outer], kind="stable")]
    x, y, z = integral_properties.centroid(moments)
    return SolidProperties(
        closed=closed,
        volume=float(volumes.sum()),
        area=float(moments.area.sum()),
        centroid=(float(x), float(y), float(z)),
        betti=betti,
        pieces=tuple(
            SolidPiece(float(volumes[s]), tuple(brep.vertices[vertex_shell == s].mean(axis=0).tolist()))
            for s in outer_by_volume
        ),
        euler=tuple(euler.tolist()),
        contacts=tuple(
            TouchingPlace("point", (x, y, z))
            for x, y, z in brep.vertices[connectivity.find_touching_vertices(brep)].tolist()
        ),
    )
