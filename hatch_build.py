"""What a package's metadata say of its home: urls, and the README with links that lead there.

The home is written once, in `tool.hatch.metadata.hooks.custom` of pyproject.toml. Without one the README keeps its links, and
there are no urls.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

RELATIVE_LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^]]*)\]\((?!https?:|#)(?P<path>[^)]+)\)")


def link_to_home(text: str, page: str, picture: str) -> str:
    """The text with its relative links below `page`, or below `picture` if they are pictures."""

    def absolute(match: re.Match[str]) -> str:
        return f"{match['picture']}[{match['text']}]({picture if match['picture'] else page}{match['path']})"

    return RELATIVE_LINK.sub(absolute, text)


class HomeHook(MetadataHookInterface):
    """Sets `readme` and `urls`."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Complete the metadata of a build."""
        text = Path(self.root, "README.md").read_text("utf-8")
        home = self.config["home"].rstrip("/")
        if home:
            places = {"home": home, "version": metadata["version"]}
            text = link_to_home(text, *(self.config[kind].format(**places) for kind in ("pages", "pictures")))
            metadata["urls"] = {name: url.format(**places) for name, url in self.config["urls"].items()}
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
