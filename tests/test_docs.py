"""Documents name files that exist, and link to each other."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(p for p in (ROOT / "docs").rglob("*.md") if "_generated" not in p.parts)])
LINK = re.compile(r"\]\(([^)]+)\)")


def missing_paths(text: str, folder: Path) -> list[str]:
    """Relative links that lead nowhere, and paths in backticks that are neither below the root nor below the package.

    What the build of the site generates is its own to check.
    """
    links = [target.split("#")[0] for target in re.findall(r"\]\((?!https?:)([^)#][^)]*)\)", text)]
    paths = re.findall(r"`([\w./-]+(?:\.py|/))`", text)
    lost = [t for t in links if "_generated/" not in t and not (folder / t).exists()]
    return lost + [path for path in paths if not ((ROOT / path).exists() or (ROOT / "tpmscad" / path).exists())]


def missing_anchors(text: str, path: Path) -> list[str]:
    """Links to headings that the document, or the one that is linked to, does not have."""
    lost = []
    for target in LINK.findall(text):
        file, _, anchor = target.partition("#")
        page = path.parent / file if file else path
        if anchor and "://" not in target and page.exists():
            headings = re.findall(r"^#+ (.+)$", text if page == path else page.read_text(), re.MULTILINE)
            slugs = [re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings]
            lost += [target] if anchor not in slugs else []
    return lost


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_a_link_to_a_heading_finds_it(path: Path) -> None:
    assert not missing_anchors(path.read_text(), path)


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_a_link_to_another_site_is_whole_and_encrypted(path: Path) -> None:
    """The sites themselves are not asked: the tests run offline."""
    away = [target for target in LINK.findall(path.read_text()) if "://" in target]
    assert [target for target in away if not re.fullmatch(r"https://[\w-]+(\.[\w-]+)+(/\S*)?", target)] == []


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_a_document_names_files_that_exist(path: Path) -> None:
    assert not missing_paths(path.read_text(), path.parent)


def test_a_lost_file_is_noticed() -> None:
    assert missing_paths("see `brep/no_such_module.py`", ROOT) == ["brep/no_such_module.py"]
    assert missing_paths("see [the guide](no_such_page.md)", ROOT) == ["no_such_page.md"]


def test_a_lost_heading_is_noticed() -> None:
    text = "# One heading, of two\n[it](#one-heading-of-two) [not](#two)"
    assert missing_anchors(text, ROOT / "README.md") == ["#two"]
