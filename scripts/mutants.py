"""Single-point mutants of a room: the changes of one expression or statement that its tests do not notice.

    python scripts/mutants.py splines --count 10 --seed 1

Each mutant is one change in one module of the room (a comparison, an operator, a constant, a condition, two swapped arguments, a
dropped statement) in a copy of the tree; the tests of the room stop at the first failure. Survivors are named with line and
difference. Not every survivor is a hole: a mutant may do the same in another way.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import random
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

from tree_copy import ROOT, copied_tree, pytest_call

TESTS = {
    "splines": ["tests/splines", "tests/lattices/test_cpia_nets.py"],
    "topology": ["tests/topology", "tests/refusals/test_refused_fields.py"],
    "fields": ["tests/fields", "tests/refusals/test_refused_fields.py", "tests/recipe/test_data_fields.py"],
    "surfaces": ["tests/surfaces", "tests/refusals/test_refused_fields.py"],
    "brep": [
        "tests/brep",
        "tests/trimming/test_boxes.py",
        "tests/levelset/test_field_brep.py",
        "tests/lattices/test_copies.py",
    ],
    "lattices": ["tests/lattices", "tests/solids/test_lattices.py"],
    "levelset": ["tests/levelset", "tests/solids/test_second_look.py"],
    "trimming": ["tests/trimming", "tests/solids/test_infill.py"],
    "blending": ["tests/blending", "tests/refusals/test_refused_recipes.py"],
    "kernel": [
        "tests/kernel",
        "tests/part21",
        "tests/refusals/test_refused_solids.py",
        "tests/studies/test_metrics.py",
    ],
    "solids": ["tests/solids", "tests/requests", "tests/results", "tests/refusals/test_refused_solids.py"],
    "recipe": ["tests/recipe", "tests/refusals/test_refused_recipes.py"],
    "cli": ["tests/cli"],
    "meshing": ["tests/meshing", "tests/studies/test_hexahedra_of_models.py", "tests/studies/test_meshing.py"],
    "simulation": [
        "tests/simulation",
        "tests/studies/test_homogenization.py",
        "tests/studies/test_permeability.py",
    ],
    "sweeps": ["tests/sweeps"],
}
"""The tests of each room, those first that fail soonest."""

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


def draw_mutants(room: str, count: int, seed: int) -> Iterator[tuple[Path, int, str, str, str]]:
    """Random mutants: file, line, way, the text as it was (normalised) and as it is changed."""
    rng = random.Random(f"{room} {seed}")
    files = sorted((ROOT / "tpmscad" / room).rglob("*.py"))
    files = [f for f in files if f.name != "__init__.py"]
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
        apply_mutation(node, way)
        yield file, getattr(node, "lineno", 0), way, before, ast.unparse(ast.fix_missing_locations(tree))


def run_tests(tree: Path, tests: list[str], seconds: float, marks: str) -> str:
    """What the tests say of the tree as it is: "noticed", "survived" or "too long"."""
    command, environment = pytest_call(tree, ["-x", "-p", "no:xdist", "-m", marks, *tests])
    try:
        ended = subprocess.run(command, cwd=tree, env=environment, capture_output=True, timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        return "too long"
    if ended.returncode > 3:  # below zero: ended by a signal, as compiled code may be
        raise SystemExit(f"pytest ended with {ended.returncode}:\n{ended.stdout.decode()[-2000:]}")
    return "noticed" if ended.returncode else "survived"


def main() -> int:
    """Print what became of every mutant, and the survivors' differences; 1 if any survived."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("room", choices=sorted(TESTS))
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--seconds", type=float, default=300.0, help="time limit of the tests of one mutant, 300 by default"
    )
    parser.add_argument("--marks", default="not slow and not frontend", help="which tests run, as for pytest -m")
    given = parser.parse_args()
    survivors: list[str] = []
    with copied_tree() as tree:
        for number, (file, line, way, before, after) in enumerate(draw_mutants(given.room, given.count, given.seed), 1):
            inside = tree / file.relative_to(ROOT)
            inside.write_text(after, encoding="utf-8")
            begun = time.perf_counter()
            verdict = run_tests(tree, TESTS[given.room], given.seconds, given.marks)
            shutil.copy(file, inside)
            place = f"{file.relative_to(ROOT)}:{line} ({way})"
            print(f"{number:3d} {verdict:9} {place}  {time.perf_counter() - begun:.0f} s", flush=True)
            if verdict == "survived":
                difference = difflib.unified_diff(before.splitlines(), after.splitlines(), lineterm="", n=1)
                survivors.append(
                    "\n".join([place, *[f"    {d}" for d in difference if not d.startswith(("---", "+++", "@@"))]])
                )
    print(f"\n{given.room}: {given.count - len(survivors)} of {given.count} noticed")
    print(*survivors, sep="\n\n")
    return 1 if survivors else 0


if __name__ == "__main__":
    raise SystemExit(main())
