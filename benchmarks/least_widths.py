"""Smallest wall and gap of made bodies with known answers: bound, value, truth and seconds.

    python -m benchmarks.least_widths [PART OF A NAME ...]

A row is WRONG if the truth is below the bound, or if the value is not the truth within one percent (field solids: within their
tolerance as well). Kernel bodies are those of build123d; field solids come from `solidify` and from lattices. Some are rotated.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import build123d as bd
import numpy as np

import tpmscad
from tpmscad import fields
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.occt.exploration import require_shape
from tpmscad.kernel.printability.least_widths import measure_least_widths

Row = tuple[str, Callable[[], Any], float | None, float | None]
"""Name, body, smallest wall and smallest gap; None where it is not judged."""

VALUE_RTOL = 0.01
TILT = bd.Rot(20, 30, 40)


def two_voids(wall: float) -> Any:
    return bd.Box(12, 8, 8) - bd.Pos(-2 - wall / 2, 0, 0) * bd.Sphere(2) - bd.Pos(2 + wall / 2, 0, 0) * bd.Sphere(2)


def two_voids_of_a_field(wall: float) -> Any:
    balls = fields.union(fields.sphere((4, 4, 4), 2.0), fields.sphere((8 + wall, 4, 4), 2.0))
    return tpmscad.solidify(fields.complement(balls), ((0, 0, 0), (12, 8, 8)), tol=0.002).wrapped


def void_below_a_side(wall: float) -> Any:
    return bd.Box(10, 10, 10) - bd.Pos(0, 0, 4 - wall) * bd.Sphere(1)


def void_of_a_field_below_a_side(wall: float) -> Any:
    ball = fields.sphere((4, 4, 2 + wall), 2.0)
    return tpmscad.solidify(fields.complement(ball), ((0, 0, 0), (8, 8, 8)), tol=0.002).wrapped


def trapezoid(wall: float) -> Any:
    return bd.extrude(bd.Polygon((0, 0), (20, 0), (20, wall + 1), (0, wall), align=None), 10)


def tube(wall: float) -> Any:
    return bd.Cylinder(3, 10) - bd.Cylinder(3 - wall, 10)


def spheres_across_a_seam(gap: float) -> Any:
    """Two balls that come nearest on the seams of their spheres, joined by a bar behind."""
    balls = [TILT * bd.Pos(x, 0, 0) * bd.Sphere(2) for x in (-2 - gap / 2, 2 + gap / 2)]
    return bd.Compound([ball.solid() for ball in balls])


def gyroid(wall: float) -> Any:
    return tpmscad.lattice("gyroid", cell=10, thickness=wall, tol=0.002, boundary="natural").wrapped


def turned_diamond(wall: float) -> Any:
    lattice = tpmscad.lattice("diamond", cell=10, thickness=wall, tol=0.002, boundary="natural").wrapped
    return TILT * bd.Compound(lattice)


def skin(wall: float) -> Any:
    return tpmscad.infill(bd.Box(16, 16, 16), "schwarz_p", cell=8, thickness=1.5, skin=wall, tol=0.01).wrapped


def rows() -> Iterator[Row]:
    """The bodies: name, body, wall, gap."""
    for wall in (0.05, 0.1, 0.2, 0.5, 1.0):
        yield f"two voids, {wall}", lambda w=wall: two_voids(w), wall, None
        yield f"two voids, {wall}, rotated", lambda w=wall: TILT * two_voids(w), wall, None
        yield f"two voids of a field, {wall}", lambda w=wall: two_voids_of_a_field(w), wall, None
    for wall in (0.05, 0.1, 0.3, 0.8):
        yield f"void below a side, {wall}", lambda w=wall: void_below_a_side(w), wall, 2.0
        yield f"void of a field below a side, {wall}", lambda w=wall: void_of_a_field_below_a_side(w), wall, 4.0
    for wall in (0.1, 0.3):
        yield f"trapezoid, {wall}", lambda w=wall: trapezoid(w), wall, None
    yield "sharp wedge", lambda: bd.extrude(bd.Polygon((0, 0), (30, 0), (30, 3), align=None), 10), None, None
    for wall in (0.1, 0.2, 0.5):
        yield f"tube, {wall}", lambda w=wall: TILT * tube(w), wall, 2 * (3 - wall)
    for gap in (0.05, 0.2, 1.0):
        yield f"balls, gap {gap}", lambda g=gap: spheres_across_a_seam(g), 4.0, gap
    for wall in (0.1, 0.2, 0.3, 0.4):
        yield f"gyroid sheet, {wall}", lambda w=wall: gyroid(w), wall, None
    yield "diamond sheet, 0.2, rotated", lambda: turned_diamond(0.2), 0.2, None
    for wall in (0.4, 0.8):
        yield f"skin, {wall}", lambda w=wall: skin(w), wall, None
    yield "waist", lambda: bd.Cylinder(1, 4) - bd.Torus(2.17, 2), 0.34, None


def main(wanted: list[str]) -> None:
    """Print a line for each body, and how many were wrong."""
    count, wrong = 0, 0
    for name, make, wall, gap in rows():
        if wanted and not any(part in name for part in wanted):
            continue
        shape = require_shape(make())
        report = check_shape(shape)
        begun = time.process_time()
        found = measure_least_widths(shape, report)
        seconds = time.process_time() - begun
        texts, bad = [], False
        for kind, one, truth in zip(("wall", "gap"), found, (wall, gap), strict=True):
            if truth is None:
                continue
            if one is None:
                texts.append(f"{kind} none, true {truth:g}")
                bad = True
                continue
            bad |= one.bound > truth * (1 + VALUE_RTOL) or not np.isclose(one.value, truth, rtol=VALUE_RTOL, atol=0.004)
            texts.append(f"{kind} [{one.bound:.5g}, {one.value:.6g}] true {truth:g}")
        count, wrong = count + 1, wrong + bad
        print(f"{'WRONG ' if bad else ''}{name:36s} {'; '.join(texts):70s} {seconds:6.2f} s", flush=True)
    print(f"{count} bodies, {wrong} wrong")


if __name__ == "__main__":
    main(sys.argv[1:])
