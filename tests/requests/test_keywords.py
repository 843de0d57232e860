"""An argument that is declared once is found wherever it is taken: in the signature, the door, the help and the front ends."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Annotated, Any

import pytest

from tpmscad.api.arguments import arguments_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import POSITIVE
from tpmscad.errors import InvalidRequest
from tpmscad.solids._fluid_domains import fluid_domains
from tpmscad.solids._infill import infill
from tpmscad.solids._lattice import lattice

pytestmark = pytest.mark.kernel


def keywords(function: Callable[..., Any]) -> set[str]:
    parameters = inspect.signature(function).parameters
    return {name for name, p in parameters.items() if p.kind is inspect.Parameter.KEYWORD_ONLY}


@pytest.mark.parametrize("function", [lattice, infill, fluid_domains])
def test_signature_door_and_help_hold_the_same_arguments(function: Callable[..., Any]) -> None:
    declared = arguments_of(function)
    assert list(declared) == list(inspect.signature(function).parameters)
    for argument in declared.values():
        assert f"\n{argument.heading}\n" in str(function.__doc__)
        assert argument.meaning.endswith(".")


def test_fluid_domains_takes_the_keywords_of_infill_that_apply_to_a_sheet() -> None:
    own = {"openings", "transition"}
    assert keywords(fluid_domains) == keywords(infill) - {"kind", "side", "open_faces", "loose", "map"} | own


def test_an_argument_without_a_declaration_is_noticed() -> None:
    def half(size: float) -> float:
        """Half of a size."""
        return size / 2

    with pytest.raises(LookupError, match=r"declare what size of .*half takes"):
        validate_call()(half)


def test_an_argument_is_declared_by_its_annotation_alone() -> None:
    @validate_call()
    def half(size: Annotated[float, POSITIVE, "Length of the whole, mm."]) -> float:
        """Half of a size."""
        return size / 2

    assert half(3) == 1.5
    assert "size : a positive number\n    Length of the whole, mm." in str(half.__doc__)
    with pytest.raises(InvalidRequest, match=r"size -1 must be positive; it takes a positive number, as in size=1\.0"):
        half(size=-1)
