"""A boundary representation in a box, carried over by a trivariate spline: the same faces, edges and vertices in another shape.

Every patch becomes a patch of higher degree that interpolates its image at Chebyshev nodes, sides included, so that neighbours
that share a whole side still do. The planes of the box become the boundary surfaces of the spline, exactly, and the curves in
them become parameter curves without a change, because their coordinates are parameters of the spline.

Connectivity is not touched. Where the Jacobian is positive and the spline is one-to-one, the topology is that in the box.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep, EdgeUses
from tpmscad.brep.carriers import Plane
from tpmscad.brep.edge_continuity import EdgeContinuity, compare_sides, curvature_tensors, summarise_jumps
from tpmscad.rigid_motion import Motion
from tpmscad.splines.basis import bernstein_basis, bezier_interpolation, evaluate_bezier_patches
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.splines.bspline_volume import BSplineVolume
from tpmscad.splines.knots import bezier_knots, greville_abscissae
from tpmscad.splines.smooth_interpolation import interpolate_patches

DEGREES = (5, 6, 8, 10, 12, 14, 16)
"""Degrees of mapped patches in the order of trial; all patches take the same one, so that sides are shared."""

FIT_TOL_PATCHES = 2e-7
"""Greatest error of the interpolation, in sizes of the patch: it bends joints by a few thousandths of a degree."""

SAMPLES_PER_USE = 9
"""Points along an edge at which its faces are compared."""

SAMPLES_PER_PARAMETER = 9
"""Samples of every patch along u and v for its distance from the reference."""


@dataclass(frozen=True, slots=True, eq=False)
class MappedBrep:
    """The image of a boundary representation, and what it was made of.

    `faces` (n,) are the patches, `source` (n, U, V, 3) and `poles` (n, D + 1, D + 1, 3) their control nets before and after,
    `fit_error` the greatest distance of a patch from the exact image of its source at equal parameters.
    """

    brep: Brep
    faces: IntArray
    source: list[Array]
    poles: Array
    fit_error: float
    continuity: EdgeContinuity

    def sample(self) -> tuple[Array, Array]:
        """Points (m, 3) of the patches before the map and after it, at equal parameters."""
        rows = np.linspace(0.0, 1.0, SAMPLES_PER_PARAMETER)
        before = _evaluate(self.source, rows)
        basis = bernstein_basis(self.poles.shape[1] - 1, rows)
        return before.reshape(-1, 3), evaluate_bezier_patches(basis, self.poles, basis).reshape(-1, 3)


def map_brep(brep: Brep, volume: BSplineVolume) -> MappedBrep:
    """The image of the faces in the domain of the spline: Bezier patches, and planes in the faces of its domain."""
    on_plane = np.array([isinstance(c, Plane) for c in brep.carriers], bool)
    patches = np.flatnonzero(~on_plane[brep.faces.carrier])
    source = [brep.faces.motion[f].apply(brep.carriers[brep.faces.carrier[f]].poles) for f in patches]
    poles, fit_error = _map_patches(source, volume)
    degree = poles.shape[1] - 1
    knots = bezier_knots(degree)
    curves, curve = _map_curves(brep, volume, degree)
    caps = np.flatnonzero(on_plane)
    surfaces = [_cap_surface(brep.carriers[c], volume) for c in caps]  # type: ignore[arg-type]
    carrier = np.empty(len(brep.faces), np.int64)
    carrier[patches] = np.arange(len(patches))
    number = np.full(len(brep.carriers), -1)
    number[caps] = len(patches) + np.arange(len(caps))
    in_plane = on_plane[brep.faces.carrier]
    carrier[in_plane] = number[brep.faces.carrier[in_plane]]
    pcurves, uses = _cap_pcurves(brep, on_plane)
    n_edges, n_faces = len(brep.edges), len(brep.faces)
    mapped = replace(
        brep,
        carriers=(*(BSplineSurface(p, knots, knots, degree, degree) for p in poles), *surfaces),
        curves=curves,
        pcurves=pcurves,
        vertices=volume.images(brep.vertices)[0],
        edges=replace(brep.edges, curve=curve, motion=Motion.identity(n_edges)),
        uses=uses,
        faces=replace(brep.faces, carrier=carrier, motion=Motion.identity(n_faces)),
    )
    deviation, continuity = _compare_uses(mapped, poles)
    mapped = replace(mapped, edges=replace(mapped.edges, deviation=deviation))
    return MappedBrep(mapped, patches, source, poles, fit_error, continuity)


def _evaluate(nets: list[Array], t: Array) -> Array:
    """Points (n, m, m, 3) of Bezier patches of any degrees on the grid of t (m,)."""
    result = np.empty((len(nets), len(t), len(t), 3))
    shapes = np.array([net.shape[:2] for net in nets])
    for shape in np.unique(shapes, axis=0):
        own = np.flatnonzero((shapes == shape).all(axis=1))
        rows, columns = (bernstein_basis(n - 1, t) for n in shape.tolist())
        points = evaluate_bezier_patches(rows, np.stack([nets[i] for i in own]), columns)
        result[own] = points.reshape(len(own), len(t), len(t), 3)
    return result


def _map_patches(source: list[Array], volume: BSplineVolume) -> tuple[Array, float]:
    """Control nets (n, D + 1, D + 1, 3) of the images, of the lowest degree that meets the tolerance, and the greatest error."""
    for degree in DEGREES:
        nodes, _ = bezier_interpolation(degree)
        between = (nodes[1:] + nodes[:-1]) / 2
        poles = interpolate_patches(_image(volume, _evaluate(source, nodes)))
        basis = bernstein_basis(degree, between)
        exact = _image(volume, _evaluate(source, between))
        miss = evaluate_bezier_patches(basis, poles, basis).reshape(exact.shape) - exact
        errors = np.linalg.norm(miss, axis=-1).max(axis=(1, 2))
        sizes = np.linalg.norm(poles[:, 0, 0] - poles[:, -1, -1], axis=-1)
        if (errors <= FIT_TOL_PATCHES * sizes).all():
            break
    return poles, float(errors.max())


def _image(volume: BSplineVolume, points: Array) -> Array:
    return volume.images(points.reshape(-1, 3))[0].reshape(points.shape)


def _map_curves(brep: Brep, volume: BSplineVolume, degree: int) -> tuple[tuple[BSplineCurve, ...], IntArray]:
    """The images of the edges' curves, one for each placed curve, and the curve of every edge."""
    key = np.column_stack([brep.edges.curve, brep.edges.motion.translation])
    _, first, label = np.unique(key, axis=0, return_index=True, return_inverse=True)
    nodes, to_poles = bezier_interpolation(degree)
    curves = []
    for edge in first.tolist():
        curve = brep.curves[brep.edges.curve[edge]]
        assert isinstance(curve, BSplineCurve)
        low, high = curve.domain
        ends = brep.edges.motion[edge].apply(curve.poles)
        if curve.degree == 1 and len(ends) == 2 and (straight := _boundary_curve(volume, ends, curve.domain)):
            curves.append(straight)
            continue
        image, _ = volume.images(brep.edges.motion[edge].apply(curve(low + (high - low) * nodes)))
        curves.append(BSplineCurve(to_poles @ image, low + (high - low) * bezier_knots(degree), degree))
    return tuple(curves), label.ravel()


def _boundary_curve(volume: BSplineVolume, ends: Array, span: tuple[float, float]) -> BSplineCurve | None:
    """The image of a segment (2, 3) along an axis, exactly, over a span of parameters; None if it runs along no axis."""
    moving = np.flatnonzero(ends[0] != ends[1])
    if len(moving) != 1 or ends[1, moving[0]] < ends[0, moving[0]]:
        return None
    axis = int(moving[0])
    a, b = ends[:, axis]
    degree, knots = volume.degrees[axis], volume.knots[axis]
    inner = knots[(knots > a) & (knots < b)]
    own = np.concatenate([np.full(degree + 1, a), inner, np.full(degree + 1, b)])
    sites = greville_abscissae(own, degree)
    points = np.repeat(ends[:1], len(sites), axis=0)
    points[:, axis] = sites
    low, high = span
    scaled = low + (own - a) * ((high - low) / (b - a))
    scaled[: degree + 1], scaled[-degree - 1 :] = low, high
    collocation = BSplineCurve(np.eye(len(sites)), own, degree)(sites)
    return BSplineCurve(np.asarray(np.linalg.solve(collocation, volume.images(points)[0])), scaled, degree)


def _cap_surface(plane: Plane, volume: BSplineVolume) -> BSplineSurface:
    """The boundary surface of the spline over a plane of its domain, with the parameters of the plane."""
    axis = int(np.argmax(np.abs(plane.normal)))
    b, c = int(np.argmax(np.abs(plane.x_axis))), int(np.argmax(np.abs(plane.y_axis)))
    poles = np.take(volume.poles, -1 if plane.normal[axis] > 0 else 0, axis=axis)
    if b > c:
        poles = poles.swapaxes(0, 1)
    knots_u, knots_v = volume.knots[b] - plane.origin[b], volume.knots[c] - plane.origin[c]
    if plane.y_axis[c] < 0:
        poles, knots_v = poles[:, ::-1], -knots_v[::-1]
    return BSplineSurface(poles.copy(), knots_u, knots_v, volume.degrees[b], volume.degrees[c])


def _cap_pcurves(brep: Brep, on_plane: Array) -> tuple[tuple[BSplineCurve, ...], EdgeUses]:
    """The parameter curves with those of the uses on planes added: projections of the edges' curves onto the plane."""
    pcurves, pcurve = list(brep.pcurves), brep.uses.pcurve.copy()
    face = brep.face_of_use
    for use in np.flatnonzero(on_plane[brep.faces.carrier[face]]).tolist():
        edge, plane = brep.uses.edge[use], brep.carriers[brep.faces.carrier[face[use]]]
        curve = brep.curves[brep.edges.curve[edge]]
        assert isinstance(plane, Plane)
        assert isinstance(curve, BSplineCurve)
        flat = plane.parameters(brep.edges.motion[edge].apply(curve.poles))
        pcurve[use] = len(pcurves)
        pcurves.append(BSplineCurve(flat, curve.knots, curve.degree))
    return tuple(pcurves), replace(brep.uses, pcurve=pcurve)


def _compare_uses(brep: Brep, poles: Array) -> tuple[Array, EdgeContinuity]:
    """Distance (E,) of every edge's curve from its faces, and the continuity across edges between patches."""
    fractions = np.linspace(0.0, 1.0, SAMPLES_PER_USE)
    uses, edges = brep.uses, brep.edges
    low, high = edges.span.T
    t = low[:, None] + (high - low)[:, None] * fractions
    on_curve = np.stack([brep.curves[c](s) for c, s in zip(edges.curve, t, strict=True)])
    carrier = brep.faces.carrier[brep.face_of_use]
    smooth = carrier < len(poles)
    degree = poles.shape[1] - 1
    points = np.empty((len(uses), SAMPLES_PER_USE, 3))
    normals = np.zeros((len(uses), SAMPLES_PER_USE, 3))
    tensors = np.zeros((len(uses), SAMPLES_PER_USE, 3, 3))
    for use in np.flatnonzero(~smooth).tolist():
        u, v = brep.pcurves[uses.pcurve[use]](t[uses.edge[use]]).T
        points[use] = brep.carriers[carrier[use]](u, v)
    keys = np.column_stack([uses.pcurve, edges.span[uses.edge]])
    _, first, label = np.unique(keys[smooth], axis=0, return_index=True, return_inverse=True)
    own = np.flatnonzero(smooth)
    for kind, one in enumerate(first.tolist()):
        rows = own[label.ravel() == kind]
        u, v = brep.pcurves[uses.pcurve[own[one]]](t[uses.edge[own[one]]]).T
        rows_u, rows_v = ([bernstein_basis(degree, x, order) for order in range(3)] for x in (u, v))
        nets = poles[carrier[rows]]
        s = {
            (i, j): np.einsum("ta,tb,nabd->ntd", rows_u[i], rows_v[j], nets, optimize=True)
            for i in range(3)
            for j in range(3 - i)
        }
        points[rows] = s[0, 0]
        normals[rows], tensors[rows] = curvature_tensors(s[1, 0], s[0, 1], s[2, 0], s[1, 1], s[0, 2])
    deviation = np.zeros(len(edges))
    np.maximum.at(deviation, uses.edge, np.linalg.norm(points - on_curve[uses.edge], axis=-1).max(axis=1))
    order = own[np.argsort(uses.edge[own], kind="stable")]
    pair = np.flatnonzero(uses.edge[order[:-1]] == uses.edge[order[1:]])
    a, b = order[pair], order[pair + 1]
    if not len(pair):
        return deviation, summarise_jumps(np.zeros(4), 0)
    sides = ((points[side], normals[side], tensors[side]) for side in (a, b))
    return deviation, summarise_jumps(compare_sides(*sides), len(pair))
