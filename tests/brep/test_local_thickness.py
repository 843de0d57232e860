"""Patches on the two sides of a wall that cross each other: at one of them the field's gradient points the other way."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.shapes.ball_level_sets import CENTRE, RADIUS, ball_fit
from tpmscad import fields
from tpmscad.levelset.fit.fit_quality import sample_patches
from tpmscad.levelset.level_set_fit import MIN_NORMAL_COSINE, LevelSetFit
from tpmscad.splines.basis import bernstein_basis, evaluate_bezier_patches


@pytest.mark.slow
@pytest.mark.parametrize(("part", "crossing"), [(0.2, True), (3.0, False)])
def test_sides_of_a_wall_that_cross_have_normals_against_the_gradient(part: float, crossing: bool) -> None:
    outer = ball_fit(spacing=1.5)
    off = float(outer.quality.samples.distance.max())
    inner = ball_fit((5, 8, 6), radius=RADIUS - part * off, spacing=1.5)
    wall = fields.sphere(CENTRE, RADIUS) & ~fields.sphere(CENTRE, RADIUS - part * off)
    beyond = clearly_beyond(outer, inner, 0.2 * off)
    assert (len(beyond) > 0) == crossing
    of_outer, of_inner = (
        np.array([sample_patches(wall, turn(p)[None]).min_normal_cosine[0] for p in layer.fit.patches])
        for layer, turn in ((outer, lambda p: p), (inner, lambda p: np.swapaxes(p, 0, 1)))
    )
    for one, others in beyond.items():
        assert min(of_outer[one], *of_inner[sorted(others)]) < MIN_NORMAL_COSINE
    assert crossing or min(of_outer.min(), of_inner.min()) > MIN_NORMAL_COSINE


def clearly_beyond(outer: LevelSetFit, inner: LevelSetFit, margin: float) -> dict[int, set[int]]:
    """Patches of the outer sphere's that are nearer to the centre, somewhere, than some of the inner one's in that direction."""
    t = np.linspace(0.0, 1.0, 25)

    def points(p):
        basis_u, basis_v = (bernstein_basis(count - 1, t) for count in p.shape[:2])
        return evaluate_bezier_patches(basis_u, p[None], basis_v)[0]

    rays = [[points(p) - CENTRE for p in layer.fit.patches] for layer in (outer, inner)]
    each = len(t) ** 2
    length = [np.linalg.norm(np.concatenate(part), axis=1) for part in rays]
    distance, near = cKDTree(np.concatenate(rays[1]) / length[1][:, None]).query(
        np.concatenate(rays[0]) / length[0][:, None], k=4
    )
    found: dict[int, set[int]] = {}
    for i in np.flatnonzero((length[0] < length[1][near].min(axis=1) - margin) & (distance.max(axis=1) < 0.03)):
        found.setdefault(int(i // each), set()).update((near[i] // each).tolist())
    return found
