"""Restricted carriers are the same surfaces with fewer poles outside; faces, edges and what is measured on them stay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.brep.test_extents import PARABOLOID, random_rotation, trimmed_face
from tests.trimming.conftest import covered
from tests.trimming.network_operands import trim
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.edge_continuity import measure_edge_continuity
from tpmscad.brep.extents import true_bounds
from tpmscad.brep.restricted_surfaces import RestrictedSurface, bound_curves, restrict_carriers, whole_surfaces
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.rigid_motion import Motion
from tpmscad.splines import BSplineCurve, BSplineSurface
from tpmscad.trimming.operands.polyhedra import box


def poles_of_faces(brep: Brep) -> list[np.ndarray]:
    carriers = [brep.carriers[i] for i in brep.faces.carrier]
    pairs = zip(carriers, brep.faces.motion, strict=True)
    return [motion.apply(c.poles.reshape(-1, 3)) for c, motion in pairs if isinstance(c, BSplineSurface)]


@pytest.mark.parametrize("seed", range(6))
def test_a_restricted_carrier_is_the_surface_on_a_box_that_holds_the_face(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-0.5, 0.4, (3, 2))
    motion = Motion(random_rotation(rng), rng.normal(size=3))
    face = trimmed_face(PARABOLOID, corners, motion)
    tight = restrict_carriers(face, *true_bounds(face))
    carrier = tight.carriers[int(tight.faces.carrier[0])]
    assert isinstance(carrier, RestrictedSurface)
    assert carrier.whole is PARABOLOID
    low, high = np.array(carrier.domain).T
    assert (low <= corners.min(axis=0)).all()
    assert (high >= corners.max(axis=0)).all()
    assert (high - low <= np.ptp(corners, axis=0) + 4 / 1024).all()
    u, v = rng.uniform(low, high, (20, 2)).T
    np.testing.assert_allclose(carrier(u, v), PARABOLOID(u, v), atol=1e-14)
    np.testing.assert_allclose(carrier(u, v, 1, 1), PARABOLOID(u, v, 1, 1), atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_the_box_of_a_curve_holds_it_however_sharply_it_turns_between_samples(seed: int) -> None:
    rng = np.random.default_rng(seed)
    inner = np.sort(rng.uniform(0.0, 1.0, rng.integers(0, 12)) ** 3)
    degree = int(rng.integers(1, 8))
    knots = np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)])
    curve = BSplineCurve(rng.normal(size=(len(knots) - degree - 1, 2)), knots, degree)
    span = np.sort(rng.uniform(0.0, 1.0, 2))
    low, high = bound_curves([curve], np.array([0]), span[None])
    points = curve(np.linspace(*span, 20001))
    assert (low[0] <= points.min(axis=0)).all()
    assert (high[0] >= points.max(axis=0)).all()


def test_the_box_of_a_curve_is_little_larger_than_the_curve() -> None:
    poles = np.array([[0.0, 0.0], [1.0, 2.0], [2.0, -1.0], [3.0, 0.5]])
    curve = BSplineCurve(poles, np.repeat([0.0, 1.0], 4), 3)
    low, high = bound_curves([curve], np.array([0]), np.array([[0.2, 0.9]]))
    points = curve(np.linspace(0.2, 0.9, 20001))
    np.testing.assert_allclose(low[0], points.min(axis=0), atol=0.02)
    np.testing.assert_allclose(high[0], points.max(axis=0), atol=0.02)


def test_a_face_whose_poles_stay_in_the_box_keeps_its_carrier() -> None:
    face = trimmed_face(PARABOLOID, np.array([[-0.3, -0.3], [0.3, -0.3], [0.0, 0.4]]))
    assert restrict_carriers(face, np.full(3, -9.0), np.full(3, 9.0)) is face


@pytest.fixture(scope="module")
def cut() -> tuple[Brep, Brep]:
    """A lattice in a box as it comes of a trim, and the same on whole patches."""
    lattice = covered("gyroid", (1, 1, 1), (0.02, 0.03, 0.05), (-0.03, 0.05))
    tight = trim(lattice, box([1.3, 2.1, 1.7], [8.2, 9.1, 7.9])).brep
    wholes, number = whole_surfaces(tight)
    carriers = tuple(wholes.get(i, c) for i, c in enumerate(tight.carriers))
    return tight, replace(tight, carriers=carriers, faces=replace(tight.faces, carrier=number[tight.faces.carrier]))


@pytest.mark.slow
def test_restriction_changes_neither_measures_nor_continuity(cut: tuple[Brep, Brep]) -> None:
    tight, whole = cut
    assert any(isinstance(c, RestrictedSurface) for c in tight.carriers)
    ours, theirs = measure_solid(tight), measure_solid(whole)
    assert ours.volume == pytest.approx(theirs.volume, rel=1e-9)
    assert ours.area == pytest.approx(theirs.area, rel=1e-9)
    tags = ("offset+", "offset-")
    assert measure_edge_continuity(tight, tags) == measure_edge_continuity(whole, tags)


@pytest.mark.slow
def test_restriction_brings_the_poles_nearer_to_the_box_and_leaves_the_true_extent(cut: tuple[Brep, Brep]) -> None:
    tight, whole = cut
    bounds = true_bounds(tight)
    np.testing.assert_allclose(bounds, true_bounds(whole), atol=1e-8)
    np.testing.assert_allclose(bounds, [[1.3, 2.1, 1.7], [8.2, 9.1, 7.9]], atol=2e-7)

    def excess(brep: Brep) -> float:
        poles = np.concatenate(poles_of_faces(brep))
        return float(max((bounds[0] - poles.min(axis=0)).max(), (poles.max(axis=0) - bounds[1]).max()))

    assert excess(tight) < 0.7 * excess(whole)


@pytest.mark.slow
def test_copies_of_a_face_share_a_restricted_carrier(cut: tuple[Brep, Brep]) -> None:
    face: Callable[[float], Brep] = lambda x: trimmed_face(  # noqa: E731
        PARABOLOID, np.array([[0.1, 0.1], [0.5, 0.1], [0.1, 0.4]]), Motion(np.eye(3), np.array([x, 0.0, 0.0]))
    )
    steps = [restrict_carriers(face(x), *true_bounds(face(x))).carriers[1].domain for x in (0.0, 3.0)]
    assert steps[0] == steps[1]
    tight, _ = cut
    used = np.unique(tight.faces.carrier)
    count = sum(isinstance(tight.carriers[i], RestrictedSurface) for i in used)
    domains = {(c.domain, id(c.whole)) for c in tight.carriers if isinstance(c, RestrictedSurface)}
    assert len(domains) == count
