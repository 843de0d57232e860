"""Volumes by samples: the fraction of a body that is filled, from points that no boolean takes part in."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.measure.shape_sampling import sample_solid
from tpmscad.results.certificate import Check

N_SAMPLE_LINES = 512
POINTS_PER_LINE = 4
"""Size of the sample: a missing piece of a tenth of the volume shows."""

SAMPLE_POINTS = 20_000
"""Points in a box, of which those in a field's solid are its sample."""

MAX_STANDARD_ERRORS = 5.0
"""Standard errors of an independent random sample by which the volume may differ from the sample's."""


def sample_body(body: CadBody) -> Array:
    """An even sample (n, 3) of points in a body."""
    return sample_solid(body.shape, N_SAMPLE_LINES, POINTS_PER_LINE)


def sample_box(low: Array, high: Array) -> Array:
    """Points (n, 3) in a box, a low-discrepancy sequence of three dimensions (M. Roberts, 2018)."""
    steps = 1.2207440846057596 ** -np.arange(1.0, 4.0)
    return low + (high - low) * np.modf(0.5 + np.outer(np.arange(SAMPLE_POINTS), steps))[0]


def compare_with_sample(filled: float, inside: BoolArray, name: str) -> Check:
    """The check that the part of a body that is filled is that of a sample (n,) of points in the body."""
    fraction, error = estimate_fraction(inside)
    return Check(
        "volume",
        abs(filled - fraction),
        error,
        f"it fills {filled:.3g} of {name}, but {fraction:.3g} +- {error:.2g} of a sample",
    )


def estimate_fraction(inside: BoolArray) -> tuple[float, float]:
    """The fraction of a sample (n,) that is inside, and the error allowed for it."""
    fraction = float(inside.mean())
    variance = max(fraction * (1 - fraction), 1 / len(inside)) / len(inside)
    return fraction, MAX_STANDARD_ERRORS * float(np.sqrt(variance))
