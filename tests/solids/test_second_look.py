"""Where the Betti numbers of patches and field differ, the field is fitted with a closer look; a lasting difference is told."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from tpmscad import fields
from tpmscad.brep import connectivity
from tpmscad.errors import LevelSetError
from tpmscad.solids.matter import field_patches
from tpmscad.solids.matter.field_patches import FieldPatches, fit_field_patches
from tpmscad.solids.matter.patch_measures import measure_field_patches
from tpmscad.stage_timer import StageTimer

pytestmark = pytest.mark.kernel  # the room imports it

BALL = fields.sphere((1.0, 1.1, 0.9), 0.7)


def fit(field: fields.Field = BALL) -> FieldPatches:
    return fit_field_patches(field, np.zeros(3), np.full(3, 2.0), 2e-2, StageTimer(lambda *_: None))


def pretend(monkeypatch: pytest.MonkeyPatch, betti: Any) -> None:
    """Say these Betti numbers (a value or a function) of every field."""
    monkeypatch.setattr(field_patches, "compute_betti_numbers", betti if callable(betti) else lambda *_, **__: betti)


def failed(found: FieldPatches) -> list[str]:
    return [check.shortfall for check in measure_field_patches(found).checks if not check.passed]


@pytest.mark.parametrize("betti", [(1, 0, 0), None])
def test_numbers_that_agree_or_are_unknown_are_no_shortfall(
    betti: tuple[int, int, int] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    pretend(monkeypatch, betti)
    found = fit()
    assert failed(found) == []
    assert ("did not settle" in " ".join(measure_field_patches(found).notes)) == (betti is None)


def test_numbers_that_differ_to_the_end_are_a_shortfall(monkeypatch: pytest.MonkeyPatch) -> None:
    pretend(monkeypatch, (2, 0, 0))
    found = fit()
    assert found.properties.betti == (1, 0, 0)
    assert failed(found) == [
        "Betti numbers (1, 0, 0) differ from the field's, (2, 0, 0): use a finer `tol`; "
        "of a blend, subgrid_check=True removes isolated parts that lie between its samples"
    ]


BALL_AND_SPECK = fields.expression(
    "((x - 1)^2 + (y - 1.1)^2 + (z - 0.9)^2 - 0.49) * ((x - 1.83)^2 + (y - 1.78)^2 + (z - 1.81)^2 - 0.015^2)"
)


@pytest.mark.parametrize("continuation_fails", [False, True])
def test_a_part_that_the_first_fit_misses_is_found(continuation_fails: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def refine(first: Any, *rest: Any) -> Any:
        assert connectivity.label_shells(first.brep)[0] == 1
        if continuation_fails:
            raise LevelSetError("4 places could not be fitted")
        return refine_field_fit(first, *rest)

    refine_field_fit = field_patches.refine_field_fit
    monkeypatch.setattr(field_patches, "refine_field_fit", refine)
    found = fit(BALL_AND_SPECK)
    assert found.properties.betti == (2, 0, 0)
    assert failed(found) == []


def test_a_finer_grid_that_agrees_with_the_patches_is_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(field_patches, "FINER_LINES", 40.0)
    count = field_patches.compute_betti_numbers
    said = iter([(2, 0, 0)])
    pretend(monkeypatch, lambda *args, **options: next(said, None) or count(*args, **options))
    found = fit()
    assert found.field_betti == (1, 0, 0)
    assert failed(found) == []


def test_uncertain_numbers_that_differ_lead_to_no_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    def uncertain(*args: Any, confirm: Any) -> Any:
        return (1, 1, 0) if confirm((1, 1, 0)) else None

    pretend(monkeypatch, uncertain)
    found = fit()
    assert found.field_betti is None
    assert failed(found) == []


def test_every_figure_beyond_its_limit_is_a_shortfall() -> None:
    found = fit()
    rough = replace(found.fitted, continuity=replace(found.fitted.continuity, tangent_jump_deg=0.011))
    words = failed(replace(found, fitted=rough, field_volume=1.01 * found.field_volume))
    assert words[0].split(" exceeds ")[-1] == "0.01"
    assert "differs from the field's" in words[1]
    assert len(words) == 2


def test_fits_use_one_thread_of_blas_and_give_the_others_back() -> None:
    def count_threads() -> set[int]:
        return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}

    seen: list[set[int]] = []

    def watch(part: float) -> None:
        seen.append(count_threads())

    stages = StageTimer(lambda stage, part: watch(part) if stage == "fit" and part < 1 else None)
    with threadpool_limits(2, user_api="blas"):
        fit_field_patches(BALL, np.zeros(3), np.full(3, 2.0), 2e-2, stages)
        assert count_threads() == {2}
    assert {1} in seen
