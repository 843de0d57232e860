"""The door of the package: arguments are declared by annotations, what does not fit is refused, and only our errors leave."""

from __future__ import annotations

import dataclasses
import inspect
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest

import tpmscad
from benchmarks import fuzz
from tpmscad import fields
from tpmscad.api.arguments import arguments_of
from tpmscad.api.public_calls import validate_call, validate_options
from tpmscad.api.shared_kinds import ANYTHING
from tpmscad.errors import (
    InvalidRequest,
    MisusedCall,
    NestedTooDeeply,
    NotMet,
    OutOfMemory,
    TpmscadError,
    UserFunctionError,
)
from tpmscad.memory_limit import format_bytes, physical_memory, require_memory

pytestmark = pytest.mark.kernel


def test_every_public_function_passes_the_door() -> None:
    targets = {target.function for target in fuzz.find_targets()}
    for module in (tpmscad, fields, tpmscad.maps, tpmscad.surfaces, tpmscad.topology):
        for name in module.__all__:
            value = getattr(module, name)
            if inspect.isfunction(value) and value not in targets:
                assert not [p for p in inspect.signature(value).parameters.values() if p.kind is not p.VAR_KEYWORD], (
                    name
                )


def test_the_example_of_every_argument_is_what_it_takes() -> None:
    for target in fuzz.find_targets():
        for argument in arguments_of(target.function).values():
            if argument.kind.example:
                argument.kind.read(fuzz.evaluate_example(argument))


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda: tpmscad.lattice("gyroid", cell=10, thickness=True),
            "thickness True is not a number; .* as in thickness=1.0",
        ),
        (lambda: tpmscad.lattice("gyroid", cell=b"10", thickness=1), "cell b'10' is not a number"),
        (lambda: tpmscad.lattice("gyroid", cell=10, thickness=1, phase=(0, np.nan, 0)), "phase .* must be finite"),
        (lambda: fields.warp(fields.tpms("gyroid"), 3), "map 3 can't be called"),
        (lambda: fields.rotate(1.0, "x", float("nan")), "angle nan must be finite"),
        (lambda: fields.sphere((0, 0, 0), 1e308), r"radius 1e\+308 is beyond 1e\+100"),
        (lambda: fields.sphere((0, 0, 0), 10**400), r"radius 1000.* is beyond 1e\+100"),
    ],
)
def test_values_of_the_wrong_kind_are_refused_by_name_value_and_example(call: Any, said: str) -> None:
    with pytest.raises(InvalidRequest, match=said):
        call()


def test_a_list_of_three_is_as_good_as_a_tuple() -> None:
    parts = [fields.rod(fields.tpms(name, 0.5), 0.0) for name in ("gyroid", "schwarz_p")]
    regions = [fields.box((0, 0, 0), (0.5, 0.5, 0.5)), fields.box((0.5, 0, 0), (1, 0.5, 0.5))]
    result = tpmscad.blend(parts, regions, [fields.box((0.3, 0, 0), (0.7, 0.5, 0.5))], resolution=[24, 13, 12])
    assert result.resolution == (24, 13, 12)


def test_the_exception_of_a_given_function_is_the_cause_on_the_trial_and_later() -> None:
    def fails(points: np.ndarray) -> Any:
        raise KeyError("density")

    with pytest.raises(UserFunctionError, match="fails raised KeyError: 'density'") as caught:
        fields.from_function(fails)
    assert isinstance(caught.value.__cause__, KeyError)
    later = fields.from_function(lambda p: p[:, 0] if len(p) < 6 else fails(p))
    with pytest.raises(UserFunctionError, match="raised KeyError: 'density'") as caught:
        later(np.zeros((9, 3)))
    assert isinstance(caught.value.__cause__, KeyError)
    mapped = tpmscad.maps.Map(fails)
    with pytest.raises(UserFunctionError, match="user map raised KeyError"):
        mapped((1.0, 2.0, 3.0))


def test_a_given_function_in_which_a_function_of_the_package_fails_is_named() -> None:
    @validate_call("half(3)")
    def half(source: Annotated[Any, ANYTHING, "A number."]) -> Any:
        return source / 2

    def outline(points: np.ndarray) -> Any:
        return points[:, 0] - half("three")

    with pytest.raises(UserFunctionError, match=r"outline raised .*half failed .* unsupported operand") as caught:
        fields.from_function(outline)
    assert isinstance(caught.value.__cause__, TypeError)


def test_many_fields_join_by_union_where_a_chain_is_refused() -> None:
    balls = [fields.sphere((i, 0, 0), 0.5) for i in range(3000)]
    assert fields.union(*balls)((2999.0, 0.0, 0.0)) == -0.5
    chain = balls[0]
    for ball in balls[1:]:
        chain = chain | ball
    with pytest.raises(NestedTooDeeply, match=r"fields\.union"):
        chain((1.0, 2.0, 3.0))


def test_a_call_of_a_field_that_does_not_fit_names_its_arguments() -> None:
    with pytest.raises(MisusedCall, match="points"):
        fields.tpms("gyroid")(1.0, 2.0, 3.0)  # type: ignore[call-arg]


def test_requests_beyond_the_memory_are_refused_before_it_is_taken() -> None:
    rod = fields.rod(fields.tpms("gyroid", 0.01), 0.1)
    with pytest.raises(OutOfMemory, match=r"TiB of memory.*larger cells or a smaller box"):
        tpmscad.solidify(rod, ((0, 0, 0), (10, 10, 10)), tol=0.001)
    with pytest.raises(OutOfMemory, match="export_slabs"):
        tpmscad.lattice("gyroid", cell=1, cells=(1000, 1000, 1000), thickness=0.1)
    with pytest.raises(OutOfMemory, match="fewer samples"):
        fields.volume_fraction(fields.tpms("gyroid"), samples=10**5)
    for make in (tpmscad.struts, lambda kind, cell, cells, diameter: fields.strut_lattice(kind, cell, diameter, cells)):
        with pytest.raises(OutOfMemory, match=r"struts of 2000 x 2000 x 2000 cells; use fewer cells"):
            make("octet", cell=6, cells=(2000, 2000, 2000), diameter=0.8)
        with pytest.raises(OutOfMemory, match=r"struts of 1e\+99 x 1 x 1 cells"):
            make("octet", cell=6, cells=(10**99, 1, 1), diameter=0.8)
    require_memory(1, physical_memory() / 2, "half of it", "nothing")
    with pytest.raises(OutOfMemory):
        require_memory(2, physical_memory(), "twice of it", "half of it")
    assert [format_bytes(n) for n in (5, 2048, 3.7 * 2**40)] == ["5 bytes", "2 KiB", "3.7 TiB"]


def test_memory_that_the_process_may_not_take_is_not_counted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    whole = physical_memory.__wrapped__()
    (tmp_path / "memory.max").write_text("3000000\n")
    monkeypatch.setattr("tpmscad.memory_limit.CONTAINER_LIMITS", (tmp_path / "memory.max", tmp_path / "missing"))
    assert physical_memory.__wrapped__() == 3_000_000
    (tmp_path / "memory.max").write_text("max\n")
    assert physical_memory.__wrapped__() >= whole
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (2_000_000, -1))
    assert physical_memory.__wrapped__() == 2_000_000


def test_a_solid_of_a_field_without_slope_on_its_surface_is_refused() -> None:
    flat = fields.from_function(lambda p: (p[:, 0] - 5) ** 3, gradient=lambda p: 3 * (p - 5) ** 2 * [1, 0, 0])
    with pytest.raises(TpmscadError, match="gradient is zero"):
        tpmscad.solidify(flat, ((0, 0, 0), (10, 10, 10)), tol=0.5)


@pytest.mark.slow
def test_hostile_values_give_results_or_refusals_only() -> None:
    tally = fuzz.run(seed=14, count=1500)
    assert not tally.failures, "\n".join(f"{kind}: {call}" for kind, call in tally.failures.items())
    assert tally.outcomes["result"] > 25
    assert tally.outcomes["refusal"] > 500


def test_a_name_that_the_package_lacks_is_answered_with_the_nearest() -> None:
    with pytest.raises(AttributeError, match="no attribute 'fill'; did you mean 'infill'"):
        tpmscad.fill  # noqa: B018


@pytest.mark.parametrize(
    "refused",
    [
        lambda: tpmscad.lattice("gyroid", cell=-1),
        lambda: tpmscad.lattice("gyroid", period=10),
        lambda: tpmscad.lattice("gyro", cell=10, thickness=1),
        lambda: tpmscad.lattice("gyroid", cell=10),
        lambda: tpmscad.maps.cylinder(-1),
        lambda: tpmscad.maps.cylinder(),
        lambda: fields.tpms("gyroid")([1, 2]),
        lambda: tpmscad.read_body("no_such_file.step"),
    ],
    ids=["value", "keyword", "choice", "combination", "map", "missing", "points", "file"],
)
def test_the_traceback_of_a_refusal_is_the_line_of_the_caller_and_one_hidden_frame(refused: Callable[[], Any]) -> None:
    with pytest.raises(InvalidRequest) as caught:
        refused()
    frames = [frame for frame, _ in traceback.walk_tb(caught.value.__traceback__)]
    assert len(frames) == 3  # this one, the lambda's, the door's
    assert [frame.f_locals.get("__tracebackhide__", False) for frame in frames] == [False, False, True]
    assert "During handling" not in "".join(traceback.format_exception(caught.value))


def test_a_refusal_inside_public_functions_that_call_each_other_has_one_frame_of_the_door() -> None:
    @validate_call("outer()")
    def outer() -> Any:
        return tpmscad.maps.cylinder(-1)

    with pytest.raises(InvalidRequest) as caught:
        outer()
    assert len(list(traceback.walk_tb(caught.value.__traceback__))) == 2


def test_other_errors_keep_the_frames_of_the_package_and_hide_those_of_the_door() -> None:
    @dataclasses.dataclass(frozen=True)
    class Options:
        value: Annotated[int, ANYTHING, "A number."]

    @validate_options(Options, "measure(1)")
    def measure(options: Options) -> None:
        raise NotMet(f"{options.value} is too much")

    with pytest.raises(NotMet) as caught:
        measure(1)
    frames = [frame for frame, _ in traceback.walk_tb(caught.value.__traceback__)]
    door = [frame for frame in frames if frame.f_code.co_filename == validate_call.__code__.co_filename]
    assert len(door) == 3
    assert all(frame.f_locals["__tracebackhide__"] for frame in door)
    assert frames[-1].f_code.co_name == "measure"
