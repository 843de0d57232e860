"""Check a built guide: every internal link leads to a page and a place on it, and nothing is loaded from the network.

    python scripts/check_site.py SITE

Status 1 and a line for each fault otherwise. Links to other sites are left alone: a reader follows them, or not.
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {("script", "src"), ("img", "src"), ("iframe", "src"), ("source", "src"), ("link", "href")}
"""Elements and attributes of what a browser loads without being asked."""

HINTS = {"search", "index", "next", "prev", "canonical", "edit", "author", "copyright"}
"""Kinds of `link` elements of which a browser loads nothing."""

GUESSED_BACK_LINKS = "_modules"
"""The folder of viewcode's pages of source text, whose links back name a function by its module where the guide names it by its
public name: places there are not looked for."""


class Page(HTMLParser):
    """The places, the links and the loaded resources of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.places: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what an element names, leads to or loads."""
        given = {name: value for name, value in attrs if value}
        self.places |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag == "link" and given.get("rel") in HINTS:
            return
        self.loaded += [given[name] for name in given if (tag, name) in LOADED]


def find_faults(site: Path) -> list[str]:
    """A line for each lost link, and for each resource of the network."""
    pages = {path.resolve(): Page(path.read_text("utf-8")) for path in sorted(site.rglob("*.html"))}
    faults = []
    for path, page in pages.items():
        here = path.relative_to(site.resolve())
        for target in [*page.links, *page.loaded]:
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                if target in page.loaded and parts.scheme != "data":
                    faults.append(f"{here} loads {target}")
                continue
            file = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not file.exists():
                faults.append(f"{here} leads to {target}, which is not there")
            elif here.parts[0] == GUESSED_BACK_LINKS:
                continue
            elif parts.fragment and file in pages and unquote(parts.fragment) not in pages[file].places:
                faults.append(f"{here} leads to {target}, a place that the page has not")
    return faults


if __name__ == "__main__":
    found = find_faults(Path(sys.argv[1]))
    print("\n".join(found) or "all links lead somewhere, and nothing is loaded from the network")
    sys.exit(bool(found))
