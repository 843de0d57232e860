"""Edges of blended walls are rounded within the allowed displacement, and nothing else changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from tpmscad import fields
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.levelset.edge_rounding import round_edges

LO, HI = np.array([0.0, 0.0, -0.5]), np.array([2.0, 0.7, 0.5])
HALF, VOID = 0.2, 0.45


@dataclass(frozen=True)
class Ramp:
    """The weight x - 0.5, and its gradient."""

    def __call__(self, points: ArrayLike) -> NDArray[np.float64]:
        return np.asarray(points)[..., 0] - 0.5

    def gradient(self, points: ArrayLike) -> NDArray[np.float64]:
        return np.broadcast_to([1.0, 0.0, 0.0], np.shape(points)).copy()

    def on_grid(self, *axes: NDArray[np.float64]) -> NDArray[np.float64]:
        return self(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))


def tapered(wall: fields.Field) -> BlendedField:
    """A wall that is blended with void along x: it thins out to an edge."""
    regions = fields.box((0, 0, -1), (1, 1, 1)), fields.box((1, 0, -1), (2, 1, 1))
    return BlendedField((wall, fields.constant(VOID)), regions, (fields.box((0.5, 0, -1), (1.5, 1, 1)),), (Ramp(),))


WALL = fields.sheet(fields.coordinate("z"), -HALF, HALF)


@pytest.mark.slow
@pytest.mark.parametrize("allowed", [1e-2, 1e-4])
def test_the_tip_of_a_tapered_wall_moves_by_what_is_said_and_no_further_than_allowed(allowed: float) -> None:
    field = tapered(WALL)
    rounding = round_edges(field, LO, HI, allowed)
    assert rounding is not None

    def tip(f: fields.Field) -> float:
        return brentq(lambda x: float(f(np.array([x, 0.3, 0.0]))), 0.51, 1.49, xtol=1e-14)

    # (1 - w) (-HALF) + w VOID = 0
    assert tip(field) == pytest.approx(0.5 + HALF / (HALF + VOID))
    moved = abs(tip(rounding.field) - tip(field))
    assert 0.6 * allowed < moved <= 1.01 * allowed
    assert rounding.max_displacement == pytest.approx(allowed, rel=0.12)
    # |z| = HALF - VOID w / (1 - w) has the slope VOID / (1 - w)^2 at the edge, where w = HALF / (HALF + VOID)
    half = np.arctan((HALF + VOID) ** 2 / VOID)
    assert rounding.opening_deg == pytest.approx(np.degrees(2 * half), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("allowed", [1e-2, 1e-3])
def test_the_tip_has_the_radius_that_is_said_and_more_than_a_cut_edge_has(allowed: float) -> None:
    rounding = round_edges(tapered(WALL), LO, HI, allowed)
    assert rounding is not None
    z = 0.02 * allowed * np.arange(-1, 2)
    x = [brentq(lambda x, z=z: float(rounding.field(np.array([x, 0.3, z]))), 0.51, 1.49, xtol=1e-15) for z in z]
    radius = (z[2] - z[1]) ** 2 / abs(x[0] - 2 * x[1] + x[2])
    assert rounding.radius == pytest.approx(radius, rel=0.02)
    half = np.radians(0.5 * rounding.opening_deg)
    assert radius > 0.95 * allowed / (1 / np.sin(half) - 1)


@pytest.mark.slow
@pytest.mark.parametrize("allowed", [1e-2, 1e-3])
def test_nothing_beside_the_edge_moves_further_than_allowed_and_some_of_it_outwards(allowed: float) -> None:
    field = tapered(WALL)
    rounding = round_edges(field, LO, HI, allowed)
    assert rounding is not None
    heights = np.linspace(-HALF, HALF, 401) * (1 - 1e-9)
    moved = []
    for z in heights[np.abs(heights) > 0.05 * allowed]:
        ends = [
            brentq(lambda x, f=f, z=z: float(f(np.array([x, 0.3, z]))), 0.4, 1.49, xtol=1e-14)
            for f in (field, rounding.field)
        ]
        # along x; across the surface it is less
        steep = field.gradient(np.array([ends[0], 0.3, z]))
        moved.append((ends[1] - ends[0]) * abs(steep[0]) / np.linalg.norm(steep))
    assert max(np.abs(moved)) <= 1.02 * allowed
    assert max(moved) > 0.1 * allowed > 0 > min(moved)


def test_only_the_edge_is_touched() -> None:
    field = tapered(WALL)
    rounding = round_edges(field, LO, HI, 1e-3)
    assert rounding is not None
    points = np.random.default_rng(0).uniform(LO, HI, (20_000, 3))
    far = np.abs(points[:, 2]) > 0.02
    assert np.array_equal(rounding.field(points)[far], field(points)[far])
    assert not np.array_equal(rounding.field(points), field(points))


@pytest.mark.parametrize(
    "field",
    [
        WALL,
        tapered(fields.coordinate("z") - HALF),
        tapered(fields.sheet(fields.coordinate("z"), -HALF, 3.0)),
    ],
    ids=["no blend", "no wall", "crease outside the box"],
)
def test_a_solid_without_edges_stays_as_it_is(field: fields.Field) -> None:
    assert round_edges(field, LO, HI, 1e-3) is None


@pytest.mark.slow
def test_a_wall_without_edges_in_the_box_does_not_matter() -> None:
    """A second wall, blended in where the first is gone: in half of the box only the first has an edge."""
    second = fields.sheet(fields.coordinate("z") - 0.1, -HALF, HALF)
    regions = tapered(WALL).regions
    field = BlendedField((WALL, fields.constant(VOID)), regions, (fields.box((0.5, 0, -1), (1.5, 1, 1)),), (Ramp(),))
    both = BlendedField(
        (WALL, fields.constant(VOID), second),
        (*regions, fields.box((2, 0, -1), (3, 1, 1))),
        (*field.blending_regions, fields.box((1.9, 0, -1), (2.1, 1, 1))),
        (Ramp(), Ramp()),
    )
    one, other = (
        round_edges(field, LO, np.array([1.8, 0.7, 0.5]), 1e-3),
        round_edges(both, LO, np.array([1.8, 0.7, 0.5]), 1e-3),
    )
    assert one is not None
    assert other is not None
    assert other.max_displacement == pytest.approx(one.max_displacement, rel=0.1)
    assert 0.8e-3 < other.max_displacement <= 1e-3
