"""Closed boundary representations made by hand: boxes of planes, voxel solids of bent patches, a box with a void, a drilled dome.

Every one is known in closed form or by its symmetry, and has unequal sizes and degrees along u and v where it can.
"""

from __future__ import annotations

import numpy as np

from tests.shapes.box_shapes import plane_box
from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces, join_breps, reverse_faces
from tpmscad.brep.welding import weld_patches
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, line_segment


def hollow_box() -> Brep:
    """The box 2 x 3 x 5 with a void of 0.5 x 1 x 2 in it."""
    return join_breps([plane_box(), reverse_faces(plane_box((0.5, 1.0, 2.0), translation=(0.5, 1.0, 1.5)))])


def bend(points: Array) -> Array:
    """A smooth map that moves coinciding poles alike, so that patches stay joined."""
    x, y, z = np.moveaxis(points, -1, 0)
    shift = [np.sin(1.7 * y + 0.3) * np.cos(z), np.sin(1.3 * z + x), np.cos(0.9 * x - 0.5 * y)]
    return points + 0.12 * np.stack(shift, axis=-1)


def voxels(solid: np.ndarray, degree: int = 4, knots: int = 0) -> Brep:
    """The boundary of a union of unit cubes as bent patches, one of each face. `knots` breaks each patch inside.

    Cubes must not touch along an edge alone.
    """
    padded = np.pad(solid.astype(bool), 1)
    vector = np.concatenate([np.zeros(degree + 1), (np.arange(knots) + 1) / (knots + 1), np.ones(degree + 1)])
    greville = np.array([vector[i + 1 : i + degree + 1].mean() for i in range(degree + 1 + knots)])
    surfaces = []
    for axis in range(3):
        for outward in (1, -1):
            empty = np.roll(padded, -outward, axis)
            for cell in np.argwhere(padded & ~empty) - 1:
                base = np.zeros((len(greville), len(greville), 3))
                u, v = (axis + 1) % 3, (axis + 2) % 3
                if outward < 0:
                    u, v = v, u
                base[..., u], base[..., v] = greville[:, None], greville[None, :]
                base[..., axis] = 1.0 if outward > 0 else 0.0
                surfaces.append(BSplineSurface(bend(base + cell), vector, vector, degree, degree))
    n = len(surfaces)
    return weld_patches(surfaces, np.arange(n), Motion.identity(n), np.ones(n, int), np.arange(n) % 2, ["even", "odd"])


def frame(n: int) -> np.ndarray:
    """A jungle gym of n cells: the voxels of a cubic grid with at least two odd... even coordinates are its bars."""
    index = np.indices((2 * n + 1,) * 3)
    return (index % 2 == 0).sum(axis=0) >= 2


def drilled_dome() -> Brep:
    """The block [0, 2] x [0, 3] under a quadratic dome, drilled through by a four-arc hole: trimmed faces and caps.

    Top z = 2 + x (2 - x) y (3 - y) / 4, bottom z = 0; the hole's wall is ruled, its rim a closed piecewise cubic.
    """
    knots = np.repeat([0.0, 1.0], 3)
    x = np.array([0.0, 1.0, 2.0])
    y = np.array([0.0, 1.5, 3.0])
    poles = np.stack([*np.meshgrid(x, y, indexing="ij"), np.full((3, 3), 2.0)], axis=2)
    poles[1, 1, 2] = 2.0 + 2.25  # x(2-x)y(3-y)/4 at the Bezier centre: 4 u(1-u) 9 v(1-v) / 4 = 9 B1 B1 / 4
    top = BSplineSurface(poles, knots, knots, 2, 2)
    base = plane_box((2.0, 3.0, 2.0))
    k = 4 * (np.sqrt(2.0) - 1) / 3
    arcs = []
    for quarter in range(4):
        c, s = np.round(np.cos(quarter * np.pi / 2)), np.round(np.sin(quarter * np.pi / 2))
        turn = np.array([[c, -s], [s, c]])
        ring = np.array([[1, 0], [1, k], [k, 1], [0, 1.0]]) @ turn.T
        arcs.append(BSplineCurve(0.5 + ring * [0.3, 0.2], np.repeat([0.0, 1.0], 4), 3))
    # Faces in the order of plane_box: -x, +x, -y, +y, -z, +z; the last becomes the dome, the hole joins both ends.
    e, u, _f = base.edges, base.uses, base.faces
    rim_top = [_lifted(top, arc) for arc in arcs]
    rim_bottom = [BSplineCurve(np.column_stack([arc.poles * [2.0, 3.0], np.zeros(4)]), arc.knots, 3) for arc in arcs]
    walls = []
    for low, high in zip(rim_bottom, rim_top, strict=True):
        raised = _raised(low, high.degree)
        walls.append(
            BSplineSurface(
                np.stack([raised.poles, high.poles], axis=1), high.knots, np.repeat([0.0, 1.0], 2), high.degree, 1
            )
        )
    corners = np.array([arc.poles[0] for arc in arcs])
    vertices = np.concatenate([base.vertices, [c(0.0) for c in rim_bottom], [c(0.0) for c in rim_top]])
    posts = [line_segment(vertices[8 + q], vertices[12 + q]) for q in range(4)]
    curves = (*base.curves, *rim_bottom, *rim_top, *posts)
    start = np.concatenate([e.start, 8 + np.arange(4), 12 + np.arange(4), 8 + np.arange(4)])
    end = np.concatenate([e.end, 8 + (np.arange(4) + 1) % 4, 12 + (np.arange(4) + 1) % 4, 12 + np.arange(4)])
    n = len(curves)
    span = np.concatenate([e.span, np.tile([0.0, 1.0], (n - len(e), 1))])
    edges = Edges(np.arange(n), Motion.identity(n), span, start, end, np.zeros(n))
    pcurves: list[BSplineCurve] = []

    def pcurve(curve: BSplineCurve) -> int:
        pcurves.append(curve)
        return len(pcurves) - 1

    uses: list[tuple[int, int, int]] = []
    use_start, loop_start = [0], [0]
    carriers = list(base.carriers)
    carriers[5] = top
    for face in range(6):
        for k in range(4 * face, 4 * face + 4):
            p = -1
            if face == 5:
                ends = vertices[[start[u.edge[k]], end[u.edge[k]]]][:, :2] / [2.0, 3.0]
                p = pcurve(line_segment(*ends, tuple(span[u.edge[k]])))
            uses.append((int(u.edge[k]), int(u.sense[k]), p))
        use_start.append(len(uses))
        if face == 5:  # the hole clockwise seen from above
            uses += [(16 + q, -1, pcurve(arcs[q])) for q in (3, 2, 1, 0)]
            use_start.append(len(uses))
        if face == 4:  # seen from below, clockwise is the arcs' own way
            uses += [(12 + q, 1, -1) for q in range(4)]
            use_start.append(len(uses))
        loop_start.append(len(use_start) - 1)
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    for q in range(4):  # u along the rim, v upwards: S_u x S_v points away from the hole's axis, into the solid
        sides = [(12 + q, 1, (0, 1)), (20 + (q + 1) % 4, 1, (1, 2)), (16 + q, -1, (3, 2)), (20 + q, -1, (0, 3))]
        uses += [(edge, sense, pcurve(line_segment(*corner[list(c)]))) for edge, sense, c in sides]
        use_start.append(len(uses))
        loop_start.append(len(use_start) - 1)
    carriers += walls
    assert len(corners) == 4
    table = np.array(uses)
    m = len(carriers)
    return Brep(
        tuple(carriers), curves, tuple(pcurves), vertices, edges, EdgeUses(*table.T),
        Faces(np.arange(m), Motion.identity(m), np.array([1] * 6 + [-1] * 4),
              np.array([0, 0, 0, 0, 1, 1, 2, 2, 2, 2]), np.array(loop_start), np.array(use_start)),
        ("side", "end", "hole"),
    )  # fmt: skip


def _lifted(surface: BSplineSurface, pcurve: BSplineCurve) -> BSplineCurve:
    """The Bezier curve surface(pcurve(t)), exact: interpolated at as many points as its degree asks for."""
    degree = pcurve.degree * (surface.degree_u + surface.degree_v)
    return _through(surface(*pcurve(_nodes(degree)).T), degree)


def _raised(curve: BSplineCurve, degree: int) -> BSplineCurve:
    return _through(curve(_nodes(degree)), degree)


def _nodes(degree: int) -> Array:
    return 0.5 - 0.5 * np.cos(np.pi * np.arange(degree + 1) / degree)


def _through(points: Array, degree: int) -> BSplineCurve:
    from tpmscad.splines.basis import design_matrix

    knots = np.repeat([0.0, 1.0], degree + 1)
    poles = np.linalg.solve(design_matrix(knots, degree, _nodes(degree)), points)
    poles[0], poles[-1] = points[0], points[-1]
    return BSplineCurve(poles, knots, degree)


def notched_hollow() -> Brep:
    """A long box with a void at its foot, which stands in the notch of a smaller U: the void is in both boxes, not in the U."""
    u = np.ones((3, 1, 3), bool)
    u[1, :, 1:] = False
    bar = plane_box((0.6, 0.6, 40.0), translation=(1.2, 0.2, 1.4))
    void = reverse_faces(plane_box((0.2, 0.2, 0.2), translation=(1.4, 0.3, 1.6)))
    return join_breps([voxels(u, 3), bar, void])


TURN = np.array([[0.0, 0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])

CASES = {
    "box of planes": plane_box,
    "mirrored box": lambda: plane_box(rotation=np.diag([1.0, -1.0, 1.0]) @ TURN, translation=(1.0, -2.0, 0.5)),
    "box with a void": hollow_box,
    "two boxes": lambda: join_breps(
        [plane_box((1.0, 1.0, 2.0)), plane_box((3.0, 3.0, 5.0), translation=(10.0, 0.0, 0.0))]
    ),
    "bent cube": lambda: voxels(np.ones((1, 1, 1)), 5),
    "bent frame": lambda: voxels(frame(1), 3),
    "drilled dome": drilled_dome,
    "hollow bar in a notch": notched_hollow,
}


def mirrored_pair() -> Brep:
    """A bent cube and its mirror image, made of the same six primitives, turned and set apart."""
    cube = voxels(np.ones((1, 1, 1)), 3)
    n, f = len(cube.faces), cube.faces
    motions = [(np.eye(3), np.zeros(3)), (TURN @ np.diag([1.0, 1.0, -1.0]), np.array([4.0, 0.0, 1.0]))]
    return weld_patches(
        cube.carriers,
        np.tile(f.carrier, 2),
        Motion.concatenate([Motion(np.tile(r, (n, 1, 1)), np.tile(t, (n, 1))) for r, t in motions]),
        np.concatenate([f.sense, -f.sense]),  # a mirror turns S_u x S_v inwards
        np.tile(f.tag, 2),
        cube.tags,
    )


CASES["cube and mirror image"] = mirrored_pair
