"""Lattices trimmed by boxes are closed, agree with volumes from theory, periodicity and additivity, and fit their carriers."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.shapes.misfits import misfit, volume
from tests.trimming.network_operands import trim
from tpmscad import surfaces
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import InvalidRequest, NothingLeft, TrimmingError
from tpmscad.trimming.operands.polyhedra import box

CELL = 10.0
TOL = 1e-7
SHEET, SKEW, SKELETAL, OFF_SKELETAL = (-0.05, 0.05), (-0.03, 0.08), (None, 0.0), (None, 0.05)
NAMES = ("gyroid", "diamond", "schwarz_p")
AT_HOME = (0.0, 0.0, 0.0)


def trim_box(lattice: Brep, lo: np.ndarray, hi: np.ndarray, tol: float = TOL) -> Brep:
    """The boundary representation of the lattice in the box from lo to hi."""
    return trim(lattice, box(lo, hi), tol).brep


def theory(name: str, layers: tuple[float | None, float | None]) -> float:
    """Volume of one cell from sheet theory, model units cubed."""
    lower, upper = layers
    if lower is None:
        assert upper is not None
        return CELL**3 * surfaces.skeletal_volume_fraction(name, "minimal", upper, "-")
    assert upper is not None
    return CELL**3 * surfaces.volume_fraction(name, "minimal", lower, upper)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "layers"),
    [
        ("schwarz_p", SKELETAL),
        ("gyroid", SKEW),
        ("diamond", OFF_SKELETAL),
    ],
)
def test_a_box_of_one_cell_has_the_volume_of_theory_wherever_it_stands(
    name: str, layers: tuple[float | None, float | None], cover: Callable[..., Brep]
) -> None:
    rng = np.random.default_rng(sum(map(ord, name)))
    lattice = cover(name, (2, 2, 2), AT_HOME, layers)
    volumes = []
    for _ in range(2):
        lo = rng.uniform(0, CELL, 3)
        trimmed = trim(lattice, box(lo, lo + CELL), TOL)
        assert trimmed.report.shifted == 0
        assert connectivity.is_closed(trimmed.brep)
        volumes.append(volume(trimmed.brep))
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-8)
    assert volumes[0] == pytest.approx(theory(name, layers), rel=3e-5)  # accuracy of the fit of degree 9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "layers", "phase"),
    [
        ("gyroid", SKELETAL, AT_HOME),
        ("diamond", SKELETAL, (0.25, 0.25, 0.25)),
        ("schwarz_p", SKELETAL, (0.125, 0.0, 0.0)),
        ("gyroid", SHEET, (0.25, 0.25, 0.25)),
        ("diamond", SHEET, (0.125, 0.0, 0.0)),
        ("schwarz_p", SHEET, AT_HOME),
        ("gyroid", OFF_SKELETAL, (0.125, 0.0, 0.0)),
        ("diamond", OFF_SKELETAL, AT_HOME),
        ("schwarz_p", OFF_SKELETAL, (0.25, 0.25, 0.25)),
    ],
)
def test_boxes_in_planes_of_symmetry_are_cut_in_place(
    name: str,
    layers: tuple[float | None, float | None],
    phase: tuple[float, float, float],
    cover: Callable[..., Brep],
) -> None:
    """Such planes contain sides, saddles and corners of patches exactly, and the box's corners are lattice vertices."""
    trimmed = trim(cover(name, (1, 1, 1), phase, layers), box(np.zeros(3), np.full(3, CELL)), TOL)
    assert trimmed.report.shifted == 0
    assert connectivity.is_closed(trimmed.brep)
    assert volume(trimmed.brep) == pytest.approx(theory(name, layers), rel=3e-5)


@pytest.mark.slow
def test_cells_cost_faces_but_no_new_curves(cover: Callable[..., Brep]) -> None:
    one, many = (
        trim(cover("gyroid", cells, (0.1, 0.2, 0.3), SKELETAL), box(np.zeros(3), CELL * np.array(cells)), TOL)
        for cells in ((2, 1, 1), (3, 1, 1))
    )
    assert len(many.brep.curves) == len(one.brep.curves)
    assert volume(many.brep) == pytest.approx(1.5 * volume(one.brep), rel=1e-9)


@pytest.mark.slow
@settings(max_examples=4, deadline=None, derandomize=True)
@given(
    corners=st.lists(st.floats(0.5, 4.0), min_size=3, max_size=3).flatmap(
        lambda low: st.tuples(st.just(low), st.lists(st.floats(5.5, 9.0), min_size=3, max_size=3))
    ),
    axis=st.integers(0, 2),
    cut=st.floats(0.1, 0.9),
    layers=st.sampled_from([SHEET, SKELETAL]),
)
def test_the_halves_of_a_box_add_up(
    corners: tuple[list[float], list[float]],
    axis: int,
    cut: float,
    layers: tuple[float | None, float | None],
    cover: Callable[..., Brep],
) -> None:
    lattice = cover("gyroid", (1, 1, 1), AT_HOME, layers)
    lo, hi = np.array(corners[0]), np.array(corners[1])

    middle_hi, middle_lo = hi.copy(), lo.copy()
    middle_hi[axis] = middle_lo[axis] = lo[axis] + cut * (hi[axis] - lo[axis])
    parts = [trim_box(lattice, p, q, TOL) for p, q in ((lo, hi), (lo, middle_hi), (middle_lo, hi))]
    assert all(connectivity.is_closed(part) for part in parts)
    assert volume(parts[0]) == pytest.approx(volume(parts[1]) + volume(parts[2]), abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["schwarz_p", "gyroid"])
def test_edges_lie_on_both_their_faces_as_near_as_they_say(name: str, cover: Callable[..., Brep]) -> None:
    trimmed = trim_box(cover(name, (1, 1, 1), (0.13, 0.29, 0.41), SHEET), np.zeros(3), np.full(3, CELL), TOL)
    off = misfit(trimmed)
    assert (
        off <= trimmed.edges.deviation[trimmed.uses.edge] + 1e-9
    ).all()  # 1e-9 for the joints of the patches themselves
    assert off.max() < TOL
    caps = integral_properties.integrate_faces(trimmed)
    np.testing.assert_allclose(caps.normal.sum(axis=0), 0, atol=1e-4)  # closed surfaces have no net area vector


NEAR = [0.0, -1.5e-7, 1e-9, 5e-8, -1e-5, 1e-4]


@pytest.mark.slow
@pytest.mark.parametrize("by", NEAR)
def test_planes_near_a_corner_of_patches_cut_cleanly(by: float, cover: Callable[..., Brep]) -> None:
    lattice = cover("gyroid", (2, 2, 2), AT_HOME, OFF_SKELETAL)
    lo = np.array([1.234, 3.456, 5.678])
    at = lattice.vertices[:, 0]
    lo[0] = at[(at > 0.1) & (at < 9.9)][7] + by
    trimmed = trim(lattice, box(lo, lo + CELL), TOL)
    assert trimmed.report.shifted == 0
    assert connectivity.is_closed(trimmed.brep)
    assert trimmed.report.max_deviation < 3 * TOL  # a corner within two tolerances lies on the plane
    assert volume(trimmed.brep) == pytest.approx(theory("gyroid", OFF_SKELETAL), rel=3e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "by"), [*product(["gyroid"], NEAR), ("diamond", 5e-8), ("schwarz_p", 0.0)])
def test_planes_near_a_saddle_cut_cleanly(name: str, by: float, cover: Callable[..., Brep]) -> None:
    """The middle of a patch is a saddle over its tangent plane, which is a coordinate plane."""
    lattice = cover(name, (2, 2, 2), (0.05, 0.05, 0.05), OFF_SKELETAL)
    face = lattice.faces
    middle = np.stack([lattice.carriers[c](0.5, 0.5) for c in face.carrier])
    normal = np.stack([lattice.carriers[c].normal(0.5, 0.5) for c in face.carrier])
    middle = face.motion.apply(middle)
    normal = face.motion.apply_to_vectors(normal)
    along_x = (np.abs(normal[:, 0]) > 0.999 * np.linalg.norm(normal, axis=1)) & (np.abs(middle[:, 0] - 5) < 4)
    lo = np.array([middle[along_x][0, 0] + by, 3.456, 5.678])
    trimmed = trim(lattice, box(lo, lo + CELL), TOL)
    assert trimmed.report.shifted <= 25 * TOL * (abs(by) < 1e-8)  # only where the plane is tangent in all digits
    assert connectivity.is_closed(trimmed.brep)
    assert trimmed.report.max_deviation < TOL
    assert volume(trimmed.brep) == pytest.approx(theory(name, OFF_SKELETAL), rel=3e-5)


@pytest.mark.parametrize(("middle", "solid"), [(5.0, True), (0.0, False)])
def test_a_box_that_meets_no_surface_is_all_solid_or_nothing(
    middle: float, solid: bool, cover: Callable[..., Brep]
) -> None:
    """Schwarz P separates the middle from the corners of the cell; the nearest patch decides which of them is solid."""
    lattice = cover("schwarz_p", (2, 2, 2), AT_HOME, SKELETAL)
    lo, hi = np.full(3, CELL + middle - 0.1), np.full(3, CELL + middle + 0.1)
    if solid:
        assert volume(trim_box(lattice, lo, hi)) == pytest.approx(0.008, rel=1e-12)
    else:
        with pytest.raises(NothingLeft):
            trim_box(lattice, lo, hi)


@pytest.mark.slow
def test_a_lattice_that_does_not_cover_the_box_is_refused(cover: Callable[..., Brep]) -> None:
    lattice = cover("gyroid", (1, 1, 1), AT_HOME, SKELETAL)
    with pytest.raises(TrimmingError, match="ends inside it"):
        trim_box(lattice, np.zeros(3), CELL * np.array([1.6, 0.4, 0.3]), TOL)


def test_bad_requests_are_named(cover: Callable[..., Brep]) -> None:
    lattice = cover("gyroid", (1, 1, 1), AT_HOME, SKELETAL)
    with pytest.raises(InvalidRequest, match="lo < hi"):
        trim_box(lattice, np.zeros(3), np.array([1.0, 0.0, 1.0]))
    with pytest.raises(InvalidRequest, match="tol"):
        trim_box(lattice, np.zeros(3), np.ones(3), 0.0)
