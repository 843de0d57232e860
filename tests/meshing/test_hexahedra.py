"""Hexahedra of a wall straight from its trivariate splines: they fill the solid, share nodes, repeat, and can be read."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tests.meshing.mesh_facets import boundary_facets
from tests.trimming.network_operands import trim
from tpmscad import InvalidRequest
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.lattices.spline_volumes import SplineVolumes
from tpmscad.meshing.hexahedra import mesh_hexahedra, place_nodes, space_parameters
from tpmscad.sources.catalogue_sources import lattice_source
from tpmscad.splines.jacobian_bounds import bound_jacobian
from tpmscad.studies.hexahedral_meshing import fill_with_splines, mesh_by_splines
from tpmscad.trimming.operands.polyhedra import box

LAYERS = (-0.035, 0.02)  # of unequal size, so that lower and upper cannot be exchanged
CASES = [("gyroid", (2, 1, 1)), ("diamond", (1, 1, 1)), ("schwarz_p", (1, 1, 1))]
MIRRORED = [("iwp", (1, 1, 1)), ("neovius", (1, 1, 1)), ("frd", (1, 1, 1))]
SLOW = [pytest.param(*case, marks=pytest.mark.slow) for case in (*CASES[1:], *MIRRORED[1:])]
ALL = [CASES[0], MIRRORED[0], *SLOW]


@cache
def make(name: str, cells: tuple[int, int, int]) -> tuple[SplineVolumes, float]:
    """The trivariate splines of a lattice in cells, and the volume inside its boundary representation."""
    source = lattice_source(name, "nodal" if (name, cells) in MIRRORED else "minimal")
    sheet = source.fit(LAYERS, 1.0, 1e-3).surfaces
    assembly = source.natural(sheet, cells, np.zeros(3))
    brep = assembly.brep
    if assembly.trim_corner is not None:
        brep = trim(brep, box(np.zeros(3), np.array(cells, float)), 5e-10).brep
    volumes = source.fill(sheet, cells, np.zeros(3), natural=True)
    assert volumes is not None
    return volumes, measure_solid(brep).volume


@pytest.mark.parametrize(("name", "cells"), ALL)
@pytest.mark.slow
def test_the_splines_fill_the_solid_and_are_regular(name: str, cells: tuple[int, int, int]) -> None:
    volumes, volume = make(name, cells)
    assert volumes.integrate_volume() == pytest.approx(volume, rel=1e-11)
    for body in volumes.right_handed_primitives():
        assert bound_jacobian(body.bezier_nets()).positive
    assert all(volumes.body(i).integrate_volume() > 0 for i in range(len(volumes)))


@pytest.mark.parametrize(("name", "cells"), ALL)
def test_neighbours_share_nodes_and_the_mesh_closes(name: str, cells: tuple[int, int, int]) -> None:
    volumes, volume = make(name, cells)
    assert place_nodes(volumes, 4, 2).mismatch < 1e-11
    mesh = mesh_hexahedra(volumes, 2, (1, 0))
    points = np.unique(np.round(mesh.points, 9), axis=0)
    assert len(points) == len(mesh.points)  # no two nodes in one place
    assert mesh.volume == pytest.approx(volume, rel=1e-2)
    assert mesh.quality.inverted == 0
    (boundary,) = boundary_facets(mesh.cells).values()
    (facets,) = mesh.facets.values()
    assert {tuple(row) for row in np.sort(boundary, axis=1).tolist()} == {
        tuple(row) for row in np.sort(facets, axis=1).tolist()
    }
    inside = mesh.points[facets]
    normal = np.cross(inside[:, 2] - inside[:, 0], inside[:, 3] - inside[:, 1])
    assert np.abs(normal.sum(axis=0)).max() < 0.05 * np.abs(normal).sum()


@pytest.mark.parametrize(("name", "cells"), ALL)
def test_translates_are_tied_and_the_repeated_solid_has_no_border(name: str, cells: tuple[int, int, int]) -> None:
    volumes, _ = make(name, cells)
    mesh = mesh_hexahedra(volumes, 2, (1, 0))
    assert mesh.mismatch < 1e-11
    repeated, shift = mesh.periodic_ties()
    np.testing.assert_allclose(mesh.points, mesh.points[repeated] + shift * np.array(cells), atol=1e-11)
    (kind,) = mesh.cells
    (boundary,) = boundary_facets({kind: repeated[mesh.cells[kind]]}).values()
    assert len(boundary) == 2 * 4 * len(volumes)  # the two surfaces, four facets for each body


def test_parameters_are_spaced_by_length_and_fit_together() -> None:
    for case, symmetric in ((CASES[0], True), (MIRRORED[0], False)):
        volumes, _ = make(*case)
        u, v = space_parameters(volumes, volumes.connect(), 4)
        assert (u[0], u[-1], v[0], v[-1]) == (0, 1, 0, 1)
        assert (np.abs(u + u[::-1] - 1).max() < 1e-14) or not symmetric
        line = volumes.primitives[0].grid(u, np.linspace(0, 1, 33), [0.5])[:, :, 0]
        lengths = np.linalg.norm(np.diff(line, axis=0), axis=-1).mean(axis=1)
        assert lengths.max() < 1.15 * lengths.min()  # chords of a curved line


@pytest.mark.slow
def test_refined_quadratic_hexahedra_tend_to_the_volume_of_the_splines() -> None:
    volumes, volume = make(*CASES[0])
    coarse, fine = (abs(mesh_hexahedra(volumes, 2, (n, 0)).volume / volume - 1) for n in (3, 7))
    assert coarse < 3e-4
    assert fine < coarse / 6


@pytest.mark.parametrize(("order", "serendipity", "kind"), [(1, False, 8), (2, True, 20), (2, False, 27)])
@pytest.mark.slow
def test_every_kind_of_element_has_its_nodes_and_its_count(order: int, serendipity: bool, kind: int) -> None:
    volumes, volume = make(*CASES[0])
    mesh = mesh_by_splines(lambda: volumes, "gyroid", order, (3, 1), serendipity)
    (nodes,) = mesh.cells.values()
    assert nodes.shape == (48 * 16 * 2, kind)
    assert len(np.unique(nodes)) == len(mesh.points)
    assert mesh.volume == pytest.approx(volume, rel=3e-2)
    assert set(mesh.facet_groups) == {"surface +", "surface -", "gap"}


def test_caps_lie_in_the_planes_that_name_them() -> None:
    volumes, _ = make(*MIRRORED[0])
    mesh = mesh_hexahedra(volumes, 2, (1, 0))
    sets = mesh.node_sets
    for axis, letter in enumerate("XYZ"):
        for sign, level in (("-", 0.0), ("+", 1.0)):
            assert np.abs(mesh.points[sets[f"cap {letter}{sign}"], axis] - level).max() < 1e-12


def test_walls_that_fold_coarse_elements_and_other_solids_are_refused() -> None:
    volumes, _ = make(*CASES[0])
    with pytest.raises(InvalidRequest, match=r'boundary="natural"'):
        fill_with_splines(None, "gyroid sheet")
    with pytest.raises(InvalidRequest, match="refine 1 times"):
        mesh_by_splines(lambda: volumes, "gyroid", 1, (0, 0), False)
    with pytest.raises(InvalidRequest, match="order = 3"):
        mesh_by_splines(lambda: volumes, "gyroid", 3, (0, 0), False)
    with pytest.raises(InvalidRequest, match="serendipity"):
        mesh_by_splines(lambda: volumes, "gyroid", 1, (0, 0), True)
    with pytest.raises(InvalidRequest, match="refine less"):
        mesh_by_splines(lambda: volumes, "gyroid", 2, (999, 9), False)
    body = volumes.primitives[0]
    poles = body.poles.copy()
    poles[2:4, 2:4] += 3.0 * (poles[2:4, 2:4] - poles[:1, :1])
    folded = SplineVolumes(
        (type(body)(poles, body.knots, body.degrees),), volumes.carrier, volumes.motion, volumes.sense, (0, 0, 0), "gap"
    )
    with pytest.raises(InvalidRequest, match=r"folds near \("):
        fill_with_splines(lambda: folded, "gyroid sheet")


def test_splinepy_joins_the_same_sides_and_evaluates_the_same_points() -> None:
    """As the guide has it: what a program of isogeometric analysis makes of the bodies, those placed by mirrors among them."""
    splinepy = pytest.importorskip("splinepy")
    for name, cells in (CASES[0], MIRRORED[0]):
        volumes, _ = make(name, cells)
        bodies = [volumes.body(i) for i in range(len(volumes))]
        walls = splinepy.Multipatch(
            [splinepy.BSpline(b.degrees, b.knots, b.poles.transpose(2, 1, 0, 3).reshape(-1, 3)) for b in bodies]
        )
        walls.determine_interfaces(tolerance=1e-8)
        assert np.count_nonzero(walls.interfaces >= 0) == np.count_nonzero(~volumes.connect().is_open)
        at = np.random.default_rng(0).random((4, 3))
        for patch, body in zip(walls.patches, bodies, strict=True):
            wanted = [body.grid(*p[:, None])[0, 0, 0] for p in at]
            np.testing.assert_allclose(patch.evaluate(at), wanted, atol=1e-13)
