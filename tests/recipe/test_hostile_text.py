"""Recipes from elsewhere: marks of editors, endless numbers, deep nesting and long texts are read or refused with the place."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from tpmscad.errors import RecipeError
from tpmscad.recipe.key_lines import find_key_lines
from tpmscad.recipe.solid_recipe import read_solid_recipe

RECIPE = """domain = [[0, 0, 0], [10, 10, 10]]
tol = 0.05

[field]
kind = "rod"
level = 0.1
of = { kind = "tpms", surface = "gyroid", period = 10 }
"""


def written(folder: Path, text: str, encoding: str = "utf-8") -> Path:
    """The text as a file."""
    path = folder / "part.toml"
    path.write_text(text, encoding)
    return path


def test_a_byte_order_mark_changes_nothing(tmp_path: Path) -> None:
    plain = read_solid_recipe(written(tmp_path, RECIPE))
    marked = read_solid_recipe(written(tmp_path, RECIPE, "utf-8-sig"))
    assert (marked.tol, marked.domain) == (plain.tol, plain.domain)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("tol = 0.05", f"tol = {'9' * 400}", "line 2, tol: 9999.* is beyond 1e\\+100"),
        ("tol = 0.05", f"tol = {'9' * 5000}", r"part\.toml holds a value that cannot be read: .* digits"),
        ("tol = 0.05", "tol = 1e308", r"line 2, tol: 1e\+308 is beyond"),
        ("tol = 0.05", f"tol = {'[' * 5000}{']' * 5000}", "nested too deeply"),
        ("tol = 0.05", f"tol = {'{a=' * 500}1{'}' * 500}", "nested too deeply|tol"),
    ],
)
def test_numbers_and_nesting_beyond_bounds_are_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(RecipeError, match=said):
        read_solid_recipe(written(tmp_path, RECIPE.replace(old, new)))


def test_fields_nested_too_deeply_are_refused(tmp_path: Path) -> None:
    tables = (f"\n[fields.f{k}]\nkind = 'complement'\nof = 'f{k + 1}'\n" for k in range(3000))
    by_name = RECIPE.replace("[field]", "field = 'f0'\n\n[fields.f3000]") + "".join(tables)
    tables_in_tables = "{ kind = 'complement', of = " * 300 + "{ kind = 'tpms', surface = 'gyroid' }" + " }" * 300
    for text in (by_name, f"domain = [[0, 0, 0], [10, 10, 10]]\ntol = 0.05\nfield = {tables_in_tables}\n"):
        with pytest.raises(RecipeError, match=r"nested (more|too) deeply"):
            read_solid_recipe(written(tmp_path, text))


def test_the_lines_of_keys_are_found_in_a_time_proportional_to_the_text() -> None:
    def seconds(count: int) -> float:
        text = "\n".join(f"key_{i} = [1.0, 2.0, 3.0] # some words after it" for i in range(count))
        begun = time.process_time()
        lines = find_key_lines(text)
        assert lines[f"key_{count - 1}",] == count
        return time.process_time() - begun

    seconds(100)
    assert seconds(6_000) < 12 * seconds(1_500) + 0.1
