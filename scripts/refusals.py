"""Which refusals of the package the tests reach: every `raise` of an error of tpmscad, and whether a run of the tests passed it.

    python scripts/refusals.py [--unreached] [ARGUMENTS OF PYTEST]

Without arguments the quick part of the suite runs, `-m "not kernel and not slow"`. Requests are refused by
`InvalidRequest` and its kin; failures (`KernelError`, `TrimmingError`, ...) come from deeper inside and are counted apart.

The tests run in a copy of the tree in which each `raise` writes its number to a file: threads and child processes count too.
"""

from __future__ import annotations

import ast
import builtins
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tree_copy import copied_tree, pytest_call

QUICK = ["-m", "not kernel and not slow", "tests"]
FAILURES = (
    "KernelError",
    "TrimmingError",
    "_RejectedTrim",
    "LevelSetError",
    "LoopError",
    "SideMismatch",
    "NoFoot",
    "NotMet",
)
"""Errors that say a method failed; all others say that the request cannot be carried out."""

COUNTER = '''
import os

def mark(number, error):
    """Write the number of a `raise` that is about to be carried out."""
    record = os.open(__file__ + ".txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.write(record, b"%d\\n" % number)
    os.close(record)
    return error
'''
"""The module `raise_counter` of the copied tree."""


class RaiseStatement(NamedTuple):
    """A `raise` of the package's own errors."""

    file: str
    line: int
    error: str
    expression: ast.expr

    @property
    def is_refusal(self) -> bool:
        """Whether it blames the request."""
        return self.error not in FAILURES


def find_raises(root: Path) -> Iterator[RaiseStatement]:
    """Every `raise` in the package and the front ends but those of Python's own exceptions."""
    for folder in ("tpmscad", "cq_plugins"):
        for path in sorted((root / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if not isinstance(node, ast.Raise) or node.exc is None:
                    continue
                made = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
                error = ast.unparse(made)
                if isinstance(made, ast.Name) and not isinstance(node.exc, ast.Call) and not made.id[0].isupper():
                    continue  # an exception caught before is raised again
                if hasattr(builtins, error) or error.startswith("typer."):
                    continue
                yield RaiseStatement(str(path.relative_to(root)), node.lineno, error, node.exc)


def mark_raises(tree: Path, raises: list[RaiseStatement]) -> None:
    """Let each `raise` of a tree write its number in `raises` when it is carried out; no line changes its number."""
    (tree / "raise_counter.py").write_text(COUNTER, encoding="utf-8")
    changes: dict[str, list[tuple[int, int, bytes]]] = {}
    for number, r in enumerate(raises):
        node = r.expression
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        opening = b'__import__("raise_counter").mark(%d, ' % number
        changes.setdefault(r.file, []).append((node.lineno, node.col_offset, opening))
        changes[r.file].append((node.end_lineno, node.end_col_offset, b")"))
    for file, inserted in changes.items():
        lines = (tree / file).read_bytes().splitlines(keepends=True)
        for line, column, text in sorted(inserted, reverse=True):
            lines[line - 1] = lines[line - 1][:column] + text + lines[line - 1][column:]
        (tree / file).write_bytes(b"".join(lines))


def main(arguments: list[str]) -> int:
    """Run the tests, print the table, and return pytest's status."""
    unreached_only = "--unreached" in arguments
    chosen = [word for word in arguments if word != "--unreached"] or QUICK
    with copied_tree() as tree:
        raises = list(find_raises(tree))
        mark_raises(tree, raises)
        command, environment = pytest_call(tree, chosen)
        status = subprocess.run(command, cwd=tree, env=environment, check=False).returncode
        record = tree / "raise_counter.py.txt"
        numbers = {int(n) for n in record.read_text().split()} if record.exists() else set()
    for number, r in enumerate(raises):
        if number not in numbers or not unreached_only:
            text = ast.unparse(r.expression)[:150]
            print(f"{'reached' if number in numbers else 'NOT    '} {r.file}:{r.line}: {text}")
    for name, wanted in (("refusals", True), ("failures", False)):
        those = {n for n, r in enumerate(raises) if r.is_refusal is wanted}
        print(f"{name}: reached {len(those & numbers)} of {len(those)}")
    return status


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
