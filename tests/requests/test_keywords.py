"""The keywords of a lattice are the same in every function, front end and command that takes them."""

from __future__ import annotations

import inspect
from typing import Any

import pytest

from tpmscad.cli.infill_command import infill as infill_command
from tpmscad.cli.lattice_command import lattice as lattice_command
from tpmscad.requests.lattice_request import (
    INFILL_DEFAULTS,
    LATTICE_DEFAULTS,
    InfillOptions,
    LatticeOptions,
    with_keywords_of,
)
from tpmscad.solids._fluid_domains import fluid_domains
from tpmscad.solids._infill import infill
from tpmscad.solids._lattice import lattice

pytestmark = pytest.mark.kernel


def keywords(function: Any) -> dict[str, inspect.Parameter]:
    parameters = inspect.signature(function).parameters
    return {name: p for name, p in parameters.items() if p.kind is inspect.Parameter.KEYWORD_ONLY}


def test_the_typed_dictionaries_hold_the_keywords_of_lattice_and_infill() -> None:
    assert set(keywords(lattice)) == set(LatticeOptions.__annotations__)
    assert set(keywords(infill)) == set(InfillOptions.__annotations__)


@pytest.mark.parametrize(("function", "defaults"), [(lattice, LATTICE_DEFAULTS), (infill, INFILL_DEFAULTS)])
def test_the_tables_hold_the_defaults_of_lattice_and_infill(function: Any, defaults: Any) -> None:
    assert {name: p.default for name, p in keywords(function).items() if p.default is not p.empty} == defaults


def test_fluid_domains_takes_the_keywords_of_infill_that_apply_to_a_sheet() -> None:
    assert keywords(fluid_domains).keys() == keywords(infill).keys() - {"kind", "side", "skin", "open_faces", "loose"}


@pytest.mark.parametrize(("command", "function"), [(lattice_command, lattice), (infill_command, infill)])
def test_a_command_takes_the_keywords_of_its_function(command: Any, function: Any) -> None:
    missing = keywords(function).keys() - inspect.signature(command).parameters.keys()
    assert missing <= {"map", "progress", "open_faces", "loose"}


def test_a_front_end_shows_every_keyword_before_its_own() -> None:
    @with_keywords_of(lattice)
    def part(surface: str, *, mode: str = "add", **options: Any) -> None:
        """A part."""

    shown = inspect.signature(part).parameters
    assert list(shown) == ["surface", *keywords(lattice), "mode"]
    assert all(shown[name] == p for name, p in keywords(lattice).items())
