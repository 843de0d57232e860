"""Lattices of whole patches: closed, of the volume that theory gives, smooth over every joint."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tpmscad import surfaces
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import scale_brep, select_faces
from tpmscad.brep.edge_continuity import measure_edge_continuity
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.lattices import copies
from tpmscad.lattices.cell_block import build_incidence, choose_manifold_block
from tpmscad.lattices.primitive import fit_offset_surfaces

SURFACES = ("gyroid", "diamond", "schwarz_p")
OFFSETS = {"gyroid": (-0.05, 0.08), "diamond": (-0.07, 0.07), "schwarz_p": (0.02, 0.11)}
STILL = np.zeros(3)


@cache
def sheet(name: str) -> copies.OffsetSurfaces:
    return fit_offset_surfaces(name, "minimal", OFFSETS[name], 1.0, 1e-3).surfaces


@cache
def block(name: str, cells: tuple[int, int, int]) -> copies.Brep:
    return copies.build_natural_lattice(
        surfaces.patch_symmetry(name), sheet(name), copies.place_whole_cells(name, cells, STILL)
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("cells", [(1, 1, 1), (1, 2, 1), (3, 2, 1), (3, 3, 3)])
def test_every_block_of_cells_is_one_closed_shell(name: str, cells: tuple[int, int, int]) -> None:
    brep = block(name, cells)
    assert connectivity.is_closed(brep)
    assert connectivity.label_shells(brep)[0] == 1


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("cells", [(1, 1, 1), (2, 1, 3)])
@pytest.mark.slow
def test_the_volume_per_cell_is_the_swept_one_whatever_the_block(name: str, cells: tuple[int, int, int]) -> None:
    expected = surfaces.volume_fraction(name, "minimal", *OFFSETS[name]) * np.prod(cells)
    # The gap faces are ruled between borders that lie on normals: what is left is the fit's error, 4e-5 here and 1e-6 at a tenth
    # of the tolerance.
    assert measure_solid(block(name, cells)).volume == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("name", SURFACES)
def test_offset_faces_join_with_continuous_curvature_at_every_edge_and_vertex(name: str) -> None:
    found = measure_edge_continuity(block(name, (2, 2, 1)), ("offset+", "offset-"))
    assert found.gap < 1e-12
    assert found.tangent_jump_deg < 1e-8
    assert found.curvature_jump < 1e-8
    assert found.n_classes >= 4


@pytest.mark.slow
@pytest.mark.parametrize("name", SURFACES)
def test_opposite_offsets_share_one_primitive_and_unequal_ones_do_not(name: str) -> None:
    assert len(fit_offset_surfaces(name, "minimal", (-0.06, 0.06), 1.0, 1e-3).surfaces.primitives) == 1
    assert len(fit_offset_surfaces(name, "minimal", (-0.06, OFFSETS[name][1]), 1.0, 1e-3).surfaces.primitives) == 2


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("reference", ["minimal", "nodal"])
@pytest.mark.slow
def test_a_fit_meets_its_tolerance_and_one_pole_row_less_does_not(name: str, reference: str) -> None:
    from tpmscad.lattices.primitive import fit_primitive

    fit = fit_primitive(name, reference, 0.06, 1e-3)
    assert fit.converged
    assert fit.deviation <= 1e-3
    smaller = [deviation for degree, deviation in fit.trials.items() if degree < fit.degree]
    assert smaller
    assert min(smaller) > 1e-3


def test_a_phase_moves_the_block_and_scaling_scales_it() -> None:
    name, phase = "gyroid", np.array([0.2, -0.7, 0.1])
    motions = surfaces.patch_symmetry(name)
    still = measure_solid(block(name, (1, 1, 1)))
    moved = copies.build_natural_lattice(motions, sheet(name), copies.place_whole_cells(name, (1, 1, 1), phase))
    large = measure_solid(scale_brep(moved, 7.0))
    assert large.volume == pytest.approx(343 * still.volume, rel=1e-12)
    assert large.area == pytest.approx(49 * still.area, rel=1e-12)
    np.testing.assert_allclose(large.centroid, 7 * (np.array(still.centroid) + phase), rtol=0, atol=1e-10)
    assert large.betti == still.betti


@pytest.mark.parametrize("name", SURFACES)
def test_patches_that_cover_a_box_close_over_its_inside(name: str) -> None:
    cells, phase = (2, 1, 1), np.array([0.13, 0.21, -0.34])
    brep = copies.patches_over_box(surfaces.patch_symmetry(name), sheet(name), cells, phase)
    middles = (brep.vertices[brep.edges.start] + brep.vertices[brep.edges.end]) / 2
    open_edges = np.bincount(brep.uses.edge, minlength=len(brep.edges)) == 1
    # Chords of open edges stay near their curves; none may come well inside the box.
    inside = ((middles > 0.15) & (middles < np.array(cells) - 0.15)).all(axis=1)
    assert open_edges.any()
    assert not (open_edges & inside).any()


def test_schwarz_p_is_quartered_where_its_mirrors_are_the_box_and_only_there() -> None:
    motions = surfaces.patch_symmetry("schwarz_p")
    on = copies.patches_over_box(motions, sheet("schwarz_p"), (1, 1, 1), np.array([0.5, 0.0, 1.0]))
    off = copies.patches_over_box(motions, sheet("schwarz_p"), (1, 1, 1), np.array([0.1, 0.2, 0.3]))
    assert len(on.carriers) == 4 * len(off.carriers)
    middles = on.faces.motion.apply(np.stack([on.carriers[c](0.5, 0.5) for c in on.faces.carrier]))  # type: ignore[operator]
    within = np.flatnonzero(((middles > 0) & (middles < 1)).all(axis=1))  # others end in the planes from outside
    assert len(within) == 2 * 48
    inner = select_faces(on, within)
    box = np.array([inner.vertices.min(axis=0), inner.vertices.max(axis=0)])
    np.testing.assert_allclose(box, [[0, 0, 0], [1, 1, 1]], rtol=0, atol=1e-12)


@pytest.mark.parametrize("cells", [(1, 1, 1), (4, 3, 2), (5, 5, 5)])
@pytest.mark.slow
def test_a_block_takes_each_patch_class_once(cells: tuple[int, int, int]) -> None:
    motions = surfaces.patch_symmetry("gyroid")
    corners = surfaces.primitive_patch("gyroid").jet(*copies.UNIT_SQUARE_CORNERS.T).position
    placed = [motions.cell_motions[:, None].apply(p) for p in (motions.side_middles, corners)]
    chosen = np.array(choose_manifold_block(build_incidence(*placed), cells))
    classes = np.column_stack([chosen[:, 0], np.mod(chosen[:, 1:], cells)])
    assert len(np.unique(classes, axis=0)) == len(chosen) == 24 * np.prod(cells)
