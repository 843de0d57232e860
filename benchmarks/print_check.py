"""The check before printing on five parts with known faults and on lattices: what it finds, what is so, and its time.

`python -m benchmarks.print_check [--lattices]`
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import build123d as bd
import numpy as np

import tpmscad

LIMITS = {"min_wall": 0.3, "min_gap": 0.3, "max_overhang": 45.0}

PARTS: dict[str, tuple[Callable[[], Any], set[str], str]] = {
    "clean bushing": (lambda: bd.Cylinder(5, 10) - bd.Cylinder(3, 10), set(), "wall 2, gap 6"),
    "fin of 0.25": (
        lambda: bd.Pos(0, 0, 5) * bd.Box(10, 10, 10) + bd.Pos(0, 0, 12) * bd.Box(0.25, 8, 4),
        {"wall"},
        "wall 0.25",
    ),
    "slot of 0.2": (lambda: bd.Box(10, 10, 10) - bd.Pos(1, 0, 3) * bd.Box(0.2, 10, 6), {"gap"}, "gap 0.2"),
    "table": (
        lambda: bd.Pos(0, 0, 5) * bd.Box(2, 2, 10) + bd.Pos(0, 0, 11) * bd.Box(10, 2, 2),
        {"overhang"},
        "90 degrees, 16 mm2",
    ),
    "hollow cube": (
        lambda: bd.Pos(0, 0, 4) * (bd.Box(8, 8, 8) - bd.Rot(45, 0, 0) * bd.Box(4, 4, 4)),
        {"cavities"},
        "1 cavity of 64 mm3",
    ),
}
"""Parts, the checks that they must fail, and the values that they must give."""

LATTICES = {
    "gyroid, wall 0.5": ("gyroid", 0.5, 1, {"overhang"}),
    "gyroid, wall 0.25": ("gyroid", 0.25, 1, {"wall", "overhang"}),
    "diamond, wall 0.5": ("diamond", 0.5, 1, {"overhang"}),
    "gyroid 2x2x2, wall 0.5": ("gyroid", 0.5, 2, {"overhang"}),
}


def show(name: str, source: Any, expected: set[str], known: str) -> None:
    """Print what was found beside what is so."""
    begun = time.process_time()
    report = tpmscad.check_print(source, **LIMITS)
    seconds = time.process_time() - begun
    found = {fault.check for fault in report.faults}
    verdict = "as known" if found == expected else f"WRONG: found {sorted(found)}, known {sorted(expected)}"
    values = []
    for finding in report.findings:
        value = "-" if finding.value is None else f"{finding.value:.5g}"
        extra = finding.area if finding.check == "overhang" else finding.volume
        values.append(value if not extra else f"{value} ({extra:.6g})")
    print(f"{name:24}" + "".join(f"{value:>18}" for value in values) + f"{seconds:8.1f}   {known}: {verdict}")


def main() -> None:
    """Print the table."""
    print(f"limits {LIMITS}")
    print(
        f"{'part':24}"
        + "".join(f"{title:>18}" for title in ("wall", "gap", "overhang (mm2)", "cavities (mm3)"))
        + "   CPU s"
    )
    for name, (make, expected, known) in PARTS.items():
        show(name, make(), expected, known)
    if "--lattices" in sys.argv:
        for name, (surface, thickness, count, expected) in LATTICES.items():
            model = tpmscad.lattice(surface, cell=5.0, cells=(count,) * 3, thickness=thickness, tol=0.005)
            show(name, model, expected, f"wall {thickness:g}, fraction {model.volume / np.prod([5.0 * count] * 3):.4f}")


if __name__ == "__main__":
    main()
