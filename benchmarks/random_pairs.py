"""Random pairs of porous structures to blend, from a stated distribution.

Each of the two structures is drawn independently: any surface of the catalogue; type rod, pore or sheet; a volume fraction from
0.2 to 0.6 (thresholds are quantiles of the surface's values, and a sheet's lower one is uniform in the remaining range); 3 to 8
periods along x. The domain is 1 x s x s with s of 1/4, 1/2 or 1, the regions meet at x = 1/2, and the blending region is the
middle 0.15 to 0.5 of x. All distributions are uniform. A structure that is not one component without cavities on the
50 x 50 x 50 grid of the domain is drawn again; no pair is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tpmscad import fields
from tpmscad.blending.composition.defects import count_defects

SAMPLES = 50


@dataclass(frozen=True)
class Pair:
    """The arguments of a blend, and its name."""

    name: str
    structures: tuple[fields.Field, fields.Field]
    regions: tuple[fields.Field, fields.Field]
    blending: fields.Field


def random_pair(seed: int) -> Pair:
    """The pair of a seed."""
    rng = np.random.default_rng(seed)
    side, width = float(rng.choice([0.25, 0.5, 1.0])), float(rng.uniform(0.15, 0.5))
    axes = [np.linspace(0, length, SAMPLES) for length in (1.0, side, side)]
    drawn = _structures(rng, axes)
    (first, f), (second, g) = next(drawn), next(drawn)
    regions = fields.box((0, 0, 0), (0.5, side, side)), fields.box((0.5, 0, 0), (1, side, side))
    middle = fields.box((0.5 - width / 2, 0, 0), (0.5 + width / 2, side, side))
    return Pair(f"{first} + {second}, side {side:g}, width {width:.2f}", (f, g), regions, middle)


def _structures(rng: np.random.Generator, axes: list[np.ndarray]) -> Iterator[tuple[str, fields.Field]]:
    names = sorted(fields.TPMS)
    while True:
        name, kind = names[rng.integers(len(names))], ("rod", "pore", "sheet")[rng.integers(3)]
        fraction, periods = rng.uniform(0.2, 0.6), rng.uniform(3, 8)
        phi = fields.tpms(name, period=1 / periods)
        values = fields.tpms(name, period=1.0)(rng.uniform(0, 1, (20_000, 3)))
        if kind == "sheet":
            start = rng.uniform(0.02, 0.98 - fraction)
            levels = np.quantile(values, [start, start + fraction])
        else:
            levels = np.quantile(values, [fraction if kind == "rod" else 1 - fraction])
        structure = getattr(fields, kind)(phi, *map(float, levels))
        seen = count_defects(structure.on_grid(*axes))
        if seen.n0 == seen.n2 == 0:
            yield f"{kind} {name} {np.round(levels, 3)} x{periods:.2f}", structure
