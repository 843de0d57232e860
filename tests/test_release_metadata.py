"""What a release says of itself: one version everywhere, and links that lead from an index to the repository."""

from __future__ import annotations

import re
import runpy
import tomllib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

import tpmscad

ROOT = Path(__file__).resolve().parents[1]
HOOK = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["metadata"]["hooks"]["custom"]


def complete(home: str) -> dict[str, Any]:
    """The metadata that the hook adds for a home of the repository."""
    pytest.importorskip("hatchling", reason="hatchling is not installed: pip install '.[test]'")
    metadata: dict[str, Any] = {"version": "1.2.3"}
    runpy.run_path(str(ROOT / "hatch_build.py"))["HomeHook"](str(ROOT), {**HOOK, "home": home}).update(metadata)
    return metadata


def test_every_link_and_url_leads_to_the_home() -> None:
    metadata = complete("https://example.org/o/tpmscad/")
    links = re.findall(r"(!?)\[[^]]*\]\(([^)]+)\)", metadata["readme"]["text"])
    assert len(links) > 20
    assert [link for _, link in links if not link.startswith("https://")] == []
    home = "https://example.org/o/tpmscad"
    assert ("!", f"{home}/raw/v1.2.3/docs/gyroid.png") in links
    assert ("", f"{home}/blob/v1.2.3/docs/guide/bodies.md") in links
    assert {url.startswith(home) for url in metadata["urls"].values()} == {True}
    assert {"Homepage", "Changelog", "Issues"} <= metadata["urls"].keys()


def test_without_a_home_the_readme_is_as_it_stands_and_there_are_no_urls() -> None:
    assert complete("") == {
        "version": "1.2.3",
        "readme": {"content-type": "text/markdown", "text": (ROOT / "README.md").read_text()},
    }


def test_the_addon_of_freecad_names_the_same_home() -> None:
    package = ElementTree.parse(ROOT / "package.xml").getroot()
    urls = [url.text for url in package.iterfind("{https://wiki.freecad.org/Package_Metadata}url[@type='repository']")]
    assert urls == [HOOK["home"]] * bool(HOOK["home"])


def test_the_recipe_for_conda_asks_for_what_the_package_needs() -> None:
    """By the names of conda-forge, where lib3mf's wheel is py-lib3mf."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = {re.sub(r"(?<=[\w-])(?=[<>=])", " ", each, count=1) for each in project["dependencies"]}
    recipe = (ROOT / "packaging" / "recipe.yaml").read_text()
    run = recipe[recipe.index("  run:\n") : recipe.index("\ntests:")]
    listed = {line.replace("py-lib3mf", "lib3mf") for line in re.findall(r"    - (.+)", run)}
    assert listed == {*needed, f"python {project['requires-python']}"}
    assert f'version: "{tpmscad.__version__}"' in recipe


def test_a_released_version_has_its_date() -> None:
    heading = re.search(r"^## .*$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert heading is not None
    assert re.fullmatch(r"## [\d.]+ \((\d{4}-\d\d-\d\d|not released)\)", heading[0])


def test_the_changelog_begins_with_this_version() -> None:
    (version, *_) = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert version == tpmscad.__version__
