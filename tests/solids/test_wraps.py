"""Lattices wrapped into rings and domes, as certified solids; wraps that overlap are refused."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

import tpmscad
from tpmscad import maps
from tpmscad.errors import InvalidRequest

pytestmark = pytest.mark.kernel


@pytest.mark.slow
def test_a_dome_lies_around_the_axis_and_is_certified() -> None:
    model = tpmscad.lattice(
        "schwarz_p", cell=10.0, cells=(2, 2, 1), thickness=0.6, tol=0.3, map=maps.sphere(15.0), boundary="natural"
    )
    assert model.certificate.met, model.certificate.shortfalls
    # The Schwarz P is symmetric under a half-turn about the axis of its cells.
    low, high = model.patches.vertices.min(axis=0), model.patches.vertices.max(axis=0)
    assert high[2] > 15
    assert low[:2].max() < -10 < 10 < high[:2].min()


@pytest.mark.slow
def test_a_tube_ends_in_the_cylinders_and_planes_of_its_box() -> None:
    radius, tol = 20 / np.pi, 0.1
    model = tpmscad.lattice(
        "schwarz_p",
        cell=10.0,
        cells=(4, 1, 1),
        kind="skeletal",
        reference="nodal",
        tol=tol,
        map=maps.cylinder(radius),
        phase=(0, 0, 0),
    )
    assert model.certificate.met, model.certificate.shortfalls
    # Slow oracle: the formula on a grid of the lattice's box, weighted by the Jacobian determinant 1 + y / radius.
    x = (np.arange(160) + 0.5) / 16
    c = np.cos(2 * np.pi * x / 10)
    solid = c[:, None, None] + c[None, :, None] + c[None, None, :] < 0
    volume = 4 * float((solid * (1 + x / radius)[None, :, None]).sum()) / 16**3
    assert model.certificate.volume == pytest.approx(volume, rel=3e-3)
    radii = np.hypot(*model.patches.vertices.T[:2])
    assert radii.min() == pytest.approx(radius, abs=1e-6)
    assert radii.max() == pytest.approx(radius + 10, abs=1e-6)


@pytest.mark.slow
def test_the_example_of_a_ring_makes_what_it_says(tmp_path: Path) -> None:
    example = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "closed_ring.py"))
    found = example["main"](tmp_path / "ring.step", cells=4, surface="schwarz_p", tol=0.3)
    assert found["met"]
    assert (found["pieces"], found["tunnels"], found["cavities"]) == (1, 13, 0)
    assert "repeats after 4.39822972 cells along x" in found["refused"]
    assert tpmscad.check_step(tmp_path / "ring.step").ok


@pytest.mark.parametrize(
    ("options", "match"),
    [
        (
            {"cells": (5, 1, 1), "map": maps.cylinder(7.0)},
            "overlaps itself: near .*repeats after 4.39822972 cells along x",
        ),
        ({"map": lambda p: p * [1, 1, 0]}, "squeezes the lattice flat near lattice point"),
        ({"map": lambda p: p * [1, 1, 0], "boundary": "box"}, "squeezes the lattice flat near lattice point"),
        ({"map": lambda p: (p - 5) ** 2 / 5, "boundary": "box"}, "folds.*near lattice point"),
        ({"map": 3}, "map 3 can't be called"),
    ],
)
def test_wraps_that_are_not_one_to_one_are_refused(options: dict[str, object], match: str) -> None:
    request = {"cell": 10.0, "thickness": 0.6, "tol": 0.3, "boundary": "natural", **options}
    with pytest.raises(InvalidRequest, match=match):
        tpmscad.lattice("schwarz_p", **request)  # type: ignore[arg-type]


@pytest.mark.slow
def test_patches_that_a_map_bends_until_they_oscillate_are_refused_before_they_are_cut() -> None:
    """Patches of the diamond that reach beyond the box cross the axis of so small a cylinder."""
    with pytest.raises(InvalidRequest, match=r"deviate by .*, more than a tenth of the cell.*larger radius") as refused:
        tpmscad.lattice("diamond", map=maps.cylinder(2.65), cell=10.0, cells=1, thickness=0.5, tol=0.07)
    assert "radius 2.65" in str(refused.value)
