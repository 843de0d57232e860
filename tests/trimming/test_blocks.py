"""Blocks of curved patches trimmed by planes: closed loops inside one patch, and volumes against direct summation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from tests.shapes.misfits import volume
from tests.trimming.network_operands import trim
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.moments import integral_properties
from tpmscad.brep.welding import weld_patches
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.operands.polyhedra import box, polyhedron

HEIGHT = 0.5
SIDES = ((0, 2, 3, 1), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6), (4, 5, 7, 6))


def bumpy_block() -> Brep:
    """The unit cube with a curved top, z = 1 + HEIGHT 16 x (1 - x) y (1 - y)."""
    corners = np.array([[x, y, z] for z in (0.0, 1) for y in (0.0, 1) for x in (0.0, 1)])
    knots_u, knots_v = np.repeat([0.0, 1.0], 4), np.repeat([0.0, 1.0], 3)  # unequal degrees, 3 along u and 2 along v
    s, t = np.linspace(0, 1, 4)[:, None, None], np.linspace(0, 1, 3)[None, :, None]
    patches = []
    for a, b, c, d in corners[list(map(list, SIDES))]:
        patches.append(
            BSplineSurface(
                (1 - s) * (1 - t) * a + s * (1 - t) * b + s * t * c + (1 - s) * t * d, knots_u, knots_v, 3, 2
            )
        )
    # 4 x (1 - x) has the cubic coefficients 0, 4/3, 4/3, 0, and 4 y (1 - y) the quadratic ones 0, 2, 0
    patches[5].poles[..., 2] += HEIGHT * np.outer([0, 4 / 3, 4 / 3, 0], [0, 2, 0])
    n = len(patches)
    return weld_patches(patches, np.arange(n), Motion.identity(n), np.ones(n, int), np.zeros(n, int), ["block"])


def above(level: float) -> float:
    """Volume of the part above z = level >= 1, by quadrature over x."""
    c = (level - 1) / HEIGHT

    def slice_area(x: float) -> float:
        a = 16 * x * (1 - x) / 4  # the slice is HEIGHT (4 a y (1 - y) - c) where positive
        half = 0.5 * np.sqrt(max(0.0, 1 - c / a)) if a > c else 0.0
        return HEIGHT * (2 * half * (a - c) - 8 * a * half**3 / 3)

    edge = 0.5 * np.sqrt(1 - c)
    return float(quad(slice_area, 0.5 - edge, 0.5 + edge, epsabs=1e-13, epsrel=1e-12)[0])


@pytest.mark.parametrize("below_top", [0.3, 1e-2, 1e-4, 1e-6])
def test_a_loop_inside_one_patch_is_cut_however_small(below_top: float) -> None:
    level = 1 + HEIGHT - below_top
    kept = trim(bumpy_block(), box([-1, -1, -1], [2, 2, level]), 1e-9)
    rest = trim(bumpy_block(), box([-1, -1, level], [2, 2, 2]), 1e-9)
    assert (len(kept.brep.faces), len(rest.brep.faces)) == (7, 2)
    assert connectivity.is_closed(kept.brep)
    assert connectivity.is_closed(rest.brep)
    volumes = [volume(cut.brep) for cut in (kept, rest)]
    assert volumes[1] == pytest.approx(above(level), rel=1e-4, abs=1e-11)
    assert sum(volumes) == pytest.approx(1 + HEIGHT * 4 / 9, rel=1e-9)


def test_a_box_inside_the_block_and_one_across_its_corner() -> None:
    block = bumpy_block()
    inside = trim(block, box([0.2, 0.3, 0.1], [0.7, 0.8, 0.6]), 1e-9).brep
    assert volume(inside) == pytest.approx(0.125, rel=1e-12)
    corner = trim(block, box([-0.5, -0.5, -0.5], [0.25, 0.5, 0.75]), 1e-9).brep
    assert volume(corner) == pytest.approx(0.25 * 0.5 * 0.75, rel=1e-12)
    assert connectivity.is_closed(corner)


def turned_tetrahedron() -> Brep:
    corners = np.array([[0, 0, 0], [1.4, 0, 0], [0, 1.3, 0], [0, 0, 1.7]]) - 0.2
    turn = Rotation.from_rotvec([0.2, 0.5, -0.3]).as_matrix()
    return polyhedron(corners @ turn.T + 0.3, [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])


@pytest.mark.slow
def test_any_convex_polyhedron_cuts_and_its_volume_matches_a_count_of_points() -> None:
    tool = turned_tetrahedron()
    cut = trim(bumpy_block(), tool, 1e-9).brep
    assert connectivity.is_closed(cut)
    n = 120
    lo, hi = tool.vertices.min(axis=0), tool.vertices.max(axis=0)
    x = np.stack(np.meshgrid(*[np.linspace(0.5 / n, 1 - 0.5 / n, n)] * 3), axis=-1).reshape(-1, 3) * (hi - lo) + lo
    top = 1 + HEIGHT * 16 * x[:, 0] * (1 - x[:, 0]) * x[:, 1] * (1 - x[:, 1])
    solid = ((x[:, :2] > 0) & (x[:, :2] < 1)).all(axis=1) & (x[:, 2] > 0) & (x[:, 2] < top)
    counted = (solid & np.all([plane.distance(x) < 0 for plane in tool.carriers], axis=0)).mean() * np.prod(hi - lo)
    assert volume(cut) == pytest.approx(counted, rel=2e-3)


def test_a_cut_and_its_complement_meet_in_the_same_area() -> None:
    left = trim(bumpy_block(), box([-1, -1, -1], [0.37, 2, 3]), 1e-9).brep
    right = trim(bumpy_block(), box([0.37, -1, -1], [2, 2, 3]), 1e-9).brep
    areas = []
    for part in (left, right):
        assert len(part.faces_with_tag("cap")) == 1
        areas.append(integral_properties.integrate_faces(part).area[part.faces_with_tag("cap")[0]])
    assert areas[0] == pytest.approx(areas[1], rel=1e-12)
    assert areas[0] == pytest.approx(1 + HEIGHT * 16 * 0.37 * 0.63 / 6, rel=1e-10)
