"""Lattices of the surfaces without exact patches, and walls asked for by porosity and pore size."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

import tpmscad
from tests.trimming.network_operands import trim
from tpmscad import fields, surfaces
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.errors import InvalidRequest
from tpmscad.levelset.periodic import periodic_layers
from tpmscad.levelset.periodic.periodic_fit import PeriodicFit, fit_periodic_patches
from tpmscad.levelset.periodic.periodic_layers import fit_periodic_offset, make_periodic_layout
from tpmscad.levelset.periodic.periodic_mesh import PeriodicMesh
from tpmscad.requests.lattice_request import read_lattice_request
from tpmscad.sources.level_set_source import COARSEST_GRIDS, LevelSetSource
from tpmscad.trimming.operands.polyhedra import box

LEVEL_SET_SURFACES = tuple(name for name, each in surfaces.CATALOGUE.items() if each.primitives == "level set")


def made(name: str, **options: Any) -> Any:
    """The closed boundary representation of a lattice, without the kernel."""
    request = read_lattice_request(name, cell=1.0, tol=1e-3, **options)
    source = LevelSetSource(request.surface, (1.0, 1.0, 1.0), request.levels)
    fit = source.fit(request.layer_offsets, 1.0, request.tol)
    assembly = source.cover(fit.surfaces, request.cells, np.array(request.phase))
    return trim(assembly.brep, box(np.zeros(3), np.array(request.cells, float))).brep, fit, request


@pytest.mark.slow
@pytest.mark.parametrize("name", LEVEL_SET_SURFACES)
def test_the_layout_of_a_period_has_the_genus_of_the_catalogue(name: str) -> None:
    layout = make_periodic_layout(fields.tpms(name, 1.0), COARSEST_GRIDS.get(name))
    pure_translations = int((np.abs(layout.isometries.rotation - np.eye(3)).max(axis=(1, 2)) == 0).sum())
    expected = (2 - 2 * surfaces.find_surface(name).genus) * pure_translations
    assert len(layout.mesh.vertices) - len(layout.mesh.corners) == expected


@pytest.mark.slow
def test_a_lattice_of_level_set_patches_is_closed_and_has_the_porosity_asked_for() -> None:
    brep, fit, _ = made("fischer_koch_s", porosity=0.8)
    properties = measure_solid(brep)
    assert properties.closed
    assert properties.volume == pytest.approx(0.2, abs=1e-5)
    assert fit.deviation.max < 1e-3


@pytest.mark.slow
def test_an_offset_that_the_coarsest_grid_cannot_fit_is_fitted_on_a_finer_one(monkeypatch: pytest.MonkeyPatch) -> None:
    field, coarsest = fields.tpms("split_p", 1.0), COARSEST_GRIDS["split_p"]
    n_coarse = len(make_periodic_layout(field, coarsest).mesh.corners)

    def miss_on_coarsest(of: fields.Field, mesh: PeriodicMesh, *rest: Any) -> PeriodicFit:
        fit = fit_periodic_patches(of, mesh, *rest)
        return replace(fit, met=fit.met and len(mesh.corners) > n_coarse)

    monkeypatch.setattr(periodic_layers, "fit_periodic_patches", miss_on_coarsest)
    fit = fit_periodic_offset(field, -0.04, 0.0049, coarsest)
    assert fit.met
    assert len(fit.mesh.corners) > n_coarse
    assert np.abs(fit.poles).max() < 2.0


@pytest.mark.slow
def test_the_patches_lie_at_the_offset_by_an_independent_measure() -> None:
    """The distance of points of the patches from a dense sample of the mid surface, by a kd-tree."""
    offset, phi = 0.02, fields.tpms("split_p", 1.0)
    fit = fit_periodic_offset(phi, offset, 1e-3, COARSEST_GRIDS["split_p"])
    t = np.linspace(0.0, 1.0, 240, endpoint=False)
    values = phi.on_grid(t, t, t)
    near = np.argwhere(np.abs(values) < 0.05 * np.abs(values).max()) / 240
    for _ in range(6):
        value, gradient = phi.value_and_gradient(near)
        near = near - (value / np.einsum("ni,ni->n", gradient, gradient))[:, None] * gradient
    tree = cKDTree(np.minimum(np.mod(near, 1.0), np.nextafter(1.0, 0.0)), boxsize=1.0)
    distance, _ = tree.query(np.mod(fit.poles[:, 0, 0], 1.0))  # corners of the patches lie on them
    np.testing.assert_allclose(distance, offset, rtol=0, atol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "reference"), [("gyroid", "minimal"), ("split_p", "nodal")])
def test_the_cell_of_a_pore_size_leaves_a_void_of_that_size(name: str, reference: str) -> None:
    """The distance transform of the wall on a grid, as an independent measure of the largest sphere."""
    request = read_lattice_request(name, reference=reference, porosity=0.7, pore_size=0.6)
    cell, n = request.cell[0], 60
    t = (np.arange(n) + 0.5) / n * cell
    low, high = request.offset
    distance = fields.normal_distance(fields.tpms(name, cell)).on_grid(t, t, t)
    wall = np.argwhere((distance > low) & (distance < high)) * cell / n
    void = np.argwhere((distance <= low) | (distance >= high)) * cell / n
    radius = cKDTree(wall, boxsize=cell).query(void)[0].max()
    assert 2 * radius == pytest.approx(0.6, abs=2 * cell / n)
    fraction = surfaces.volume_fraction(name, reference, low / cell, high / cell)
    assert fraction == pytest.approx(0.3, abs=1e-9)


@pytest.mark.slow
def test_a_pore_size_with_a_thickness_leaves_the_thickness_as_it_is() -> None:
    request = read_lattice_request("diamond", thickness=0.2, pore_size=0.6)
    assert request.offset == (-0.1, 0.1)
    # the deepest points of the minimal diamond lie sqrt(3) / 8 of the cell from it
    assert request.cell[0] == pytest.approx(0.4 / (np.sqrt(3) / 8), rel=1e-3)
    assert "the largest spheres in the void have the diameters 0.6 (channel -) and 0.6 (channel +)" in request.notes


def test_a_cell_contradicts_a_pore_size() -> None:
    with pytest.raises(InvalidRequest, match="or pore_size, not both"):
        read_lattice_request("gyroid", cell=2.0, porosity=0.7, pore_size=0.6)
    with pytest.raises(InvalidRequest, match="needs cell="):
        read_lattice_request("gyroid", porosity=0.7)


@pytest.mark.slow
def test_a_fraction_beyond_symmetric_walls_is_met_off_the_middle_or_between_levels() -> None:
    """O,C-TO bends too sharply on one side for a symmetric wall of a fifth, and on both for one of three tenths."""
    fifth = read_lattice_request("octo", cell=1.0, volume_fraction=0.2)
    assert fifth.levels is None
    assert -fifth.offset[0] < fifth.offset[1]
    assert "allows no symmetric wall" in fifth.notes[0]
    tenths = read_lattice_request("octo", cell=1.0, volume_fraction=0.3)
    assert tenths.levels is not None
    phi = fields.tpms("octo", 1.0)
    assert fields.volume_fraction(fields.sheet(phi, *tenths.levels)) == pytest.approx(0.3, abs=1e-4)
    assert "thickness varies" in tenths.notes[0]


@pytest.mark.kernel
@pytest.mark.slow
@pytest.mark.parametrize("name", LEVEL_SET_SURFACES)
def test_every_surface_without_exact_patches_makes_a_lattice(name: str) -> None:
    model = tpmscad.lattice(name, cell=10.0, thickness=0.3, tol=0.05)
    assert model.certificate.met, model.certificate.shortfalls
    fraction = surfaces.volume_fraction(name, model.certificate.reference.split()[0], -0.015, 0.015)
    assert model.volume == pytest.approx(1000 * fraction, rel=2e-3)


@pytest.mark.kernel
@pytest.mark.slow
def test_a_body_is_filled_with_a_level_set_lattice_and_divided_by_it() -> None:
    import build123d as bd

    body = bd.Box(9, 8, 7.5)
    filled = tpmscad.infill(body, "octo", cell=8, thickness=0.3, tol=0.05)
    domains = tpmscad.fluid_domains(body, "octo", cell=8, thickness=0.3, tol=0.05)
    assert filled.certificate.met
    assert domains.certificate.met
    assert domains.wall.volume == pytest.approx(filled.volume, rel=1e-6)
    total = domains.wall.volume + domains.plus.volume + domains.minus.volume
    assert total == pytest.approx(body.volume, rel=1e-6)
