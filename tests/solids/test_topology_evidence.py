"""When tunnels are counted on the finest grids: only where their number alone may be wrong."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.fields.analysis.betti_numbers import Betti
from tpmscad.levelset.field_solid import fit_field
from tpmscad.solids.matter import field_patches

LO, HI = np.full(3, -1.5), np.full(3, 1.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("counted", "finest", "expected"),
    [
        ((1, 0, 0), None, ((1, 0, 0), True)),
        ((1, 2, 0), (1, 0, 0), ((1, 0, 0), True)),
        ((1, 2, 0), None, ((1, 2, 0), False)),
        ((1, 2, 1), "not asked", ((1, 2, 1), False)),  # a shell of which the patches have none
    ],
)
def test_tunnels_are_counted_where_the_shells_are_the_patches(
    counted: Betti, finest: Betti | str | None, expected: tuple[Betti, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    ball = fit_field(fields.sphere((0, 0, 0), 1.0), LO, HI, 0.05)

    def count_on_finest_grids(*_: object) -> Betti | str | None:
        assert finest != "not asked"
        return finest

    monkeypatch.setattr(field_patches, "compute_betti_numbers", lambda *_args, **_options: counted)
    monkeypatch.setattr(field_patches, "count_tunnels_near_surface", count_on_finest_grids)
    assert field_patches._compute_betti_numbers_of(ball) == expected
