"""A call that does not fit is answered with the keyword that was meant and the call as it is written."""

from __future__ import annotations

import inspect
from typing import Annotated, Any

import pytest

import tpmscad
from tpmscad import fields
from tpmscad.api.public_calls import SYNONYMS, validate_call
from tpmscad.api.shared_kinds import ANYTHING
from tpmscad.errors import InvalidRequest, MisusedCall, UnexpectedError

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: tpmscad.lattice("gyroid", 10, 1), ["by position", "cell=10", "thickness=1"]),
        (lambda: tpmscad.lattice("gyroid", period=10, thickness=1), ["'period'", "cell="]),
        (lambda: tpmscad.lattice("gyroid", cell=10, thicknes=1), ["'thicknes'", "called thickness="]),
        (lambda: tpmscad.infill("part.step", "gyroid", 8, 0.8), ["body and surface by position", "cell=8"]),
        (lambda: tpmscad.fluid_domains("part.step"), ["surface", "cell=10"]),
        (lambda: tpmscad.solidify(fields.tpms("gyroid"), ((0, 0, 0), (1, 1, 1))), ["tol", "tol=0.01"]),
    ],
)
def test_the_answer_names_the_keyword_and_shows_the_call(call: Any, words: list[str]) -> None:
    with pytest.raises(MisusedCall) as refused:
        call()
    assert isinstance(refused.value, TypeError | InvalidRequest)
    assert all(word in str(refused.value) for word in words), str(refused.value)


def test_an_error_inside_the_function_is_its_own() -> None:
    @validate_call("half(3)")
    def half(source: Annotated[Any, ANYTHING, "A number."]) -> Any:
        return source / 2

    assert half(3) == 1.5
    assert list(inspect.signature(half).parameters) == ["source"]
    with pytest.raises(UnexpectedError, match=r"half failed .* unsupported operand") as raised:
        half("three")
    assert isinstance(raised.value.__cause__, TypeError)


def test_every_synonym_stands_for_a_keyword_and_is_none() -> None:
    functions = (tpmscad.lattice, tpmscad.infill, tpmscad.solidify, tpmscad.fluid_domains)
    known = {name for function in functions for name in inspect.signature(function).parameters}
    assert set(SYNONYMS.values()) <= known
    assert not set(SYNONYMS) & known


def test_fields_take_the_cell_of_lattices_for_their_period() -> None:
    assert fields.tpms("gyroid", cell=8).periods() == fields.tpms("gyroid", period=8).periods() == (8.0, 8.0, 8.0)
    assert fields.tpms("gyroid").periods() == (10.0, 10.0, 10.0)
    unit = fields.bspline_unit([[[1.0, 2.0], [3.0, 4.0]]], cell=(1, 2, 3))
    assert unit.periods() == (1.0, 2.0, 3.0)
    with pytest.raises(InvalidRequest, match=r"period 8\.0 and cell 9\.0"):
        fields.tpms("gyroid", period=8, cell=9)
    with pytest.raises(InvalidRequest, match="cell"):
        fields.tpms("gyroid", cell=-1)


@pytest.mark.parametrize("module", [tpmscad, tpmscad.fields, tpmscad.maps, tpmscad.surfaces, tpmscad.topology])
def test_completion_lists_public_names_only(module: Any) -> None:
    names = dir(module)
    assert set(names) == set(module.__all__) - {"__version__"}
    assert not [name for name in names if inspect.ismodule(getattr(module, name)) and module is not tpmscad]


def test_completion_of_the_build123d_face_lists_its_two_parts() -> None:
    import tpmscad.build123d

    assert dir(tpmscad.build123d) == ["Struts", "Tpms", "TpmsInfill"]
