"""Smallest walls and gaps are bounded from below and attained, on bodies whose widths are known: none is overlooked."""

from __future__ import annotations

from typing import Any

import build123d as bd
import numpy as np
import pytest
from OCP.BRep import BRep_Tool
from OCP.GeomAPI import GeomAPI_ProjectPointOnSurf
from OCP.gp import gp_Pnt
from OCP.TopoDS import TopoDS_Face
from scipy.spatial import cKDTree

import tpmscad
from tpmscad import fields
from tpmscad.brep import least_width
from tpmscad.brep.least_width import RESOLUTION, LeastWidth, SharpEdges, _Search
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.measure.shape_sampling import find_creases
from tpmscad.kernel.occt.exploration import faces_of, require_shape
from tpmscad.kernel.printability.face_cells import face_cells
from tpmscad.kernel.printability.least_widths import _refine, measure_least_widths

pytestmark = pytest.mark.kernel

TILT = bd.Rot(20, 30, 40)
FIELD_TOL = 0.002


def widths(shape: Any) -> tuple[LeastWidth | None, LeastWidth | None]:
    topods = require_shape(shape)
    return measure_least_widths(topods, check_shape(topods))


def assert_is(found: LeastWidth | None, truth: float, tol: float = 1e-6) -> None:
    assert found is not None
    assert found.bound <= truth + tol
    assert found.bound >= (1.0 - 1.5 * RESOLUTION) * truth - tol
    assert found.value == pytest.approx(truth, abs=tol)
    assert np.linalg.norm(found.places[1] - found.places[0]) == pytest.approx(found.value)


def parameters_at(face: TopoDS_Face, point: np.ndarray) -> tuple[float, float]:
    u, v = GeomAPI_ProjectPointOnSurf(gp_Pnt(*point), BRep_Tool.Surface_s(face)).LowerDistanceParameters()
    return u, v


def field_with_voids(*voids: fields.Field) -> Any:
    return tpmscad.solidify(fields.complement(fields.union(*voids)), ((0, 0, 0), (12, 8, 8)), tol=FIELD_TOL).wrapped


def test_the_wall_between_two_voids_of_a_field_is_found() -> None:
    """The voids come nearest at a corner where several patches of each meet."""
    found, _ = widths(field_with_voids(fields.sphere((4, 4, 4), 2.0), fields.sphere((8.05, 4, 4), 2.0)))
    assert_is(found, 0.05, 2 * FIELD_TOL)


@pytest.mark.parametrize("wall", [0.1, 0.8])
@pytest.mark.parametrize("placement", [bd.Pos(0, 0, 0), TILT], ids=["straight", "rotated"])
def test_the_wall_over_a_void_below_a_flat_side_is_found(wall: float, placement: bd.Location) -> None:
    found, gap = widths(placement * (bd.Box(10, 10, 10) - bd.Pos(0, 0, 4 - wall) * bd.Sphere(1)))
    assert_is(found, wall)
    assert_is(gap, 2.0)


def test_a_search_that_is_given_up_bounds_the_least_width_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(least_width, "MAX_PAIRS", 0)
    found, gap = widths(bd.Box(10, 10, 10) - bd.Pos(0, 0, 3.2) * bd.Sphere(1))
    for each, truth in ((found, 0.8), (gap, 2.0)):
        assert each is not None
        assert 0 <= each.bound <= truth
        assert each.value > each.bound
        assert np.linalg.norm(each.places[1] - each.places[0]) == pytest.approx(each.value)


def test_a_wall_is_found_behind_any_number_of_pairs_with_lower_bounds() -> None:
    """Pairs of cells that no normal joins may have the least bounds: the value must fall all the same, or the search swells."""
    shape = require_shape(bd.Box(10, 10, 1))
    report, faces = check_shape(shape), faces_of(shape)
    creases = find_creases(faces, 0.1)
    edges = SharpEdges(creases.points, np.sort(creases.smooth_group[creases.faces], axis=1), 0.1)
    cells = face_cells(faces, 0.01 * report.volume / report.area)
    for _ in range(4):
        cells, _ = cells.bisect(np.ones(len(cells), bool))
    search = _Search(cells, -1.0, creases.smooth_group, np.zeros(len(faces), int), edges, cKDTree(edges.points))
    search.value = 16.0
    top, below = (np.flatnonzero(search.axis[:, 2] * sign > 0.99) for sign in (1.0, -1.0))
    one = top[np.argmin(np.linalg.norm(search.center[top, :2], axis=1))]
    other = top[np.argmax(np.linalg.norm(search.center[top] - search.center[one], axis=1))]
    opposite = below[np.argmin(np.linalg.norm(search.center[below] - search.center[one], axis=1))]
    pairs = np.array([[one, other]] * 40_000 + [[opposite, one]])
    search._attain(pairs, np.append(np.zeros(40_000), 0.9))
    assert search.value == pytest.approx(1.0)


def limit_pairs(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    """Have the search fail where it is left with more pairs of cells."""
    select = _Search._select_pairs

    def select_few(search: _Search, *asked: Any) -> Any:
        found = select(search, *asked)
        assert len(found[0]) < most
        return found

    monkeypatch.setattr(_Search, "_select_pairs", select_few)


@pytest.mark.slow
def test_the_gap_between_trimmed_edges_of_two_solids_does_not_swell_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it is least, both sides are trimmed: the nearest places of their cells lie beyond the edges and attain nothing."""
    model = tpmscad.lattice(
        "P", cell=(7.0443, 8.7752, 7.3626), thickness=0.181, phase=(-0.596, -0.778, 0.776), tol=0.05
    )
    assert len(model.certificate.pieces) > 1
    limit_pairs(monkeypatch, 200_000)
    _, gap = widths(model.wrapped)
    assert gap is not None
    assert gap.bound > (1.0 - 1.5 * RESOLUTION) * gap.value


def test_places_from_which_newton_goes_to_another_width_are_as_far_apart_as_stated() -> None:
    """A place 0.25 rad beside the one of a ball that is nearest to a plane, which Newton's method finds."""
    ball, block = faces_of(require_shape(bd.Sphere(5)))[0], faces_of(require_shape(bd.Pos(7, 0, 0) * bd.Box(2, 20, 20)))
    plane = next(face for face in block if abs(bd.Face(face).center().X - 6) < 1e-9)
    place, foot = 5 * np.array([np.cos(0.25), 0, np.sin(0.25)]), np.array([6, 0, 5 * np.sin(0.25)])
    parameters = np.array([parameters_at(face, at) for face, at in ((ball, place), (plane, foot))])
    stated = LeastWidth(1.3, 1.001 * (6 - place[0]), np.stack([place, foot]), (0, 1), parameters)
    found = _refine([ball, plane], stated)
    assert found.value == pytest.approx(6 - place[0], rel=1e-12)
    assert np.linalg.norm(found.places[1] - found.places[0]) == pytest.approx(found.value, rel=1e-12)


def test_a_tube_has_its_wall_and_its_bore() -> None:
    wall, gap = widths(TILT * (bd.Cylinder(3, 10) - bd.Cylinder(2.5, 10)))
    assert_is(wall, 0.5)
    assert_is(gap, 5.0)


def test_the_least_width_of_a_tapered_wall_is_at_its_end() -> None:
    wall, _ = widths(bd.extrude(bd.Polygon((0, 0), (20, 0), (20, 1.3), (0, 0.3), align=None), 10))
    assert_is(wall, 0.3, 0.001)


def test_a_sharp_wedge_has_no_wall() -> None:
    wall, gap = widths(bd.extrude(bd.Polygon((0, 0), (30, 0), (30, 3), align=None), 10))
    assert wall is None
    assert gap is None


@pytest.mark.slow
def test_a_sheet_that_ends_in_whole_patches_is_as_thick_as_asked() -> None:
    wall, _ = widths(tpmscad.lattice("gyroid", cell=10, thickness=0.4, boundary="natural", tol=FIELD_TOL).wrapped)
    assert_is(wall, 0.4, FIELD_TOL)


@pytest.mark.slow
def test_the_narrowest_place_at_an_edge_needs_no_exact_normal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nowhere is the segment exactly along a normal, only within what counts as straight: pairs must not be divided for ever."""
    limit_pairs(monkeypatch, 100_000)
    _, gap = widths(tpmscad.lattice("iwp", cell=100, cells=(1, 1, 1), offset=(-1.8392, 0.5952), tol=0.866))
    assert gap is not None
    assert 0.98 * gap.value <= gap.bound <= gap.value
