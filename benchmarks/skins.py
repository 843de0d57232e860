"""Skins of 1 mm on bodies with concave edges, cavities, apexes and free-form faces, filled with a gyroid.

    python -m benchmarks.skins [--bodies bracket,boss,...] [--cell 8] [--thickness 0.6] [--skin 1]

Columns: solids, shells and Betti numbers of the part with its openings; whether it is valid and its
certificate met; the least and greatest thickness of the skin, and the share of the points at which it exceeds the request by more
than 2 %; CPU seconds of the infill.

The thickness is measured independently of the program: the vertices of a triangulation of the skin's inner faces against a fine
triangulation of the body's closed faces, point to triangle. Openings are planar faces without a skin, or bores cut afterwards.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import build123d as bd
import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepTools import BRepTools
from OCP.Geom import Geom_BSplineSurface, Geom_OffsetSurface
from scipy.spatial import cKDTree

import tpmscad
from benchmarks.small_bodies import FREE_FORM_BODIES
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.boolean.hollow_body import find_skin_faces
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.measure.skin_depth import SkinDepth, measure_skin_thickness, sample_depths
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.solids.skins.offset_skin import erode_body, find_deepest

DEVIATION, ANGLE = 1e-3, 0.03
"""Model units and radians: fineness of the body's triangulation."""


@dataclass(frozen=True)
class Case:
    """A body, the directions in which its outermost planar faces are open, and bores cut afterwards."""

    make: Callable[[], Any]
    open_along: tuple[bd.Vector, ...] = ()
    bores: tuple[Any, ...] = ()


UP, DOWN, RIGHT = bd.Vector(0, 0, 1), bd.Vector(0, 0, -1), bd.Vector(1, 0, 0)
THROUGH = bd.Cylinder(1.5, 100)


def flange() -> bd.Part:
    """A hub with a central bore, six bolt holes, and three pockets from below."""
    part = bd.Cylinder(26, 10) + bd.Pos(0, 0, 12) * bd.Cylinder(14, 14) - bd.Cylinder(7, 60)
    for k in range(6):
        part -= bd.Rot(0, 0, 60 * k) * bd.Pos(20.5, 0, 0) * bd.Cylinder(2, 40)
    for k in range(3):
        part -= bd.Rot(0, 0, 120 * k + 30) * bd.Pos(20, 0, -4) * bd.Box(7, 5, 4)
    return part


def handle() -> bd.Solid:
    """A free-form handle, lofted through three ellipses."""
    middle, top = bd.Pos(0, 0, 16) * bd.Rot(0, 12, 0), bd.Pos(4, 0, 34) * bd.Rot(0, 20, 0)
    return bd.loft([bd.Ellipse(9, 7).face(), (middle * bd.Ellipse(6, 5)).face(), (top * bd.Ellipse(8, 6)).face()])


def bone() -> bd.Solid:
    """A bone, lofted through three ellipses, waisted at mid-length."""
    middle, top = bd.Pos(0, 0, 16) * bd.Ellipse(5.5, 5).face(), bd.Pos(2, 0, 34) * bd.Ellipse(8, 6.5).face()
    return bd.loft([bd.Ellipse(9, 7).face(), middle, top])


CASES = {
    "bracket": Case(lambda: bd.Box(40, 24, 6) + bd.Pos(-17, 0, 12) * bd.Box(6, 24, 20), (UP, RIGHT)),
    "boss": Case(lambda: bd.Box(40, 30, 8) + bd.Pos(4, 0, 9) * bd.Cylinder(8, 10), (UP, DOWN)),
    "hollow": Case(lambda: bd.Box(30, 26, 22) - bd.Box(14, 10, 8), (UP, DOWN)),
    "cone": Case(lambda: bd.Cone(14, 0, 30), (DOWN,)),
    "frustum": Case(lambda: bd.Cone(14, 8, 24), (UP, DOWN)),
    "torus": Case(lambda: bd.Torus(20, 7), (), (bd.Pos(20, 0, 0) * THROUGH, bd.Pos(-20, 0, 0) * THROUGH)),
    "cylinder": Case(lambda: bd.Cylinder(12, 26), (UP, DOWN)),
    "sphere": Case(lambda: bd.Sphere(14), (), (bd.Pos(3, 2, 0) * THROUGH,)),
    "flange": Case(flange, (UP, DOWN)),
    "filleted": Case(lambda: bd.fillet(bd.Box(30, 24, 20).edges(), 4), (), (bd.Pos(3, 2, 0) * THROUGH,)),
    "handle": Case(handle, (UP, DOWN)),
    "bone": Case(bone, (UP, DOWN)),
    "junction": Case(
        lambda: bd.Cylinder(9, 44) + bd.Rot(0, 90, 0) * bd.Pos(0, 0, 11) * bd.Cylinder(7, 22), (UP, DOWN, RIGHT)
    ),
    "pierced": Case(lambda: bd.Box(30, 24, 18) - bd.Rot(90, 0, 0) * bd.Cylinder(5, 40), (UP, DOWN)),
}


ERODED: dict[str, Callable[[], Any]] = {
    "box": lambda: bd.Box(30, 26, 22),
    "bored": lambda: bd.Cylinder(12, 26) - bd.Cylinder(4, 40),
    "pocket": lambda: bd.Box(30, 26, 22) - bd.Pos(0, 0, 6) * bd.Box(12, 10, 12),
    **{name: case.make for name, case in CASES.items() if name != "cylinder"},
    **{name: make for name, make in FREE_FORM_BODIES.items() if name != "dome"},
}
"""Bodies that are eroded without being filled."""


def erode(name: str, ratio: float, opened: bool) -> None:
    """One row of the table of eroded bodies."""
    shape = ERODED[name]()
    body = read_body(shape)
    if opened and not any(face.geom_type == bd.GeomType.PLANE for face in shape.faces()):
        print(f"{name:>9} has no planar face to open", flush=True)
        return
    openings = (outermost(shape, UP).wrapped,) if opened else ()
    closed = [face for face in faces_of(body.shape) if not any(face.IsSame(o) for o in openings)]
    depth = SkinDepth(body.shape, closed)
    points, depths = sample_depths(depth, 0.1, 256, 0)
    skin = float(f"{ratio * find_deepest(depth, points, depths)[1]:.3g}")
    begun = cpu_seconds()
    try:
        found = erode_body(body, skin, openings)
    except tpmscad.TpmscadError as error:
        print(f"{name:>9} {skin:7.4g} refused after {cpu_seconds() - begun:.1f} s: {str(error)[:90]}", flush=True)
        return
    seconds = cpu_seconds() - begun
    measured = measure_skin_thickness(find_skin_faces([p.shape for p in found.parts], openings), depth)
    valid = all(check_shape(part.shape).valid for part in found.parts)
    volume = sum(part.volume for part in found.parts)
    print(
        f"{name:>9} {skin:7.4g} {len(found.parts):>5} "
        f"{valid!s:>5} {volume:12.6g} {measured.least / skin:9.6f} {measured.greatest / skin:9.6f} {seconds:6.1f}",
        flush=True,
    )


def outermost(body: Any, direction: bd.Vector) -> bd.Face:
    """The planar face farthest along a direction, by its center."""
    planar = [f for f in body.faces() if f.geom_type == bd.GeomType.PLANE]
    return max(planar, key=lambda f: f.center().dot(direction))


def triangles(faces: Sequence[bd.Face]) -> np.ndarray:
    """Corners (n, 3, 3) of fine triangulations of the faces.

    The kernel keeps to the deviation only where it looks: on a lofted face it is exceeded tenfold at 0.1 radians.
    """
    found = []
    for face in faces:
        BRepTools.Clean_s(face.wrapped)  # else a coarser triangulation that the face holds is taken
        points, corners = face.tessellate(DEVIATION, ANGLE)
        found.append(np.array([tuple(p) for p in points])[np.array(corners, int)])
    return np.concatenate(found)


MAX_EDGE = 0.5
"""Model units: longest edge of the triangles that distances are measured from; longer ones are divided."""


def divide_long_triangles(corners: np.ndarray) -> np.ndarray:
    """The triangles (m, 3, 3) bisected across their longest edge until none is longer than MAX_EDGE."""
    done = []
    while len(corners):
        length = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        is_long = length.max(axis=1) > MAX_EDGE
        done.append(corners[~is_long])
        turn = (length[is_long].argmax(axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(corners[is_long], turn[..., None], axis=1), 1, 0)
        middle = (a + b) / 2
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    return np.concatenate(done)


class TriangleTree:
    """Distances from triangles (m, 3, 3), found by a tree of their centers."""

    def __init__(self, corners: np.ndarray) -> None:
        self.corners = divide_long_triangles(corners)
        center = self.corners.mean(axis=1)
        self.radius = float(np.linalg.norm(self.corners - center[:, None], axis=2).max())
        self.tree = cKDTree(center)

    def are_beyond(self, points: np.ndarray, distance: float) -> bool:
        """Whether all points (n, 3) are certain to lie farther than a distance from the triangles."""
        return bool((self.tree.query(points)[0] - self.radius > distance).all())

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Distances (n,) of points (n, 3) from the nearest triangle, among all whose center is near enough."""
        reach = self.tree.query(points)[0] + 2 * self.radius
        near = self.tree.query_ball_point(points, reach)
        count = np.array([len(found) for found in near])
        each = distances_from_triangles(
            np.repeat(points, count, axis=0), self.corners[np.concatenate(near).astype(int)]
        )
        return np.minimum.reduceat(each, np.cumsum(count) - count)


def distances_from_triangles(p: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distances (n,) of points (n, 3) from one triangle each (n, 3, 3)."""
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    best = np.full(len(p), np.inf)
    for origin, along in ((a, ab), (a, ac), (a + ab, ac - ab)):
        t = np.clip(((p - origin) * along).sum(1) / np.maximum((along * along).sum(1), 1e-30), 0, 1)
        best = np.minimum(best, np.linalg.norm(p - origin - t[:, None] * along, axis=1))
    normal, arm = np.cross(ab, ac), p - a
    square = np.maximum((normal * normal).sum(1), 1e-30)
    s = (np.cross(arm, ac) * normal).sum(1) / square
    t = (np.cross(ab, arm) * normal).sum(1) / square
    inside = (s >= 0) & (t >= 0) & (s + t <= 1) & (square > 1e-24)
    above = np.abs((arm * normal).sum(1)) / np.sqrt(square)
    return np.where(inside, np.minimum(best, above), best)


def measure(part: Any, closed: Sequence[bd.Face], opened: Sequence[bd.Face], skin: float) -> np.ndarray:
    """Thicknesses at vertices of a triangulation of the skin's inner faces.

    Faces of planes and quadrics inside the body are the skin's. In free-form bodies so are spline faces of even depth; those of
    the lattice cross the body.
    """
    body = TriangleTree(triangles(closed))
    free_form = any(_is_spline(face) for face in closed)
    found = []
    for face in part.faces():
        points = np.array([tuple(p) for p in face.tessellate(0.05, 0.3)[0]])
        if len(points) > 60:
            points = points[np.random.default_rng(0).choice(len(points), 60, replace=False)]
        if any(
            np.abs((points - np.array(tuple(o.center()))) @ np.array(tuple(o.normal_at()))).max() < 1e-4 for o in opened
        ):
            continue
        if body.are_beyond(points[:3], 1.6 * skin):
            continue
        depth = body.distances(points[:3])
        if depth.max() < 0.01 * skin or depth.min() > 1.6 * skin:
            continue
        spline = _is_spline(face)
        depth = body.distances(points)
        if spline and (not free_form or np.ptp(depth) > 0.05 * skin):
            continue
        found.append(depth)
    return np.concatenate(found) if found else np.zeros(0)


def _is_spline(face: bd.Face) -> bool:
    return isinstance(BRep_Tool.Surface_s(face.wrapped), Geom_BSplineSurface | Geom_OffsetSurface)


def cpu_seconds() -> float:
    """User and system time of this process and of those that it has ended."""
    return sum(os.times()[:4])


def run(name: str, cell: float, thickness: float, skin: float) -> None:
    """One row of the table."""
    case = CASES[name]
    body = case.make()
    opened = [outermost(body, direction) for direction in case.open_along]
    closed = [face for face in body.faces() if not any(face.is_same(o) for o in opened)]
    begun = cpu_seconds()
    model = tpmscad.infill(body, "gyroid", cell=cell, thickness=thickness, tol=cell / 100, skin=skin, open_faces=opened)
    whole = cpu_seconds() - begun
    depth = measure(model.solid, closed, opened, skin)
    part = model.solid
    for bore in case.bores:
        part = part - bore
    shells = sum(len(solid.shells()) for solid in part.solids())
    print(
        f"{name:>9} {len(part.solids()):>6} {shells:>6} "
        f"{model.certificate.betti!s:>12} {part.is_valid!s:>5} {model.certificate.met!s:>5} "
        f"{depth.min():8.4f} {depth.max():8.4f} {(depth > 1.02 * skin).mean():7.1%} {len(depth):>6} {whole:8.1f}",
        flush=True,
    )
    for text in (*model.certificate.shortfalls, *(n for n in model.certificate.notes if "skin" in n or "trim" in n)):
        print(" " * 10 + text)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bodies", default=",".join(CASES))
    parser.add_argument("--cell", type=float, default=8.0)
    parser.add_argument("--thickness", type=float, default=0.6)
    parser.add_argument("--skin", type=float, default=1.0)
    parser.add_argument("--erosion", action="store_true")
    parser.add_argument("--ratios", default="0.15,0.5,0.9")
    parser.add_argument("--open", action="store_true", help="with --erosion: the uppermost planar face is open")
    options = parser.parse_args(arguments)
    if options.erosion:
        print(f"{'body':>9} {'skin':>7} {'parts':>5} {'valid':>5} {'volume':>12} {'least':>9} {'most':>9} {'CPU s':>6}")
        for name in ERODED if options.bodies == ",".join(CASES) else options.bodies.split(","):
            for ratio in options.ratios.split(","):
                erode(name, float(ratio), options.open)
        return
    print(
        f"{'body':>9} {'solids':>6} {'shells':>6} {'Betti':>12} {'valid':>5} {'met':>5} "
        f"{'least':>8} {'most':>8} {'mitred':>7} {'points':>6} {'CPU s':>8}"
    )
    for name in options.bodies.split(","):
        run(name, options.cell, options.thickness, options.skin)


if __name__ == "__main__":
    main()
