"""A copy of the tree that may be changed, and the tests run in it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


@contextmanager
def copied_tree() -> Iterator[Path]:
    """A folder with every file of the tree that git does not ignore, removed at the end."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
        text=True,
    )
    with tempfile.TemporaryDirectory(prefix="tpmscad-tree-") as name:
        tree = Path(name)
        for entry in listed.stdout.split("\0"):
            if (ROOT / entry).is_file():
                (tree / entry).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / entry, tree / entry)
        yield tree


def pytest_call(tree: Path, arguments: list[str]) -> tuple[list[str], dict[str, str]]:
    """Command and environment of a run of pytest that imports the package of `tree`."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments]
    return command, os.environ | {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
