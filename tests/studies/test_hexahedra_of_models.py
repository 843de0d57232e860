"""Hexahedra and trivariate splines of models: they have the kernel's volume, under maps too, and other solids are refused."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import tpmscad
from tpmscad import InvalidRequest, maps

pytestmark = pytest.mark.kernel


def test_a_natural_lattice_has_hexahedra() -> None:
    model = tpmscad.lattice("gyroid", cell=10, thickness=1, boundary="natural", tol=0.05)
    volumes = model.make_spline_volumes()
    assert volumes.integrate_volume() == pytest.approx(model.volume, rel=1e-11)
    mesh = model.hexahedra(refine=(1, 0))
    assert mesh.n_cells == 96
    assert mesh.volume == pytest.approx(model.volume, rel=2e-3)
    assert mesh.quality.smallest_scaled_jacobian > 0.75
    again = pickle.loads(pickle.dumps(model)).hexahedra(refine=(1, 0))
    np.testing.assert_array_equal(again.points, mesh.points)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "periods"),
    [
        ({"map": maps.cylinder(radius=25 / np.pi), "cells": (5, 1, 1)}, (0, 0, 10)),  # a closed ring
        ({"map": maps.grading(2, (1.0, 1.6), 20.0), "cells": (1, 1, 2)}, (10, 10, 0)),
        ({"cell": (10, 12, 9)}, (10, 12, 9)),
    ],
)
def test_mapped_lattices_are_filled_too(options: dict, periods: tuple[float, float, float]) -> None:
    model = tpmscad.lattice(
        "schwarz_p", **{"cell": 10, "thickness": 0.8, "boundary": "natural", "tol": 0.05, **options}
    )
    volumes = model.make_spline_volumes()
    assert volumes.integrate_volume() == pytest.approx(model.volume, rel=1e-9)
    assert volumes.periods == pytest.approx(periods, abs=1e-9)
    mesh = model.hexahedra(refine=(1, 0))
    assert mesh.volume == pytest.approx(model.volume, rel=2e-3)
    assert set(mesh.periodic) >= {axis for axis, period in zip("xyz", periods, strict=True) if period}


@pytest.mark.slow
def test_a_box_between_mirrors_cuts_no_wall() -> None:
    model = tpmscad.lattice("iwp", cell=10, thickness=0.6, tol=0.05, phase=(0.5, 0, 1))
    volumes = model.make_spline_volumes()
    assert volumes.integrate_volume() == pytest.approx(model.volume, rel=1e-11)
    (low, high), points = model.bounding_box, model.hexahedra(refine=(1, 0)).points
    np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], [low, high], atol=1e-6)
    cut = tpmscad.lattice("iwp", cell=10, thickness=0.6, tol=0.05, phase=(0.3, 0, 0), loose="keep")
    assert cut.make_spline_volumes() is None
    with pytest.raises(InvalidRequest, match="natural"):
        cut.hexahedra()


def test_solids_that_are_no_whole_walls_say_what_to_use_instead() -> None:
    cut = tpmscad.lattice("schwarz_p", cell=10, thickness=1, tol=0.05)
    with pytest.raises(InvalidRequest, match=r'boundary="natural".*model\.mesh'):
        cut.hexahedra()
    for wrong in (-1, (1, 2, 3), 0.5, "1"):
        with pytest.raises(InvalidRequest, match="refine"):
            cut.hexahedra(refine=wrong)
