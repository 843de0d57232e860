"""Lattices wrapped around cylinders and spheres: closed rings, a pipe, half a sphere, and the maps that are refused.

python -m benchmarks.rings [rings | pipe | dome | refusals] ...

Tunnels are held against a count of vertices, sides and patches by integer addresses modulo the length of the ring; volumes
against quadrature of the exact offsets over the mapped patches, without the fit (differences of points for tangents).
"""

from __future__ import annotations

import sys
from time import perf_counter
from typing import Any

import numpy as np

import tpmscad
from tests.lattices.test_rings import CELL, OVERLAPS, count_euler_characteristic
from tpmscad import maps, surfaces
from tpmscad.errors import InvalidRequest
from tpmscad.lattices import copies
from tpmscad.lattices.mapped_surface import MappedSurface, find_closed_axes

TOL = 0.01
THICKNESS = 1.0


def rings() -> None:
    """Gyroid, diamond and Schwarz P, 4, 6 and 12 cells around."""
    for name in ("gyroid", "diamond", "schwarz_p"):
        for count in (4, 6, 12):
            row(name, (count, 1, 1), maps.cylinder(count * CELL / (2 * np.pi)))


def pipe() -> None:
    """A pipe whose wall is two layers of gyroid cells, twelve around and two high."""
    row("gyroid", (12, 2, 2), maps.cylinder(12 * CELL / (2 * np.pi)))


def dome() -> None:
    """Half a sphere with a round rim, and a closed band around the equator, 90 degrees high."""
    for count in (4, 6):
        row("schwarz_p", (count, count, 1), maps.sphere(count * CELL / np.pi), boundary="box")
    row("gyroid", (12, 3, 1), maps.sphere(12 * CELL / (2 * np.pi), chart="equator"))


def refusals() -> None:
    """Maps under which the lattice overlaps itself, or that fold."""
    fold = maps.Map(lambda p: p + 8 * np.sin(0.5 * p), name="a shear that folds over")
    for name, (map, cells, _) in {**OVERLAPS, "a shear that folds over": (fold, (2, 1, 1), "")}.items():
        start = perf_counter()
        try:
            tpmscad.lattice("schwarz_p", cell=CELL, cells=cells, thickness=0.1, map=map, boundary="natural", tol=0.3)
            said = "MADE"
        except InvalidRequest as error:
            said = str(error)
        print(f"{name}: {perf_counter() - start:.1f} s: {said}")


def row(name: str, cells: tuple[int, int, int], map: maps.Map, boundary: str = "natural") -> Any:
    """Make the lattice and print one line; tunnels and volume of a trimmed one are not counted."""
    start = perf_counter()
    model = tpmscad.lattice(
        name, cell=CELL, cells=cells, thickness=THICKNESS, map=map, boundary=boundary, tol=TOL, phase=(0, 0, 0)
    )
    seconds, c = perf_counter() - start, model.certificate
    map = map.over_block(CELL * np.array(cells))
    closed = find_closed_axes(map, cells, CELL)
    natural = boundary == "natural"
    tunnels = 1 - count_euler_characteristic(name, cells, closed) if natural else "-"
    volume = integrate_offsets(name, cells, closed, map) if natural else float("nan")
    print(
        f"{name:10} {'x'.join(str(n) for n in cells):8} met {c.met} closed {c.closed} valid {c.valid} faces {c.n_faces:5} "
        f"primitives {c.n_primitives:4} betti {c.betti} counted (1, {tunnels}, 0) "
        f"deviation {c.max_deviation:.2g} gap {c.gap:.1e} volume {c.volume:.6g} ({c.volume / volume - 1:+.1e}) {seconds:.1f} s"
    )
    for shortfall in c.shortfalls:
        print("   ", shortfall)
    return model


def integrate_offsets(
    name: str, cells: tuple[int, int, int], closed: tuple[bool, bool, bool], map: maps.Map, nodes: int = 10
) -> float:
    """The volume between the exact offsets over a natural block: Gauss quadrature of the triple product of the tangents."""
    placements = copies.place_whole_cells(name, cells, np.zeros(3), closed)
    mapped = MappedSurface(surfaces.primitive_patch(name), surfaces.patch_symmetry(name), placements, map, CELL)
    t, w = np.polynomial.legendre.leggauss(nodes)
    t, w = (t + 1) / 2, w / 2
    u, v = (g.ravel() for g in np.meshgrid(t, t, indexing="ij"))
    weights, h, total = np.outer(w, w).ravel(), 1e-5, 0.0
    heights, shares = np.polynomial.legendre.leggauss(3)
    for height, share in zip(THICKNESS / 2 * heights, THICKNESS / 2 * shares, strict=True):
        along_u = (mapped.offset(u + h, v, height) - mapped.offset(u - h, v, height)) / (2 * h)
        along_v = (mapped.offset(u, v + h, height) - mapped.offset(u, v - h, height)) / (2 * h)
        out = mapped.points(u, v).normal
        total += share * float((np.abs(np.einsum("pni,pni->pn", np.cross(along_u, along_v), out)) * weights).sum())
    return total


if __name__ == "__main__":
    for part in sys.argv[1:] or ["rings", "pipe", "dome", "refusals"]:
        {"rings": rings, "pipe": pipe, "dome": dome, "refusals": refusals}[part]()
