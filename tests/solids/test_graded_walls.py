"""Walls whose distances from the mid surface vary from place to place, without a map."""

from __future__ import annotations

from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tpmscad import fields, maps, surfaces
from tpmscad.lattices import copies
from tpmscad.requests.lattice_request import read_lattice_request
from tpmscad.sources.patched_surface import PatchedSurface

pytestmark = pytest.mark.kernel

CELL, TOL = 6.0, 0.03
POINTS = np.random.default_rng(5).random((40, 3)) * 5.0
BODY = bd.Pos(0, 0, 4) * bd.Cylinder(5, 8)
CREASED = fields.clip(fields.expression("0.3 + 0.08 * z + 0.03 * x"), 0.45, 0.8)


def farthest(model: Any, thickness: Any, turn: Any, phase: Any, slope: float) -> float:
    """How far points of all patches are from the half thickness at their feet on the exact mid surface."""
    brep, t = model.patches, np.linspace(0.0, 1.0, 6)
    walls = [brep.tags.index(tag) for tag in ("offset+", "offset-")]
    rows = np.flatnonzero(np.isin(brep.faces.tag, walls))
    points = []
    for row in rows.tolist():
        carrier = brep.carriers[brep.faces.carrier[row]]
        (u0, u1), (v0, v1) = carrier.domain
        points.append(brep.faces.motion[row].apply(carrier.grid(u0 + t * (u1 - u0), v0 + t * (v1 - v0)).reshape(-1, 3)))
    points = np.concatenate(points)
    cells = copies.cell_origins((4, 4, 4), 1) - 2.0 + np.mod(phase, 1.0)
    placements = copies.translate_motions(surfaces.patch_symmetry("gyroid").cell_motions, cells)
    mid = PatchedSurface(surfaces.primitive_patch("gyroid"), placements, CELL, None)
    distance, foot = mid.distance_and_foot(points @ turn)
    return float(np.abs(np.abs(distance) - thickness(foot @ turn.T) / 2).max() / np.hypot(1.0, slope))


@pytest.mark.parametrize(
    ("thickness", "options"),
    [
        (lambda p: 0.6 + 0.03 * p[:, 2] - 0.02 * p[:, 0], {"rotation": (90.0, 0.0, 0.0), "phase": (0.3, 0.0, 0.1)}),
        (CREASED, {}),
        # its third derivative jumps just outside the body, in corners of few patches
        (fields.ramp("z", (-1.0, 16.0), (0.6, 1.0)), {}),
    ],
    ids=["function", "creases", "ramp"],
)
def test_a_graded_wall_in_a_body_is_as_thick_as_asked_for_at_the_feet_of_its_points(
    thickness: Any, options: dict[str, Any]
) -> None:
    model = tpmscad.infill(BODY, "gyroid", cell=CELL, thickness=thickness, tol=TOL, **options)
    found = model.certificate
    assert found.met, found.shortfalls
    assert "wall graded" in found.reference
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) if options else np.eye(3)
    off = farthest(model, thickness, turn, options.get("phase", (0, 0, 0)), 0.05)
    assert 0.5 * found.rms_deviation < off <= found.max_deviation * 1.02
    assert any("its surfaces are rounded" in note for note in found.notes) == isinstance(thickness, fields.Field)


def test_a_constant_function_is_the_even_wall() -> None:
    common: dict[str, Any] = {"cell": CELL, "tol": TOL, "phase": (0.1, 0.2, 0.3)}
    graded = tpmscad.lattice("gyroid", thickness=lambda p: np.full(len(p), 0.8), **common)
    fitted = tpmscad.lattice("gyroid", thickness=0.8, map=maps.stretching((1, 1, 1)), **common)
    assert graded.volume == pytest.approx(fitted.volume, rel=1e-9)
    copied = tpmscad.lattice("gyroid", thickness=0.8, **common)
    assert graded.certificate.n_faces == copied.certificate.n_faces
    assert graded.volume == pytest.approx(copied.volume, abs=0.1 * TOL * copied.area)


def test_graded_fractions_and_offsets_are_those_of_the_even_lattice_of_each_place() -> None:
    def request(**given: Any) -> Any:
        return read_lattice_request("gyroid", cell=CELL, **given)

    fraction = 0.15 + 0.03 * POINTS[:, 0]
    sheet = request(porosity="0.85 - 0.03 * x")
    wanted = [CELL * surfaces.thickness_for("gyroid", "minimal", f) for f in fraction]
    np.testing.assert_allclose(sheet.thickness(POINTS), wanted, rtol=1e-12)
    for side in "-+":
        rod = request(volume_fraction="0.3 + 0.03 * x", kind="skeletal", side=side)
        wanted = [CELL * surfaces.skeletal_offset_for("gyroid", "minimal", f + 0.15, side) for f in fraction]
        np.testing.assert_allclose(rod.centre(POINTS), wanted, rtol=0, atol=1e-12)
    wall = request(offset=("-0.2 - 0.01 * z", 0.4))
    low, high = (wall.centre(POINTS) + m * wall.thickness(POINTS) for m in wall.offset)
    np.testing.assert_allclose([low, high], [-0.2 - 0.01 * POINTS[:, 2], np.full(len(POINTS), 0.4)], atol=1e-15)


def test_a_skeletal_solid_of_graded_fraction_holds_it() -> None:
    model = tpmscad.lattice(
        "gyroid", cell=CELL, cells=(1, 1, 2), volume_fraction="0.3 + 0.02 * z", kind="skeletal", tol=TOL
    )
    assert model.certificate.met
    assert model.volume / (2 * CELL**3) == pytest.approx(0.3 + 0.02 * CELL, rel=2e-3)
