"""The guide: its scripts run as they stand there, its generated pages name what is public."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import tpmscad

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted((ROOT / "docs" / "guide").glob("*.md"))
SCRIPT = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
QUICK = ("conventions", "first_solid", "sweeps")
"""Pages whose scripts take about a second; those of the others run with the documentation."""

GENERATORS = sorted(path.stem for path in (ROOT / "docs").glob("*_pages.py"))
SCRIPTS = [(page.stem, number, text) for page in PAGES for number, text in enumerate(SCRIPT.findall(page.read_text()))]


def marks_of(page: str, script: str) -> list[pytest.MarkDecorator]:
    """The marks of a script by what it imports and how long it takes."""
    marks = [pytest.mark.kernel]
    if page not in QUICK or "properties=True" in script:
        marks.append(pytest.mark.documentation)
    if "cadquery" in script:
        marks.append(pytest.mark.frontend)
    return marks


@pytest.mark.parametrize(
    ("page", "script"),
    [
        pytest.param(page, script, marks=marks_of(page, script), id=f"{page}-{number}")
        for page, number, script in SCRIPTS
    ],
)
def test_a_script_of_the_guide_runs(page: str, script: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(script, f"{page}.md", "exec"), {"__name__": "__main__"})
    for name in re.findall(r'(?:export|write|export_step)\((?:\w+, )?"([\w.]+)"\)', script):
        assert (tmp_path / name).stat().st_size > 0


def test_every_page_of_the_guide_is_in_the_index() -> None:
    index = (ROOT / "docs" / "index.md").read_text()
    assert all(f"guide/{page.stem}" in index for page in PAGES)
    assert len(SCRIPTS) >= 10


@pytest.fixture
def load_pages(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Any]]:
    """Import one of the modules that write pages of the guide."""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    yield importlib.import_module
    for name in GENERATORS:
        sys.modules.pop(name, None)


@pytest.mark.kernel
def test_the_generated_pages_hold_all_public_functions(load_pages: Callable[[str], Any]) -> None:
    page = load_pages("reference_pages").describe_module("tpmscad", "Solids", set())
    assert ".. autofunction:: sweep" in page
    for name in tpmscad.__all__:
        if callable(getattr(tpmscad, name)):
            assert f":: {name}\n" in page


@pytest.mark.kernel
def test_every_public_function_has_a_job(load_pages: Callable[[str], Any]) -> None:
    listed = [name for names in load_pages("reference_pages").JOBS.values() for name in names]
    for prefix, module in (("", tpmscad), ("fields.", tpmscad.fields), ("maps.", tpmscad.maps)):
        functions = {f"{prefix}{name}" for name in module.__all__ if inspect.isfunction(getattr(module, name))}
        assert functions - set(listed) == set()


@pytest.mark.kernel
def test_what_public_functions_return_is_described(load_pages: Callable[[str], Any]) -> None:
    described = {name.rpartition(".")[2] for name in load_pages("reference_pages").RESULTS} | {"Field", "None"}
    functions = [value for name in tpmscad.__all__ if inspect.isfunction(value := getattr(tpmscad, name))]
    returned = {word for function in functions for word in str(function.__annotations__["return"]).split(" | ")}
    assert returned - described == set()


@pytest.mark.kernel
def test_the_inventories_of_other_projects_are_read_by_sphinx(load_pages: Callable[[str], Any]) -> None:
    inventory = pytest.importorskip("sphinx.util.inventory").InventoryFile
    pages = load_pages("reference_pages")
    for project, (url, linked) in pages.LINKED.items():
        read = inventory.loads(pages.format_inventory(project, linked), uri=url).data
        assert sorted(name for kind in read.values() for name in kind) == sorted(linked)
        assert all(item.uri.startswith(url) for kind in read.values() for item in kind.values())
    targets = {name for _, linked in pages.LINKED.values() for name in linked}
    targets |= {f":class:`python:{name}`" for name in targets}
    assert all(name in targets or name.startswith("tpmscad.") for name in pages.ALIASES.values())


@pytest.mark.kernel
def test_every_option_of_a_command_is_on_its_page(load_pages: Callable[[str], Any]) -> None:
    from tpmscad import cli

    pages = load_pages("command_pages").make_commands()
    for command in cli.COMMANDS:
        page = pages[f"commands/{command.name}.md"]
        parameters = inspect.signature(command.load()).parameters
        assert all(
            f"`--{name.replace('_', '-')}" in page or f"`{name.upper()}" in page
            for name in ("report", "quiet")
            if name in parameters
        )
        assert page.count("\n: ") >= len(parameters)
        assert f"commands/{command.name}.md" in pages["commands.md"]


@pytest.mark.kernel
def test_every_public_module_has_a_page_with_names(load_pages: Callable[[str], Any]) -> None:
    reference_pages = load_pages("reference_pages")
    described: set[int] = set()
    for module, title in reference_pages.MODULES.items():
        assert (
            ":: "
            in reference_pages.describe_module(module, title, described).split("currentmodule", 1)[1].split("\n", 1)[1]
        ), module
