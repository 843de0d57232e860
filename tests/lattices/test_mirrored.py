"""Pieces between mirrors: they meet their tolerance and their reflections, and close into the solids that theory gives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from tests.trimming.network_operands import trim
from tpmscad import fields, surfaces, topology
from tpmscad.brep import connectivity
from tpmscad.brep.edge_continuity import measure_edge_continuity
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.lattices.copies import reflected_pieces_over_box
from tpmscad.lattices.harmonic_chart import compute_harmonic_chart
from tpmscad.lattices.mirror_fit import PIECE_DEGREES, fit_mirror_piece, fit_mirror_pieces, measure_mirror_deviation
from tpmscad.sources.catalogue_sources import lattice_source
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.knots import restrict_surface
from tpmscad.trimming.operands.polyhedra import box

NAMES = ("iwp", "neovius", "frd")
OFFSETS = {"iwp": (-0.04, 0.03), "neovius": (-0.02, 0.03), "frd": (0.01, 0.035)}
STILL = np.zeros(3)
SIDES = [(0, slice(None)), (-1, slice(None)), (slice(None), 0), (slice(None), -1)]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_chart_is_conformal(name: str) -> None:
    """Dirichlet's energy of a map is its area if, and only if, the map is conformal; it is never less."""
    form = compute_harmonic_chart(name)
    assert form.distortion == pytest.approx(1, abs=1e-6)
    t = np.linspace(0, 1, 9)
    u, v = (g.ravel() for g in np.meshgrid(t, t))
    tangents = np.stack([form.patch(u, v, 1, 0), form.patch(u, v, 0, 1)], axis=-1)
    metric = np.swapaxes(tangents, 1, 2) @ tangents
    wanted = np.linalg.inv(form.quadrilateral.dirichlet_tensor(u, v))
    np.testing.assert_allclose(metric / np.sqrt(np.linalg.det(metric))[:, None, None], wanted, rtol=0, atol=2e-2)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("tol", [1e-3, 1e-4])
def test_a_piece_is_as_near_to_its_offset_surface_as_it_says(name: str, tol: float) -> None:
    """Distances by constrained minimisation on the formula as the fields read it."""
    offset = OFFSETS[name][1]
    piece = fit_mirror_piece(name, offset, tol)
    assert piece.deviation.max <= tol
    field = fields.tpms(name, 1.0)
    for u, v in np.random.default_rng(2).random((6, 2)):
        point = piece.patch(u, v)
        slope = field.gradient(point)
        start = point - offset * slope / np.linalg.norm(slope)
        found = minimize(
            lambda p, point=point: ((p - point) ** 2).sum(),
            start,
            jac=lambda p, point=point: 2 * (p - point),
            method="SLSQP",
            constraints={"type": "eq", "fun": field, "jac": field.gradient},
            options={"ftol": 1e-15, "maxiter": 100},
        )
        assert abs(np.sqrt(found.fun) - offset) <= piece.deviation.max + 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("name", ["iwp", *(pytest.param(name, marks=pytest.mark.slow) for name in NAMES[1:])])
def test_a_piece_of_a_lower_degree_misses(name: str) -> None:
    piece = fit_mirror_piece(name, OFFSETS[name][0], 1e-4)
    closer = fit_mirror_piece(name, OFFSETS[name][0], 0.9 * piece.deviation.max)
    assert PIECE_DEGREES[0] <= piece.degree < closer.degree


@pytest.mark.slow
def test_the_measured_deviation_sees_a_shift_a_dent_and_a_fold() -> None:
    mirrors = surfaces.mirror_symmetry("iwp")
    patch = fit_mirror_piece("iwp", 0.0, 1e-5).patch
    assert measure_mirror_deviation(mirrors, patch, 0.0).max < 1e-5
    assert measure_mirror_deviation(mirrors, patch, 2e-3).max == pytest.approx(2e-3, rel=1e-2)
    dented = patch.poles.copy()
    dented[4, 5] += 0.03 * mirrors.waves.gradient(patch(0.45, 0.55)) / 30
    far = measure_mirror_deviation(
        mirrors, BSplineSurface(dented, patch.knots_u, patch.knots_v, patch.degree_u, patch.degree_v), 0.0
    )
    assert far.to_reference > 1e-4
    assert far.from_reference == pytest.approx(far.to_reference, rel=0.05)
    # Half of the piece lies on the surface, but leaves the other half bare.
    short = restrict_surface(patch, (0.0, 0.5), (0.0, 1.0))
    unit = BSplineSurface(short.poles, patch.knots_u, patch.knots_v, patch.degree_u, patch.degree_v)
    bare = measure_mirror_deviation(mirrors, unit, 0.0)
    assert bare.to_reference < 1e-5
    assert bare.from_reference > 0.05
    there_and_back = (patch.poles + patch.poles[::-1]) / 2
    folded = BSplineSurface(there_and_back, patch.knots_u, patch.knots_v, patch.degree_u, patch.degree_v)
    assert np.isinf(measure_mirror_deviation(mirrors, folded, 0.0).max)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.slow
def test_borders_lie_in_the_mirrors_poles_and_all(name: str) -> None:
    mirrors = surfaces.mirror_symmetry(name)
    patch = fit_mirror_piece(name, OFFSETS[name][0], 1e-4).patch
    for side, normal, offset in zip(
        [SIDES[2], SIDES[1], SIDES[3], SIDES[0]], mirrors.wall_normals, mirrors.wall_offsets, strict=True
    ):
        np.testing.assert_allclose(patch.poles[side] @ normal, offset, rtol=0, atol=2e-16)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.slow
def test_pieces_meet_with_continuous_curvature_at_every_edge_and_vertex(name: str) -> None:
    sheet = fit_mirror_pieces(name, OFFSETS[name], 1.0, 1e-4).surfaces
    found = measure_edge_continuity(
        reflected_pieces_over_box(surfaces.mirror_symmetry(name), sheet, (1, 1, 1), np.array([0.2, 0.3, 0.4])),
        ("offset+", "offset-"),
    )
    assert found.gap < 1e-13
    assert found.tangent_jump_deg < 1e-7
    assert found.curvature_jump < 1e-8
    assert found.n_classes >= 8


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("cells", "phase"), [((1, 1, 1), (0, 0, 0)), ((2, 1, 1), (0.5, 1.0, -0.5))])
def test_a_box_of_mirrors_is_capped_without_a_cut(
    name: str, cells: tuple[int, int, int], phase: tuple[float, float, float]
) -> None:
    fit = lattice_source(name, "nodal").fit(OFFSETS[name], 1.0, 1e-4)
    cover = reflected_pieces_over_box(surfaces.mirror_symmetry(name), fit.surfaces, cells, np.array(phase))
    assert len(cover.faces) == 2 * surfaces.CATALOGUE[name].patches_per_cell * np.prod(cells)
    box_of = np.array([cover.vertices.min(axis=0), cover.vertices.max(axis=0)])
    np.testing.assert_allclose(box_of, [[0, 0, 0], cells], rtol=0, atol=1e-13)
    cut = trim(cover, box([0, 0, 0], cells), tol=1e-9)
    assert cut.report.arcs == 0
    assert cut.report.max_deviation < 1e-13
    assert connectivity.is_closed(cut.brep)
    expected = surfaces.volume_fraction(name, "nodal", *OFFSETS[name]) * np.prod(cells)
    assert measure_solid(cut.brep).volume == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.slow
def test_the_natural_boundary_is_the_block_between_mirrors_wherever_it_is(name: str) -> None:
    sheet = fit_mirror_pieces(name, OFFSETS[name], 1.0, 1e-3).surfaces
    phase = np.array([0.1, -0.7, 3.3])
    block = reflected_pieces_over_box(surfaces.mirror_symmetry(name), sheet, (1, 1, 2), phase, natural=True)
    np.testing.assert_allclose(block.vertices.min(axis=0), phase, rtol=0, atol=1e-12)
    np.testing.assert_allclose(block.vertices.max(axis=0), phase + np.array([1, 1, 2]), rtol=0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("side", ["-", "+"])
def test_the_two_sides_have_the_betti_numbers_of_the_formula(name: str, side: str) -> None:
    sheet = fit_mirror_pieces(name, (0.0, None) if side == "+" else (None, 0.0), 1.0, 1e-3).surfaces
    solid = trim(
        reflected_pieces_over_box(surfaces.mirror_symmetry(name), sheet, (1, 1, 1), STILL),
        box([0, 0, 0], [1, 1, 1]),
        tol=1e-9,
    )
    t = np.linspace(0, 1, 49)
    field = fields.tpms(name, 1.0)
    sampled = topology.betti((1 if side == "-" else -1) * field.on_grid(t, t, t))
    assert measure_solid(solid.brep).betti == (sampled.b0, sampled.b1, sampled.b2)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_box_anywhere_is_closed_with_the_volume_of_its_cell(name: str) -> None:
    rng = np.random.default_rng(8)
    expected = surfaces.volume_fraction(name, "nodal", *OFFSETS[name])
    for tol in (1e-3, 1e-5):
        sheet = fit_mirror_pieces(name, OFFSETS[name], 1.0, tol).surfaces
        cover = reflected_pieces_over_box(surfaces.mirror_symmetry(name), sheet, (1, 1, 1), rng.random(3))
        cut = trim(cover, box([0, 0, 0], [1, 1, 1]), tol=5e-10)
        assert connectivity.is_closed(cut.brep)
        assert measure_solid(cut.brep).volume == pytest.approx(expected, rel=30 * tol)
