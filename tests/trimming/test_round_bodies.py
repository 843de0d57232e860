"""Lattices trimmed by curved bodies are closed, fit their carriers, and agree with volumes from summation and complements."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.shapes import round_shapes as shapes
from tests.shapes.misfits import misfit, volume
from tests.trimming.network_operands import trim
from tpmscad import surfaces
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, reverse_faces, select_faces, translate_brep
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import InvalidRequest, NothingLeft
from tpmscad.lattices import copies as lattices
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.operands.polyhedra import polyhedron

CELL = 10.0
TOL = 1e-7
AT_HOME = (0.0, 0.0, 0.0)
TILT = Rotation.from_rotvec([0.3, 0.5, -0.2]).as_matrix()


def bracket() -> Brep:
    """A non-convex L of two walls."""
    corners = [(0, 0), (6, 0), (6, 2), (2, 2), (2, 7), (0, 7)]
    points = [(x, y, z) for z in (0.0, 5.0) for x, y in corners]
    sides = [(i, (i + 1) % 6, 6 + (i + 1) % 6, 6 + i) for i in range(6)]
    return polyhedron(np.array(points) @ TILT.T + [7.0, 6.5, 8.0], [(5, 4, 3, 2, 1, 0), (6, 7, 8, 9, 10, 11), *sides])


BODIES = {
    "cylinder": lambda: shapes.cylinder(4.3, 9.1, rotation=TILT, translation=(9.1, 8.7, 4.3)),
    "sphere": lambda: shapes.sphere(4.1, rotation=TILT, translation=(9.7, 10.2, 9.9)),
    "cone": lambda: shapes.cone(5.0, 8.0, rotation=TILT, translation=(9.1, 8.7, 4.3)),
    "frustum": lambda: shapes.frustum(5.0, 3.0, 8.0, rotation=TILT, translation=(9.1, 8.7, 4.3)),
    "torus": lambda: shapes.torus(4.0, 1.7, rotation=TILT, translation=(9.7, 10.2, 9.9)),
    "flask": lambda: shapes.flask(rotation=TILT, translation=(8.0, 9.0, 6.0)),
    "pierced block": lambda: translate_brep(shapes.pierced_block(), np.array([7.0, 8.0, 9.0])),
    "bracket": bracket,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "surface"),
    list(
        zip(
            BODIES,
            itertools.cycle((("gyroid", (-0.05, 0.05)), ("diamond", (None, 0.0)), ("schwarz_p", (None, 0.05)))),
            strict=False,
        )
    ),
)
def test_solid_and_void_share_the_body_between_them(
    body: str, surface: tuple[str, tuple[float | None, float | None]], cover: Callable[..., Brep]
) -> None:
    tool, lattice = BODIES[body](), cover(surface[0], (2, 2, 2), AT_HOME, surface[1])
    parts = [trim(lattice, tool, TOL), trim(reverse_faces(lattice), tool, TOL)]
    for part in parts:
        assert part.report.shifted == 0
        assert connectivity.is_closed(part.brep)
        off = misfit(part.brep)
        assert (off <= part.brep.edges.deviation[part.brep.uses.edge] + 1e-9).all()
        assert off.max() < 2 * TOL
        used = [part.brep.carriers[c] for c in np.unique(part.brep.faces.carrier)]
        patches = [getattr(surface, "whole", surface) for surface in used if isinstance(surface, BSplineSurface)]
        assert patches
        assert {id(surface) for surface in patches} <= {
            id(own) for own in lattice.carriers
        }  # the lattice's, or parts of them
    assert volume(parts[0].brep) + volume(parts[1].brep) == pytest.approx(volume(tool), rel=1e-8)
    areas = [
        integral_properties.integrate_faces(part.brep).area[part.brep.faces.tag < len(tool.tags)].sum()
        for part in parts
    ]
    assert sum(areas) == pytest.approx(integral_properties.integrate_faces(tool).area.sum(), rel=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("body", ["torus", "bracket"])
def test_volumes_are_those_of_a_count_of_points(body: str, cover: Callable[..., Brep]) -> None:
    """The trigonometric gyroid deviates by up to 1.4e-3 of the cell, on either side of the exact one; the sample is large."""
    tool = BODIES[body]()
    found = volume(trim(cover("gyroid", (2, 2, 2), AT_HOME, (None, 0.0)), tool, TOL).brep)
    n = 90
    low, high = tool.vertices.min(axis=0) - 5, tool.vertices.max(axis=0) + 5
    x = np.stack(np.meshgrid(*[np.linspace(0.5 / n, 1 - 0.5 / n, n)] * 3), axis=-1).reshape(-1, 3) * (high - low) + low
    local = tool.faces.motion[0].apply_inverse(x)
    r, z = np.hypot(local[:, 0], local[:, 1]), local[:, 2]
    inside = (r - 4) ** 2 + z**2 < 1.7**2 if body == "torus" else in_bracket(x)
    a, b, c = 2 * np.pi * x.T / CELL
    solid = np.sin(a) * np.cos(b) + np.sin(b) * np.cos(c) + np.sin(c) * np.cos(a) < 0
    counted = (inside & solid).mean() * np.prod(high - low)
    assert found == pytest.approx(counted, rel=1.5e-2)
    assert inside.mean() * np.prod(high - low) == pytest.approx(volume(tool), rel=1.5e-2)  # the count is of this body


def in_bracket(x: np.ndarray) -> np.ndarray:
    a, b, c = ((x - [7.0, 6.5, 8.0]) @ TILT).T
    return (c > 0) & (c < 5) & (a > 0) & (b > 0) & (((a < 6) & (b < 2)) | ((a < 2) & (b < 7)))


def test_a_lattice_inside_the_body_stays_whole(cover: Callable[..., Brep]) -> None:
    surface = cover("gyroid", (1, 1, 1), AT_HOME, (-0.05, 0.05)).carriers[0].scaled(1 / CELL)
    motions = surfaces.patch_symmetry("gyroid")
    sheet = lattices.OffsetSurfaces((surface,), (0, True), (0, False))
    whole = lattices.build_natural_lattice(motions, sheet, lattices.place_whole_cells("gyroid", (1, 1, 1), np.zeros(3)))
    kept = trim(whole, shapes.sphere(3.0), TOL).brep
    assert len(kept.faces) == len(whole.faces)
    assert volume(kept) == pytest.approx(volume(whole), rel=1e-12)
    with pytest.raises(NothingLeft):
        trim(whole, shapes.sphere(3.0, translation=(9.0, 0.0, 0.0)), TOL)


@pytest.mark.slow
def test_a_cylinder_along_a_period_has_the_same_share_in_each_cell(cover: Callable[..., Brep]) -> None:
    found = []
    for cells in (1, 2):
        lattice = cover("gyroid", (1, 1, 3), AT_HOME, (None, 0.0))
        tool = shapes.cylinder(3.1, CELL * cells, translation=(4.7, 5.2, 3.4))
        found.append(trim(lattice, tool, TOL))
    assert volume(found[1].brep) == pytest.approx(2 * volume(found[0].brep), rel=1e-8)


def test_a_body_that_is_open_is_refused(cover: Callable[..., Brep]) -> None:
    lattice = cover("gyroid", (1, 1, 1), AT_HOME, (None, 0.0))
    ball = shapes.sphere(2.0, translation=(5.0, 5.0, 5.0))
    with pytest.raises(InvalidRequest, match="do not join two faces"):
        trim(lattice, select_faces(ball, np.array([0])), TOL)
