"""Blends as solids: edges of walls that thin out are rounded, and the certificate says so; bodies bound what counts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import quad
from scipy.optimize import brentq

from tpmscad import fields
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.errors import LevelSetError
from tpmscad.kernel.measure.shape_report import check_step
from tpmscad.solids._solidify import solidify
from tpmscad.solids.matter.field_patches import check_field_in_box, limit_tol_to_walls
from tpmscad.splines.bspline import BSplineSurface

pytestmark = pytest.mark.kernel

LO, HI = (0.3, 0.0, -0.3), (1.2, 0.4, 0.3)
HALF, VOID, TOL = 0.2, 0.45, 8e-3


def share(x: ArrayLike) -> NDArray[np.float64]:
    """The smooth step from 0 at 1/2 to 1 at 3/2."""
    t = np.asarray(x, float) - 0.5
    return t**3 * (10 - 15 * t + 6 * t**2)


@dataclass(frozen=True)
class Step:
    """The weight share(x), and its gradient."""

    def __call__(self, points: ArrayLike) -> NDArray[np.float64]:
        return share(np.asarray(points)[..., 0])

    def gradient(self, points: ArrayLike) -> NDArray[np.float64]:
        t = np.asarray(points)[..., :1] - 0.5
        return 30 * t**2 * (1 - t) ** 2 * np.array([1.0, 0.0, 0.0])

    def on_grid(self, *axes: NDArray[np.float64]) -> NDArray[np.float64]:
        return self(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))


def test_a_wall_that_thins_out_to_an_edge_is_a_solid_whose_edge_is_rounded_within_tol(tmp_path: Path) -> None:
    wall = fields.sheet(fields.coordinate("z"), -HALF, HALF)
    regions = fields.box((0, 0, -1), (1, 1, 1)), fields.box((1, 0, -1), (2, 1, 1))
    blending = fields.box((0.5, 0, -1), (1.5, 1, 1))
    field = BlendedField((wall, fields.constant(VOID)), regions, (blending,), (Step(),))
    model = solidify(field, (LO, HI), tol=TOL)

    found = model.certificate
    assert found.met, found.shortfalls
    assert "rounded" in found.notes[0]
    assert found.betti == (1, 0, 0)
    # |z| = HALF - VOID w / (1 - w) is the wall where it is blended
    tip = brentq(lambda x: share(x) - HALF / (HALF + VOID), 0.5, 1.5)
    blended = quad(lambda x: 2 * (HALF - VOID * share(x) / (1 - share(x))), 0.5, tip)[0]
    assert found.volume == pytest.approx(0.4 * (2 * HALF * 0.2 + blended), rel=1e-3)
    u, v = (g.ravel() for g in np.meshgrid(*[np.linspace(0, 1, 41)] * 2))
    reach = max(c(u, v)[:, 0].max() for c in model.patches.carriers if isinstance(c, BSplineSurface))
    assert tip - TOL <= reach < tip  # the edge itself is taken off
    assert tip - reach <= found.max_deviation <= TOL

    model.export_step(tmp_path / "wall.step")
    assert check_step(tmp_path / "wall.step").ok


def test_an_edge_whose_rounding_is_too_small_for_patches_is_refused() -> None:
    wall = fields.sheet(fields.tpms("schwarz_p", 1.0), -0.3, 0.3)
    regions = fields.box((0, 0, -1), (1, 1, 1)), fields.box((1, 0, -1), (2, 1, 1))
    field = BlendedField((wall, fields.constant(VOID)), regions, (fields.box((0.5, 0, -1), (1.5, 1, 1)),), (Step(),))
    with pytest.raises(
        LevelSetError, match=r"edge of \d+ degrees at \(.* too little for smooth patches; blend over a longer"
    ):
        check_field_in_box(field, LO, HI, 1e-5)


def test_what_a_field_is_beyond_a_body_does_not_matter() -> None:
    from build123d import Cylinder

    ball = fields.sphere((0.0, 0.0, 0.0), 0.7)
    field = fields.from_function(
        lambda p: np.where(np.abs(p[:, 2]) > 0.5, 5.0, ball(p)),
        lambda p: np.where(np.abs(p[:, 2:]) > 0.5, 0.0, ball.gradient(p)),
    )
    with pytest.raises(LevelSetError, match="jumps"):
        solidify(field, ((-0.61, -0.61, -0.51), (0.61, 0.61, 0.51)), tol=5e-3)
    found = solidify(field, Cylinder(0.6, 1.0), tol=5e-3).certificate
    assert found.met, found.shortfalls
    assert found.betti == (1, 0, 0)
    assert found.volume == pytest.approx(quad(lambda z: np.pi * min(0.36, 0.49 - z * z), -0.5, 0.5)[0], rel=1e-3)


def test_a_default_tolerance_is_lowered_to_what_the_walls_allow() -> None:
    """Walls of .1 and of 1 by the gradient of the nodal function, which is sqrt(3) on much of the surface of period 2 pi."""
    gyroid, corners = fields.tpms("gyroid", 2 * np.pi), (np.zeros(3), np.full(3, 2 * np.pi))
    thin, thick = (fields.sheet(gyroid, -half, half) for half in (0.05 * np.sqrt(3), 0.5 * np.sqrt(3)))
    tol = limit_tol_to_walls(thin, *corners, 0.1)
    assert 0.09 / 3 < tol < 0.11 / 3
    check_field_in_box(thin, *corners, tol)
    assert limit_tol_to_walls(thick, *corners, 0.1) == 0.1
