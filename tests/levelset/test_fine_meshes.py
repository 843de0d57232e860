"""Laws of meshes finer than the tolerance asks: simplified before they are fitted, they give what fits of all polygons give."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.brep import connectivity
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.linear_extension import extend_linearly
from tpmscad.levelset import fine_meshes
from tpmscad.levelset.boundary_level_sets import sample_level_set
from tpmscad.levelset.field_solid import FieldFit, fit_field, simplify_field_fit
from tpmscad.levelset.fine_meshes import find_missed_leaves, fit_risky_polygons, is_finer_than_asked
from tpmscad.levelset.fit_simplification import fit_simplified_mesh, simplify_fit
from tpmscad.levelset.level_set_fit import FitRequest, fit_level_set, mesh_level_set
from tpmscad.levelset.quadmesh import octree
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.smoothing import extract_submesh

LO, HI, TOL = np.zeros(3), np.array([8.0, 7.0, 6.0]), 0.3


def rough_field(noise: float = 0.2) -> Field:
    """A slanted wall of samples with noise."""
    x, y, z = np.mgrid[0:9, 0:8, 0:7].astype(float)
    return fields.sampled(z - 3.1 - 0.2 * x + 0.1 * y + noise * np.random.default_rng(5).normal(size=x.shape))


@cache
def meshed(cells: int = 12, noise: float = 0.2) -> tuple[FitRequest, Octree, QuadMesh]:
    field = extend_linearly(rough_field(noise), LO, HI)
    tree = octree.uniform_octree(LO, HI, np.array((cells, cells - 1, cells - 2)))
    return FitRequest(field, TOL, sample_level_set(field, LO, HI, 0.25)), tree, mesh_level_set(tree, field)[0]


def fitted(monkeypatch: pytest.MonkeyPatch, least: int) -> FieldFit:
    monkeypatch.setattr(fine_meshes, "MIN_POLYGONS", least)
    return fit_field(rough_field(), LO, HI, TOL)


def euler_characteristic(fit: FieldFit) -> int:
    _count, shell = connectivity.label_shells(fit.brep)
    return int(connectivity.euler_characteristic(fit.brep, shell).sum())


@pytest.mark.slow
def test_simplified_early_or_late_a_rough_field_has_as_few_patches_within_the_tolerance_and_the_same_topology(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    early, late = fitted(monkeypatch, 0), fitted(monkeypatch, 10**9)
    assert early.fits[0].is_simplified
    assert not late.fits[0].is_simplified
    assert len(early.fits[0].fit.patches) < len(late.fits[0].fit.patches)
    early, late = simplify_field_fit(early), simplify_field_fit(late)
    assert len(early.fits[0].fit.patches) <= 1.1 * len(late.fits[0].fit.patches)
    for each in (early, late):
        assert connectivity.is_closed(each.brep)
        assert each.fits[0].quality.distance.max() <= TOL
        assert each.fits[0].sample_distances.max() <= TOL
    assert euler_characteristic(early) == euler_characteristic(late)


def test_a_mesh_is_finer_than_asked_if_the_tolerance_is_loose_and_its_polygons_are_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    request, tree, mesh = meshed()
    assert not is_finer_than_asked(request, tree, mesh)
    monkeypatch.setattr(fine_meshes, "MIN_POLYGONS", len(mesh.corners))
    assert is_finer_than_asked(request, tree, mesh)
    assert not is_finer_than_asked(replace(request, tol=1e-3), tree, mesh)


@pytest.mark.parametrize(("period", "simplified"), [(4.0, True), (2.4, False)])
def test_the_mesh_of_a_periodic_field_is_simplified_in_a_box_of_few_periods(
    monkeypatch: pytest.MonkeyPatch, period: float, simplified: bool
) -> None:
    monkeypatch.setattr(fine_meshes, "MIN_POLYGONS", 0)
    monkeypatch.setattr(fine_meshes, "MAX_PERIODS", 12.0)
    tree = octree.uniform_octree(LO, HI, np.array((40, 35, 30)))
    request = FitRequest(fields.tpms("schwarz_p", period), TOL, np.empty((0, 3)))
    mesh, _ = mesh_level_set(tree, request.field)
    assert is_finer_than_asked(request, tree, mesh) is simplified
    monkeypatch.setattr(fine_meshes, "MAX_PERIODS", np.inf)
    assert is_finer_than_asked(request, tree, mesh)


def test_leaves_of_samples_that_the_mesh_misses_are_found_and_no_others() -> None:
    request, tree, mesh = meshed()
    assert not len(find_missed_leaves(tree, mesh, request.surface_samples))
    far = mesh.vertices[mesh.corners[:, :3]].mean(axis=1)[:, 0] < 4.0
    leaves = find_missed_leaves(tree, extract_submesh(mesh, far)[0], request.surface_samples)
    centres = tree.leaf_centres(leaves)
    assert len(leaves)
    assert centres[:, 0].min() > 4.0


@pytest.mark.slow
@pytest.mark.parametrize("cells", [7, 9])
def test_the_leaves_that_fail_are_found_by_fitting_the_polygons_of_poor_shape(cells: int) -> None:
    request, tree, mesh = meshed(cells, 0.35)
    whole, part = fit_level_set(request, tree, mesh), fit_risky_polygons(request, tree, mesh, None)
    assert whole.failing.any()
    assert part is not None
    assert np.isin(whole.network.leaf[whole.failing], part.bad_leaves).any(axis=1).all()
    assert len(part.fit.patches) < len(whole.fit.patches)


def test_nothing_is_fitted_where_all_polygons_are_of_good_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fine_meshes, "MIN_RISKY_INTERIOR", 10.0)
    monkeypatch.setattr(fine_meshes, "MIN_RISKY_CORNER", 10.0)
    assert fit_risky_polygons(*meshed(), None) is None


@pytest.mark.slow
def test_a_fit_that_was_simplified_early_is_not_simplified_within_the_narrow_limit_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fit = fit_simplified_mesh(*meshed())
    assert fit.is_simplified
    assert not len(fit.bad_leaves)
    limits = []

    def simplify_once(_whole: object, max_distortion: float) -> None:
        limits.append(max_distortion)

    monkeypatch.setattr("tpmscad.levelset.fit_simplification._simplify_once", simplify_once)
    assert simplify_fit(fit) is fit
    assert limits == [1.3]


def test_patches_nearest_to_samples_that_no_patch_reaches_fall_short() -> None:
    request, tree, mesh = meshed()
    fit = fit_level_set(request, tree, mesh)
    assert not fit.short.any()
    beyond = np.array([[4.0, 3.5, 5.9]])  # far above the wall, where no patch comes
    missed = fit_level_set(replace(request, surface_samples=beyond), tree, mesh, fit)
    above = np.array([poles[..., :2].mean(axis=(0, 1)) for poles in missed.fit.patches])
    assert missed.short.sum() == 1
    assert np.abs(above[missed.short][0] - beyond[0, :2]).max() < 1.0
    assert set(missed.network.leaf[missed.short].ravel()) <= set(missed.leaves_of_short.tolist())
