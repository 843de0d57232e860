"""Solids of fields go on in CAD: cut, common and fuse by plain build123d, and trimmed by bodies whose own faces stay."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import build123d as bd
import numpy as np
import pytest
from OCP.BRep import BRep_Tool
from OCP.Geom import Geom_CylindricalSurface, Geom_Plane

from tpmscad import fields
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.step.step_reader import read_step
from tpmscad.solids._solidify import solidify

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

CELL = ((0.0, 0.0, 0.0), (10.0, 10.0, 10.0))
VOLUME = 1e-3
"""Relative: as certified of the solids, and what the quadrature is good to."""

ROD = fields.rod(fields.tpms("gyroid", 10.0), -0.2)

Inside = Callable[[np.ndarray], np.ndarray]


def in_cylinder(x: np.ndarray) -> np.ndarray:
    return np.hypot(x[..., 0] - 5.0, x[..., 1] - 5.0) < 3.0


def in_ball(x: np.ndarray) -> np.ndarray:
    return np.linalg.norm(x - 5.0, axis=-1) < 4.5


def quadratures(
    insides: Callable[[np.ndarray], tuple[np.ndarray, ...]], low: np.ndarray, high: np.ndarray, count: int = 240
) -> list[float]:
    """Volumes of sets in a box, by one random point in each of count^3 cells: within 3e-4 or so of thin walls."""
    rng = np.random.default_rng(5)
    step = (high - low) / count
    y, z = (low[k] + step[k] * (np.arange(count) + 0.5) for k in (1, 2))
    hits = []
    for i in range(count):
        grid = np.stack(np.meshgrid([low[0] + step[0] * (i + 0.5)], y, z, indexing="ij"), axis=-1)
        hits.append([int(s.sum()) for s in insides(grid + step * (rng.random(grid.shape) - 0.5))])
    return [float(step.prod()) * n for n in np.sum(hits, axis=0).tolist()]


def sound(shape: bd.Shape) -> float:
    """The volume of a shape that is valid and closed."""
    found = check_shape(shape)
    assert found.ok, found
    return found.volume


def test_cylinder_cut_sphere_common_and_plate_fuse() -> None:
    field, low, high = ROD, np.zeros(3), np.full(3, 10.0)
    model = solidify(field, CELL, tol=1e-2)
    assert model.certificate.met, model.certificate.shortfalls
    cut = model.solid - bd.Pos(5, 5, 5) * bd.Cylinder(3, 12)
    common = model.solid & bd.Pos(5, 5, 5) * bd.Sphere(4.5)
    fused = model.solid + bd.Pos(5, 5, -0.9) * bd.Box(12, 12, 2)  # reaches 0.1 into the cell

    def cut_and_common(x: np.ndarray) -> tuple[np.ndarray, ...]:
        solid = field(x) < 0
        return solid & ~in_cylinder(x), solid & in_ball(x)

    assert [sound(cut), sound(common)] == pytest.approx(quadratures(cut_and_common, low, high), rel=VOLUME)
    (buried,) = quadratures(lambda x: (field(x) < 0,), low, np.array([10.0, 10.0, 0.1]), 120)
    assert sound(fused) == pytest.approx(288.0 + model.certificate.volume - buried, rel=VOLUME)


def flask() -> bd.Part:
    profile = bd.Polyline((0, 0), (7, 0), (7, 8), (3, 13), (3, 17), (0, 17), (0, 0))
    return bd.revolve(bd.Plane.XZ * bd.make_face(profile), bd.Axis.Z)


def in_flask(x: np.ndarray) -> np.ndarray:
    z = x[..., 2]
    radius = np.interp(z, [0.0, 8.0, 13.0, 17.0], [7.0, 7.0, 3.0, 3.0])
    return (z > 0) & (z < 17) & (np.hypot(x[..., 0], x[..., 1]) < radius)


def quadrics(shape: object) -> set[tuple[object, ...]]:
    """The planes and cylinders that faces of a shape lie on, each told by a few rounded numbers."""
    found: set[tuple[object, ...]] = set()
    for face in faces_of(shape):
        surface = BRep_Tool.Surface_s(face)
        if isinstance(surface, Geom_Plane):
            axis = surface.Pln().Axis()
            normal, origin = (np.array(v.Coord()) for v in (axis.Direction(), axis.Location()))
            normal = normal * np.sign(normal[np.abs(normal) > 1e-6][0])
            found.add(("plane", *(np.append(normal, normal @ origin).round(5) + 0.0).tolist()))
        elif isinstance(surface, Geom_CylindricalSurface):
            axis = surface.Cylinder().Axis()
            along, origin = (np.array(v.Coord()) for v in (axis.Direction(), axis.Location()))
            along = along * np.sign(along[np.abs(along) > 1e-6][0])
            foot = origin - (origin @ along) * along
            found.add(("cylinder", round(surface.Radius(), 6), *(np.append(along, foot).round(5) + 0.0).tolist()))
    return found


def test_trimmed_by_a_body_whose_faces_stay_what_they_are(tmp_path: Path) -> None:
    body, field = flask(), fields.rod(fields.tpms("gyroid", 13.0), -0.2)
    low, high = (np.array(tuple(corner)) for corner in (body.bounding_box().min, body.bounding_box().max))
    model = solidify(field, body, tol=2e-2)
    assert model.certificate.valid
    assert model.certificate.closed
    assert len(model.certificate.pieces) == len(model.solid.solids())

    def body_and_solid(x: np.ndarray) -> tuple[np.ndarray, ...]:
        return in_flask(x), in_flask(x) & (field(x) < 0)

    assert [body.volume, model.certificate.volume] == pytest.approx(quadratures(body_and_solid, low, high), rel=VOLUME)
    path = tmp_path / "trimmed.step"
    model.export_step(path)
    written = read_step(path).shape
    assert sound(written) == pytest.approx(model.certificate.volume, rel=1e-6)
    assert quadrics(written) == quadrics(body)
