"""Solids of fields in plain build123d booleans: CPU seconds, validity, and volumes beside quadrature of the fields.

    python -m benchmarks.solid_booleans [field | body] ...

field: a cylinder cut, a ball in common and a plate fused, two solids of one cell. body: trimmed by two CAD bodies.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import build123d as bd
import numpy as np

from tests.solids.test_solid_booleans import CELL, ROD, Inside, flask, in_ball, in_cylinder, in_flask, quadratures
from tpmscad import fields
from tpmscad.fields import Field
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.solids._solidify import solidify

RAMP = fields.ramp("x", (0, 10), (0.15, 0.55))
FIELDS = {"gyroid rod": ROD, "graded gyroid": fields.sheet(fields.tpms("gyroid", 10.0), -RAMP, RAMP)}


def filleted_block() -> bd.Part:
    """A block with two bores."""
    block = bd.fillet(bd.Box(12, 10, 8).edges(), 1.5)
    holes = bd.Pos(3, 1.5, 0) * bd.Cylinder(1.5, 12) + bd.Pos(-3, -1, 0) * bd.Cylinder(1.2, 12)
    return bd.Pos(1, 2, 3) * (block - holes)


def in_filleted_block(x: np.ndarray) -> np.ndarray:
    """Whether points lie in it."""
    x = x - np.array([1.0, 2.0, 3.0])
    beyond = np.linalg.norm(np.maximum(np.abs(x) - np.array([4.5, 3.5, 2.5]), 0.0), axis=-1)
    bored = (np.hypot(x[..., 0] - 3.0, x[..., 1] - 1.5) < 1.5) | (np.hypot(x[..., 0] + 3.0, x[..., 1] + 1.0) < 1.2)
    return (beyond < 1.5) & ~bored


BODIES: dict[str, tuple[Callable[[], bd.Part], Inside, Field]] = {
    "filleted block": (filleted_block, in_filleted_block, fields.sheet(fields.tpms("gyroid", 12.0), -0.35, 0.35)),
    "flask": (flask, in_flask, fields.rod(fields.tpms("gyroid", 13.0), -0.2)),
}


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
