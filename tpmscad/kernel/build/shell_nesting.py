"""Nesting of shells: outer shells and the void shells inside them form solids.

A shell whose faces look out of the material it encloses has positive volume; a void shell has negative volume.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array, IntArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, sample_edges, spline_faces
from tpmscad.brep.carriers import Plane, Quadric, SphericalSurface, ToroidalSurface
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import KernelError
from tpmscad.splines.bspline import BSplineSurface


@dataclass(frozen=True, slots=True, eq=False)
class ShellNesting:
    """Solids of a closed boundary representation, as groups of its shells.

    shell_of_face (F,): shell of each face. volume: signed volume of each shell. moments: moments of the faces.
    shells_of_solid: for each solid its outer shell, then its void shells; solids are sorted by outer volume, largest first,
    equal ones by their first face.
    """

    shell_of_face: IntArray
    volume: Array
    moments: integral_properties.FaceMoments
    shells_of_solid: tuple[tuple[int, ...], ...]

    def faces_of_shell(self, shell: int) -> IntArray:
        """Indices of the faces of a shell."""
        return np.flatnonzero(self.shell_of_face == shell)


def nest_shells(
    brep: Brep, inside: Callable[[int, Array], bool], moments: integral_properties.FaceMoments | None = None
) -> ShellNesting:
    """Group the shells of a closed boundary representation into solids.

    A void belongs to the smallest outer shell around it. The boxes of edges decide if only one contains the void's; otherwise,
    for shells with quadric faces, and where spline faces bulge beyond their edges, `inside(shell, point)` decides. `moments` are
    those of the faces, if known already. Raises KernelError if no shell contains a void: a solid is inside out.
    """
    count, shell = connectivity.label_shells(brep)
    moments = integral_properties.integrate_faces(brep) if moments is None else moments
    volume = integral_properties.volume(moments, shell)
    outer = np.flatnonzero(volume > 0)
    outer = outer[np.argsort(-volume[outer], kind="stable")]
    shells_of_solid = {int(s): [int(s)] for s in outer}
    voids = np.flatnonzero(volume <= 0)
    if len(voids):
        low, high, point = _edge_boxes(brep, shell, count)
        least, most, round_shell = _enlarge_by_surfaces(brep, shell, low, high)
        for void in voids:
            reach = low[void], high[void]
            around = [int(s) for s in outer if (least[s] < reach[0]).all() and (most[s] > reach[1]).all()]
            bulges = any((low[s] >= reach[0]).any() or (high[s] <= reach[1]).any() for s in around)
            if len(around) > 1 or bulges or any(round_shell[s] for s in around):
                around = [s for s in around if inside(s, point[void])]
            if not around:
                raise KernelError(
                    "build",
                    f"a shell of volume {volume[void]:.6g} near {point[void].round(6)} is in no solid: inside out",
                )
            shells_of_solid[around[-1]].append(int(void))
    return ShellNesting(shell, volume, moments, tuple(tuple(piece) for piece in shells_of_solid.values()))


def _edge_boxes(brep: Brep, shell: IntArray, count: int) -> tuple[Array, Array, Array]:
    """Bounding box of the end and middle points of the edges of each shell, and one vertex of it: (count, 3) each."""
    edges = brep.edges
    middle = sample_edges(brep, 3)[:, 1]
    edge_shell = shell[brep.face_of_use]
    used = brep.uses.edge
    points = np.concatenate([brep.vertices[edges.start[used]], brep.vertices[edges.end[used]], middle[used]])
    of = np.concatenate([edge_shell] * 3)
    lowest, highest = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(lowest, of, points)
    np.maximum.at(highest, of, points)
    _, first = np.unique(of, return_index=True)
    return lowest, highest, points[first]


def _enlarge_by_surfaces(
    brep: Brep, shell: IntArray, low: Array, high: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """The boxes enlarged to contain the curved faces of each shell, and a mask of the shells that have quadric ones."""
    low, high, has = low.copy(), high.copy(), np.zeros(len(low), bool)
    faces, uses, face = brep.faces, brep.uses, brep.face_of_use
    for own, spline in spline_faces(brep):
        poles = faces.motion[own][:, None].apply(spline.poles.reshape(-1, 3))
        np.minimum.at(low, shell[own], poles.min(axis=1))
        np.maximum.at(high, shell[own], poles.max(axis=1))
    for i, index in enumerate(faces.carrier.tolist()):
        carrier = brep.carriers[index]
        if isinstance(carrier, BSplineSurface | Plane):
            continue
        v = np.concatenate([brep.pcurves[p].poles[:, 1] for p in np.unique(uses.pcurve[face == i]).tolist()])
        centre, radius = _bounding_sphere(carrier, float(v.min()), float(v.max()))
        centre = faces.motion[i].apply(centre)
        s = shell[i]
        low[s], high[s], has[s] = np.minimum(low[s], centre - radius), np.maximum(high[s], centre + radius), True
    return low, high, has


def _bounding_sphere(quadric: Quadric, low: float, high: float) -> tuple[Array, float]:
    """Center and radius of a sphere around the part of a quadric between two values of v."""
    if isinstance(quadric, SphericalSurface):
        return quadric.origin, quadric.radius
    if isinstance(quadric, ToroidalSurface):
        return quadric.origin, quadric.major + quadric.minor
    rims = quadric(np.zeros(2), np.array([low, high]))
    heights = (rims - quadric.origin) @ quadric.axis
    middle = quadric.origin + heights.mean() * quadric.axis
    return middle, float(np.linalg.norm(rims - middle, axis=1).max())
