"""The tutorials: their snippets run in order, print what the pages say, and write the pictures that they show."""

from __future__ import annotations

import codeop
import re
from pathlib import Path

import pytest

from benchmarks import tutorials

pytestmark = pytest.mark.kernel

PAGES = {path.stem: path.read_text() for path in sorted(tutorials.FOLDER.glob("*.md"))}
NUMBER = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?")


def words_of(printed: str) -> str:
    """What is printed, without the digits that another machine or kernel may print otherwise."""
    return " ".join(NUMBER.sub("#", printed).split())


def check_run(name: str, front_end: str, folder: Path) -> None:
    page = PAGES[name]
    for snippet, printed in tutorials.run_page(page, folder, front_end):
        if snippet.printed:
            assert words_of(printed) == words_of(page[slice(*snippet.printed)])
    missing = [
        file for file in tutorials.PICTURE.findall(page) if not (folder / file.removeprefix(f"{name}-")).exists()
    ]
    assert not missing


@pytest.mark.documentation
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", PAGES)
def test_a_tutorial_runs_from_an_empty_folder(name: str, tmp_path: Path) -> None:
    check_run(name, "build123d", tmp_path)


@pytest.mark.frontend
def test_the_tutorial_of_a_part_runs_with_cadquery(tmp_path: Path) -> None:
    check_run("cad_part", "CadQuery", tmp_path)


def test_tabs_of_the_other_front_end_are_left_out() -> None:
    texts = {name: [s.text for s in tutorials.read_snippets(PAGES["cad_part"], name)] for name in tutorials.FRONT_ENDS}
    build123d, cadquery = texts.values()
    assert len(build123d) == len(cadquery)
    assert "import build123d" in build123d[0]
    assert "import cadquery" in cadquery[0]
    assert build123d[1:] == cadquery[1:]


def test_printed_text_takes_the_place_of_the_block_below_its_snippet_only() -> None:
    page = "```python\nprint(1)\n```\n\n```text\nold\n```\n\n```sh\ntrue\n```\n\nwords\n\n```text\nkept\n```\n"
    first, second = tutorials.read_snippets(page)
    assert second.printed is None
    assert tutorials.replace_printed(page, [(first, "1 \n"), (second, "2\n")]) == page.replace("old", "1")


def test_a_command_that_fails_stops_the_page(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="status 3"):
        tutorials.run_page("```sh\necho begun\nexit 3\n```\n", tmp_path)


@pytest.mark.parametrize("name", PAGES)
def test_a_page_shows_a_picture_for_its_steps_and_says_where_to_go_next(name: str) -> None:
    page = PAGES[name]
    shown = tutorials.PICTURE.findall(page)
    assert len(shown) >= 2
    assert len(shown) == len(re.findall(r"!\[", page)), "every picture is one of the page's own, with words for it"
    assert all(file.startswith(f"{name}-") for file in shown)
    assert "](../guide/" in page.partition("## Where to go next")[2]


def pasted_errors(text: str) -> list[str]:
    """Lines that the prompt of Python, of 3.12 and older, refuses when a text is pasted: it wants an empty one after a block."""
    lines: list[str] = []
    refused, complete = [], codeop.CommandCompiler()
    for line in [*text.splitlines(), ""]:
        lines.append(line)
        try:
            done = complete("\n".join(lines), symbol="single") is not None
        except SyntaxError:
            refused.append(line)
            done = True
        lines = [] if done else lines
    return refused


@pytest.mark.parametrize("name", PAGES)
@pytest.mark.parametrize("front_end", tutorials.FRONT_ENDS)
def test_a_snippet_can_be_pasted_into_the_prompt_of_python(name: str, front_end: str) -> None:
    snippets = [s.text for s in tutorials.read_snippets(PAGES[name], front_end) if s.language == "python"]
    assert [line for text in snippets for line in pasted_errors(text)] == []


def test_a_line_that_a_prompt_refuses_is_found() -> None:
    assert pasted_errors("for k in range(2):\n    print(k)\nprint(3)\n") == ["print(3)"]


EXTRAS = {
    "matplotlib": "plot",
    "skfem": "simulation",
    "gmsh": "mesh",
    "nibabel": "images",
    "trimesh": "triangles",
    "cadquery": "cadquery",
}
"""Libraries that snippets import, and the extra that brings each."""

OF_CORE = {"build123d", "numpy", "tpmscad"}


@pytest.mark.parametrize("name", PAGES)
def test_a_page_names_the_extras_that_its_snippets_import(name: str) -> None:
    page = PAGES[name]
    texts = [
        s.text for end in tutorials.FRONT_ENDS for s in tutorials.read_snippets(page, end) if s.language == "python"
    ]
    imported = {word for text in texts for word in re.findall(r"^(?:import|from) (\w+)", text, re.MULTILINE)} - OF_CORE
    installed = page[page.index("[Install]") : page.index("\n\n## ")]
    assert {word for word in imported if f"`{EXTRAS[word]}`" not in installed} == set()


def test_the_kept_pictures_are_those_that_the_pages_show_and_are_small() -> None:
    shown = [file for page in PAGES.values() for file in tutorials.PICTURE.findall(page)]
    kept = sorted(tutorials.PICTURES.iterdir())
    assert sorted(shown) == [path.name for path in kept]
    assert max(path.stat().st_size for path in kept) <= tutorials.PICTURE_BYTES


def test_a_card_of_the_first_page_leads_to_every_tutorial() -> None:
    index = (tutorials.ROOT / "docs" / "index.md").read_text()
    cards = re.findall(r":link: tutorials/(\w+)", index)
    assert sorted(cards) == sorted(PAGES)
    assert all(re.search(rf"^tutorials/{name}$", index, re.MULTILINE) for name in PAGES)
