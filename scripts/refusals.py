"""Which refusals of the package the tests reach: every `raise` of an error of tpmscad, and whether a run of the tests passed it.

    python scripts/refusals.py [--unreached] [ARGUMENTS OF PYTEST]

Without arguments the quick part of the suite runs, `-m "not kernel and not slow"`. Requests are refused by
`InvalidRequest` and its kin; failures (`KernelError`, `TrimmingError`, ...) come from deeper inside and are counted apart.
"""

from __future__ import annotations

import ast
import builtins
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parent.parent
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


class RaiseStatement(NamedTuple):
    """A `raise` of the package's own errors; a statement of several lines is reached on any of them."""

    file: str
    line: int
    last_line: int
    error: str
    text: str

    @property
    def is_refusal(self) -> bool:
        """Whether it blames the request."""
        return self.error not in FAILURES


def find_raises(root: Path = ROOT) -> Iterator[RaiseStatement]:
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
                file = str(path.relative_to(root))
                yield RaiseStatement(file, node.lineno, node.end_lineno or node.lineno, error, ast.unparse(node.exc))


def record_raises(places: set[tuple[str, int]], reached: set[tuple[str, int]]) -> None:
    """From now on each of `places` (file, line) that raises is added to `reached`; functions without one are not traced."""
    wanted: dict[CodeType, bool] = {}

    def has_raise(code: CodeType) -> bool:
        if not code.co_filename.startswith(str(ROOT)):
            return False
        file = str(Path(code.co_filename).relative_to(ROOT))
        return any((file, line) in places for _, _, line in code.co_lines() if line)

    def enter(frame: FrameType, event: str, value: Any) -> Any:
        code = frame.f_code
        if code not in wanted:
            wanted[code] = has_raise(code)
        if not wanted[code]:
            return None
        frame.f_trace_lines = False
        return see

    def see(frame: FrameType, event: str, value: Any) -> Any:
        if event == "exception":
            reached.add((str(Path(frame.f_code.co_filename).relative_to(ROOT)), frame.f_lineno))
        return see

    sys.settrace(enter)
    threading.settrace(enter)


def main(arguments: list[str]) -> int:
    """Run the tests, print the table, and return pytest's status."""
    import pytest

    unreached_only = "--unreached" in arguments
    chosen = [word for word in arguments if word != "--unreached"] or QUICK
    raises = list(find_raises())
    lines: set[tuple[str, int]] = set()
    record_raises({(r.file, n) for r in raises for n in range(r.line, r.last_line + 1)}, lines)
    status = int(pytest.main(["-q", "-p", "no:xdist", "--rootdir", str(ROOT), *chosen]))
    reached = {r for r in raises if any((r.file, n) in lines for n in range(r.line, r.last_line + 1))}
    for r in raises:
        if r not in reached or not unreached_only:
            print(f"{'reached' if r in reached else 'NOT    '} {r.file}:{r.line}: {r.text[:150]}")
    for name, those in (
        ("refusals", {r for r in raises if r.is_refusal}),
        ("failures", {r for r in raises if not r.is_refusal}),
    ):
        print(f"{name}: reached {len(those & reached)} of {len(those)}")
    return status


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
