"""Volume, area and centroid of a boundary representation by Gauss quadrature on its faces, trimmed ones included.

The moments of a face,

    A = int dA,   N = int n dA,   M = int x n^T dA,   Q = int x (x . n) dA,

transform in closed form under a rigid motion, so they are integrated once per pcurve span and carrier and then placed. By the
divergence theorem, with outward normals, the volume is sum tr M / 3 and the centroid sum Q / (4 volume).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Carrier, Plane
from tpmscad.brep.foot_surface import find_point_sides
from tpmscad.brep.moments.loop_integrals import N_MOMENTS, composite_curve_rule, integrate_pcurves
from tpmscad.brep.moments.tensor_gauss import whole_moments
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.splines.knots import turn_surface


@dataclass(frozen=True, slots=True)
class FaceMoments:
    """Moments of F faces: area (F,), normal = N (F, 3), first = M (F, 3, 3) = int x_i n_j, second = Q (F, 3)."""

    area: Array
    normal: Array
    first: Array
    second: Array

    def select(self, faces: IntArray, reversed_faces: BoolArray | bool = False) -> FaceMoments:
        """The moments of some faces (n,), of which those of the mask (n,) look the other way."""
        sign = np.where(reversed_faces, -1.0, 1.0)[..., None]
        first = self.first[faces] * sign[..., None]
        return FaceMoments(self.area[faces], self.normal[faces] * sign, first, self.second[faces] * sign)


def integrate_faces(brep: Brep) -> FaceMoments:
    """The moments of every face with its outward normal, in model units."""
    faces, uses = brep.faces, brep.uses
    face = brep.face_of_use
    carrier = faces.carrier[face]
    planar = np.array([isinstance(c, Plane) for c in brep.carriers], bool)[carrier]

    whole, moments = whole_moments(brep)
    curved = np.flatnonzero(~planar & ~whole[face])
    if len(curved):
        span = brep.edges.span[uses.edge[curved]]
        columns = [carrier[curved], uses.pcurve[curved], span, _find_starts(brep, curved)]
        keys, key_of_use = np.unique(np.column_stack(columns), axis=0, return_inverse=True)
        table = np.empty((len(keys), N_MOMENTS))
        starts = [0, *(np.flatnonzero(np.diff(keys[:, 0])) + 1).tolist(), len(keys)]  # keys come sorted by carrier
        for start, stop in zip(starts[:-1], starts[1:], strict=True):
            surface = brep.carriers[int(keys[start, 0])]
            assert not isinstance(surface, Plane)
            pieces = [(brep.pcurves[int(p)], (low, high)) for _, p, low, high, _ in keys[start:stop].tolist()]
            if isinstance(surface, BSplineSurface) and _start_axis(surface):
                pieces = [(BSplineCurve(c.poles[:, ::-1], c.knots, c.degree), along) for c, along in pieces]
                turned = integrate_pcurves(turn_surface(surface, swap=True), pieces, keys[start:stop, 4])
                # loops run the other way round, and so does the normal
                table[start:stop] = turned * np.where(np.arange(N_MOMENTS) == 0, -1.0, 1.0)
            else:
                table[start:stop] = integrate_pcurves(surface, pieces, keys[start:stop, 4])
        np.add.at(moments, face[curved], table[key_of_use.ravel()] * uses.sense[curved, None])
    if len(curved) or whole.any():
        moments = _move_moments(moments, faces.motion)
    _add_planar_faces(moments, brep, np.flatnonzero(planar), face)

    outward = np.where(faces.sense > 0, 1.0, -1.0)[:, None]
    return FaceMoments(
        area=moments[:, 0],
        normal=moments[:, 1:4] * outward,
        first=moments[:, 4:13].reshape(-1, 3, 3) * outward[:, None],
        second=moments[:, 13:] * outward,
    )


def _start_axis(carrier: Carrier) -> int:
    """The parameter, u or v (0 or 1), along which moments on a surface are integrated first: of a spline that of fewer spans.

    On a spline with poles it is u: loops have steps along v = const at a pole, which are no half-edges.
    """
    if not isinstance(carrier, BSplineSurface) or len(np.unique(carrier.knots_u)) <= len(np.unique(carrier.knots_v)):
        return 0
    return int(not find_point_sides(carrier).any())


def _find_starts(brep: Brep, curved: IntArray) -> Array:
    """For each of the uses `curved` (n,), the last knot of its surface along `_start_axis` before all of its face: (n,).

    On a quadric it is the face's least angle: counted from 0, gaps of 1e-8 between pcurves gave a face of 9e-6 an area that was
    off by 6e-8, and a sliver of a lattice a negative volume. A face is small beside its surface where a large spline face of a
    body has been cut into hundreds.
    """
    face, pcurve = brep.face_of_use[curved], brep.uses.pcurve[curved]
    first = np.full(len(brep.faces), np.inf)
    axis = np.array([_start_axis(c) for c in brep.carriers])[brep.faces.carrier[face]].tolist()
    poles = [brep.pcurves[p].poles[:, a].min() for p, a in zip(pcurve.tolist(), axis, strict=True)]
    np.minimum.at(first, face, np.array(poles))
    start, carrier = first[face], brep.faces.carrier[face]
    for c in np.unique(carrier).tolist():
        surface = brep.carriers[c]
        if isinstance(surface, BSplineSurface):
            own = np.flatnonzero(carrier == c)
            knots = np.unique((surface.knots_u, surface.knots_v)[_start_axis(surface)])
            start[own] = knots[np.maximum(np.searchsorted(knots, first[face[own]], side="right") - 1, 0)]
    return start


def volume(moments: FaceMoments, face_group: IntArray | None = None) -> Array:
    """Signed volume of each closed group of faces (n_groups,); all faces form one group if `face_group` (F,) is None.

    It is taken about a point amid each group's own faces: neighbouring faces agree to a tolerance only, so that int n dA is not
    quite zero, and its scalar product with the position of the group would count as volume. A flat face has (int x n' dA)
    (int n dA) = area^2 times its centroid; the point is the mean of these.
    """
    group = np.zeros(len(moments.area), np.int64) if face_group is None else face_group
    each = np.trace(moments.first, axis1=1, axis2=2) / 3.0
    arms = np.einsum("fij,fj->fi", moments.first, moments.normal)
    weight = np.bincount(group, weights=(moments.normal**2).sum(axis=1))
    sums = np.column_stack([np.bincount(group, weights=column) for column in arms.T])
    centre = sums / np.where(weight > 0.0, weight, np.inf)[:, None]
    return np.bincount(group, weights=each - (centre[group] * moments.normal).sum(axis=1) / 3.0).astype(float)


def centroid(moments: FaceMoments) -> Array:
    """Centroid (3,) of the region that the faces bound."""
    normal, first, second = (m.sum(axis=0) for m in (moments.normal, moments.first, moments.second))
    cone = np.trace(first)
    centre = second / (4.0 * cone / 3.0)
    about_centre = second - first @ centre - (cone - centre @ normal) * centre
    return np.asarray(centre + about_centre / (4.0 * volume(moments)[0]))


def _move_moments(moments: Array, motion: Motion) -> Array:
    """Moments (F, 16) after rigid motions (F,), with S_u x S_v of the moved surface, which a mirror reverses."""
    normal, first, second = moments[:, 1:4], moments[:, 4:13].reshape(-1, 3, 3), moments[:, 13:]
    rotation, t = motion.rotation, motion.translation
    back = motion.apply_inverse_to_vectors(t)
    cone = np.trace(first, axis1=1, axis2=2) + (back * normal).sum(axis=1)  # int (R x + t) . R n
    second = motion.apply_to_vectors(second + np.einsum("fij,fj->fi", first, back)) + t * cone[:, None]
    first = np.einsum("fia,fab,fjb->fij", rotation, first, rotation, optimize=True)
    normal = motion.apply_to_vectors(normal)
    first = first + np.einsum("fi,fj->fij", t, normal)
    signed = motion.handedness[:, None] * np.concatenate([normal, first.reshape(-1, 9), second], axis=1)
    return np.concatenate([moments[:, :1], signed], axis=1)


def _add_planar_faces(moments: Array, brep: Brep, planar_uses: IntArray, face: IntArray) -> None:
    """Write the moments of planar faces to `moments`, from the curves of their edges projected on the plane (Green's theorem)."""
    edges, uses, faces = brep.edges, brep.uses, brep.faces
    if len(planar_uses) == 0:
        return
    in_plane = np.zeros((len(faces), 3))  # int of 1, u, v
    frames = _plane_frames(brep)
    edge = uses.edge[planar_uses]
    keys, key_of_use = np.unique(np.column_stack([edges.curve[edge], edges.span[edge]]), axis=0, return_inverse=True)
    order = np.argsort(key_of_use.ravel(), kind="stable")
    bounds = np.searchsorted(key_of_use.ravel()[order], np.arange(len(keys) + 1)).tolist()
    for k, (index, low, high) in enumerate(keys.tolist()):
        curve = brep.curves[int(index)]
        nodes, weights = composite_curve_rule(curve, (low, high))
        local, speed = curve(nodes), curve(nodes, 1)
        at = planar_uses[order[bounds[k] : bounds[k + 1]]]
        e, f = uses.edge[at], face[at]
        points = (
            local @ np.swapaxes(edges.motion.rotation[e], 1, 2) + (edges.motion.translation[e] - frames[f, 0])[:, None]
        )
        axes = np.swapaxes(frames[f, 1:3], 1, 2)
        u, v = np.moveaxis(points @ axes, -1, 0)
        dv = (speed @ np.swapaxes(edges.motion.rotation[e], 1, 2) @ axes)[:, :, 1] * weights * uses.sense[at][:, None]
        np.add.at(in_plane, f, np.stack([(p * dv).sum(axis=1) for p in (u, u**2 / 2, u * v)], axis=1))
    at = np.unique(face[planar_uses])
    moments[at] = lift_planar_moments(in_plane[at], frames[at])


def _plane_frames(brep: Brep) -> Array:
    """Origin, x axis, y axis and normal of each planar face after its motion, zeros for others: (F, 4, 3).

    The normal is the cross product of the placed axes, so a mirrored plane keeps counter-clockwise loops.
    """
    faces = brep.faces
    frames = np.zeros((len(faces), 4, 3))
    for index, carrier in enumerate(brep.carriers):
        if isinstance(carrier, Plane):
            at = np.flatnonzero(faces.carrier == index)
            rotation = faces.motion.rotation[at]
            frames[at, 0] = rotation @ carrier.origin + faces.motion.translation[at]
            frames[at, 1] = rotation @ carrier.x_axis
            frames[at, 2] = rotation @ carrier.y_axis
            frames[at, 3] = np.cross(frames[at, 1], frames[at, 2])
    return frames


def lift_planar_moments(in_plane: Array, frames: Array) -> Array:
    """Moments in space (n, 16) of planar faces from their in-plane integrals of 1, u, v (n, 3)."""
    o, n, area = frames[:, 0], frames[:, 3], in_plane[:, :1]
    x = area * o + np.einsum("na,nai->ni", in_plane[:, 1:3], frames[:, 1:3])
    height = (o * n).sum(axis=1)[:, None]
    return np.concatenate([area, area * n, np.einsum("ni,nk->nik", x, n).reshape(-1, 9), height * x], axis=1)
