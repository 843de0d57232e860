"""Solids of fields in plain build123d booleans: CPU seconds, validity, and volumes beside quadrature of the fields.

    python -m benchmarks.solid_booleans [field | body] ...

field: a cylinder cut, a ball in common and a plate fused, five solids of one cell. body: trimmed by three CAD bodies.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import build123d as bd
import numpy as np

from tests.solids.test_solid_booleans import BODIES, CELL, FIELDS, in_ball, in_cylinder, quadratures
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.solids._solidify import solidify


def field() -> None:
    """One line for each operation on each solid."""
    low, high = np.zeros(3), np.full(3, 10.0)
    plate = bd.Pos(5, 5, -0.9) * bd.Box(12, 12, 2)
    ball, bore = bd.Pos(5, 5, 5) * bd.Sphere(4.5), bd.Pos(5, 5, 5) * bd.Cylinder(3, 12)
    print(f"{'':24s} faces  result  seconds  volume off")
    for name, f in FIELDS.items():
        solid = solidify(f, CELL, tol=1e-2).solid
        faces, whole = len(solid.faces()), check_shape(solid).volume
        (buried,) = quadratures(lambda x, f=f: (f(x) < 0,), low, np.array([10.0, 10.0, 0.1]), 120)
        cut, common = quadratures(lambda x, f=f: ((f(x) < 0) & ~in_cylinder(x), (f(x) < 0) & in_ball(x)), low, high)
        row(f"{name} - cylinder", faces, lambda s=solid: s - bore, cut)
        row(f"{name} & ball", faces, lambda s=solid: s & ball, common)
        row(f"{name} + plate", faces, lambda s=solid: s + plate, 288.0 + whole - buried)


def body() -> None:
    """One line for each body, the making of the lattice around it included."""
    print(f"{'':24s} faces  result  seconds  volume off")
    for name, (make, inside, f) in BODIES.items():
        shape = make()
        low, high = (np.array(tuple(corner)) for corner in (shape.bounding_box().min, shape.bounding_box().max))
        (expected,) = quadratures(lambda x, f=f, inside=inside: (inside(x) & (f(x) < 0),), low, high)
        row(name, len(shape.faces()), lambda s=shape, f=f: solidify(f, s, tol=2e-2).solid, expected)


def row(name: str, faces: int, make: Callable[[], Any], expected: float) -> None:
    """Time it, look at it, compare its volume."""
    begun = time.process_time()
    made = make()
    seconds = time.process_time() - begun
    found = check_shape(made)
    verdict = "valid" if found.ok else "NOT valid"
    pieces = f"{found.solids} pieces" if found.solids > 1 else ""
    print(f"{name:24s} {faces:5d} {found.faces:7d} {seconds:8.1f}  {found.volume / expected - 1.0:+10.1e}  {verdict} {pieces}",
          flush=True)  # fmt: skip


if __name__ == "__main__":
    for task in sys.argv[1:] or ["field", "body"]:
        {"field": field, "body": body}[task]()
