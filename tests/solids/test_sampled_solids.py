"""Solids of samples: flat sides of the domain, the volume that is asked for, and specks that cost nothing."""

from __future__ import annotations

from pathlib import Path

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tests.cli.test_cli import run
from tpmscad import fields
from tpmscad.solids.matter.field_patches import fit_field_patches

pytestmark = pytest.mark.kernel

SPACING = 0.5
PLACES = np.moveaxis(np.indices((28, 26, 24)), 0, -1)
DEPTH = np.clip(7.2 - np.linalg.norm(PLACES - (10.3, 11.4, 12.1), axis=-1), -3.0, 3.0)
"""A ball of 7.2 voxels."""

CORNER = 3 * np.argwhere(np.linalg.norm(PLACES[::3, ::3, ::3] - (10.3, 11.4, 12.1), axis=-1) > 12)
"""Voxels away from it, no two of them neighbours."""


def scan(n_specks: int) -> np.ndarray:
    """The ball with specks of one voxel."""
    values = DEPTH.copy()
    for voxel in CORNER[:: len(CORNER) // n_specks][:n_specks]:
        values[tuple(voxel)] = 2.0
    return values


def test_a_noisy_scan_makes_the_solid_of_the_clean_one_and_tells_its_specks(monkeypatch: pytest.MonkeyPatch) -> None:
    fitted = []
    monkeypatch.setattr(
        "tpmscad.solids._solidify.fit_field_patches",
        lambda field, *rest, **named: fitted.append(field) or fit_field_patches(field, *rest, **named),
    )
    clean, noisy = (fields.sampled(scan(n) if n else DEPTH, SPACING, level=0.0, centred=True) for n in (0, 40))
    model = tpmscad.solidify(noisy, noisy.domain, tol=0.1)
    certificate = model.certificate
    assert certificate.met
    assert len(certificate.pieces) == 1
    np.testing.assert_allclose(certificate.dropped, np.full(40, SPACING**3))
    assert any(note.startswith("left out: 40 loose pieces, 5 mm3 together") for note in certificate.notes)
    axes = [SPACING * np.arange(0, n, 0.5) for n in DEPTH.shape]
    np.testing.assert_array_equal(fitted[0].on_grid(*axes) < 0, clean.on_grid(*axes) < 0)
    assert model.volume == pytest.approx(4 / 3 * np.pi * (7.2 * SPACING) ** 3, rel=3e-3)


def test_specks_are_kept_where_they_are_asked_for() -> None:
    noisy = fields.sampled(scan(2), SPACING, level=0.0, centred=True)
    certificate = tpmscad.solidify(noisy, noisy.domain, tol=0.1, loose="keep").certificate
    assert len(certificate.pieces) == 3
    assert certificate.dropped == ()


def find_planes(path: Path) -> list[tuple[np.ndarray, str]]:
    """A point of each plane of a file, and the axis of its normal."""
    found = []
    for face in bd.import_step(path).faces().filter_by(bd.GeomType.PLANE):
        normal = np.abs(np.array(tuple(face.normal_at())))
        assert normal.max() > 1 - 1e-12
        found.append((np.array(tuple(face.center())), "xyz"[int(normal.argmax())]))
    return found


def test_a_density_of_elements_has_the_sides_of_its_mesh_and_the_volume_asked_for(tmp_path: Path) -> None:
    """From the elements of a mesh to STEP on the command line: a bracket that fills three sides of the domain."""
    meshio = pytest.importorskip("meshio")
    pytest.importorskip("vtkmodules")
    shape, size, first = np.array([12, 6, 4]), np.array([2.0, 2.5, 2.0]), np.array([1.0, -3.0, 5.0])
    corners = np.indices(shape + 1).reshape(3, -1).T * size + first
    number = np.arange((shape + 1).prod()).reshape(shape + 1)
    ring = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    nx, ny, nz = shape
    bricks = np.stack([number[i : i + nx, j : j + ny, k : k + nz].ravel() for i, j, k in ring], axis=1)
    x, y, _ = (np.moveaxis(np.indices(shape), 0, -1) + 0.5).transpose(3, 0, 1, 2)
    density = 1 / (1 + np.exp(1.5 * (y - 5 + x / 4)))
    mesh = meshio.Mesh(corners, [("hexahedron", bricks)], cell_data={"density": [density.ravel()]})
    mesh.write(tmp_path / "rho.vtu")
    line = f"solidify {tmp_path}/rho.vtu --volume-fraction 0.5 --cell-data -o {tmp_path}/part.step --quiet"
    assert run(line) == 0
    shape_read = tpmscad.check_step(tmp_path / "part.step").shape
    domain = shape * size
    assert shape_read.solids == 1
    assert shape_read.volume == pytest.approx(0.5 * domain.prod(), rel=1e-3)
    planes = find_planes(tmp_path / "part.step")
    for at, normal in ((first[0], "x"), (first[1], "y"), (first[2], "z"), (first[2] + domain[2], "z")):
        sides = [f for f in planes if abs(f[0]["xyz".index(normal)] - at) < 1e-9 and f[1] == normal]
        assert len(sides) == 1, (normal, at)
