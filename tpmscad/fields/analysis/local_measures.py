"""Volume and Betti numbers of a tree of many solids, from the leaves that matter in the cells of an octree.

The volume is that of the cells which are solid all over, exactly, and of a stratified sample of the undecided ones: two random
points in each, whose difference gives the standard error without bias. Betti numbers are counted on the centres of the cells.
Both need the field only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tpmscad import topology
from tpmscad._typing import Array
from tpmscad.fields.analysis.betti_numbers import MAX_UNIFORM_NODES, Betti
from tpmscad.fields.analysis.local_leaves import LocalLeaves, count_first_cells, halve_cells, locate_leaves
from tpmscad.fields.field import Field

LEAST_CELLS = 128
"""Cells along the longest edge of the box on the first grid whose measures count."""

MAX_CELLS = 2**21
"""Greatest number of undecided cells: 2 s and 400 MB."""

VOLUME_RTOL = 3e-4
"""Relative uncertainty at which a volume is accepted."""

STANDARD_ERRORS = 3.0
"""Uncertainty of a volume in standard errors."""

SEED = 20240


class LocalMeasures(NamedTuple):
    """Volume and its uncertainty, model units cubed, and Betti numbers, None where no two grids agree."""

    volume: float
    uncertainty: float
    betti: Betti | None


def measure_locally(field: Field, lo: Array, hi: Array, confirm: Callable[[Betti], bool]) -> LocalMeasures:
    """Volume and Betti numbers of {field < 0} in a box.

    Betti numbers are those of the first grid that other evidence confirms, by `confirm`, or else those on which the last two
    grids agree: grids do not resolve every neck, and acute wedges may fall apart on them.
    """
    local = locate_leaves(field, lo, hi, count_first_cells(lo, hi))
    rng = np.random.default_rng(SEED)
    volume, uncertainty = 0.0, np.inf
    counted: list[Betti] = []
    while True:
        if local.counts.max() >= LEAST_CELLS:
            if uncertainty > VOLUME_RTOL * volume:
                volume, uncertainty = _sample_volume(local, rng)
            settled = bool(counted) and confirm(counted[-1])
            if not settled and np.prod(local.counts, dtype=float) <= MAX_UNIFORM_NODES:
                found = topology.betti(np.where(local.on_grid(), -1.0, 1.0))
                counted.append((found.b0, found.b1, found.b2))
                settled = confirm(counted[-1])
            settled |= np.prod(2.0 * local.counts) > MAX_UNIFORM_NODES
            if settled and uncertainty <= VOLUME_RTOL * volume:
                break
        if 4 * len(local.cells) > MAX_CELLS and np.isfinite(uncertainty):
            break
        local = halve_cells(local)
    agree = bool(counted) and (confirm(counted[-1]) or len(set(counted[-2:])) == 1 < len(counted))
    return LocalMeasures(volume, uncertainty, counted[-1] if agree else None)


def _sample_volume(local: LocalLeaves, rng: np.random.Generator) -> tuple[float, float]:
    """Volume and uncertainty by two points in each undecided cell."""
    found = local.is_solid(rng.random((len(local.cells), 2, 3)))
    cell = float(np.prod(local.size))
    differ = np.count_nonzero(found[:, 0] != found[:, 1])
    volume = local.solid_volume + cell * float(found.mean(axis=1).sum())
    return volume, STANDARD_ERRORS * cell * 0.5 * float(np.sqrt(differ))
