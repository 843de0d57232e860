"""The true extent of a boundary representation along the coordinate axes: what is cut off a carrier does not count.

A coordinate is greatest at a vertex, on an edge, or inside a face where its gradient along the surface vanishes. Vertices come
first. Conics, spheres and tori have their extremes in closed form; planes, cylinders and cones have none inside. B-splines are
searched by branch and bound: the poles of a Bezier piece bound it, a piece that cannot exceed the extent found so far is
dropped, and so is a piece of a surface without a stationary point; the others are bisected.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep, spline_faces
from tpmscad.brep.carriers import SphericalSurface, ToroidalSurface
from tpmscad.brep.conics import TWO_PI, Circle, Ellipse
from tpmscad.brep.loops import points_in_polygons
from tpmscad.rigid_motion import Motion
from tpmscad.splines.basis import bezier_interpolation, halving_matrix
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.splines.knots import bezier_pieces

EXTENT_RTOL = 1e-9
"""Greatest part of the size by which an extent may be too small."""

SAMPLES_PER_USE = 33
"""Points along an edge use in the polygon that tells whether a point lies in a face."""

MAX_BISECTIONS = 60
"""Bisections of a piece: with fewer than this its size falls below round-off."""

PERIOD_SHIFTS = range(-2, 3)
"""Multiples of the period at which a point is looked for in the loops of a face, whose angles lie in any period."""


def true_bounds(brep: Brep) -> tuple[Array, Array]:
    """Opposite corners (3,), (3,) of the smallest box that contains the faces, to `EXTENT_RTOL` of its size.

    ValueError if there is no face.
    """
    if not len(brep.faces):
        raise ValueError("a boundary representation without faces has no extent")
    used = np.unique(np.concatenate([brep.edges.start, brep.edges.end]))
    points = brep.vertices[used]
    reach = np.concatenate([-points.min(axis=0), points.max(axis=0)])  # along -x, -y, -z, x, y, z
    tol = EXTENT_RTOL * float(np.max(reach[:3] + reach[3:]))
    reach = np.maximum(reach, _conic_reach(brep))
    reach = _extend_by_spline_edges(brep, reach, tol)
    reach = np.maximum(reach, _round_face_reach(brep))
    reach = _extend_by_spline_faces(brep, reach, tol)
    return -reach[:3], reach[3:]


def _reach_along_axes(points: Array) -> Array:
    """Coordinates along -x, -y, -z, x, y, z of points (..., 3): (..., 6)."""
    return np.concatenate([-points, points], axis=-1)


def _conic_reach(brep: Brep) -> Array:
    """Greatest coordinates (6,) of the edges on circles and ellipses between their ends."""
    reach = np.full(6, -np.inf)
    edges = brep.edges
    conic = np.array([isinstance(c, Circle | Ellipse) for c in brep.curves], bool)
    order = np.argsort(edges.curve, kind="stable")
    limits = np.searchsorted(edges.curve[order], np.arange(len(brep.curves) + 1))
    for index in np.flatnonzero(conic).tolist():
        own, curve = order[limits[index] : limits[index + 1]], brep.curves[index]
        assert isinstance(curve, Circle | Ellipse)
        radii = (curve.major, curve.minor) if isinstance(curve, Ellipse) else (curve.radius, curve.radius)
        origin, normal, x_axis = np.moveaxis(curve.place_frames(edges.motion[own]), 1, 0)
        x, y = (r * _reach_along_axes(v) for r, v in zip(radii, (x_axis, np.cross(normal, x_axis)), strict=True))
        low, high = edges.span[own].T[..., None]
        t = np.arctan2(y, x)
        t += TWO_PI * np.ceil((low - t) / TWO_PI)
        farthest = np.where(t <= high, _reach_along_axes(origin) + np.hypot(x, y), -np.inf)
        reach = np.maximum(reach, farthest.max(axis=0, initial=-np.inf))
    return reach


def _round_face_reach(brep: Brep) -> Array:
    """Greatest coordinates (6,) inside the faces on spheres and tori."""
    reach = np.full(6, -np.inf)
    for f, index in enumerate(brep.faces.carrier.tolist()):
        carrier, motion = brep.carriers[index], brep.faces.motion[f]
        if not isinstance(carrier, SphericalSurface | ToroidalSurface):
            continue
        start, end = _face_polygon(brep, f)
        outward = motion.apply_inverse_to_vectors(_reach_along_axes(np.eye(3)).T.copy())
        uv = stationary_parameters(carrier, outward)
        height = (motion.apply(carrier(uv[..., 0], uv[..., 1])) * _reach_along_axes(np.eye(3)).T[:, None]).sum(axis=-1)
        inside = np.zeros(height.shape, bool)
        for i in PERIOD_SHIFTS:
            for j in PERIOD_SHIFTS if carrier.period[1] else (0,):
                shifted = (uv + np.array([i * carrier.period[0], j * carrier.period[1]])).reshape(-1, 2)
                inside |= points_in_polygons(start, end, shifted).reshape(height.shape)
        reach = np.maximum(reach, np.where(inside, height, -np.inf).max(axis=1))
    return reach


def stationary_parameters(carrier: SphericalSurface | ToroidalSurface, direction: Array) -> Array:
    """Parameters (n, k, 2) of the points whose normal is parallel to the directions (n, 3): k = 2 on a sphere, 4 on a torus."""
    along, x, y = (direction @ axis for axis in (carrier.axis, carrier.x_axis, carrier.y_axis))
    across, u = np.hypot(x, y), np.arctan2(y, x)
    v = np.arctan2(along, across)
    if isinstance(carrier, SphericalSurface):
        return np.stack([np.stack([u, v], axis=-1), np.stack([u + np.pi, -v], axis=-1)], axis=1)
    pairs = [(u, v), (u, v + np.pi), (u + np.pi, np.pi - v), (u + np.pi, -v)]
    return np.stack([np.stack(pair, axis=-1) for pair in pairs], axis=1)


def _face_polygon(brep: Brep, face: int) -> tuple[Array, Array]:
    """Starts and ends (m, 2) of the segments of a face's loops in the parameters of its carrier."""
    faces, uses = brep.faces, brep.uses
    start, end = [], []
    for loop in range(int(faces.loop_start[face]), int(faces.loop_start[face + 1])):
        points = []
        for k in range(int(faces.use_start[loop]), int(faces.use_start[loop + 1])):
            low, high = brep.edges.span[uses.edge[k]].tolist()
            t = np.linspace(low, high, SAMPLES_PER_USE)
            points.append(brep.pcurves[int(uses.pcurve[k])](t if uses.sense[k] > 0 else t[::-1]))
        polygon = np.concatenate(points)
        start.append(polygon)
        end.append(np.roll(polygon, -1, axis=0))
    return np.concatenate(start), np.concatenate(end)


def _extend_by_spline_edges(brep: Brep, reach: Array, tol: float) -> Array:
    """The reach (6,) extended by the B-spline edges that exceed it between their ends."""
    edges = brep.edges
    nets: dict[int, list[tuple[Array, IntArray]]] = {}
    for index in np.unique(edges.curve).tolist():
        curve = brep.curves[index]
        if not isinstance(curve, BSplineCurve):
            continue
        own = np.flatnonzero(edges.curve == index)
        own = own[(reach_of_poles(edges.motion[own], curve.poles) > reach + tol).any(axis=1)]
        for low, high in np.unique(edges.span[own], axis=0).tolist():
            at = own[(edges.span[own] == [low, high]).all(axis=1)]
            pieces = _bezier_pieces_of_curve(curve, low, high)
            height = np.moveaxis(_reach_along_axes(edges.motion[at][:, None, None].apply(pieces)), 3, 0)
            axis = np.broadcast_to(np.arange(6)[:, None, None], height.shape[:3])
            nets.setdefault(curve.degree, []).append((height.reshape(-1, curve.degree + 1), axis.ravel()))
    for of_degree in nets.values():
        net, axis = (np.concatenate(parts) for parts in zip(*of_degree, strict=True))
        reach = _extend_on_curves(net, axis, reach, tol)
    return reach


def reach_of_poles(motion: Motion, poles: Array) -> Array:
    """Greatest coordinates along -x, -y, -z, x, y, z of the poles (n, 3) of placed curves or surfaces (m,): (m, 6)."""
    turned = np.einsum("mij,nj->min", motion.rotation, poles)
    low, high = turned.min(axis=2) + motion.translation, turned.max(axis=2) + motion.translation
    return np.concatenate([-low, high], axis=1)


def _bezier_pieces_of_curve(curve: BSplineCurve, low: float, high: float) -> Array:
    """The poles (n, degree + 1, D) of the Bezier pieces of a curve between two parameters."""
    start, end = curve.domain
    low, high = max(low, start), min(high, end)
    ends = np.unique([low, high, *curve.knots[(curve.knots > low) & (curve.knots < high)].tolist()])
    nodes, to_poles = bezier_interpolation(curve.degree)
    return np.asarray(to_poles @ curve(ends[:-1, None] + np.diff(ends)[:, None] * nodes))


def _extend_on_curves(net: Array, axis: IntArray, reach: Array, tol: float) -> Array:
    """The reach extended by the maxima of Bezier functions net (n, p + 1) along the directions axis (n,)."""
    low, high = (halving_matrix(net.shape[1] - 1, half) for half in (1, 2))
    for _ in range(MAX_BISECTIONS):
        keep = net.max(axis=1) > reach[axis] + tol
        net, axis = net[keep], axis[keep]
        if not len(net):
            break
        net, axis = np.concatenate([net @ low.T, net @ high.T]), np.concatenate([axis, axis])
        reach = reach.copy()
        np.maximum.at(reach, axis, np.maximum(net[:, 0], net[:, -1]))
    return reach


@dataclass(frozen=True, slots=True, eq=False)
class _Pieces:
    """Coordinates of Bezier pieces: poles (n, p + 1, q + 1), parameter boxes (n, 2, 2: low, high), directions and faces (n,)."""

    net: Array
    box: Array
    axis: IntArray
    face: IntArray

    def select(self, kept: IntArray | BoolArray) -> _Pieces:
        """Some of the pieces."""
        return _Pieces(self.net[kept], self.box[kept], self.axis[kept], self.face[kept])

    @staticmethod
    def concatenate(parts: Sequence[_Pieces]) -> _Pieces:
        """Pieces of one degree, one after another."""
        return _Pieces(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("net", "box", "axis", "face")))

    def quarters(self) -> _Pieces:
        """The pieces bisected along both parameters."""
        (low_u, high_u), (low_v, high_v) = ([halving_matrix(m - 1, h) for h in (1, 2)] for m in self.net.shape[1:])
        middle, parts = self.box.mean(axis=1), []
        for i, rows in enumerate((low_u, high_u)):
            half = np.matmul(rows, self.net)
            for j, columns in enumerate((low_v, high_v)):
                box = self.box.copy()
                box[:, 1 - i, 0], box[:, 1 - j, 1] = middle[:, 0], middle[:, 1]
                parts.append(_Pieces(half @ columns.T, box, self.axis, self.face))
        return _Pieces.concatenate(parts)


def _extend_by_spline_faces(brep: Brep, reach: Array, tol: float) -> Array:
    """The reach (6,) extended by the stationary points of the coordinates inside B-spline faces."""
    polygons: dict[int, tuple[Array, Array]] = {}

    def contains(face: int, uv: Array) -> bool:
        if face not in polygons:
            polygons[face] = _face_polygon(brep, face)
        return bool(points_in_polygons(*polygons[face], uv[None])[0])

    by_degree: dict[tuple[int, int], list[_Pieces]] = {}
    for own, surface in spline_faces(brep):
        f, axis = np.nonzero(reach_of_poles(brep.faces.motion[own], surface.poles.reshape(-1, 3)) > reach + tol)
        if len(f):
            pieces = _pieces_of_surface(surface, brep.faces.motion[own[f]], axis, own[f])
            by_degree.setdefault((surface.degree_u, surface.degree_v), []).append(pieces)
    for parts in by_degree.values():
        reach = _extend_on_surfaces(_Pieces.concatenate(parts), contains, reach, tol)
    return reach


def extend_by_surface(surface: BSplineSurface, contains: Callable[[Array], bool], reach: Array, tol: float) -> Array:
    """The reach (6,), along -x, -y, -z, x, y, z, extended by stationary points of a surface that a face contains.

    contains(uv (2,)) tells whether a point of the surface lies in the face.
    """
    motion = Motion.identity(1)
    axis = np.flatnonzero(reach_of_poles(motion, surface.poles.reshape(-1, 3))[0] > reach + tol)
    if not len(axis):
        return reach
    zeros = np.zeros(len(axis), np.int64)
    pieces = _pieces_of_surface(surface, motion[zeros], axis, zeros)
    return _extend_on_surfaces(pieces, lambda _, uv: contains(uv), reach, tol)


def _pieces_of_surface(surface: BSplineSurface, motion: Motion, axis: IntArray, face: IntArray) -> _Pieces:
    """The coordinates of a surface along directions (n,), placed by motions (n,), on its Bezier pieces."""
    u, v, pieces = bezier_pieces(surface)
    corners = [np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1) for ends in ((u[:-1], v[:-1]), (u[1:], v[1:]))]
    box, pieces = np.stack(corners, axis=2).reshape(-1, 2, 2), pieces.reshape(-1, *pieces.shape[2:])
    height = _reach_along_axes(motion[:, None, None, None].apply(pieces))
    net = np.take_along_axis(height, axis[:, None, None, None, None], axis=4)[..., 0]
    n = len(pieces)
    return _Pieces(
        net.reshape(-1, *net.shape[2:]), np.tile(box, (len(axis), 1, 1)), np.repeat(axis, n), np.repeat(face, n)
    )


def _extend_on_surfaces(pieces: _Pieces, contains: Callable[[int, Array], bool], reach: Array, tol: float) -> Array:
    """The reach (6,) extended by the stationary points of pieces that lie in their faces."""
    for _ in range(MAX_BISECTIONS):
        net = pieces.net
        keep = net.max(axis=(1, 2)) > reach[pieces.axis] + tol
        for slope in (np.diff(net, axis=1), np.diff(net, axis=2)):
            keep &= (slope.min(axis=(1, 2)) <= 0) & (slope.max(axis=(1, 2)) >= 0)
        small = keep & (np.ptp(net, axis=(1, 2)) < tol)
        for i in np.flatnonzero(small).tolist():
            axis, value = int(pieces.axis[i]), float(net[i].max())
            if value > reach[axis] and contains(int(pieces.face[i]), pieces.box[i].mean(axis=0)):
                reach = np.where(np.arange(6) == axis, value, reach)
        pieces = pieces.select(keep & ~small)
        if not len(pieces.net):
            break
        pieces = pieces.quarters()
    return reach
