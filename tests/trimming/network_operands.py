"""What tests of networks have in common: an operand, and all operations on two of them."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from tpmscad import fields
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep
from tpmscad.levelset.field_solid import fit_field
from tpmscad.trimming.network_boolean import DEFAULT_TOL, KEPT_PARTS, NetworkResult, Operation, combine_networks


@lru_cache
def rod() -> Brep:
    """A solid with caps at its box, and patches with T-vertices."""
    return fit_field(fields.rod(fields.tpms("schwarz_p", 3.0), -0.6), np.full(3, -1.87), np.full(3, 1.93), 2e-2).brep


def trim(lattice: Brep, body: Brep, tol: float = DEFAULT_TOL, **options: Any) -> NetworkResult:
    """The part of a lattice inside a body; nothing left has no faces."""
    return combine_networks(body, lattice, "intersection", tol, is_cover=True, **options)


def combine(first: Brep, second: Brep) -> dict[Operation, NetworkResult]:
    """All operations, each result closed with connected loops."""
    found = {operation: combine_networks(first, second, operation) for operation in KEPT_PARTS}
    for result in found.values():
        assert connectivity.is_closed(result.brep)
        assert not len(connectivity.find_broken_loops(result.brep))
    return found
