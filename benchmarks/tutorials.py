"""The tutorials of the guide as programs: their snippets run in order, what they print and the pictures they write are kept.

    python -m benchmarks.tutorials [PAGE ...]

Each page of docs/tutorials that is named, or every one, runs in an empty folder. What a snippet prints replaces the block of text
that follows it on the page, and each picture that the page shows is reduced into docs/tutorials/pictures.

All snippets of Python on a page share one namespace; those of the shell run in the same folder. Tabs of one front end run.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.gallery import reduce_picture

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "tutorials"
PICTURES = FOLDER / "pictures"
FRONT_ENDS = ("build123d", "CadQuery")

PROGRESS = re.compile(r"^tpmscad: .*( \.\.\.|: \d+ %.*)\n", re.MULTILINE)
"""What long work tells on standard error, which pages do not show."""

PICTURE_BYTES = 150_000
"""Greatest size of a kept picture."""

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TAB = re.compile(r"^:::\{tab-item\} (.+?)\n(.*?)^:::$", re.MULTILINE | re.DOTALL)
PICTURE = re.compile(r"!\[[^]]+\]\(pictures/([\w-]+\.png)\)")

SHELL = f'set -e\ntpmscad() {{ "{sys.executable}" -m tpmscad "$@"; }}\n'
"""Goes before the lines of a page: the command is that of this environment."""


@dataclass(frozen=True)
class Snippet:
    """A block of Python or of the shell, and where on the page the text stands that it prints, if it does."""

    language: str
    text: str
    printed: tuple[int, int] | None


def read_snippets(page: str, front_end: str = FRONT_ENDS[0]) -> list[Snippet]:
    """The snippets of a page in their order, without those in tabs of the other front end."""
    left_out = [match.span() for match in TAB.finditer(page) if match[1] in FRONT_ENDS and match[1] != front_end]
    blocks = [match for match in BLOCK.finditer(page) if not any(a <= match.start() < b for a, b in left_out)]
    snippets = []
    for block, after in zip(blocks, [*blocks[1:], None], strict=True):
        if block[1] in ("python", "sh"):
            follows = after and after[1] == "text" and not page[block.end() : after.start()].strip()
            snippets.append(Snippet(block[1], block[2], after.span(2) if after and follows else None))
    return snippets


def run_snippet(snippet: Snippet, namespace: dict[str, Any]) -> str:
    """Run a snippet in the working folder, and return what it prints."""
    if snippet.language == "python":
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            exec(compile(snippet.text, "snippet", "exec"), namespace)
        return out.getvalue()
    environment = {**os.environ, "TERM": "dumb", "NO_COLOR": "1", "COLUMNS": "120", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        ["bash", "-c", SHELL + snippet.text],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment,
    )
    if done.returncode:
        raise RuntimeError(f"status {done.returncode} of\n{snippet.text}{done.stdout}")
    return PROGRESS.sub("", done.stdout)


def run_page(
    page: str, folder: Path, front_end: str = FRONT_ENDS[0], *, report: bool = False
) -> list[tuple[Snippet, str]]:
    """Run all snippets of a page in a folder; return each with what it printed."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    done = []
    with contextlib.chdir(folder):
        for snippet in read_snippets(page, front_end):
            begun = sum(os.times()[:4])
            done.append((snippet, run_snippet(snippet, namespace)))
            if report:
                print(f"{sum(os.times()[:4]) - begun:6.1f} s  {snippet.text.splitlines()[-1]}", flush=True)
    return done


def replace_printed(page: str, done: list[tuple[Snippet, str]]) -> str:
    """The page with what its snippets printed."""
    for snippet, printed in reversed(done):
        if snippet.printed:
            begin, end = snippet.printed
            lines = (line.rstrip() for line in printed.strip("\n").splitlines())
            page = page[:begin] + "\n".join(lines) + "\n" + page[end:]
    return page


def keep_page(path: Path) -> None:
    """Run a page, write what it prints into it, and keep the pictures that it shows."""
    page = path.read_text()
    with tempfile.TemporaryDirectory() as folder:
        begun = sum(os.times()[:4])
        done = run_page(page, Path(folder), report=True)
        print(f"{path.stem}: {sum(os.times()[:4]) - begun:.0f} CPU seconds", flush=True)
        path.write_text(replace_printed(page, done))
        for name in PICTURE.findall(page):
            own = name.removeprefix(f"{path.stem}-")
            reduce_picture(Path(folder) / own, PICTURES / name)


def main() -> None:
    PICTURES.mkdir(exist_ok=True)
    for name in sys.argv[1:] or sorted(path.stem for path in FOLDER.glob("*.md")):
        keep_page(FOLDER / f"{name}.md")


if __name__ == "__main__":
    main()
