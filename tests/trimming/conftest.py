"""Lattices to trim: Bezier patches that interpolate the exact surfaces at Chebyshev points and agree on common sides."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest

from tpmscad import surfaces
from tpmscad.brep.boundary_representation import Brep, scale_brep
from tpmscad.lattices import copies as lattices
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineSurface

CELL = 10.0
Cover = Callable[..., Brep]


@lru_cache
def primitive(name: str, offset: float, degree: int = 9) -> BSplineSurface:
    t = 0.5 - 0.5 * np.cos(np.pi * np.arange(degree + 1) / degree)
    knots = np.repeat([0.0, 1.0], degree + 1)
    inverse = np.linalg.inv(design_matrix(knots, degree, t))
    points = surfaces.primitive_patch(name).jet(t[:, None], t[None, :], offset).position
    return BSplineSurface(np.einsum("ai,bj,ijk->abk", inverse, inverse, points), knots, knots, degree, degree)


@lru_cache
def covered(
    name: str, cells: tuple[int, int, int], phase: tuple[float, float, float], layers: tuple[float | None, float | None]
) -> Brep:
    """Patches that cover the box from the origin to `cells` times CELL; layers and phase in cells."""
    sizes = sorted({abs(d) for d in layers if d is not None})
    lower, upper = (None if d is None else (sizes.index(abs(d)), d < 0) for d in layers)
    sheet = lattices.OffsetSurfaces(tuple(primitive(name, size) for size in sizes), lower, upper)
    return scale_brep(lattices.patches_over_box(surfaces.patch_symmetry(name), sheet, cells, np.array(phase)), CELL)


@pytest.fixture(scope="session")
def cover() -> Cover:
    return covered
