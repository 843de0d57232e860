"""The printed reference names every kind and key that the reader knows, and the templates are recipes as they stand."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.recipe.blend_recipe import BLEND_KEYS, WEIGHT_KINDS
from tpmscad.recipe.field_kinds import field_kinds
from tpmscad.recipe.key_reference import describe_kind, format_reference, read_template
from tpmscad.recipe.recipe_keys import KeyTable, keys_of
from tpmscad.recipe.recipe_runs import BlendRun, SolidRun
from tpmscad.recipe.solid_recipe import SOLID_KEYS

WIDTH = 80
EXAMPLES = Path(__file__).parents[2] / "examples"
TABLES = [
    *((name, keys_of(function)) for name, function in field_kinds().items()),
    *((name, keys_of(function)) for name, function in WEIGHT_KINDS.items()),
    ("solidify", SOLID_KEYS),
    ("blend", BLEND_KEYS),
]


@pytest.mark.parametrize(("name", "table"), TABLES, ids=[name for name, _ in TABLES])
def test_the_reference_of_a_kind_says_every_key_with_what_it_takes(name: str, table: KeyTable) -> None:
    text = " ".join(format_reference(name, width=WIDTH).split())
    for key in table.values():
        assert key.argument.meaning
        assert f"{' | '.join(key.words)} {describe_kind(key.argument)}" in text


def test_the_whole_reference_holds_every_kind_within_the_width() -> None:
    whole = format_reference(width=WIDTH)
    assert max(map(len, whole.splitlines())) <= WIDTH
    for name, _ in TABLES:
        assert format_reference(name, width=WIDTH) in whole or name in ("cylinder", "sphere")


def test_an_unknown_kind_is_answered_with_a_similar_one() -> None:
    with pytest.raises(InvalidRequest, match="did you mean 'sheet'"):
        format_reference("sheets")


@pytest.fixture(params=["solidify", "blend"])
def template(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / f"{request.param}.toml"
    path.write_text(read_template(request.param))
    return path


def read(path: Path) -> SolidRun | BlendRun:
    return SolidRun.read(path) if path.stem == "solidify" else BlendRun.read(path)


@pytest.mark.slow
def test_a_template_passes_the_dry_run(template: Path) -> None:
    text, content = read(template).describe()
    assert text
    assert content.get("converged", True)


@pytest.mark.parametrize(("name", "example"), [("solidify", "graded"), ("blend", "transition")])
def test_a_template_holds_the_values_of_an_example_that_is_made_a_solid(name: str, example: str) -> None:
    # tests/cli/test_cli_recipes.py makes the solids of both examples
    assert tomllib.loads(read_template(name)) == tomllib.loads((EXAMPLES / f"{example}.toml").read_text()) | (
        {"tol": 0.05} if name == "solidify" else {}
    )


def test_what_a_template_leaves_out_in_comments_is_valid_too(tmp_path: Path) -> None:
    text = read_template("solidify")
    head, _, rest = text.partition("# More fields to try")
    more = "\n".join(line.removeprefix("#").removeprefix(" ") for line in rest.splitlines() if line.startswith("#"))
    more = more[more.index("[fields.") :]
    np.save(tmp_path / "density.npy", np.random.default_rng(0).random((21, 21, 31)))
    names = [line.split("]")[0].removeprefix("[fields.") for line in more.splitlines() if line.startswith("[fields.")]
    assert len(names) == 3
    for name in names:
        before = head[: head.index("[field]")] + f'field = "{name}"\n' + head[head.index("# A field with a name") :]
        path = tmp_path / f"{name}.toml"
        path.write_text(before + more)
        recipe = SolidRun.read(path).recipe
        assert 0 < fields.volume_fraction(recipe.field, recipe.domain, samples=24) < 1  # type: ignore[arg-type]


@pytest.mark.kernel
def test_the_table_of_the_sweep_template_holds_valid_designs(tmp_path: Path) -> None:
    from tpmscad.sweeps.parameter_table import read_table

    path = tmp_path / "designs.csv"
    path.write_text(read_template("sweep"))
    assert len(read_table(path).designs) == 3
