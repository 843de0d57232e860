"""Single-point mutants of the package: changes of one expression or statement that its tests do not notice.

    python -m pytest -n auto --cov --cov-context=test --cov-report=     # once: which test runs which line, into .coverage
    python scripts/mutants.py --count 40 --seed 1 [ROOM ...]

Each mutant is one change in one module (a comparison, an operator, a constant, a condition, two swapped arguments, a dropped
statement) in a copy of the tree. The tests that run its line are tried, those first that run the fewest lines, until one fails;
of compiled loops, whose lines are not recorded, those that run the module, or one that imports it. Survivors are named with line
and difference. Not every survivor is a hole: a mutant may do the same in another way.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import difflib
import json
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tree_copy import ROOT, copied_tree, pytest_call

COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult, ast.Mod: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip


def list_mutations(tree: ast.Module) -> list[tuple[ast.AST, str]]:
    """Every place that can be changed, and the way; docstrings, annotations and messages of errors stay."""
    skipped: set[ast.AST] = set()
    for node in ast.walk(tree):
        fields = [getattr(node, name, None) for name in ("annotation", "returns")]
        fields += node.decorator_list if isinstance(node, ast.FunctionDef | ast.ClassDef) else []
        fields += [node] if isinstance(node, ast.Raise | ast.JoinedStr) else []
        for field in fields:
            if isinstance(field, ast.AST):
                skipped.update(ast.walk(field))
    found: list[tuple[ast.AST, str]] = []
    for node in ast.walk(tree):
        if node in skipped:
            continue
        if isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARISONS:
            found.append((node, "comparison"))
        elif isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in OPERATORS:
            found.append((node, "operator"))
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
            found.append((node, "sign or not"))
        elif isinstance(node, ast.BoolOp):
            found.append((node, "and, or"))
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float, bool):
            found.append((node, "constant"))
        elif isinstance(node, ast.If | ast.IfExp):
            found.append((node, "condition"))
        elif (
            isinstance(node, ast.Call)
            and len(node.args) == 2
            and not any(isinstance(a, ast.Starred) for a in node.args)
        ):
            found.append((node, "arguments"))
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            found.append((node, "statement"))
    return found


def apply_mutation(node: ast.AST, way: str) -> None:
    """Change one node in place."""
    if isinstance(node, ast.Compare):
        node.ops[0] = COMPARISONS[type(node.ops[0])]()
    elif isinstance(node, ast.BinOp | ast.AugAssign):
        node.op = OPERATORS[type(node.op)]()
    elif isinstance(node, ast.UnaryOp):
        node.op = ast.UAdd() if isinstance(node.op, ast.USub) else ast.Not()
        if way == "sign or not" and isinstance(node.op, ast.Not):
            node.operand = ast.UnaryOp(ast.Not(), node.operand)
    elif isinstance(node, ast.BoolOp):
        node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
    elif isinstance(node, ast.Constant):
        node.value = (not node.value) if isinstance(node.value, bool) else node.value + 1 if node.value else 1
    elif isinstance(node, ast.If | ast.IfExp):
        node.test = ast.UnaryOp(ast.Not(), node.test)
    elif isinstance(node, ast.Call):
        node.args.reverse()
    elif isinstance(node, ast.Expr):
        node.value = ast.Constant(None)


class Mutant(NamedTuple):
    """One change: the file, the line, the way, and the text (normalised) as it was and as it is changed."""

    file: Path
    line: int
    way: str
    before: str
    after: str

    @property
    def place(self) -> str:
        """Where it is, in words."""
        return f"{self.file.relative_to(ROOT)}:{self.line} ({self.way})"


def list_modules(rooms: list[str]) -> list[Path]:
    """The modules of the rooms, or of the whole package."""
    folders = [ROOT / "tpmscad" / room for room in rooms] or [ROOT / "tpmscad"]
    return sorted(f for folder in folders for f in folder.rglob("*.py") if f.name != "__init__.py")


def draw_mutants(files: list[Path], count: int, seed: int) -> Iterator[Mutant]:
    """Random mutants of modules, of which longer ones have more; equal modules have equal ones."""
    rng = random.Random(seed)
    sizes = [f.stat().st_size for f in files]
    seen: set[tuple[Path, int]] = set()
    while len(seen) < count:
        file = rng.choices(files, sizes)[0]
        tree = ast.parse(file.read_text(encoding="utf-8"))
        before = ast.unparse(tree)
        places = list_mutations(tree)
        if not places:
            continue
        index = rng.randrange(len(places))
        if (file, index) in seen:
            continue
        seen.add((file, index))
        node, way = places[index]
        line = getattr(node, "lineno", 0)
        apply_mutation(node, way)
        yield Mutant(file, line, way, before, ast.unparse(ast.fix_missing_locations(tree)))


class LineRecord:
    """Which test runs which line, of a database of coverage.py with a context for each test."""

    def __init__(self, database: Path) -> None:
        self.tables = sqlite3.connect(database)
        names = self.tables.execute("select id, context from context where context != ''").fetchall()
        self.test = {number: context.rpartition("|")[0] or context for number, context in names}
        self.lines_run: Counter[str] = Counter()
        self.of_file: dict[str, list[tuple[str, bytes]]] = {}
        rows = self.tables.execute("select path, context_id, numbits from line_bits join file on file.id = file_id")
        for path, context, bits in rows:
            if context in self.test:
                name = path[path.rindex("tpmscad/") :] if "tpmscad/" in path else path
                self.of_file.setdefault(name, []).append((self.test[context], bits))
                self.lines_run[self.test[context]] += sum(byte.bit_count() for byte in bits)

    def find_tests(self, mutant: Mutant) -> list[str]:
        """The tests that run the line of a mutant, those first that run the fewest lines in all."""
        name = mutant.file.relative_to(ROOT).as_posix()
        rows, (place, bit) = self.of_file.get(name, []), divmod(mutant.line, 8)
        found = {test for test, bits in rows if place < len(bits) and bits[place] >> bit & 1}
        if not found and "njit" in mutant.before:
            found = {test for test, _ in rows} or self._find_callers(name)
        return sorted(found, key=lambda test: (self.lines_run[test], test))

    def _find_callers(self, name: str) -> set[str]:
        """The tests that run a module which imports the module `name`."""
        dotted = name.removesuffix(".py").replace("/", ".")
        return {
            test
            for file, rows in self.of_file.items()
            if (ROOT / file).exists() and dotted in (ROOT / file).read_text(encoding="utf-8")
            for test, _ in rows
        }


def try_mutant(tree: Path, mutant: Mutant, tests: list[str], seconds: float) -> str:
    """What the tests say: "noticed", "survived", or "too long"."""
    if not tests:
        return "not run"
    inside = tree / mutant.file.relative_to(ROOT)
    inside.write_text(mutant.after, encoding="utf-8")
    os.utime(inside, (time.time() + 10, time.time() + 10))  # never the stamp of bytecode that was kept
    command, environment = pytest_call(tree, ["-x", "-p", "no:xdist", "-m", "", *tests])
    with open(tree / "pytest.log", "wb") as log:
        run = subprocess.Popen(command, cwd=tree, env=environment, stdout=log, stderr=log, start_new_session=True)
        try:
            status = run.wait(seconds)
        except subprocess.TimeoutExpired:
            return "too long"
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(run.pid, signal.SIGKILL)  # with the processes that a test has started
            shutil.copy(mutant.file, inside)
            os.utime(inside)
    told = (tree / "pytest.log").read_text(encoding="utf-8", errors="replace")
    if status > 3 and "ERROR collecting" not in told:  # below zero: ended by a signal, as compiled code may be
        raise SystemExit(f"pytest ended with {status}:\n{told[-2000:]}")
    return "noticed" if status else "survived"


def main() -> int:
    """Print what became of every mutant, and the survivors' differences; 1 if any survived."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rooms", nargs="*", help="rooms of the package; all of it by default")
    parser.add_argument("--modules", type=Path, help="a text with the modules, one a line, in place of rooms")
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--coverage", type=Path, default=ROOT / ".coverage", help="the database of the run of the tests"
    )
    parser.add_argument("--tests", type=int, default=40, help="tests that are tried of a mutant, 40 by default")
    parser.add_argument("--seconds", type=float, default=300.0, help="time limit of the tests of one mutant")
    parser.add_argument(
        "--report", type=Path, help="a JSON file of places and verdicts, to be compared with another run"
    )
    parser.add_argument("--noticed-in", type=Path, help="an earlier report: only the mutants that it says were noticed")
    given = parser.parse_args()
    earlier = json.loads(given.noticed_in.read_text()) if given.noticed_in else None
    record, verdicts, survivors = LineRecord(given.coverage), dict[str, str](), list[str]()
    files = [ROOT / name for name in given.modules.read_text().split()] if given.modules else list_modules(given.rooms)
    with copied_tree() as tree:
        for number, mutant in enumerate(draw_mutants(files, given.count, given.seed), 1):
            if earlier is not None and earlier[f"{number} {mutant.place}"] != "noticed":
                continue
            begun = time.perf_counter()
            verdict = try_mutant(tree, mutant, record.find_tests(mutant)[: given.tests], given.seconds)
            verdicts[f"{number} {mutant.place}"] = verdict
            print(f"{number:3d} {verdict:9} {mutant.place}  {time.perf_counter() - begun:.0f} s", flush=True)
            if verdict in ("survived", "not run"):
                lines = mutant.before.splitlines(), mutant.after.splitlines()
                difference = [
                    d for d in difflib.unified_diff(*lines, lineterm="", n=1) if d[:3] not in ("---", "+++", "@@ ")
                ]
                survivors.append("\n".join([mutant.place, *(f"    {d}" for d in difference)]))
    if given.report:
        given.report.write_text(json.dumps(verdicts, indent=1))
    print(f"\n{Counter(verdicts.values())['noticed']} of {len(verdicts)} noticed: {dict(Counter(verdicts.values()))}")
    print(*survivors, sep="\n\n")
    return 1 if survivors else 0


if __name__ == "__main__":
    raise SystemExit(main())
