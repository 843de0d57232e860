"""How smooth the joints of a solid are in its STEP file, by the kernel alone: the angle between the normals of two faces.

    python -m benchmarks.joints FILE.step ...

At random parameters of every edge between two B-spline faces the normals of both are taken at the point of the edge. The reader's
pcurves lead there to within its tolerance of 1e-7 mm, which bends the joints of patches of 1e-3 mm by 0.01 degrees; Newton steps
lead on from them. Edges at planes and quadrics, which cut the solid, are no joints.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Curve2d, BRepAdaptor_Surface
from OCP.GeomAbs import GeomAbs_BSplineSurface
from OCP.gp import gp_Pnt, gp_Vec
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE
from OCP.TopExp import TopExp

from tpmscad.kernel.occt import convert
from tpmscad.kernel.step.step_reader import read_step

SAMPLES = 100
"""Random parameters of each edge."""

NEWTON_STEPS = 5
COINCIDENCE_MM = 1e-12
"""Largest number of steps to a point of an edge, and the distance at which they end."""


def worst_joint(path: str | Path, samples: int = SAMPLES, seed: int = 1) -> tuple[float, int]:
    """The largest angle in degrees between the normals of two B-spline faces at their edges in a STEP file, and their number."""
    rng = np.random.default_rng(seed)
    faces_of_edge = convert.shape_map()
    TopExp.MapShapesAndAncestors_s(read_step(path).shape, TopAbs_EDGE, TopAbs_FACE, faces_of_edge)
    worst, count = 0.0, 0
    for i in range(1, faces_of_edge.Extent() + 1):
        edge = convert.as_edge(faces_of_edge.FindKey(i))
        faces = [convert.as_face(face) for face in faces_of_edge.FindFromIndex(i)]
        surfaces = [BRepAdaptor_Surface(face, False) for face in faces]
        if len(faces) != 2 or any(s.GetType() != GeomAbs_BSplineSurface for s in surfaces):
            continue
        count += 1
        curve = BRepAdaptor_Curve(edge)
        at = rng.uniform(curve.FirstParameter(), curve.LastParameter(), samples).tolist()
        one, other = (
            _normals(surface, BRepAdaptor_Curve2d(edge, face), curve, at)
            for surface, face in zip(surfaces, faces, strict=True)
        )
        sine = np.linalg.norm(np.cross(one, other), axis=1)
        worst = max(worst, float(np.degrees(np.arcsin(np.minimum(1.0, sine))).max()))
    return worst, count


def _normals(
    surface: BRepAdaptor_Surface, on_surface: BRepAdaptor_Curve2d, curve: BRepAdaptor_Curve, at: list[float]
) -> np.ndarray:
    """Unit normals (n, 3) of a face at the points of an edge with these parameters; their sense does not matter."""
    point, along_u, along_v = gp_Pnt(), gp_Vec(), gp_Vec()
    rows = []
    for t in at:
        wanted, start = curve.Value(t), on_surface.Value(t)
        u, v = start.X(), start.Y()
        for _ in range(NEWTON_STEPS):
            surface.D1(u, v, point, along_u, along_v)
            if point.Distance(wanted) < COINCIDENCE_MM:
                break
            left = np.array(gp_Vec(point, wanted).Coord())
            du, dv = np.linalg.lstsq(np.array([along_u.Coord(), along_v.Coord()]).T, left)[0]
            u, v = u + du, v + dv
        rows.append(along_u.Crossed(along_v).Coord())
    normals = np.array(rows)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        angle, joints = worst_joint(name)
        print(f"{name}: {joints} joints, bent by at most {angle:.1e} degrees")
