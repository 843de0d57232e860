"""The search for the fewest poles, on the minimal surfaces and where there is no answer."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import surfaces
from tpmscad.splines.adaptive_fit import BEZIER_SPACES, REQUIRED_MISSES, SplineSpace, fit_to_tolerance
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.continuity_conditions import ContinuityConditions, Joint, joint_conditions
from tpmscad.splines.spline_axis import SplineAxis

EXACT = [info.name for info in surfaces.CATALOGUE.values() if info.primitives == "exact"]

T = np.linspace(0, 1, 61)
MOST_POLES = {1e-2: 64, 1e-3: 64, 1e-4: 121, 1e-5: 225, 1e-6: 289}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "share", "tol"),
    [
        ("diamond", 0.0, 1e-4),
        ("schwarz_p", 0.8, 1e-4),
        *(("gyroid", 0.8, tol) for tol in MOST_POLES),
        *(
            pytest.param(name, share, tol, marks=pytest.mark.slow)
            for name in EXACT
            for share in (0.0, 0.4, 0.8)
            for tol in MOST_POLES
        ),
    ],
)
def test_minimal_surfaces_take_few_poles(name: str, share: float, tol: float) -> None:
    patch, symmetry = surfaces.primitive_patch(name), surfaces.patch_symmetry(name)
    joints = [Joint(s, symmetry.edge_motions.rotation[s], symmetry.edge_motions.translation[s], s) for s in range(4)]

    def exact(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return patch.jet(*np.meshgrid(u, v, indexing="ij"), share * patch.max_offset).position

    jet = patch.jet(*np.meshgrid(T, T, indexing="ij"), share * patch.max_offset)

    def distance(surface: BSplineSurface) -> float:
        """Along the exact normals to first order: the tangential part of the difference is no deviation."""
        return float(np.abs(np.sum((surface.grid(T, T) - jet.position) * jet.normal, axis=-1)).max())

    def conditions(u: SplineAxis, v: SplineAxis) -> ContinuityConditions:
        return joint_conditions(joints, u, v, valence=6)

    fit = fit_to_tolerance(exact, distance, tol, conditions=conditions)
    assert fit.converged
    assert fit.deviation == distance(fit.surface) <= tol
    assert fit.n_poles == fit.surface.poles.shape[0] * fit.surface.poles.shape[1] <= MOST_POLES[tol]
    tried = {trial.space: trial.deviation for trial in fit.trials}
    below = BEZIER_SPACES[max(BEZIER_SPACES.index(fit.space) - REQUIRED_MISSES, 0) : BEZIER_SPACES.index(fit.space)]
    assert below or fit.space == BEZIER_SPACES[0]
    assert all(tried[space] > tol for space in below)


def paraboloid(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    x, y = np.meshgrid(u, v, indexing="ij")
    return np.stack([x, y, x * x - y**2], axis=-1)


def test_the_search_goes_down_as_well_as_up() -> None:
    deviations = {
        SplineSpace(d): value for d, value in zip(range(2, 9), (9.0, 9.0, 1.0, 2.0, 1.0, 1.0, 0.5), strict=True)
    }
    fit = fit_to_tolerance(paraboloid, lambda s: deviations[SplineSpace(s.degree_u)], 1.5, candidates=list(deviations))
    assert fit.space == SplineSpace(4)
    # Seen from the top down, where the first guess of a surface of low degree does not start.
    wild = fit_to_tolerance(
        lambda u, v: 1e9 * paraboloid(u, v) ** 8,
        lambda s: deviations[SplineSpace(s.degree_u)],
        1.5,
        candidates=list(deviations),
    )
    assert wild.trials[0].space == SplineSpace(8)
    assert wild.space == SplineSpace(4)


def test_missing_the_tolerance_gives_the_best_there_was() -> None:
    fit = fit_to_tolerance(paraboloid, lambda s: 1.0 / s.degree_u, 1e-3, candidates=[SplineSpace(4), SplineSpace(3)])
    assert not fit.converged
    assert fit.space == SplineSpace(4)


def test_spans_are_candidates_too() -> None:
    ladder = [SplineSpace(3, spans, 2) for spans in range(1, 6)]

    def wavy(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        x, y = np.meshgrid(u, v, indexing="ij")
        return np.stack([x, y, np.sin(6 * x * y)], axis=-1)

    fit = fit_to_tolerance(wavy, lambda s: float(np.abs(s.grid(T, T) - wavy(T, T)).max()), 1e-2, candidates=ladder)
    assert fit.converged
    assert fit.space.spans > 1
    assert fit.n_poles == fit.surface.poles[..., 0].size
