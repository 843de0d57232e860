"""Subgrid defects are found where they are and nowhere else, and are removed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from benchmarks.random_pairs import random_pair
from tpmscad import fields
from tpmscad.blending import blend
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.sampled_composition import sample_composition
from tpmscad.blending.optimise.subgrid_defects import find_subgrid_defects
from tpmscad.fields.data.sample_grid import SampleGrid

GRID = SampleGrid((0, 0, 0), (1, 1, 1), (25, 22, 27))
ALL = fields.box((-1, -1, -1), (2, 2, 2))


def subgrid_points(field: fields.Field) -> np.ndarray:
    """The subgrid defects of one field, taken as a blend of itself with itself on the whole grid."""
    blended = BlendedField((field, field), (ALL, ~ALL), (ALL,), (fields.constant(0.5),))
    composition = sample_composition(blended, GRID)
    return find_subgrid_defects(composition, blended, composition.structures[0]).points


def balls(sign: int) -> tuple[fields.Field, np.ndarray]:
    """A slab below z = 0.3 and balls between the samples above it, or the same with solid and void exchanged."""
    rng = np.random.default_rng(0)
    cells = np.stack(np.meshgrid(range(3, 21, 7), range(3, 18, 7), range(12, 23, 7), indexing="ij"), -1).reshape(-1, 3)
    centers = np.array([axis[i] for axis, i in zip(GRID.axes, cells.T, strict=True)]).T
    centers += rng.uniform(0.4, 0.6, centers.shape) * GRID.spacing
    radii = rng.uniform(0.2, 0.55, len(centers)) * GRID.spacing.min()
    small = [fields.sphere(center, radius) for center, radius in zip(centers, radii, strict=True)]
    field = fields.union(fields.halfspace((0, 0, 0.3), "z"), *small)
    return field if sign > 0 else -field, centers


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1, -1])
def test_every_ball_between_the_samples_is_found_and_nothing_else(sign: int) -> None:
    field, centers = balls(sign)
    values = field.on_grid(*GRID.axes)
    assert ndimage.label(sign * values <= 0)[1] == 1, "a sample sees a ball"
    found = subgrid_points(field)
    assert len(found) == len(centers)
    apart = np.linalg.norm(found[:, None] - centers[None], axis=2).min(axis=1)
    assert (apart < 0.6 * GRID.spacing.min()).all()


def test_connected_spikes_and_thin_walls_are_no_subgrid_defects() -> None:
    cone = fields.from_function(lambda p: np.hypot(p[:, 0] - 0.51, p[:, 1] - 0.47) - 0.1 * (0.93 - p[:, 2]))
    wall = fields.box((0.2, 0.2, -1), (0.2 + 0.3 * GRID.spacing[0], 0.8, 0.613))
    assert len(subgrid_points(fields.halfspace((0, 0, 0.3), "z") | cone | wall)) == 0


def test_a_cavity_at_the_border_of_the_domain_is_open_and_a_component_there_is_isolated() -> None:
    center = GRID.low[0], GRID.axes[1][8] + 0.5 * GRID.spacing[1], GRID.axes[2][20] + 0.5 * GRID.spacing[2]
    ball = fields.sphere(center, 0.4 * GRID.spacing.min())
    slab = fields.halfspace((0, 0, 0.3), "z")
    assert len(subgrid_points(slab | ball)) == 1
    assert len(subgrid_points(-(slab | ball))) == 0


def test_a_bar_that_enters_the_domain_from_outside_is_isolated_in_it() -> None:
    y, z = GRID.axes[1][8] + 0.5 * GRID.spacing[1], GRID.axes[2][20] + 0.5 * GRID.spacing[2]
    end = GRID.low[0] + 0.3 * GRID.spacing[0]
    along = fields.from_function(
        lambda p: np.linalg.norm(p - np.stack([np.minimum(p[:, 0], end), 0 * p[:, 1] + y, 0 * p[:, 2] + z], 1), axis=1)
    )
    bar = along - 0.4 * GRID.spacing.min()
    assert (bar.on_grid(*GRID.axes) > 0).all(), "a sample sees the bar"
    assert len(subgrid_points(fields.halfspace((0, 0, 0.3), "z") | bar)) == 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", [25, 83])
def test_random_blends_have_no_isolated_part_at_a_resolution_that_was_not_checked(seed: int) -> None:
    pair = random_pair(seed)
    left = []
    for wanted in (False, None):
        result = blend(pair.structures, pair.regions, [pair.blending], resolution=(50, 50, 50), subgrid_check=wanted)
        assert result.converged
        axes = [np.linspace(low, high, 150) for low, high in zip(*result.domain, strict=True)]
        left.append(ndimage.label(result.field.on_grid(*axes) <= 0)[1] - 1)
    assert left[0] > 0
    assert left[1] == 0
    assert result.errors.n_subgrid == 0
