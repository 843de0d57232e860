"""Joints of a field's solid in its STEP file, measured by the kernel at random parameters of every edge."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tpmscad
from tpmscad import fields

pytestmark = pytest.mark.kernel
N_PARAMETERS = 41


def measure_joints(path: Path) -> tuple[float, int]:
    """Greatest angle in degrees between the faces at the edges between two spline faces, and the number of these edges."""
    from OCP.BRepAdaptor import BRepAdaptor_Curve2d, BRepAdaptor_Surface
    from OCP.GeomAbs import GeomAbs_Plane
    from OCP.gp import gp_Pnt, gp_Vec
    from OCP.STEPControl import STEPControl_Reader
    from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_REVERSED
    from OCP.TopExp import TopExp

    from tpmscad.kernel.occt import convert

    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    owners = convert.shape_map()
    TopExp.MapShapesAndAncestors_s(reader.OneShape(), TopAbs_EDGE, TopAbs_FACE, owners)
    rng = np.random.default_rng(7)
    worst, count = 0.0, 0
    for i in range(1, owners.Extent() + 1):
        edge = convert.as_edge(owners.FindKey(i))
        faces = [convert.as_face(face) for face in owners.FindFromIndex(i)]
        surfaces = [BRepAdaptor_Surface(face) for face in faces]
        if any(surface.GetType() == GeomAbs_Plane for surface in surfaces):
            continue
        assert len(faces) == 2
        share = rng.uniform(0.0, 1.0, N_PARAMETERS)
        normals = np.empty((2, N_PARAMETERS, 3))
        for k, (face, surface) in enumerate(zip(faces, surfaces, strict=True)):
            curve = BRepAdaptor_Curve2d(edge, face)
            first, last = curve.FirstParameter(), curve.LastParameter()
            for j, t in enumerate(first + (last - first) * share):
                at, point, along_u, along_v = curve.Value(float(t)), gp_Pnt(), gp_Vec(), gp_Vec()
                surface.D1(at.X(), at.Y(), point, along_u, along_v)
                normal = along_u.Crossed(along_v)
                normals[k, j] = normal.X(), normal.Y(), normal.Z()
            normals[k] *= -1.0 if face.Orientation() == TopAbs_REVERSED else 1.0
        sine = np.linalg.norm(np.cross(*normals), axis=1)
        angle = np.degrees(np.arctan2(sine, np.einsum("ni,ni->n", *normals)))
        worst, count = max(worst, float(angle.max())), count + 1
    return worst, count


def test_joints_are_tangent_in_the_file_and_in_the_certificate(tmp_path: Path) -> None:
    cell = ((0.0, 0.0, 0.0), (10.0, 10.0, 10.0))
    model = tpmscad.solidify(fields.rod(fields.tpms("gyroid", 10.0), 0.1), cell, tol=0.01)
    model.export_step(tmp_path / "cell.step")
    worst, count = measure_joints(tmp_path / "cell.step")
    assert count > 100
    assert worst < 1e-3
    assert model.certificate.met
    assert model.certificate.tangent_jump_deg < 1e-6
