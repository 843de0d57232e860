"""The policy of methods that may fail: the first that succeeds, and what failed before it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tpmscad.errors import InvalidRequest, KernelError, LevelSetError, MissingDomain, TpmscadError, TrimmingError
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.stage_timer import StageTimer


def make_fallbacks(*steps: str | TpmscadError) -> tuple[Fallbacks[[int], str], list[int]]:
    """Methods that return a word or raise an error, and the arguments that they are called with."""
    calls: list[int] = []

    def run(step: str | TpmscadError, argument: int) -> str:
        calls.append(argument)
        if isinstance(step, str):
            return step
        raise step

    methods = (Fallback(f"way {n}", lambda argument, step=step: run(step, argument)) for n, step in enumerate(steps))
    return Fallbacks(tuple(methods)), calls


def test_the_first_method_that_succeeds_is_taken_and_the_failures_before_it_are_kept() -> None:
    methods, calls = make_fallbacks(TrimmingError("open"), KernelError("cut", "null"), "third", "fourth")
    outcome = methods.run(7)
    assert (outcome.value, outcome.name, calls) == ("third", "way 2", [7, 7, 7])
    assert [type(failure) for failure in outcome.failures] == [TrimmingError, KernelError]
    assert outcome.reasons.startswith("open; ")
    assert make_fallbacks("first")[0].run(1).reasons == ""


@pytest.mark.parametrize("error", [MissingDomain("no wall"), LevelSetError("not smooth")])
def test_an_error_that_no_other_method_avoids_is_raised_at_once(error: TpmscadError) -> None:
    methods, calls = make_fallbacks(error, "second")
    with pytest.raises(type(error), match=str(error)):
        methods.run(7)
    assert calls == [7]


def test_where_all_methods_fail_the_error_ends_in_the_remedy_unless_the_request_is_refused() -> None:
    methods = replace(make_fallbacks(TrimmingError("open"), InvalidRequest("free-form"))[0], remedy="change `tol`")
    with pytest.raises(TrimmingError, match=r"^open \(way 0; also tried: way 1: free-form\); change `tol`$"):
        methods.run(0)
    refused = replace(make_fallbacks(InvalidRequest("free-form"))[0], remedy="change `tol`")
    with pytest.raises(InvalidRequest, match=r"^free-form$"):
        refused.run(0)


def test_the_progress_tells_what_failed_before_another_method_starts() -> None:
    told: list[str] = []
    methods, _ = make_fallbacks(TrimmingError("open at (1, 2, 3)"), "second")
    with StageTimer(lambda name, done: told.append(name))("trim"):
        methods.run(0)
    assert told == ["trim", "way 1, after open at (1, 2, 3)", "trim", "trim"]


def test_the_reason_of_the_first_method_that_applies_comes_first_and_each_other_one_once() -> None:
    methods, _ = make_fallbacks(
        InvalidRequest("free-form"), TrimmingError("open"), KernelError("cut", "null"), KernelError("cut", "null")
    )
    with pytest.raises(TrimmingError) as caught:
        methods.run(0)
    assert str(caught.value) == "open (way 1; also tried: way 0: free-form; way 2: cut: null)"
    with pytest.raises(TrimmingError, match=r"^lost$"):
        make_fallbacks(TrimmingError("lost"), TrimmingError("lost"))[0].run(0)
    with pytest.raises(InvalidRequest, match=r"^free-form \(way 0; also tried: way 1: trimmed\)$"):
        make_fallbacks(InvalidRequest("free-form"), InvalidRequest("trimmed"))[0].run(0)
