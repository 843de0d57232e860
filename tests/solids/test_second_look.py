"""Where the Betti numbers of patches and field differ, the field is fitted with a closer look; a lasting difference is told."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from tests.shapes.box_shapes import plane_box
from tpmscad import fields
from tpmscad.errors import LevelSetError
from tpmscad.solids import field_patches
from tpmscad.solids.field_patches import FieldPatches, fit_field_patches
from tpmscad.solids.patch_measures import measure_field_patches
from tpmscad.stage_timer import StageTimer

pytestmark = pytest.mark.kernel  # the room imports it

BALL = fields.sphere((1.0, 1.1, 0.9), 0.7)


def fit(monkeypatch: pytest.MonkeyPatch, betti: Any, field: fields.Field = BALL) -> tuple[FieldPatches, list[bool]]:
    """The field's patches, with Betti numbers said of the field (value or function), and which fits sought hidden crossings."""
    looks: list[bool] = []
    fit_field = field_patches.fit_field

    def record(*args: Any, **options: Any) -> Any:
        looks.append(options.get("detect_hidden_crossings", False))
        return fit_field(*args, **options)

    monkeypatch.setattr(field_patches, "fit_field", record)
    monkeypatch.setattr(field_patches, "compute_betti_numbers", betti if callable(betti) else lambda *_, **__: betti)
    return fit_field_patches(field, np.zeros(3), np.full(3, 2.0), 2e-2, StageTimer(lambda *_: None)), looks


def failed(found: FieldPatches) -> list[str]:
    return [check.shortfall for check in measure_field_patches(found).checks if not check.passed]


@pytest.mark.parametrize("betti", [(1, 0, 0), None])
def test_numbers_that_agree_or_are_unknown_need_one_look(
    betti: tuple[int, int, int] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, looks = fit(monkeypatch, betti)
    assert looks == [False]
    assert failed(found) == []
    assert ("did not settle" in " ".join(measure_field_patches(found).notes)) == (betti is None)


def test_numbers_that_differ_lead_to_a_second_look_and_a_shortfall(monkeypatch: pytest.MonkeyPatch) -> None:
    found, looks = fit(monkeypatch, (2, 0, 0))
    assert looks == [False, True]
    assert found.properties.betti == (1, 0, 0)
    assert failed(found) == [
        "Betti numbers (1, 0, 0) differ from the field's, (2, 0, 0): use a finer `tol`; "
        "of a blend, subgrid_check=True removes isolated parts that lie between its samples"
    ]


BALL_AND_SPECK = fields.expression(
    "((x - 1)^2 + (y - 1.1)^2 + (z - 0.9)^2 - 0.49) * ((x - 1.83)^2 + (y - 1.78)^2 + (z - 1.81)^2 - 0.015^2)"
)


def test_a_part_that_the_first_look_misses_is_found_by_continuing_it(monkeypatch: pytest.MonkeyPatch) -> None:
    found, looks = fit(monkeypatch, field_patches.compute_betti_numbers, BALL_AND_SPECK)
    assert looks == [False]
    assert found.properties.betti == (2, 0, 0)
    assert failed(found) == []
    monkeypatch.setattr(field_patches, "refine_field_fit", lambda unchanged, *_: unchanged)
    assert fit(monkeypatch, field_patches.compute_betti_numbers, BALL_AND_SPECK)[1][:2] == [False, True]


def test_a_continued_fit_that_fails_is_repeated_from_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> Any:
        raise LevelSetError("4 places could not be fitted")

    monkeypatch.setattr(field_patches, "refine_field_fit", fail)
    assert fit(monkeypatch, (2, 0, 0))[1] == [False, True]


def test_a_finer_grid_that_agrees_with_the_patches_spares_the_second_look(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(field_patches, "FINER_LINES", 40.0)
    count = field_patches.compute_betti_numbers
    said = iter([(2, 0, 0), None])

    def mislead(*args: Any, **options: Any) -> Any:
        return next(said) or count(*args, **options)

    found, looks = fit(monkeypatch, mislead)
    assert looks == [False]
    assert found.field_betti == (1, 0, 0)
    assert failed(found) == []


def test_uncertain_numbers_that_differ_lead_to_a_second_look_and_no_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    def uncertain(*args: Any, confirm: Any) -> Any:
        return (1, 1, 0) if confirm((1, 1, 0)) else None

    found, looks = fit(monkeypatch, uncertain)
    assert looks == [False, True]
    assert found.field_betti is None
    assert failed(found) == []


def test_every_figure_beyond_its_limit_is_a_shortfall(monkeypatch: pytest.MonkeyPatch) -> None:
    found, _ = fit(monkeypatch, (1, 0, 0))
    rough = replace(found.fitted, jump_deg=0.011)
    words = failed(replace(found, fitted=rough, field_volume=1.01 * found.field_volume))
    assert words[0].split(" exceeds ")[-1] == "0.01"
    assert "differs from the field's" in words[1]
    assert len(words) == 2


@pytest.mark.parametrize(("betti", "possible"), [((1, 0, 0), True), ((1, 1, 0), False), ((2, 1, 0), False)])
def test_patches_can_have_betti_numbers_only_with_their_shells_and_euler_characteristic(
    betti: tuple[int, int, int], possible: bool
) -> None:
    assert field_patches._could_have(plane_box(), betti) is possible


def test_fits_use_one_thread_of_blas_and_give_the_others_back(monkeypatch: pytest.MonkeyPatch) -> None:
    def count_threads() -> set[int]:
        return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}

    seen: list[set[int]] = []
    fit_field = field_patches.fit_field

    def record(*args: Any, **options: Any) -> Any:
        seen.append(count_threads())
        return fit_field(*args, **options)

    monkeypatch.setattr(field_patches, "fit_field", record)
    with threadpool_limits(2, user_api="blas"):
        fit_field_patches(BALL, np.zeros(3), np.full(3, 2.0), 2e-2, StageTimer(lambda *_: None))
        assert count_threads() == {2}
    assert seen == [{1}]
