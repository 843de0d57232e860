"""What a certificate calls a bound lies above what is measured."""

from __future__ import annotations

import pytest

import tpmscad

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize("tol", [0.1, 0.01])
@pytest.mark.parametrize("surface", ["gyroid", "schwarz_p"])
def test_a_bound_of_the_deviation_is_above_the_measured_one(surface: str, tol: float) -> None:
    certificate = tpmscad.lattice(surface, cell=10, thickness=1, tol=tol).certificate
    bounds = {name: bound for name, bound in certificate.bounds.items() if name.startswith("of the deviation")}
    assert bounds
    assert certificate.max_deviation is not None
    assert min(bounds.values()) >= certificate.max_deviation
