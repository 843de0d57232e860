"""The search for the fewest poles: up, down, and where there is no answer."""

from __future__ import annotations

import numpy as np

from tpmscad.splines.adaptive_fit import SplineSpace, fit_to_tolerance

T = np.linspace(0, 1, 61)


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
