"""The search for the lowest degree: up, down, and where there is no answer."""

from __future__ import annotations

import numpy as np

from tpmscad.splines.adaptive_fit import fit_to_tolerance


def paraboloid(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    x, y = np.meshgrid(u, v, indexing="ij")
    return np.stack([x, y, x * x - y**2], axis=-1)


def test_the_search_goes_down_as_well_as_up() -> None:
    deviations = dict(zip(range(2, 9), (9.0, 9.0, 1.0, 2.0, 1.0, 1.0, 0.5), strict=True))
    fit = fit_to_tolerance(paraboloid, lambda s: deviations[s.degree_u], 1.5, degrees=list(deviations))
    assert fit.degree == 4
    # Seen from the top down, where the first guess of a surface of low degree does not start.
    wild = fit_to_tolerance(
        lambda u, v: 1e9 * paraboloid(u, v) ** 8, lambda s: deviations[s.degree_u], 1.5, degrees=list(deviations)
    )
    assert next(iter(wild.trials)) == 8
    assert wild.degree == 4


def test_missing_the_tolerance_gives_the_best_there_was() -> None:
    fit = fit_to_tolerance(paraboloid, lambda s: 1.0 / s.degree_u, 1e-3, degrees=(3, 4))
    assert not fit.converged
    assert fit.degree == 4
