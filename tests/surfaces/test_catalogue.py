"""Names of the catalogue."""

from __future__ import annotations

import pytest

from tpmscad import surfaces
from tpmscad.errors import InvalidRequest


@pytest.mark.parametrize("name", surfaces.CATALOGUE)
def test_every_spelling_finds_its_entry(name: str) -> None:
    info = surfaces.CATALOGUE[name]
    assert info.name == name
    for spelling in (name, info.title, *info.aliases):
        for variant in (spelling, spelling.upper(), f" {spelling.replace('_', '-')} ", spelling.replace("_", " ")):
            assert surfaces.find_surface(variant) is info
            if info.primitives == "exact":
                assert surfaces.primitive_patch(variant).name == name


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [("gyriod", "gyroid"), ("dimond", "diamond"), ("schwarz", "schwarz_p"), ("Primitve", "schwarz_p")],
)
def test_a_slip_is_answered_with_the_nearest_name(wrong: str, meant: str) -> None:
    with pytest.raises(InvalidRequest, match=f"unknown surface '{wrong}': did you mean '{meant}'"):
        surfaces.find_surface(wrong)


@pytest.mark.parametrize("wrong", ["", "kelvin foam"])
def test_what_is_like_nothing_is_answered_with_the_list(wrong: str) -> None:
    with pytest.raises(InvalidRequest, match=r"unknown surface .*: choose one of gyroid, diamond, schwarz_p"):
        surfaces.find_surface(wrong)


def test_an_unknown_reference_is_answered_with_the_choice() -> None:
    with pytest.raises(
        InvalidRequest, match="reference 'exact' of the gyroid is unknown; choose one of minimal, nodal"
    ):
        surfaces.primitive_patch("G", "exact")


def test_entries_cannot_be_changed() -> None:
    with pytest.raises(TypeError):
        surfaces.CATALOGUE["gyroid"] = None
    with pytest.raises(AttributeError):
        surfaces.find_surface("gyroid").genus = 4
