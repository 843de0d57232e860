"""Laws of simplified fits: they pass, too, or the full fit stays."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.shapes.ball_level_sets import BALL, HI, LO, TOL, ball_fit
from tpmscad import fields
from tpmscad.brep.connectivity import is_closed
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.levelset import fit_simplification
from tpmscad.levelset.brep_assembly import assemble_field_brep
from tpmscad.levelset.fit.network_fit import WarmStart, fit_network
from tpmscad.levelset.fit_simplification import simplify_fit
from tpmscad.levelset.level_set_fit import LevelSetFit, classify_failures, fit_level_set
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.quality import corner_distortion
from tpmscad.levelset.quadmesh.simplification import greedy_simplification
from tpmscad.levelset.quadmesh.simplification.edit_history import EditHistory
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import PolygonMesh, extract_mesh
from tpmscad.levelset.quadmesh.smoothing import project_to_level_set
from tpmscad.levelset.quadmesh.vectors import normalize


def polygons_of(mesh: QuadMesh) -> set[tuple[tuple[float, ...], ...]]:
    """Polygons by the start positions of their vertices."""
    start = [tuple(point) for point in mesh.start_positions.tolist()]
    return {tuple(sorted(start[v] for v in corners if v >= 0)) for corners in mesh.corners.tolist()}


@pytest.mark.parametrize(("kept", "tried"), [(0.6, 3), (0.7, 1)])
def test_large_fits_are_simplified_again_only_after_a_simplification_that_removed_enough(
    kept: float, tried: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = ball_fit(share=0.1)
    calls = []

    def simplify_once(fit: LevelSetFit, max_distortion: float) -> LevelSetFit:
        calls.append(max_distortion)
        curve = fit.network.curve[: int(kept * len(fit.network.curve))]
        return replace(fit, network=replace(fit.network, curve=curve))

    monkeypatch.setattr(fit_simplification, "_simplify_once", simplify_once)
    monkeypatch.setattr(fit_simplification, "MIN_GAIN_PATCHES", 0)
    simplify_fit(whole)
    assert len(calls) == tried
    calls.clear()
    monkeypatch.setattr(fit_simplification, "MIN_GAIN_PATCHES", len(whole.network.curve))
    simplify_fit(whole)
    assert len(calls) == 3


@pytest.mark.parametrize("name", ["distance", "min_normal_cosine"])
def test_a_patch_whose_measurements_are_not_finite_fails(name: str) -> None:
    whole = ball_fit(share=0.1)
    measured = whole.quality.samples
    values = getattr(measured, name).copy()
    values[7] = np.nan
    quality = replace(whole.quality, samples=replace(measured, **{name: values}))
    failing = classify_failures(replace(whole, quality=quality), whole.tree, TOL).failing
    np.testing.assert_array_equal(failing, whole.quality.row == 7)


@pytest.mark.slow
def test_a_fit_that_passes_is_simplified_to_fewer_patches_that_pass_too() -> None:
    whole = ball_fit(share=0.1)
    assert not len(whole.bad_leaves)
    small = simplify_fit(whole)
    assert not len(small.bad_leaves)
    assert len(small.fit.patches) < 0.7 * len(whole.fit.patches)
    assert small.quality.distance.max() <= TOL
    assert small.quality.tangent_jump_deg.max() <= 0.01


@pytest.mark.slow
def test_a_fit_stays_where_nothing_simplified_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = ball_fit(share=0.1)
    tried = []

    def failing(*args: object) -> LevelSetFit:
        tried.append(args)
        return replace(whole, bad_leaves=np.unique(whole.mesh.leaf)[:3])

    monkeypatch.setattr(fit_simplification, "fit_level_set", failing)
    assert simplify_fit(whole) is whole
    assert 1 < len(tried) <= fit_simplification.MAX_REFITS


@pytest.mark.slow
@pytest.mark.parametrize(("part", "is_large", "fits"), [(0.3, True, 2), (0.5, True, 1), (0.5, False, 2)])
def test_a_simplification_of_which_many_patches_fail_is_given_up_in_large_fits(
    part: float, is_large: bool, fits: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = ball_fit(share=0.1)
    if is_large:
        monkeypatch.setattr(fit_simplification, "MIN_GAIN_PATCHES", len(whole.fit.patches) - 1)
    many = replace(
        whole,
        failing=np.arange(len(whole.failing)) < part * len(whole.failing),
        bad_leaves=np.unique(whole.mesh.leaf)[:3],
    )
    tried = []

    def fit_first_badly(*args: object) -> LevelSetFit:
        tried.append(args)
        return whole if len(tried) > 1 else many

    monkeypatch.setattr(fit_simplification, "fit_level_set", fit_first_badly)
    found = fit_simplification._simplify_once(whole, 1.0)
    assert found is (None if fits == 1 else whole)
    assert len(tried) == fits


@pytest.mark.slow
def test_polygons_come_back_where_patches_fail_and_stay_merged_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = ball_fit(share=0.1)
    at = int(np.argmax(whole.mesh.vertices[:, 0]))
    wanted = {p for p in polygons_of(whole.mesh) if tuple(whole.mesh.start_positions[at]) in p}
    misses = []

    def strict(*args: Any) -> LevelSetFit:
        made = fit_level_set(*args)
        misses.append(not wanted <= polygons_of(made.mesh))
        return replace(made, bad_leaves=whole.mesh.leaf[[at]]) if misses[-1] else made

    monkeypatch.setattr(fit_simplification, "fit_level_set", strict)
    small = simplify_fit(whole)
    assert misses[0]
    assert wanted <= polygons_of(small.mesh)
    assert len(small.fit.patches) < len(whole.fit.patches)


@pytest.mark.slow
def test_where_nothing_is_left_to_undo_near_a_failure_edits_farther_away_are_undone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = ball_fit(share=0.1)
    asked = []

    class Reluctant(EditHistory):
        def undo(self, numbers: Iterable[int], levels: int) -> bool:
            asked.append(levels)
            return levels > 3 and super().undo(numbers, levels)

    def missing(*args: Any) -> LevelSetFit:
        made = fit_level_set(*args)
        return replace(made, bad_leaves=np.unique(made.mesh.leaf)[:2]) if len(asked) < 4 else made

    monkeypatch.setattr(greedy_simplification, "EditHistory", Reluctant)
    monkeypatch.setattr(fit_simplification, "fit_level_set", missing)
    small = simplify_fit(whole)
    assert asked == [1, 2, 3, 4]
    assert len(small.fit.patches) < len(whole.fit.patches)


def test_periods_stay_alike() -> None:
    field = fields.rod(fields.tpms("gyroid", 10.0), -0.3)
    whole = ball_fit(share=0.1)
    periodic = replace(whole, request=replace(whole.request, field=field))
    assert simplify_fit(periodic) is periodic


@pytest.mark.slow
def test_triangles_with_a_side_on_the_box_leave_the_solid_closed() -> None:
    whole = ball_fit(share=0.1)
    mesh = whole.mesh
    polygons = PolygonMesh(mesh)
    on_box = [n for n, p in polygons.corners_of.items() if len(p) == 4 and polygons.box_sides([n])]
    for number in on_box[::2]:
        a, b, c, d = polygons.corners_of[number]
        polygons._remove(number)
        polygons._append((a, b, c))
        polygons._append((a, c, d))
    cut, _ = extract_mesh(polygons, mesh.vertices, mesh.size, sorted(polygons.corners_of))
    volumes = []
    for part in (mesh, cut):
        made = fit_level_set(whole.request, whole.tree, part)
        brep = assemble_field_brep([(made.network, made.fit)], [made.fixed], LO, HI, np.zeros((2, 2, 2), bool))
        assert is_closed(brep)
        volumes.append(measure_solid(brep).volume)
    assert len(cut.corners) > len(mesh.corners)
    assert abs(volumes[1] - volumes[0]) < 1e-5 * volumes[0]


def test_sides_on_the_box_that_leave_it_are_not_accepted() -> None:
    whole = ball_fit(share=0.1)
    net = whole.network
    side = np.flatnonzero(net.plane == 0)
    height = net.vertices[net.ends[side], 1].max(axis=1)
    curve, top = side[height.argmax()], height.max()
    for high, bad in ((top + 0.1, False), (top - 0.3 * TOL, True)):
        tree = replace(whole.tree, hi=np.array([HI[0], high, HI[2]]))
        coarse = classify_failures(whole, tree, TOL).inaccurate
        assert coarse[(net.curve == curve).any(axis=1)].any() == bad


@pytest.mark.parametrize(("part", "bad"), [(1e-4, True), (0.05, False)])
@pytest.mark.slow
def test_vertices_that_come_to_rest_on_others_are_bad(part: float, bad: bool) -> None:
    whole = ball_fit(share=0.1)
    mesh = whole.mesh
    side = int(np.flatnonzero(~mesh.fixed[mesh.side_ends].any(axis=(1, 2)))[0])
    a, b = mesh.side_ends[side]
    vertices = mesh.vertices.copy()
    vertices[a] = project_to_level_set(
        BALL,
        (vertices[b] + part * mesh.size[[a, b]].min() * normalize(vertices[a] - vertices[b]))[None],
        np.zeros((1, 3), bool),
        mesh.size[[a]],
    )
    made = fit_level_set(whole.request, whole.tree, replace(mesh, vertices=vertices))
    assert ("without length" in made.failure_text) == bad
    assert not bad or np.isin(mesh.leaf[[a, b]], made.bad_leaves).all()
    normals = normalize(BALL.gradient(vertices))
    assert (
        corner_distortion(vertices, normals, mesh.fixed, mesh.corners[(mesh.corners == a).any(axis=1)]).max() > 9
    ) == bad


@pytest.mark.parametrize("known", [True, False])
def test_patches_that_failed_before_are_fitted_again_and_the_others_reused(known: bool) -> None:
    whole = ball_fit(share=0.1)
    at = int(np.flatnonzero((whole.network.corners >= 0).all(axis=1))[7])
    patches = [p.copy() for p in whole.fit.patches]
    patches[at][1:-1, 1:-1] += 0.1
    wrong = np.zeros(len(patches), bool)
    wrong[at] = known
    spoilt = replace(whole, fit=replace(whole.fit, patches=patches), failing=wrong)
    again = fit_level_set(whole.request, whole.tree, whole.mesh, spoilt)
    assert np.allclose(again.fit.patches[at], whole.fit.patches[at], atol=1e-9) == known
    same = sum(a is b for a, b in zip(again.fit.patches, patches, strict=True))
    assert len(patches) - 20 < same <= len(patches) - known


def test_patches_between_sides_of_different_degrees_have_one_degree_both_ways() -> None:
    """Of degrees 9 and 5 they fold."""
    whole = ball_fit(share=0.1)
    fit = whole.fit
    at = int(np.flatnonzero((whole.network.piece == 0).all(axis=1))[3])
    degree = np.full(len(fit.curves), 5)
    degree[whole.network.curve[at, 0]] = 9
    anew = WarmStart(fit, np.ones(len(fit.curves), bool), np.ones(len(fit.patches), bool))
    again = fit_network(whole.network, whole.request.field, degree, np.full(len(fit.patches), 5), anew)
    assert again.patches[at].shape[:2] == (10, 10)
    raised = (whole.network.curve == whole.network.curve[at, 0]).any(axis=1)
    assert {p.shape[:2] for p, high in zip(again.patches, raised, strict=True) if not high} == {(6, 6)}
