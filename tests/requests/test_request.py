"""Requests that can't be carried out are refused with the value, the limit and the remedy, before anything is made."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tpmscad import maps, surfaces
from tpmscad.errors import InvalidRequest
from tpmscad.requests.lattice_request import read_lattice_request

IDENTITY = maps.as_map(lambda points: points)

PLAIN: dict[str, Any] = {
    "cell": 10.0,
    "cells": 1,
    "thickness": None,
    "offset": None,
    "volume_fraction": None,
    "kind": "sheet",
    "side": "-",
    "reference": None,
    "boundary": "box",
    "phase": (0, 0, 0),
    "tol": None,
    "map": None,
}


def request(surface: str = "gyroid", **changes: Any) -> Any:
    return read_lattice_request(surface, **(PLAIN | changes))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"surface": "gyrod", "thickness": 1}, ("gyrod", "gyroid")),
        ({"cell": 0, "thickness": 1}, ("cell 0", "positive")),
        ({"cell": (10, 10), "thickness": 1}, ("cell", "three")),
        ({"cell": math.inf, "thickness": 1}, ("cell inf", "finite")),
        ({"cell": "ten", "thickness": 1}, ("cell 'ten'", "not a number")),
        ({"cells": (2, 0, 1), "thickness": 1}, ("cells (2, 0, 1)", "positive")),
        ({"cells": 1.5, "thickness": 1}, ("cells 1.5", "whole")),
        ({"thickness": -1}, ("thickness -1", "positive")),
        ({"thickness": 1, "offset": (-1, 1)}, ("exactly one", "`thickness` and `offset`")),
        ({}, ("exactly one", "none")),
        ({"offset": (1, -1)}, ("offset [1.0, -1.0]", "lower first")),
        ({"volume_fraction": 1.2}, ("volume_fraction 1.2", "below 1")),
        ({"kind": "solid", "thickness": 1}, ("kind 'solid'", "'sheet'", "'skeletal'")),
        ({"reference": "exact", "thickness": 1}, ("reference 'exact'", "'minimal'")),
        ({"thickness": 1, "tol": 0}, ("tol 0", "positive")),
        ({"thickness": 1, "phase": (0.5,)}, ("phase", "three")),
        (
            {"surface": "octo", "thickness": 1, "reference": "minimal"},
            ("reference 'minimal' of the octo", "O,C-TO", "nodal"),
        ),
        ({"surface": "F-RD", "thickness": 1.1}, ("offset", "frd", "between -0.71", "0.536", "thin")),
        (
            {"surface": "neovius", "thickness": 0.5, "map": IDENTITY},
            ("map", "mirror planes of the Neovius", "tpmscad.solidify"),
        ),
        ({"surface": "lidinoid", "thickness": 0.5, "map": IDENTITY}, ("Lidinoid", "map", "tpmscad.solidify")),
        ({"surface": "S", "thickness": 0.5, "boundary": "natural"}, ("Fischer-Koch S", "boundary='box'")),
        ({"porosity": 0.7, "volume_fraction": 0.3}, ("`volume_fraction` and `porosity`",)),
        ({"porosity": 1.2}, ("porosity 1.2", "below 1")),
    ],
)
def test_what_is_wrong_is_named_with_the_way_out(changes: dict[str, Any], words: tuple[str, ...]) -> None:
    with pytest.raises(InvalidRequest) as error:
        request(**changes)
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize("name", ["gyroid", "diamond", "schwarz_p"])
@pytest.mark.parametrize("reference", ["minimal", "nodal"])
def test_the_thickness_named_in_the_refusal_is_the_limit(name: str, reference: str) -> None:
    limit = 2 * surfaces.primitive_patch(name, reference).max_offset * 10
    assert request(name, thickness=limit * 0.999, reference=reference).offset[1] == pytest.approx(limit * 0.4995)
    with pytest.raises(InvalidRequest, match=f"thickness below {limit:.6g}"):
        request(name, thickness=limit * 1.001, reference=reference)


@given(st.floats(0.05, 0.6), st.sampled_from(["gyroid", "diamond", "schwarz_p"]), st.floats(0.5, 50))
def test_volume_fractions_become_offsets_that_scale_with_the_cell(fraction: float, name: str, cell: float) -> None:
    try:
        lower, upper = request(name, volume_fraction=fraction, cell=cell).offset
    except InvalidRequest as refusal:
        assert "out of reach" in str(refusal)  # noqa: PT017  refusals are part of the law
        return
    assert lower == -upper
    assert surfaces.volume_fraction(name, "minimal", lower / cell, upper / cell) == pytest.approx(fraction, rel=1e-9)


@given(
    st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.text(max_size=3), st.none()),
    st.sampled_from(["cell", "tol", "thickness", "volume_fraction"]),
)
def test_odd_numbers_are_resolved_or_refused_never_passed_on(value: Any, label: str) -> None:
    changes = {"thickness": 0.5} | {label: value}
    if label == "volume_fraction":
        changes.pop("thickness")
    try:
        made = request(**changes)
    except InvalidRequest:
        return
    numbers = [*made.cell, *made.offset, made.tol]
    assert all(math.isfinite(n) for n in numbers)
    assert min(*made.cell, made.tol) > 0


@pytest.mark.parametrize("name", surfaces.CATALOGUE)
def test_without_a_reference_the_exact_surface_is_meant_where_there_is_one(name: str) -> None:
    references = surfaces.CATALOGUE[name].references
    if references:
        assert request(name, thickness=0.3).reference == references[0]
