"""Refusals of recipes: each text that cannot be carried out, with words of the message, which begins with file, line and key."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.refusals.refused import check_refusal
from tpmscad.errors import InvalidRequest, RecipeError
from tpmscad.recipe.key_reference import format_reference
from tpmscad.recipe.solid_recipe import read_solid_recipe

SOLID = "tol = 0.1\ndomain = [[0, 0, 0], [1, 1, 1]]\n"
ROD = 'kind = "rod"\nsurface = "gyroid"\nperiod = 10\n'

FIELDS: dict[str, tuple[str, str]] = {
    "no kind": ("radius = 1", "the key 'kind' is missing"),
    "key of another key": ('kind = "rod"\nof = 3\nperiod = 2\nlevel = 0', "only together with 'surface'"),
    "key twice": ('kind = "tpms"\nsurface = "gyroid"\nperiod = 1\ncell = 2', "is another name of"),
    "two of one": (f"{ROD}level = 0\nvolume_fraction = 0.3", "give exactly one of"),
    "none of one": (ROD, "none of them"),
    "field of itself": (
        'kind = "complement"\nof = "a"\n[fields.a]\nkind="complement"\nof="b"\n[fields.b]\nkind="complement"\nof="a"',
        "the field 'a' is defined by itself: a -> b -> a",
    ),
    "infinite number": ('kind = "sphere"\ncenter = [0, 0, inf]\nradius = 1', "must be finite"),
    "no array": ('kind = "sphere"\ncenter = 3\nradius = 1', r"3 must be three numbers \[x, y, z\]"),
    "no table": ('kind = "cell_sizes"\nsurface = "gyroid"\nperiod = 1\nx = 3', "3 is no table; it takes a table { at"),
    "no truth": ('kind = "ramp"\nby = "x"\nspan = [0, 1]\nvalues = [0, 1]\nsmooth = 1', "1 must be true or false"),
    "no string": ('kind = "image"\nfile = 3\nlo = [0, 0]\nhi = [1, 1]', "3 is no path of a file"),
    "no file": ('kind = "image"\nfile = "no.png"\nlo = [0, 0]\nhi = [1, 1]', "there is no file"),
    "count of zero": ('kind = "bspline"\nseed = 1\ncount = [3, 0, 3]\nperiod = 1', "0 must be positive: at least 1"),
    "ragged coefficients": (
        'kind = "bspline"\ncoefficients = [[[1, 2], [3]]]\nperiod = 1',
        "no array of numbers of one shape",
    ),
    "vector of length zero": ('kind = "halfspace"\npoint = [0, 0, 0]\nnormal = [0, 0, 0]', "its length is zero"),
    "corner of four": (
        'kind = "image"\nfile = "mask.npy"\nlo = [0, 0, 0, 0]\nhi = [1, 1, 1]',
        "lo must be 3 numbers, not 4",
    ),
    "union of none": ('kind = "union"\nof = []', "at least one field is needed"),
    "fraction of two": (f"{ROD}volume_fraction = 2", r"volume_fraction: 2 must lie below 1"),
    "fraction without period": ('kind = "rod"\nof = 3\nvolume_fraction = 0.3', "solved over one period"),
    "fraction of a ball": (
        f'{ROD}volume_fraction = {{ kind = "sphere", center = [0, 0, 0], radius = 1 }}',
        'kind = "ramp"',
    ),
    "what the field refuses": ('kind = "box"\nlo = [1, 0, 0]\nhi = [0, 1, 1]', "each lo below its hi"),
    "no NumPy file": ('kind = "bspline"\nfile = "text.npy"\nperiod = 1', "not an array that NumPy saved"),
    "points with words": ('kind = "scattered"\nfile = "words.csv"', "line 2: .*not numbers"),
    "points of three columns": ('kind = "scattered"\nfile = "narrow.csv"', "line 1: 3 columns"),
    "no points": ('kind = "scattered"\nfile = "empty.csv"', "no row of x, y, z"),
    "mask of numbers": ('kind = "image"\nfile = "numbers.npy"\nlo = [0, 0]\nhi = [1, 1]', "not booleans"),
    "picture of one side": (
        'kind = "image"\nfile = "white.png"\nlo = [0, 0]\nhi = [1, 1]',
        "all pixels .* on one side",
    ),
    "no PNG": ('kind = "image"\nfile = "text.png"\nlo = [0, 0]\nhi = [1, 1]', "not a PNG file"),
    "half a PNG": ('kind = "image"\nfile = "half.png"\nlo = [0, 0]\nhi = [1, 1]', "incomplete|decompressed"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recipes")
    (path / "text.npy").write_text("no array")
    (path / "text.png").write_text("no picture")
    (path / "words.csv").write_text("0,0,0,1\n1,b,2,3\n")
    (path / "narrow.csv").write_text("0,0,0\n")
    (path / "empty.csv").write_text("# nothing\n")
    np.save(path / "mask.npy", np.arange(27).reshape(3, 3, 3) > 9)
    np.save(path / "numbers.npy", np.eye(3))
    Image.new("L", (4, 4), 255).save(path / "white.png")
    Image.effect_noise((40, 40), 60).save(path / "noise.png")
    (path / "half.png").write_bytes((path / "noise.png").read_bytes()[:200])
    return path


@pytest.mark.parametrize("name", FIELDS)
def test_a_field_that_cannot_be_made_is_refused_at_its_line(name: str, folder: Path) -> None:
    text, words = FIELDS[name]
    path = folder / "part.toml"
    path.write_text(f"{SOLID}[field]\n{text}\n")
    check_refusal((lambda: read_solid_recipe(path), words), RecipeError)
    with pytest.raises(RecipeError) as caught:
        read_solid_recipe(path)
    assert re.match(r".*part\.toml, line \d+", str(caught.value)), str(caught.value)


def test_text_that_is_not_utf_8_and_kinds_that_do_not_exist_are_refused(folder: Path) -> None:
    (folder / "latin.toml").write_bytes("tol = 0.1 # é".encode("latin-1"))
    check_refusal((lambda: read_solid_recipe(folder / "latin.toml"), "must be UTF-8"), RecipeError)
    check_refusal((lambda: format_reference("rodd"), "no kind of a recipe"), InvalidRequest)
