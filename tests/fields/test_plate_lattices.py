"""Lattices of plates: the planes of a cubic cell, thickened, as fields and as solids."""

from __future__ import annotations

import numpy as np
import pytest

import tpmscad
from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.fields.kinds.plate_lattices import FAMILIES


def lies_in_plates(structure: str, points: np.ndarray, cell: np.ndarray, thickness: float) -> np.ndarray:
    """Whether points (n, 3) are within half a thickness of a plane h x/a + k y/b + l z/c = whole number."""
    found = np.zeros(len(points), bool)
    for indices in FAMILIES[structure]:
        normal = np.array(indices) / cell
        place = points @ normal
        found |= np.abs(place - np.round(place)) / np.linalg.norm(normal) < thickness / 2
    return found


@pytest.mark.parametrize("structure", FAMILIES)
def test_plates_lie_in_the_planes_of_the_cell(structure: str) -> None:
    cell = np.array([4.0, 5.0, 6.0])
    points = np.random.default_rng(2).random((4000, 3)) * cell * (2, 1, 2)
    field = fields.plate_lattice(structure, tuple(cell), 0.3, (2, 1, 2))
    inside = lies_in_plates(structure, points, cell, 0.3)
    assert 0.1 < inside.mean() < 0.6
    np.testing.assert_array_equal(field(points) < 0, inside)


@pytest.mark.kernel
@pytest.mark.parametrize(
    ("structure", "cells", "betti"),
    [
        ("cubic", 2, (1, 0, 8)),  # a chamber in each cell
        ("fcc", 1, (1, 0, 9)),  # an octahedron and eight tetrahedra; those that the box cuts are open
        ("bcc", 2, (1, 0, 48)),  # four on each side of the twelve faces between cells
    ],
)
def test_solids_of_plates_are_exact(structure: str, cells: int, betti: tuple[int, int, int]) -> None:
    cell, thickness = 5.0, 0.4
    field = fields.plate_lattice(structure, cell, thickness, cells)
    model = tpmscad.solidify(field, ((0, 0, 0), (cells * cell,) * 3), tol=0.02, progress=False)
    certificate = model.certificate
    assert certificate.met
    assert certificate.max_deviation == 0.0
    assert certificate.betti == betti
    fraction = model.volume / (cells * cell) ** 3
    if structure == "cubic":
        assert fraction == pytest.approx(1 - (1 - thickness / cell) ** 3, rel=1e-12)
    points = np.random.default_rng(1).random((200_000, 3)) * cell
    sampled = lies_in_plates(structure, points, np.full(3, cell), thickness).mean()
    assert fraction == pytest.approx(sampled, abs=3 * np.sqrt(sampled * (1 - sampled) / len(points)))


def test_what_cannot_be_made_is_refused() -> None:
    with pytest.raises(
        InvalidRequest, match=r"thickness = 3 fills the gaps between the plates, which are 2\.88675 apart"
    ):
        fields.plate_lattice("fcc", 5, 3)
    with pytest.raises(InvalidRequest, match="363 plates, 300 is the limit"):
        fields.plate_lattice("cubic", 5, 0.1, 120)
    with pytest.raises(InvalidRequest, match="structure"):
        fields.plate_lattice("hcp", 5, 0.1)
