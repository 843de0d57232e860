"""Points in the solid of a lattice that is not closed: decided by the nearest patch, refused beyond its border."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.welding import weld_patches
from tpmscad.errors import TrimmingError
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.classify.point_membership import points_in_lattice
from tpmscad.trimming.operands.patch_sides import read_patch_sides

U = np.linspace(-1.0, 1.0, 3)
SQUARES = np.array([1.0, -1.0, 1.0])
"""Bernstein coefficients of u^2 on [-1, 1]."""


def parabola_lattice(surface: BSplineSurface) -> Brep:
    """A lattice of one patch."""
    one = np.zeros(1, int)
    return weld_patches([surface], one, Motion.identity(1), one + 1, one, ["wall"])


def parabola() -> BSplineSurface:
    """The patch (u, v, u^2), u in [-1, 1], v in [0, 1]; its normal points to the inside of the parabola."""
    poles = np.zeros((3, 3, 3))
    poles[..., 0], poles[..., 1], poles[..., 2] = U[:, None], (U[None] + 1) / 2, SQUARES[:, None]
    return BSplineSurface(poles, np.repeat([-1.0, 1.0], 3), np.repeat([0.0, 1.0], 3), 2, 2)


@pytest.mark.parametrize("v", [0.0, 0.25, 0.7, 1.0])
@pytest.mark.parametrize("u", [-0.9, -0.3, 0.4, 0.8])
def test_a_point_on_a_normal_of_the_patch_is_on_the_side_of_its_offset(u: float, v: float) -> None:
    surface = parabola()
    np.testing.assert_allclose(surface(u, v), [u, v, u * u], atol=1e-15)
    lattice = parabola_lattice(surface)
    normal = np.array([-2 * u, 0.0, 1.0]) / np.hypot(2 * u, 1.0)
    points = surface(u, v) + np.array([-0.3, -1e-3, 1e-3, 0.15])[:, None] * normal
    found = points_in_lattice(lattice, read_patch_sides(lattice), points)
    assert found.tolist() == [True, True, False, False]


@pytest.mark.parametrize("beyond", [(0.3, -0.5, 0.5), (0.2, 1.4, 0.5), (1.5, 0.5, 1.0)])
def test_a_point_beyond_the_open_border_is_refused(beyond: tuple[float, float, float]) -> None:
    lattice = parabola_lattice(parabola())
    with pytest.raises(TrimmingError, match="open border"):
        points_in_lattice(lattice, read_patch_sides(lattice), np.array([beyond]))
