"""Lattices to trim: Bezier patches through Chebyshev points of the exact surfaces, equal on common sides to round-off.

The folder's own modules and those of patches (solids of revolution made by hand) can be imported by its tests.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from tpmscad import surfaces
from tpmscad.patches import lattice as lattices
from tpmscad.patches.complex import PatchComplex, scaled
from tpmscad.splines.bspline import Surface, design

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "patches")]

CELL = 10.0
Cover = Callable[..., PatchComplex]


@lru_cache
def primitive(name: str, offset: float, degree: int = 9) -> Surface:
    t = 0.5 - 0.5 * np.cos(np.pi * np.arange(degree + 1) / degree)
    knots = np.repeat([0.0, 1.0], degree + 1)
    inverse = np.linalg.inv(design(knots, degree, t))
    points = surfaces.patch(name).jet(t[:, None], t[None, :], offset).position
    return Surface(np.einsum("ai,bj,ijk->abk", inverse, inverse, points), knots, knots, degree, degree)


@lru_cache
def covered(
    name: str, cells: tuple[int, int, int], phase: tuple[float, float, float], layers: tuple[float | None, float | None]
) -> PatchComplex:
    """Patches over the box from the origin to `cells` of CELL; layers and phase in cells."""
    sizes = sorted({abs(d) for d in layers if d is not None})
    lower, upper = (None if d is None else (sizes.index(abs(d)), d < 0) for d in layers)
    sheet = lattices.Sheet(tuple(primitive(name, size) for size in sizes), lower, upper)
    return scaled(lattices.covering(surfaces.symmetry(name), sheet, cells, np.array(phase)), CELL)


@pytest.fixture(scope="session")
def cover() -> Cover:
    return covered
